"""What a writer has to keep of each chunk until its file is finished, in few bytes.

A recording of an hour has 90,000 chunks. As objects they would take more than 100 MB by then.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from mcap.records import ChunkIndex

from mfpcc_experiments.bags.disk.mcap_format import RECORD_HEAD

#: Of a message index, before its entries: channel, and the bytes that they take.
INDEX_HEAD = struct.Struct("<HI")
#: Bytes of an entry: log time and offset.
INDEX_ENTRY = 16

_FIXED = struct.Struct("<QIQQQQQH")  # as of `WrittenChunk`, and the number of its channels
_COUNT = struct.Struct("<HQ")  # channel, messages


@dataclass(frozen=True)
class WrittenChunk:
    """
    Where a chunk lies in its file.

    Attributes
    ----------
    offset, crc : int
        Length and checksum of the file before it.
    start, end : int
        First and last log time (ns).
    length : int
        Bytes of its record; its message indexes follow in the order of `counts`.
    packed, size : int
        Bytes of its messages, compressed and not.
    counts : dict of int
        Messages per channel id.
    """

    offset: int
    crc: int
    start: int
    end: int
    length: int
    packed: int
    size: int
    counts: dict[int, int]

    def record(self, compression: str) -> ChunkIndex:
        """The chunk's record in the summary of a file."""
        offsets = {}
        behind = position = self.offset + self.length
        for channel_id, count in self.counts.items():
            offsets[channel_id] = position
            position += RECORD_HEAD.size + INDEX_HEAD.size + INDEX_ENTRY * count
        return ChunkIndex(
            message_start_time=self.start,
            message_end_time=self.end,
            chunk_start_offset=self.offset,
            chunk_length=self.length,
            message_index_offsets=offsets,
            message_index_length=position - behind,
            compression=compression,
            compressed_size=self.packed,
            uncompressed_size=self.size,
        )


def _chunk(fixed: list[int], counts: bytearray) -> WrittenChunk:
    offset, crc, start, end, length, packed, size = fixed
    by_channel = dict(_COUNT.iter_unpack(counts))
    return WrittenChunk(offset, crc, start, end, length, packed, size, by_channel)


class ChunkList:
    """The chunks of a file in their order, some 90 bytes each; grows and shrinks at its end."""

    def __init__(self) -> None:
        self._fixed = bytearray()
        self._counts = bytearray()

    def __len__(self) -> int:
        return len(self._fixed) // _FIXED.size

    def __iter__(self) -> Iterator[WrittenChunk]:
        position = 0
        for *values, channels in _FIXED.iter_unpack(self._fixed):
            end = position + channels * _COUNT.size
            yield _chunk(values, self._counts[position:end])
            position = end

    def append(self, chunk: WrittenChunk) -> None:
        """Add the chunk that was written last."""
        self._fixed += _FIXED.pack(
            chunk.offset,
            chunk.crc,
            chunk.start,
            chunk.end,
            chunk.length,
            chunk.packed,
            chunk.size,
            len(chunk.counts),
        )
        for entry in chunk.counts.items():
            self._counts += _COUNT.pack(*entry)

    def pop(self) -> WrittenChunk:
        """Remove the last chunk, and return it."""
        *values, channels = _FIXED.unpack(self._fixed[-_FIXED.size :])
        begin = len(self._counts) - channels * _COUNT.size
        chunk = _chunk(values, self._counts[begin:])
        del self._fixed[-_FIXED.size :], self._counts[begin:]
        return chunk

"""What a writer has to keep of each chunk until its file is finished, in few bytes.

A recording of an hour has 90,000 chunks. As records they would take more than 100 MB by then.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from mcap.records import ChunkIndex

from mfpcc_experiments.bags.disk.mcap_format import RECORD_HEAD

#: Of a message index, before its entries: channel, and the bytes that they take.
INDEX_HEAD = struct.Struct("<HI")
#: Bytes of an entry: log time and offset.
INDEX_ENTRY = 16

_FIXED = struct.Struct("<QIQQQQQ")  # as of `WrittenChunk`
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

    def kept(self) -> bytes:
        """As it is kept."""
        fixed = _FIXED.pack(
            self.offset, self.crc, self.start, self.end, self.length, self.packed, self.size
        )
        return fixed + b"".join(_COUNT.pack(*entry) for entry in self.counts.items())

    @classmethod
    def from_kept(cls, data: bytes) -> WrittenChunk:
        """What was kept."""
        offset, crc, start, end, length, packed, size = _FIXED.unpack_from(data)
        counts = dict(_COUNT.iter_unpack(data[_FIXED.size :]))
        return cls(offset, crc, start, end, length, packed, size, counts)

"""
The bytes of MCAP: heads of records, chunks packed and unpacked, the messages in them.

Nothing in a file is trusted: every length is held against the bytes that are really there before
anything of that size is made, and every checksum that a file has is checked.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import McapRecord
from numpy.typing import NDArray

from mfpcc_experiments.bags.errors import BagError, DamagedError

MAGIC = b"\x89MCAP0\r\n"

#: Opcode and length, before the content of every record.
RECORD_HEAD = struct.Struct("<BQ")
#: Opcode, length, channel, sequence, log time, publish time: what precedes the data of a message.
MESSAGE_HEAD = struct.Struct("<BQHIQQ")
#: Of these, the bytes that the length of the record counts.
MESSAGE_FIELDS = MESSAGE_HEAD.size - RECORD_HEAD.size
#: First and last log time, size and checksum of the records, length of the compression's name.
CHUNK_HEAD = struct.Struct("<QQQII")
#: Begin of the summary and of its index, checksum.
FOOTER = struct.Struct("<QQI")

#: Largest chunk that is unpacked (bytes): a hundred times what writers make.
MAX_CHUNK = 256 << 20

_PIECE = 1 << 20  # bytes that are unpacked at a time


def encode(record: McapRecord) -> bytes:
    """A record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def parse(kind: Any, content: bytes, path: Path) -> Any:
    """
    Parse a record of the `mcap` library from the content of a record.

    Parameters
    ----------
    kind : type
        E.g. `mcap.records.Channel`.
    content : bytes
        Content of the record.
    path : Path
        File, for messages.
    """
    try:
        return kind.read(ReadDataStream(BytesIO(content)))
    except (EndOfFile, struct.error, ValueError):
        raise DamagedError(f"{path}: a {kind.__name__.lower()} record is damaged") from None


def unpack_chunk(content: bytes, path: Path) -> bytes:
    """
    Unpack a chunk record.

    Parameters
    ----------
    content : bytes
        Content of the record.
    path : Path
        File, for messages.

    Returns
    -------
    bytes
        The records in the chunk.

    Raises
    ------
    DamagedError
        If it cannot be unpacked, or its size or checksum is wrong.
    """
    if len(content) < CHUNK_HEAD.size + 8:
        raise _damaged_chunk(path, "too short")
    _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(content)
    begin = CHUNK_HEAD.size + name_length
    name = content[CHUNK_HEAD.size : begin]
    if name_length > 16 or len(content) < begin + 8:
        raise _damaged_chunk(path, "too short")
    (packed_size,) = struct.unpack_from("<Q", content, begin)
    packed = memoryview(content)[begin + 8 :]
    if packed_size != len(packed):
        raise _damaged_chunk(path, "wrong size")
    if size > MAX_CHUNK:
        raise _damaged_chunk(path, f"claims to hold {size} bytes")
    try:
        data = _unpack(bytes(name), packed, size)
    except (RuntimeError, ValueError, EOFError, MemoryError, zstandard.ZstdError) as error:
        raise _damaged_chunk(path, str(error)) from None
    if data is None:
        raise BagError(
            f"{path}: chunks are compressed with '{name.decode('ascii', 'replace')}'; "
            "only lz4, zstd and none are known"
        )
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        raise _damaged_chunk(path, "the checksum does not match")
    return data


def _unpack(name: bytes, packed: memoryview, size: int) -> bytes | None:
    """Decompress at most `size` bytes, whatever the compressed data say of themselves.

    In pieces, so that it takes the memory of what is there, not of what is claimed.
    """
    if name == b"":
        return bytes(packed)
    data = bytearray()
    if name == b"lz4":
        frame = lz4.frame.LZ4FrameDecompressor()
        rest: memoryview | bytes = packed
        while len(data) < size and not frame.eof:
            piece = frame.decompress(rest, max_length=min(size - len(data), _PIECE))
            if not (piece or rest):
                break
            data += piece
            rest = b""  # it keeps what it has not used yet
    elif name == b"zstd":
        with zstandard.ZstdDecompressor().stream_reader(packed) as reader:
            while piece := reader.read(min(size - len(data), _PIECE)):
                data += piece
    else:
        return None
    return bytes(data)


def _damaged_chunk(path: Path, reason: str) -> DamagedError:
    return DamagedError(
        f"{path}: a part of the file is damaged ({reason}). "
        f"'mfpcc recover {path}' saves the parts that are whole"
    )


@dataclass(frozen=True)
class Messages:
    """
    Where the messages of some bytes lie.

    Attributes
    ----------
    channel_id : ndarray of uint16
    log_time : ndarray of uint64
        (ns)
    begin, end : ndarray of int64
        Of the serialized message, without the head of its record.
    """

    channel_id: NDArray[np.uint16]
    log_time: NDArray[np.uint64]
    begin: NDArray[np.int64]
    end: NDArray[np.int64]


_HEAD_DTYPE = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel_id", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)


def walk(data: bytes, path: Path) -> tuple[list[tuple[int, int, int]], Messages]:
    """
    Walk through the records of a chunk.

    Parameters
    ----------
    data : bytes
        The unpacked chunk.
    path : Path
        File, for messages.

    Returns
    -------
    others : list of (int, int, int)
        Opcode, begin and end of the content of each record that is no message.
    messages : Messages
        In the order of the chunk.

    Raises
    ------
    DamagedError
        If the records do not fill the chunk.
    """
    others: list[tuple[int, int, int]] = []
    starts: list[int] = []
    position, size = 0, len(data)
    unpack, last = RECORD_HEAD.unpack_from, size - RECORD_HEAD.size
    message = int(Opcode.MESSAGE)
    while position <= last:
        opcode, length = unpack(data, position)
        if opcode == message:
            if length < MESSAGE_FIELDS:
                raise _damaged_chunk(path, "a message is cut")
            starts.append(position)
        else:
            others.append((opcode, position + 9, position + 9 + length))
        position += 9 + length
    if position != size:
        raise _damaged_chunk(path, "a record is cut")
    begin = np.array(starts, np.int64)
    raw = np.frombuffer(data, np.uint8)
    heads = raw[begin[:, None] + np.arange(_HEAD_DTYPE.itemsize)].reshape(-1).view(_HEAD_DTYPE)
    return others, Messages(
        channel_id=heads["channel_id"].copy(),
        log_time=heads["log_time"].copy(),
        begin=begin + _HEAD_DTYPE.itemsize,
        end=begin + 9 + heads["length"].astype(np.int64),
    )

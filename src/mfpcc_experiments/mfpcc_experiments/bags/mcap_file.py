"""
Reading MCAP files record by record, trusting nothing in them.

Only the data section is used, from front to back: the index at the end of a file is a copy, which a
recording whose writer was killed does not have. Every length is held against the bytes that are
really there before anything of that size is made, and every checksum that a file has is checked.
"""

from __future__ import annotations

import fcntl
import json
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema, Statistics
from numpy.typing import NDArray

from mfpcc_experiments.bags.bag import MAGIC, BagError

#: Largest chunk that is unpacked (bytes): a hundred times what writers make.
MAX_CHUNK = 256 << 20

_PIECE = 1 << 20  # bytes that are unpacked at a time

_RECORD_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_FOOTER = struct.Struct("<QQI")  # begin of the summary, of its index, checksum


class UnfinishedError(BagError):
    """A file that ends in the middle: its writer was killed, or it was cut."""


class DamagedError(BagError):
    """A file whose bytes are not those that were written."""


@dataclass(frozen=True)
class Record:
    """
    One record of the data section.

    Attributes
    ----------
    opcode : int
        Kind of the record.
    content : bytes
        What follows its length.
    end : int
        Offset in the file behind the record.
    """

    opcode: int
    content: bytes
    end: int


def records(path: Path) -> Iterator[Record]:
    """
    Read the data section of a file.

    Parameters
    ----------
    path : Path
        An MCAP file.

    Yields
    ------
    Record
        In the order of the file. The iteration ends without an error only behind a whole data
        section, with its checksum right where there is one, that is followed by a footer.

    Raises
    ------
    BagError
        In the text: what is wrong, where, and what to do.
    """
    try:
        size = os.path.getsize(path)
        with open(path, "rb") as file:
            yield from _records(file, size, path)
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from None


def _records(file: Any, size: int, path: Path) -> Iterator[Record]:
    if size == 0:
        raise UnfinishedError(f"{path}: the file is empty")
    start = file.read(len(MAGIC))
    if start != MAGIC:
        if MAGIC.startswith(start):
            raise UnfinishedError(f"{path}: the file ends within its first bytes")
        raise BagError(f"{path}: this is no MCAP file")
    crc = zlib.crc32(start)
    offset = len(start)
    while True:
        head = file.read(_RECORD_HEAD.size)
        if len(head) < _RECORD_HEAD.size:
            raise _unfinished(path)
        opcode, length = _RECORD_HEAD.unpack(head)
        if length > size - offset - len(head):
            raise _unfinished(path)
        content = file.read(length)
        if len(content) < length:
            raise _unfinished(path)
        offset += len(head) + length
        if opcode == Opcode.DATA_END:
            stored = int.from_bytes(content[:4], "little")
            if stored and stored != crc:
                raise DamagedError(
                    f"{path}: the file is damaged: its checksum does not match. "
                    f"'mfpcc recover {path}' saves the parts that are whole"
                )
            break
        if opcode in (0, Opcode.FOOTER):
            raise DamagedError(f"{path}: the file is damaged at byte {offset - length}")
        crc = zlib.crc32(content, zlib.crc32(head, crc))
        yield Record(opcode, content, offset)
    # The footer and the magic close a file; without them the summary was cut.
    file.seek(max(offset, size - len(MAGIC)))
    if file.read() != MAGIC:
        raise _unfinished(path)


def summary(path: Path) -> Iterator[Record]:
    """
    Read the copy of schemas and channels (and more) at the end of a file.

    Parameters
    ----------
    path : Path
        An MCAP file.

    Yields
    ------
    Record
        In the order of the file; none where there is no whole summary.
    """
    tail = _RECORD_HEAD.size + _FOOTER.size + len(MAGIC)
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        if size < len(MAGIC) + tail:
            return
        file.seek(size - tail)
        footer = file.read()
        opcode, length = _RECORD_HEAD.unpack_from(footer)
        begin, _, crc = _FOOTER.unpack_from(footer, _RECORD_HEAD.size)
        if (opcode, length, footer[-len(MAGIC) :]) != (Opcode.FOOTER, _FOOTER.size, MAGIC):
            return
        if not 0 < begin <= size - tail or size - begin > MAX_CHUNK:
            return
        file.seek(begin)
        data = file.read(size - tail - begin)
    if crc and crc != zlib.crc32(footer[: _RECORD_HEAD.size + _FOOTER.size - 4], zlib.crc32(data)):
        return
    position = 0
    while len(data) - position >= _RECORD_HEAD.size:
        opcode, length = _RECORD_HEAD.unpack_from(data, position)
        content = position + _RECORD_HEAD.size
        position = content + length
        yield Record(opcode, data[content:position], begin + position)


def message_count(path: Path) -> int | None:
    """Messages that the statistics at the end of a file tell of; None where there are none."""
    for record in summary(path):
        if record.opcode == Opcode.STATISTICS:
            return int(parse(Statistics, record.content, path).message_count)
    return None


def is_being_written(path: Path) -> bool:
    """Whether a writer of this project has the file open, here or in another process."""
    try:
        with open(path, "rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False  # a file system without locks cannot tell
    return False


def _unfinished(path: Path) -> UnfinishedError:
    if is_being_written(path):
        return UnfinishedError(f"{path}: is being written at this moment; read it when it is done")
    return UnfinishedError(
        f"{path}: the recording was not finished, or was cut (was its writer killed?). "
        f"'mfpcc recover {path}' repairs it"
    )


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
    if len(content) < _CHUNK_HEAD.size + 8:
        raise _damaged_chunk(path, "too short")
    _, _, size, crc, name_length = _CHUNK_HEAD.unpack_from(content)
    begin = _CHUNK_HEAD.size + name_length
    name = content[_CHUNK_HEAD.size : begin]
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
class Topic:
    """
    One channel of a file.

    Attributes
    ----------
    name : str
        Topic name.
    type_name : str
        Message type.
    definition : str
        Its definition as stored, or an empty text.
    encoding : str
        Message encoding, e.g. ``cdr``.
    definition_encoding : str
        E.g. ``ros2msg``.
    """

    name: str
    type_name: str
    definition: str
    encoding: str
    definition_encoding: str = "ros2msg"


class Channels:
    """
    The schemas and channels seen so far in a file.

    Parameters
    ----------
    path : Path
        File, for messages.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}

    def see(self, opcode: int, content: bytes) -> None:
        """Take note of a record, if it is a schema or a channel."""
        if opcode == Opcode.SCHEMA:
            schema = parse(Schema, content, self.path)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse(Channel, content, self.path)
            self.channels[channel.id] = channel

    def topic(self, channel_id: int) -> Topic:
        """Return what is known of a channel that a message names."""
        channel = self.channels.get(channel_id)
        if channel is None:
            raise DamagedError(f"{self.path}: a message belongs to channel {channel_id}, unknown")
        schema = self.schemas.get(channel.schema_id)
        if schema is None:
            return Topic(channel.topic, "", "", channel.message_encoding)
        text = schema.data.decode("utf-8", "replace")
        return Topic(channel.topic, schema.name, text, channel.message_encoding, schema.encoding)


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


def metadata(record: Record, path: Path) -> tuple[str, Any]:
    """
    Read a metadata record; one written by `bag.json_record` gives its value.

    Parameters
    ----------
    record : Record
        A metadata record.
    path : Path
        File, for messages.

    Returns
    -------
    name : str
        Name of the record.
    value : Any
        The JSON value, or the record's entries.
    """
    name, entries = metadata_entries(record, path)
    text = entries.get("json")
    if text is None or "crc32" not in entries:
        return name, entries
    try:
        if f"{zlib.crc32(text.encode()):08x}" != entries["crc32"]:
            raise ValueError
        return name, json.loads(text)
    except (ValueError, RecursionError):
        raise DamagedError(f"{path}: the stored configuration is damaged") from None


def metadata_entries(record: Record, path: Path) -> tuple[str, dict[str, str]]:
    """Name and entries of a metadata record, as they stand."""
    entry = parse(Metadata, record.content, path)
    return entry.name, entry.metadata


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
    unpack, last = _RECORD_HEAD.unpack_from, size - _RECORD_HEAD.size
    while position <= last:
        opcode, length = unpack(data, position)
        if opcode == 5:
            if length < 22:
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

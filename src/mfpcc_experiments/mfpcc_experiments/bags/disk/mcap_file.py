"""
Reading MCAP files record by record, trusting nothing in them.

Only the data section is used, from front to back: the index at the end of a file is a copy, which a
recording whose writer was killed does not have.
"""

from __future__ import annotations

import fcntl
import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema, Statistics

from mfpcc_experiments.bags.disk.mcap_format import (
    FOOTER,
    MAGIC,
    MAX_CHUNK,
    RECORD_HEAD,
    Messages,
    parse,
    unpack_chunk,
    walk,
)
from mfpcc_experiments.bags.errors import BagError, DamagedError, UnfinishedError
from mfpcc_experiments.bags.provenance import json_value

# Messages that lie outside of chunks are gathered to so many bytes.
_GATHERED = 1 << 20


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
        head = file.read(RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            raise _unfinished(path)
        opcode, length = RECORD_HEAD.unpack(head)
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
    tail = RECORD_HEAD.size + FOOTER.size
    footer_at = size - tail - len(MAGIC)
    file.seek(max(offset, footer_at))
    footer = file.read()
    if footer[-len(MAGIC) :] != MAGIC:
        raise _unfinished(path)
    begin, _, _ = FOOTER.unpack_from(footer, RECORD_HEAD.size) if footer_at >= offset else (-1,) * 3
    # The summary, or else the footer, stands right behind the data. What stands between them, such
    # as another recording, would be read by nobody.
    if offset != (begin or footer_at):
        raise DamagedError(
            f"{path}: what follows the recording from byte {offset} on does not belong to it (were "
            f"files joined?). 'mfpcc recover {path}' keeps the recording before it"
        )


def blocks(path: Path) -> Iterator[Record]:
    """
    Read the data section of a file as `records` does, with its messages in blocks.

    Parameters
    ----------
    path : Path
        An MCAP file.

    Yields
    ------
    Record
        Those of chunks and, where messages lie outside of chunks, records of the kind MESSAGE whose
        content is many whole records of messages; `block` opens both. Others as they stand.

    Raises
    ------
    BagError
        As of `records`, behind the last block that could be read.
    """
    gathered, end = bytearray(), 0
    try:
        for record in records(path):
            if record.opcode == Opcode.MESSAGE:
                gathered += RECORD_HEAD.pack(record.opcode, len(record.content)) + record.content
                end = record.end
                if len(gathered) < _GATHERED:
                    continue
            if gathered:
                yield Record(Opcode.MESSAGE, bytes(gathered), end)
                gathered.clear()
            if record.opcode != Opcode.MESSAGE:
                yield record
    except BagError:
        if gathered:
            yield Record(Opcode.MESSAGE, bytes(gathered), end)
        raise
    if gathered:
        yield Record(Opcode.MESSAGE, bytes(gathered), end)


@dataclass(frozen=True)
class Block:
    """
    Messages that lie together in a file.

    Attributes
    ----------
    data : bytes
        Records, unpacked.
    messages : Messages
        Where the messages lie in it.
    channels : set of int
        Ids of the channels that are described in it.
    """

    data: bytes
    messages: Messages
    channels: set[int]


def block(record: Record, channels: Channels) -> Block:
    """
    Open a chunk, or messages that `blocks` has gathered.

    Parameters
    ----------
    record : Record
        Of the kind CHUNK or MESSAGE.
    channels : Channels
        Takes note of what the block says of channels.

    Raises
    ------
    DamagedError
        If it is not what was written.
    """
    packed = record.opcode == Opcode.CHUNK
    data = unpack_chunk(record.content, channels.path) if packed else record.content
    others, messages = walk(data, channels.path)
    described = set()
    for opcode, begin, end in others:
        channels.see(opcode, data[begin:end])
        if opcode == Opcode.CHANNEL:
            described.add(int.from_bytes(data[begin : begin + 2], "little"))
    return Block(data, messages, described)


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
    tail = RECORD_HEAD.size + FOOTER.size + len(MAGIC)
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        if size < len(MAGIC) + tail:
            return
        file.seek(size - tail)
        footer = file.read()
        opcode, length = RECORD_HEAD.unpack_from(footer)
        begin, _, crc = FOOTER.unpack_from(footer, RECORD_HEAD.size)
        if (opcode, length, footer[-len(MAGIC) :]) != (Opcode.FOOTER, FOOTER.size, MAGIC):
            return
        if not 0 < begin <= size - tail or size - begin > MAX_CHUNK:
            return
        file.seek(begin)
        data = file.read(size - tail - begin)
    if crc and crc != zlib.crc32(footer[: RECORD_HEAD.size + FOOTER.size - 4], zlib.crc32(data)):
        return
    position = 0
    while len(data) - position >= RECORD_HEAD.size:
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        content = position + RECORD_HEAD.size
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


def metadata(record: Record, path: Path) -> tuple[str, dict[str, str], Any]:
    """
    Read a metadata record.

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
    entries : dict
        As they stand.
    value : Any
        What they say, see `provenance.json_value`.
    """
    entry = parse(Metadata, record.content, path)
    try:
        return entry.name, entry.metadata, json_value(entry.metadata)
    except ValueError:
        raise DamagedError(f"{path}: the stored configuration is damaged") from None

"""
Reading the files of bags, whatever they are stored in: messages by topic, and what else there is.

MCAP, sqlite3, either of them packed as a whole, and messages that are packed one by one, as
rosbag2 has all of these. Each file comes in pieces of bounded size.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.opcode import Opcode
from numpy.typing import NDArray

from mfpcc_experiments.bags.disk import mcap_file
from mfpcc_experiments.bags.disk.mcap_file import Topic
from mfpcc_experiments.bags.disk.mcap_format import MAGIC
from mfpcc_experiments.bags.errors import BagError, DamagedError, UnfinishedError
from mfpcc_experiments.scratch import scratch

_ZSTD = b"\x28\xb5\x2f\xfd"
_SQLITE = b"SQLite format 3\0"

#: Largest message that is unpacked (bytes).
MAX_MESSAGE = 64 << 20

_ROWS = 10_000  # messages at a time that do not lie in a chunk
_PIECE = 1 << 20  # bytes

Wanted = Callable[[Topic], bool]
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Batch:
    """Some messages of one topic, in the order of the file."""

    topic: Topic
    messages: list[bytes]
    log_time: NDArray[np.int64]


@dataclass(frozen=True)
class Entry:
    """A metadata record of a file."""

    name: str
    value: Any


@dataclass(frozen=True)
class Counts:
    """Messages of a file: how many there are by topic, and how many its own summary tells of."""

    found: dict[str, int]
    stated: int | None


def contents(
    file: Path, wanted: Wanted, progress: Progress | None = None
) -> Iterator[Batch | Entry | Counts]:
    """
    Read one file of a bag.

    Parameters
    ----------
    file : Path
        File.
    wanted : callable
        Whether the messages of a topic are.
    progress : callable, optional
        Told the share that is done, 0 to 1.

    Yields
    ------
    Batch, Entry, Counts
        Messages of the wanted topics, metadata, and at the end the counts of all topics.

    Raises
    ------
    BagError
        If it cannot be read.
    """
    try:
        with open(file, "rb") as stream:
            start = stream.read(len(_SQLITE))
        if start.startswith(_ZSTD):
            with _unpacked(file) as plain:
                try:
                    yield from contents(plain, wanted, progress)
                except BagError as error:  # it speaks of a file that is gone by then
                    raise type(error)(str(error).replace(str(plain), str(file))) from None
        elif start == _SQLITE:
            yield from _sqlite(file, wanted)
        elif file.name.removesuffix(".zstd").endswith(".db3") and not start.startswith(MAGIC):
            raise BagError(f"{file}: this is no sqlite3 database")
        else:
            yield from _mcap(file, wanted, progress)
    except OSError as error:
        raise BagError(f"{error.filename or file}: {error.strerror}") from None


@contextmanager
def _unpacked(file: Path) -> Iterator[Path]:
    """A file that is packed as a whole, unpacked as long as it is needed."""
    with scratch("mfpcc-unpacked-") as folder:
        plain = folder / (file.name.removesuffix(".zstd") or "bag")
        try:
            with open(file, "rb") as packed, open(plain, "wb") as out:
                reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
                while piece := reader.read(_PIECE):
                    if piece.startswith(_ZSTD) and out.tell() == 0:
                        raise BagError(f"{file}: is packed more than once")
                    out.write(piece)
        except zstandard.ZstdError as error:
            raise DamagedError(f"{file}: the file is damaged: {error}") from None
        yield plain


# --- MCAP --------------------------------------------------------------------------------------


def _mcap(
    file: Path, wanted: Wanted, progress: Progress | None
) -> Iterator[Batch | Entry | Counts]:
    channels = mcap_file.Channels(file)
    counter = _Counter()
    total = file.stat().st_size or 1
    for record in mcap_file.blocks(file):
        if record.opcode in (Opcode.CHUNK, Opcode.MESSAGE):
            block = mcap_file.block(record, channels)
            yield from _mcap_messages(block, channels, wanted, counter)
            if progress is not None:
                progress(record.end / total)
        elif record.opcode == Opcode.METADATA:
            name, _, value = mcap_file.metadata(record, file)
            yield Entry(name, value)
        else:
            channels.see(record.opcode, record.content)
    yield Counts(counter.found, mcap_file.message_count(file))


class _Counter:
    """Counts the messages of topics."""

    def __init__(self) -> None:
        self.found: dict[str, int] = {}

    def add(self, topic: str, count: int) -> None:
        self.found[topic] = self.found.get(topic, 0) + count


def _mcap_messages(
    block: mcap_file.Block, channels: mcap_file.Channels, wanted: Wanted, counter: _Counter
) -> Iterator[Batch]:
    """Sort the messages of a block by topic."""
    data, messages = block.data, block.messages
    for channel_id in np.unique(messages.channel_id).tolist():
        topic = channels.topic(channel_id)
        rows = np.flatnonzero(messages.channel_id == channel_id)
        counter.add(topic.name, len(rows))
        if wanted(topic):
            begins, ends = messages.begin[rows].tolist(), messages.end[rows].tolist()
            parts = [data[begin:end] for begin, end in zip(begins, ends, strict=True)]
            yield Batch(
                topic, plain_messages(parts, channels.path), _times(messages.log_time[rows])
            )


def _times(log_time: NDArray[np.uint64]) -> NDArray[np.int64]:
    """Times that sort as they stand, also where they are beyond what rosbag2 can hold."""
    return np.minimum(log_time, np.uint64(2**63 - 1)).astype(np.int64)


def plain_messages(messages: list[bytes], file: Path) -> list[bytes]:
    """Unpack messages that are packed one by one; a message itself never begins so."""
    if not any(message.startswith(_ZSTD) for message in messages):
        return messages
    unpacker = zstandard.ZstdDecompressor()
    try:
        return [
            unpacker.decompress(message, max_output_size=MAX_MESSAGE)
            if message.startswith(_ZSTD) and zstandard.frame_content_size(message) <= MAX_MESSAGE
            else message
            for message in messages
        ]
    except zstandard.ZstdError as error:
        raise DamagedError(f"{file}: a packed message is damaged: {error}") from None


# --- sqlite3 -----------------------------------------------------------------------------------


def _sqlite(file: Path, wanted: Wanted) -> Iterator[Batch | Entry | Counts]:
    for suffix in ("-wal", "-journal"):
        beside = file.with_name(file.name + suffix)
        if beside.is_file() and beside.stat().st_size:
            raise UnfinishedError(
                f"{file}: has changes that were not finished, in {beside.name}: it is being "
                "written, or its writer was killed. 'sqlite3 FILE .schema' finishes them"
            )
    with open(file, "rb") as stream:
        head = stream.read(100)
    page = int.from_bytes(head[16:18], "big")
    pages = int.from_bytes(head[28:32], "big")
    if file.stat().st_size < pages * (65536 if page == 1 else page):
        raise UnfinishedError(f"{file}: the sqlite3 database was cut, or is being written")
    # Nothing is written, not even a lock: a bag may lie in a folder where nobody may.
    address = file.resolve().as_uri() + "?mode=ro&immutable=1"
    try:
        with closing(sqlite3.connect(address, uri=True)) as base:
            base.text_factory = lambda raw: raw.decode("utf-8", "replace")
            yield from _sqlite_contents(base, file, wanted)
    except (sqlite3.Error, OverflowError) as error:
        raise DamagedError(f"{file}: the sqlite3 database cannot be read: {error}") from None


def _sqlite_contents(
    base: sqlite3.Connection, file: Path, wanted: Wanted
) -> Iterator[Batch | Counts]:
    tables = {str(name) for (name,) in base.execute("SELECT name FROM sqlite_master")}
    if not {"messages", "topics"} <= tables:
        raise BagError(f"{file}: this sqlite3 database is no bag")
    definitions: dict[str, tuple[str, str]] = {}
    if "message_definitions" in tables:
        rows = base.execute(
            "SELECT topic_type, encoded_message_definition, encoding FROM message_definitions"
        )
        definitions = {str(kind): (str(text or ""), str(form or "")) for kind, text, form in rows}
    topics: dict[int, Topic] = {}
    for number, name, kind, encoding in base.execute(
        "SELECT id, name, type, serialization_format FROM topics"
    ):
        text, form = definitions.get(str(kind), ("", ""))
        topics[number] = Topic(str(name), str(kind), text, str(encoding), form or "ros2msg")
    counter = _Counter()
    for number, count in base.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"):
        if number not in topics:
            raise DamagedError(f"{file}: a message belongs to topic {number}, unknown")
        counter.add(topics[number].name, int(count))
    for number, topic in topics.items():
        if topic.name in counter.found and wanted(topic):
            yield from _sqlite_topic(base, file, number, topic)
    stated = None
    if "metadata" in tables:  # written when the bag was closed
        with suppress(sqlite3.Error):
            stated = _stated(base)
    yield Counts(counter.found, stated)


def _sqlite_topic(
    base: sqlite3.Connection, file: Path, number: int, topic: Topic
) -> Iterator[Batch]:
    cursor = base.execute(
        "SELECT timestamp, data FROM messages WHERE topic_id = ? ORDER BY timestamp, id", (number,)
    )
    while rows := cursor.fetchmany(_ROWS):
        times, messages = zip(*rows, strict=True)
        if not all(isinstance(message, bytes) for message in messages):
            raise DamagedError(f"{file}: a message of topic {topic.name} is no message")
        if not all(isinstance(time, int) for time in times):
            raise DamagedError(f"{file}: a message of topic {topic.name} has no time")
        yield Batch(topic, plain_messages(list(messages), file), np.array(times, np.int64))


def _stated(base: sqlite3.Connection) -> int | None:
    """Messages that the database's own metadata tell of, over all parts; None without."""
    import yaml

    last = base.execute("SELECT metadata FROM metadata ORDER BY id DESC LIMIT 1").fetchone()
    try:
        information = yaml.safe_load(last[0])
        one = len(information["relative_file_paths"]) == 1  # of a split bag it tells of all parts
        return int(information["message_count"]) if one else None
    except (TypeError, KeyError, ValueError, yaml.YAMLError):
        return None

"""Writes one recording in all the ways that there are, with writers that are not ours."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
import zstandard
from mcap.writer import CompressionType, IndexType, Writer

from mfpcc_experiments.bags import LOOP_TOPICS
from mfpcc_experiments.bags.definitions import message_definition

Message = tuple[str, int, bytes]

#: What of an index a file has.
INDEXES = {
    "all": IndexType.ALL,
    "chunks": IndexType.CHUNK | IndexType.METADATA,
    "messages": IndexType.MESSAGE,
    "none": IndexType.NONE,
}


@dataclass(frozen=True)
class Kind:
    """How a recording lies on the disk."""

    storage: str = "mcap"
    chunks: str = "lz4"  # or none, zstd, unchunked
    index: str = "all"
    summary: bool = True
    crcs: bool = True
    packed: str = "none"  # or file, message: as rosbag2 compresses
    listed: str = "sorted"  # the parts in metadata.yaml; or reversed, or missing altogether
    name: str = "run"
    namespace: str = "/"
    definitions: str = "ros2msg"


def write(
    folder: Path,
    parts: Sequence[Iterable[Message]],
    kind: Kind,
    metadata: dict[str, dict[str, str]] | None = None,
) -> Path:
    """Write a bag of some parts into a new folder."""
    folder.mkdir()
    parts = [list(part) for part in parts]
    if kind.packed == "message":
        parts = [[(t, at, zstandard.compress(data)) for t, at, data in part] for part in parts]
    files = []
    for n, part in enumerate(parts):
        suffix = {"mcap": "mcap", "sqlite3": "db3"}[kind.storage]
        path = folder / f"{kind.name}_{n}.{suffix}"
        if kind.storage == "mcap":
            # In which part the configuration stands must not matter.
            _mcap(path, part, kind, (metadata or {}) if n == len(parts) - 1 else {}, n)
        else:
            _sqlite(path, part, kind)
        if kind.packed == "file":
            packed = path.with_name(path.name + ".zstd")
            packed.write_bytes(zstandard.compress(path.read_bytes()))
            path.unlink()
            path = packed
        files.append(path.name)
    if kind.listed != "missing":
        _metadata(folder, files if kind.listed == "sorted" else files[::-1], parts, kind)
    return folder


def _mcap(
    path: Path, messages: list[Message], kind: Kind, metadata: dict[str, dict[str, str]], part: int
) -> None:
    compression = {"lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}.get(
        kind.chunks, CompressionType.NONE
    )
    with open(path, "wb") as file:
        writer = Writer(
            file,
            chunk_size=6000,
            compression=compression,
            index_types=INDEXES[kind.index],
            repeat_channels=kind.summary,
            repeat_schemas=kind.summary,
            use_chunking=kind.chunks != "unchunked",
            use_statistics=kind.summary,
            use_summary_offsets=kind.summary,
            enable_crcs=kind.crcs,
        )
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        names = list(LOOP_TOPICS)
        for topic in names[part % 4 :] + names[: part % 4]:  # other ids in each part
            type_name = LOOP_TOPICS[topic]
            schema = writer.register_schema(
                type_name, kind.definitions, message_definition(type_name).encode()
            )
            channels[topic] = writer.register_channel(kind.namespace + topic, "cdr", schema)
        for topic, time, data in messages:
            writer.add_message(channels[topic], time, data, time)
        for name, entries in metadata.items():
            writer.add_metadata(name, entries)
        writer.finish()


def _sqlite(path: Path, messages: list[Message], kind: Kind) -> None:
    """As rosbag2 makes it (schema version 4)."""
    base = sqlite3.connect(path)
    base.executescript(
        """
        CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
        CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL,
                              metadata TEXT NOT NULL);
        CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                            serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
                            type_description_hash TEXT NOT NULL);
        CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL,
                            encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL,
                            type_description_hash TEXT NOT NULL);
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
                              timestamp INTEGER NOT NULL, data BLOB NOT NULL);
        CREATE INDEX timestamp_idx ON messages (timestamp ASC);
        INSERT INTO schema VALUES (4, 'jazzy');
        """
    )
    numbers = {}
    for n, (topic, type_name) in enumerate(LOOP_TOPICS.items(), start=1):
        numbers[topic] = n
        row = (n, kind.namespace + topic, type_name, "cdr", "", "")
        base.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", row)
        text = message_definition(type_name)
        row = (n, type_name, kind.definitions, text, "")
        base.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, ?)", row)
    base.executemany(
        "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
        [(numbers[topic], time, data) for topic, time, data in messages],
    )
    base.commit()
    base.close()


def _metadata(folder: Path, files: list[str], parts: list[list[Message]], kind: Kind) -> None:
    messages = [message for part in parts for message in part]
    times = [time for _, time, _ in messages] or [0]
    information = {
        "version": 9,
        "storage_identifier": kind.storage,
        "duration": {"nanoseconds": max(times) - min(times)},
        "starting_time": {"nanoseconds_since_epoch": min(times)},
        "message_count": len(messages),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": kind.namespace + topic,
                    "type": type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [],
                    "type_description_hash": "",
                },
                "message_count": sum(1 for name, _, _ in messages if name == topic),
            }
            for topic, type_name in LOOP_TOPICS.items()
        ],
        "compression_format": "" if kind.packed == "none" else "zstd",
        "compression_mode": "" if kind.packed == "none" else kind.packed.upper(),
        "relative_file_paths": files,
        "custom_data": {},
        "ros_distro": "jazzy",
    }
    text = yaml.safe_dump({"rosbag2_bagfile_information": information})
    (folder / "metadata.yaml").write_text(text)

"""
Writing recordings: MCAP bags as rosbag2 writes them, at PWM rate.

A bag is a folder with ``<name>_0.mcap`` and ``metadata.yaml``, which ``ros2 bag``, Foxglove,
PlotJuggler and ``rosbags`` open. ``metadata.yaml`` is written last: a folder without it is a
recording that was not finished (`mfpcc recover` finishes it).

How the per-period path stays cheap
-----------------------------------
`BagWriter.write` only appends bytes to the open chunk (below 1 us per message). Everything else,
checksum, compression and the file, happens in a thread of its own, once per chunk; these calls
release the interpreter lock, so the loop goes on meanwhile. At most two chunks wait for that
thread: memory is bounded, and a disk that cannot follow slows the run down instead of losing
messages.

Chunks are closed after 50 ms of recorded time (0.3 to 0.6 MB at 10 kHz). With the open chunk, two
waiting and one being written, a writer that is killed loses at most 0.2 s. They are compressed with
LZ4: on such data, half noise, it takes a third of the time of Zstandard's level 1 and costs a fifth
more bytes.
"""

from __future__ import annotations

import fcntl
import json
import os
import queue
import re
import struct
import threading
import zlib
from array import array
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any

import lz4.frame
import numpy as np
import yaml
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from pwm_node.errors import ForPeople

MAGIC = b"\x89MCAP0\r\n"

#: Topics of the control loop (relative names) and their types.
LOOP_TOPICS = {
    "phase_feedback": "mfpcc_msgs/msg/PhaseFeedback",
    "duty_command": "mfpcc_msgs/msg/DutyCommand",
    "lut_diagnostics": "mfpcc_msgs/msg/LutDiagnostics",
    "drive_state": "mfpcc_msgs/msg/DriveState",
}

#: Names of the metadata records that hold the run's configuration and its summary.
CONFIG_RECORD = "mfpcc_config"
SUMMARY_RECORD = "mfpcc_summary"

#: Recorded time in one chunk (ns); see the head of this file.
CHUNK_NS = 50_000_000
#: A chunk is closed at this size (bytes), whatever its time.
CHUNK_BYTES = 4 << 20
# Log time between two runs of a drive (ns).
_BETWEEN_RUNS = 1_000_000_000
#: Chunks that may wait for the writing thread.
WAITING_CHUNKS = 2

# Opcode, length, channel, sequence, log time, publish time: what precedes the data of a message.
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_CHUNK_HEAD = struct.Struct("<BQQQQI")
_RECORD_HEAD = struct.Struct("<BQ")
_pack_message = _MESSAGE_HEAD.pack


class BagError(ForPeople):
    """
    A recording that cannot be written or read; the text says which, why and what to do.

    It is one line that any terminal can show, whatever the name of a file or topic holds.
    """

    def __init__(self, text: str) -> None:
        super().__init__(printable(text))


def printable(text: str) -> str:
    """`text` with everything escaped that a terminal or a file in UTF-8 cannot show."""
    return "".join(
        c
        if c.isprintable()
        else c.encode("unicode_escape", "backslashreplace").decode()
        if not 0xD800 <= ord(c) <= 0xDFFF
        else f"\\x{ord(c) & 0xFF:02x}"
        for c in text
    )


# --- Message types -----------------------------------------------------------------------------

_FIELD = re.compile(r"^\s*([A-Za-z0-9_/]+)(?:\[[^\]]*\])?\s+[A-Za-z]", re.MULTILINE)
_PRIMITIVES = frozenset(
    f"{kind}{bits}" for kind in ("int", "uint", "float") for bits in (8, 16, 32, 64)
) | {"bool", "byte", "char", "string", "wstring"}


def _share(type_name: str, suffix: str) -> Path:
    """Installed file of a message type (``pkg/msg/Name`` or ``pkg/Name``)."""
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    package, name = type_name.split("/")[0], type_name.split("/")[-1]
    try:
        return Path(get_package_share_directory(package)) / "msg" / f"{name}{suffix}"
    except PackageNotFoundError:
        raise BagError(
            f"the message package '{package}' is not on AMENT_PREFIX_PATH: source setup.bash first"
        ) from None


@lru_cache
def message_definition(type_name: str) -> str:
    """
    Definition of a message type with all it contains, as rosbag2 stores it (``ros2msg``).

    Parameters
    ----------
    type_name : str
        E.g. ``mfpcc_msgs/msg/DriveState``.

    Returns
    -------
    str
        The .msg file, followed by those of the types it uses, each after a line of 80 ``=``.
    """
    seen: set[str] = set()

    def text(name: str) -> str:
        path = _share(name, ".msg")
        try:
            result = path.read_text(encoding="utf-8")
        except OSError as error:
            raise BagError(f"message type {name}: {path}: {error.strerror}") from None
        package = name.split("/")[0]
        used = set(_FIELD.findall(result)) - _PRIMITIVES
        for part in sorted(x if "/" in x else f"{package}/{x}" for x in used):
            if part not in seen:
                seen.add(part)
                result += f"\n{'=' * 80}\nMSG: {part}\n{text(part)}"
        return result

    return text(type_name)


@lru_cache
def type_hash(type_name: str) -> str:
    """
    Return the RIHS01 hash of a message type, or an empty text if its package has none installed.

    Parameters
    ----------
    type_name : str
        E.g. ``mfpcc_msgs/msg/DriveState``.
    """
    try:
        description = json.loads(_share(type_name, ".json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return ""
    for entry in description.get("type_hashes", ()):
        if entry.get("type_name") == type_name:
            return str(entry["hash_string"])
    return ""


# QoS of the loop's topics, as rosbag2 writes it. A player offers it again.
_FOREVER = {"sec": 9223372036, "nsec": 854775807}
_QOS = {
    "history": "keep_all",
    "depth": 0,
    "reliability": "reliable",
    "durability": "volatile",
    "deadline": _FOREVER,
    "lifespan": _FOREVER,
    "liveliness": "automatic",
    "liveliness_lease_duration": _FOREVER,
    "avoid_ros_namespace_conventions": False,
}


class _Dumper(yaml.SafeDumper):
    """YAML as rosbag2 writes it: no anchors for repeated values."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _yaml(data: Any) -> str:
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=10**6)
    return text


# --- The file ----------------------------------------------------------------------------------


@dataclass
class _Chunk:
    """Where a written chunk lies, and the state of the file before it (to take it back)."""

    index: ChunkIndex
    counts: dict[int, int]
    offset: int
    crc: int


@dataclass
class McapSink:
    """
    An MCAP file that grows by whole chunks, and can be finished after any of them.

    Parameters
    ----------
    path : Path
        File; must not exist.

    Attributes
    ----------
    schemas, channels : dict
        Records by id; they must also be in the chunks (see `BagWriter`), here for the summary.
    chunks : list
        The chunks written so far.
    """

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[_Chunk] = field(default_factory=list)

    def __post_init__(self) -> None:
        # No buffer: what was handed over survives the death of the process.
        self._file = open(self.path, "xb", buffering=0)  # noqa: SIM115 (closed by finish)
        with suppress(OSError):  # not every file system has locks
            fcntl.flock(self._file, fcntl.LOCK_EX)  # says that it is being written
        self._offset = 0
        self._crc = 0
        self._metadata: list[MetadataIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._write(MAGIC + encode(Header(profile="ros2", library="mfpcc")))

    def _write(self, data: bytes) -> None:
        """Append all of `data`, or nothing."""
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) :]
        except OSError:
            self._file.truncate(self._offset)
            self._file.seek(self._offset)
            raise
        self._offset += len(data)
        self._crc = zlib.crc32(data, self._crc)

    def metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Append a metadata record."""
        record = encode(Metadata(name=name, metadata=dict(data)))
        index = MetadataIndex(offset=self._offset, length=len(record), name=name)
        self._write(record)
        self._metadata.append(index)

    def attachment(self, content: bytes, attachment: Attachment) -> None:
        """Append an attachment as it stood in another file, where it was read as `attachment`."""
        record = _RECORD_HEAD.pack(Opcode.ATTACHMENT, len(content)) + content
        index = AttachmentIndex(
            offset=self._offset,
            length=len(record),
            log_time=attachment.log_time,
            create_time=attachment.create_time,
            data_size=len(attachment.data),
            name=attachment.name,
            media_type=attachment.media_type,
        )
        self._write(record)
        self._attachments.append(index)

    def record(self, opcode: int, content: bytes) -> None:
        """Append a record that needs no index."""
        self._write(_RECORD_HEAD.pack(opcode, len(content)) + content)

    def chunk(self, records: bytes | bytearray, index: Mapping[int, array[int]]) -> None:
        """
        Append a chunk and its message indexes.

        Parameters
        ----------
        records : bytes
            The records of the chunk.
        index : mapping
            Per channel id the log time (ns) and offset of each message, alternating; layout of the
            MCAP message index.
        """
        packed = lz4.frame.compress(records, content_checksum=False, store_size=True)
        entries = {cid: np.frombuffer(a, np.uint64).reshape(-1, 2) for cid, a in index.items() if a}
        if not entries:
            return
        start = min(int(a[:, 0].min()) for a in entries.values())
        end = max(int(a[:, 0].max()) for a in entries.values())
        body = struct.pack("<I3sQ", 3, b"lz4", len(packed)) + packed
        head = _CHUNK_HEAD.pack(
            Opcode.CHUNK, 28 + len(body), start, end, len(records), zlib.crc32(records)
        )
        parts = [head, body]
        chunk_length = len(head) + len(body)
        position = self._offset + chunk_length
        offsets = {}
        for cid, a in entries.items():
            offsets[cid] = position
            parts.append(struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + a.nbytes, cid, a.nbytes))
            parts.append(a.tobytes())
            position += 15 + a.nbytes
        before = (self._offset, self._crc)
        self._write(b"".join(parts))
        record = ChunkIndex(
            message_start_time=start,
            message_end_time=end,
            chunk_start_offset=before[0],
            chunk_length=chunk_length,
            message_index_offsets=offsets,
            message_index_length=position - before[0] - chunk_length,
            compression="lz4",
            compressed_size=len(packed),
            uncompressed_size=len(records),
        )
        counts = {cid: len(a) for cid, a in entries.items()}
        self.chunks.append(_Chunk(record, counts, *before))

    def take_back(self) -> None:
        """Remove the last chunk and what came after it, to make room on a full disk."""
        chunk = self.chunks.pop()
        self._file.truncate(chunk.offset)
        self._file.seek(chunk.offset)
        self._offset, self._crc = chunk.offset, chunk.crc
        self._metadata = [m for m in self._metadata if m.offset < chunk.offset]
        self._attachments = [a for a in self._attachments if a.offset < chunk.offset]

    @property
    def counts(self) -> dict[int, int]:
        """Messages per channel id."""
        total = dict.fromkeys(self.channels, 0)
        for chunk in self.chunks:
            for cid, count in chunk.counts.items():
                total[cid] += count
        return total

    @property
    def times(self) -> tuple[int, int]:
        """First and last log time (ns); zero for an empty file."""
        if not self.chunks:
            return 0, 0
        return (
            min(c.index.message_start_time for c in self.chunks),
            max(c.index.message_end_time for c in self.chunks),
        )

    def info(self) -> PartInfo:
        """What ``metadata.yaml`` tells of the file."""
        return PartInfo(self.path.name, self.channels, self.schemas, self.counts, self.times)

    def finish(self) -> None:
        """Append the end of the data, the summary and the footer (all or nothing)."""
        end = encode(DataEnd(data_section_crc=self._crc))
        start = self._offset + len(end)
        first, last = self.times
        counts = self.counts
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, list(self.schemas.values())),
            (Opcode.CHANNEL, list(self.channels.values())),
            (
                Opcode.STATISTICS,
                [
                    Statistics(
                        attachment_count=len(self._attachments),
                        channel_count=len(self.channels),
                        channel_message_counts=counts,
                        chunk_count=len(self.chunks),
                        message_count=sum(counts.values()),
                        message_start_time=first,
                        message_end_time=last,
                        metadata_count=len(self._metadata),
                        schema_count=len(self.schemas),
                    )
                ],
            ),
            (Opcode.CHUNK_INDEX, [c.index for c in self.chunks]),
            (Opcode.ATTACHMENT_INDEX, list(self._attachments)),
            (Opcode.METADATA_INDEX, list(self._metadata)),
        ]
        summary = b""
        table = b""
        for opcode, records in groups:
            data = b"".join(encode(record) for record in records)
            if data:
                table += encode(SummaryOffset(opcode, start + len(summary), len(data)))
            summary += data
        footer = Footer(
            summary_start=start, summary_offset_start=start + len(summary), summary_crc=0
        )
        covered = summary + table + encode(footer)[:-4]
        footer.summary_crc = zlib.crc32(covered)
        self._write(end + summary + table + encode(footer) + MAGIC)

    def sync(self) -> None:
        """Have the disk keep what was written."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file as it is."""
        self._file.close()


def encode(record: McapRecord) -> bytes:
    """A record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def json_record(data: Any) -> dict[str, str]:
    """
    Content of a metadata record that holds one JSON value.

    Metadata records carry no checksum of their own, and a recording whose rotor has silently got
    another number of pole pairs is worse than none: so this one does.
    """
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"))
    return {"json": text, "crc32": f"{zlib.crc32(text.encode()):08x}"}


@dataclass(frozen=True)
class PartInfo:
    """What ``metadata.yaml`` tells of one file of a bag."""

    name: str
    channels: Mapping[int, Channel]
    schemas: Mapping[int, Schema]
    counts: Mapping[int, int]
    times: tuple[int, int]

    @property
    def message_count(self) -> int:
        """Messages of the file."""
        return sum(self.counts.values())

    @property
    def span(self) -> dict[str, Any]:
        """First log time and duration, as ``metadata.yaml`` has them."""
        first, last = self.times
        return {
            "starting_time": {"nanoseconds_since_epoch": first},
            "duration": {"nanoseconds": last - first},
        }


def bag_metadata(parts: Sequence[PartInfo], custom: Mapping[str, str]) -> dict[str, Any]:
    """
    Content of ``metadata.yaml`` (rosbag2, version 9).

    Parameters
    ----------
    parts : sequence of PartInfo
        The files of the bag.
    custom : mapping of str
        Free entries (``custom_data``).
    """
    topics: dict[tuple[str, str], dict[str, Any]] = {}
    for part in parts:
        for cid, channel in part.channels.items():
            schema = part.schemas.get(channel.schema_id)
            kind = "" if schema is None else schema.name
            entry = topics.setdefault(
                (channel.topic, kind),
                {
                    "topic_metadata": {
                        "name": channel.topic,
                        "type": kind,
                        "serialization_format": channel.message_encoding,
                        "offered_qos_profiles": _qos(channel),
                        "type_description_hash": channel.metadata.get("topic_type_hash", ""),
                    },
                    "message_count": 0,
                },
            )
            entry["message_count"] += part.counts.get(cid, 0)
    times = [part.times for part in parts if part.message_count] or [(0, 0)]
    first, last = min(begin for begin, _ in times), max(end for _, end in times)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": last - first},
        "starting_time": {"nanoseconds_since_epoch": first},
        "message_count": sum(part.message_count for part in parts),
        "topics_with_message_count": list(topics.values()),
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part.name for part in parts],
        "files": [
            {"path": part.name, **part.span, "message_count": part.message_count} for part in parts
        ],
        "custom_data": dict(custom),
        "ros_distro": os.environ.get("ROS_DISTRO") or "jazzy",
    }


def _qos(channel: Channel) -> list[Any]:
    """QoS profiles stored with a channel; a file to be repaired may hold anything there."""
    try:
        profiles = yaml.safe_load(channel.metadata.get("offered_qos_profiles", ""))
    except yaml.YAMLError:
        return []
    return profiles if isinstance(profiles, list) else []


def write_metadata(folder: Path, parts: Sequence[PartInfo], custom: Mapping[str, str]) -> Path:
    """
    Write what will be ``metadata.yaml`` under another name, and return that.

    Parameters
    ----------
    folder : Path
        Where to.
    parts, custom
        As of `bag_metadata`.
    """
    temporary = folder / ".metadata.yaml"
    try:
        with open(temporary, "w", encoding="utf-8") as file:
            file.write(_yaml({"rosbag2_bagfile_information": bag_metadata(parts, custom)}))
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    return temporary


def end_file(sink: McapSink, summary: Mapping[str, Any], custom: Mapping[str, str]) -> None:
    """
    Append to an MCAP file what belongs at its end.

    Parameters
    ----------
    sink : McapSink
        The file with all its chunks.
    summary : mapping
        JSON content of the summary record.
    custom : mapping of str
        ``custom_data`` of the metadata.
    """
    sink.metadata("rosbag2", {"serialized_metadata": _yaml(bag_metadata([sink.info()], custom))})
    sink.metadata(SUMMARY_RECORD, json_record(summary))
    sink.finish()


def finish_bag(sink: McapSink, summary: Mapping[str, Any], custom: Mapping[str, str]) -> int:
    """
    Finish a bag: summary, footer, ``metadata.yaml``.

    Where the disk is too full even for these, chunks are taken back from the end until they fit.

    Parameters
    ----------
    sink : McapSink
        The file with all its chunks.
    summary, custom
        As of `end_file`.

    Returns
    -------
    int
        Number of chunks that had to be taken back.
    """
    folder = sink.path.parent
    taken = 0
    while True:
        temporary = None
        try:
            # The small file first, then the end of the large one; renamed when both are there.
            temporary = write_metadata(folder, [sink.info()], custom)
            end_file(sink, summary, custom)
            break
        except OSError:
            if temporary is not None:
                temporary.unlink(missing_ok=True)
            if not sink.chunks:
                sink.close()
                raise
            sink.take_back()
            taken += 1
    sink.close()
    os.replace(temporary, folder / "metadata.yaml")
    return taken


# --- The writer --------------------------------------------------------------------------------


def new_folder(path: Path, *, force: bool) -> None:
    """
    Make the folder of a new bag; what is there is removed only with `force`, and only a bag.

    Parameters
    ----------
    path : Path
        Folder of the bag.
    force : bool
        Replace a bag that is there.
    """
    try:
        if path.is_dir() and not path.is_symlink():
            content = list(path.iterdir())
            if content and not force:
                raise BagError(f"{path}: is there already; nothing is overwritten without --force")
            foreign = [x for x in content if not _part_of_a_bag(x)]
            if foreign:
                raise BagError(
                    f"{path}: holds '{foreign[0].name}', so it is no bag and is not replaced"
                )
            for part in content:
                part.unlink()
        elif path.exists() or path.is_symlink():
            raise BagError(f"{path}: is a file; a bag is a folder")
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from None


def _part_of_a_bag(path: Path) -> bool:
    return path.suffix in (".mcap", ".damaged") or path.name in ("metadata.yaml", ".metadata.yaml")


class _Topic:
    """
    One topic of an open bag.

    Attributes
    ----------
    channel_id : int
    index : array
        Log times and offsets of its messages in the open chunk.
    last : int
        Its latest time (ns).
    run, shift : int
        How often its time began anew, and what is added to it since (ns).
    """

    __slots__ = ("channel_id", "index", "last", "run", "shift")

    def __init__(self, channel_id: int) -> None:
        self.channel_id = channel_id
        self.index = array("Q")
        self.last = self.run = self.shift = 0


class BagWriter:
    """
    Writes one recording.

    Parameters
    ----------
    path : Path
        Folder of the bag.
    config : dict
        The run's full configuration (JSON values): kept inside the file.
    oversampling : int
        Points per period of the oversampled waveforms, 0 for none: kept with the configuration.
    namespace : str
        Namespace of the topics, e.g. ``/axis1``.
    force : bool
        Replace a bag that is there.

    Raises
    ------
    BagError
        If the folder cannot be used.

    Notes
    -----
    One thread writes at a time. Log times of all topics must come from the same clock (the
    simulated time): a chunk covers a span of it. Where that clock begins anew, as with a drive that
    is restarted while it is recorded, the log times go on, one second later: they tell the order in
    which messages came, and the messages' own stamps the time of their drive.
    """

    def __init__(
        self,
        path: Path,
        *,
        config: Mapping[str, Any],
        oversampling: int = 0,
        namespace: str = "",
        force: bool = False,
    ) -> None:
        self.path = Path(path)
        self._namespace = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"
        self._types = dict(LOOP_TOPICS)
        for type_name in self._types.values():  # looked up now, not in the loop
            message_definition(type_name)
            type_hash(type_name)
        content = json_record({**config, "oversampling": oversampling})
        self._custom = {
            key: str(config[key])
            for key in ("experiment", "scheme", "motor", "engine", "seed")
            if config.get(key) is not None
        }
        new_folder(self.path, force=force)
        self._topics: dict[str, _Topic] = {}
        self._schema_ids: dict[str, int] = {}
        self._buffer = bytearray()
        self._begin = self._end = 0
        self._shifts = [0]  # of the runs of a drive
        self._closed = False
        self._error: OSError | None = None
        self._told = False
        try:
            self._sink = McapSink(self.path / f"{self.path.resolve().name}_0.mcap")
            self._sink.metadata(CONFIG_RECORD, content)
        except OSError as error:
            raise BagError(f"{self.path}: {error.strerror}") from None
        self._queue: queue.Queue[tuple[bytearray, dict[int, array[int]]] | None] = queue.Queue(
            WAITING_CHUNKS
        )
        self._thread = threading.Thread(target=self._write_chunks, name="bag", daemon=True)
        self._thread.start()

    def add_topic(self, topic: str, type_name: str) -> None:
        """
        Announce a topic that is not one of the loop's.

        Parameters
        ----------
        topic : str
            Name; absolute (``/diagnostics``), or relative to the namespace.
        type_name : str
            E.g. ``diagnostic_msgs/msg/DiagnosticArray``.
        """
        message_definition(type_name)
        self._types[topic] = type_name

    def write(self, topic: str, log_time_ns: int, data: bytes) -> None:
        """
        Append one message.

        Parameters
        ----------
        topic : str
            A topic of the loop, or one announced by `add_topic`.
        log_time_ns : int
            Time of the message (ns).
        data : bytes
            The message as serialized by ROS (CDR with its header).

        Raises
        ------
        BagError
            If an earlier chunk could not be written. The bag holds what came before; `close` it.
        """
        # The hot path: four calls per PWM period.
        try:
            entry = self._topics[topic]
        except KeyError:
            entry = self._open_topic(topic)
        if log_time_ns < entry.last:
            self._begin_anew(entry, log_time_ns)
        entry.last = log_time_ns
        log_time_ns += entry.shift
        offset = len(self._buffer)
        if not self._begin <= log_time_ns < self._end or offset > CHUNK_BYTES:
            self._next_chunk(log_time_ns)
            offset = len(self._buffer)
        buffer = self._buffer
        entry.index.extend((log_time_ns, offset))
        buffer += _pack_message(5, 22 + len(data), entry.channel_id, 0, log_time_ns, log_time_ns)
        buffer += data

    def close(self, summary: Mapping[str, Any] | None = None) -> None:
        """
        Finish the bag.

        Parameters
        ----------
        summary : mapping, optional
            Results of the run (JSON values), kept inside the file.

        Raises
        ------
        BagError
            If the disk was full, unless `write` has said so already. The bag is valid, and ends
            where the disk ended.
        """
        if self._closed:
            return
        self._closed = True
        self._hand_over()
        self._queue.put(None)
        self._thread.join()
        summary = dict(summary or {})
        if self._error is not None:
            summary["incomplete"] = self._reason()
        try:
            taken = finish_bag(self._sink, summary, self._custom)
        except OSError as error:
            raise BagError(
                f"{self.path}: {error.strerror}; the bag could not be finished"
            ) from None
        if (self._error is not None or taken) and not self._told:
            raise BagError(self._reason() if self._error else self._reason_at_the_end())

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # An exception is on its way: what was recorded until then is still worth a valid bag.
        self._told = self._told or kind is not None
        self.close({"incomplete": f"{kind.__name__}: {error}"} if kind else None)

    # -- inside --

    def _open_topic(self, topic: str) -> _Topic:
        """Append schema and channel records of a topic to the open chunk."""
        type_name = self._types.get(topic)
        if type_name is None:
            raise BagError(f"topic '{topic}' was not announced to the bag (add_topic)")
        schema_id = self._schema_ids.get(type_name)
        if schema_id is None:
            schema_id = self._schema_ids[type_name] = len(self._schema_ids) + 1
            schema = Schema(
                id=schema_id,
                name=type_name,
                encoding="ros2msg",
                data=message_definition(type_name).encode(),
            )
            self._sink.schemas[schema_id] = schema
            self._buffer += encode(schema)
        channel = Channel(
            id=len(self._topics) + 1,
            topic=topic if topic.startswith("/") else self._namespace + topic,
            message_encoding="cdr",
            schema_id=schema_id,
            metadata={
                "offered_qos_profiles": _yaml([_QOS]),
                "topic_type_hash": type_hash(type_name),
            },
        )
        self._sink.channels[channel.id] = channel
        self._buffer += encode(channel)
        entry = self._topics[topic] = _Topic(channel.id)
        return entry

    def _begin_anew(self, entry: _Topic, log_time_ns: int) -> None:
        """Let the log times of a topic go on although its time began anew."""
        logged = entry.last + entry.shift
        entry.run += 1
        if entry.run == len(self._shifts) or log_time_ns + self._shifts[entry.run] <= logged:
            # The first topic that begins anew. What comes of the others until they do is before.
            entry.run = len(self._shifts)
            self._shifts.append(self._end + _BETWEEN_RUNS - log_time_ns)
        entry.shift = self._shifts[entry.run]

    def _next_chunk(self, log_time_ns: int) -> None:
        """Begin a chunk that covers `log_time_ns`."""
        self._hand_over()
        begin = log_time_ns // CHUNK_NS * CHUNK_NS
        self._end = begin + CHUNK_NS
        # Topics are not quite in step: what comes a little late stays in this chunk, rather than
        # that each such message opens one of its own.
        self._begin = begin - CHUNK_NS

    def _hand_over(self) -> None:
        """Give the open chunk to the writing thread; wait while that is two chunks behind."""
        index = {}
        for entry in self._topics.values():
            if entry.index:
                index[entry.channel_id] = entry.index
                entry.index = array("Q")
        if not index:
            return
        self._queue.put((self._buffer, index))
        self._buffer = bytearray()
        if self._error is not None and not self._closed:
            self._told = True
            raise BagError(self._reason())

    def _write_chunks(self) -> None:
        """Compress and write chunk after chunk; after an error, swallow the rest."""
        while (item := self._queue.get()) is not None:
            if self._error is None:
                try:
                    self._sink.chunk(*item)
                except OSError as error:
                    self._error = error

    def _reason(self) -> str:
        assert self._error is not None
        return (
            f"{self.path}: {self._error.strerror}; the recording ends at "
            f"{self._sink.times[1] * 1e-9:.3f} s"
        )

    def _reason_at_the_end(self) -> str:
        return (
            f"{self.path}: no space left for the end of the recording; it ends at "
            f"{self._sink.times[1] * 1e-9:.3f} s"
        )

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

Chunks are closed after 40 ms of recorded time (0.3 to 0.5 MB at 10 kHz), between two periods:
only the topic that began a chunk begins the next one. So what was written when a process is killed
ends at the same period in all topics, if they come period by period. With the open chunk, two
waiting and one being written, it ends at most 0.2 s before the last period of which all topics have
come (a recorder holds the others back for one that is behind, `graph.in_step`). Chunks are
compressed with LZ4: on such data, half noise, it takes a third of the time of Zstandard's level 1
and costs a fifth more bytes.
"""

from __future__ import annotations

import queue
import threading
from array import array
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from mfpcc_experiments.bags.definitions import message_definition, type_hash
from mfpcc_experiments.bags.disk.mcap_format import MESSAGE_FIELDS, MESSAGE_HEAD, encode
from mfpcc_experiments.bags.disk.sink import McapSink, finish_bag
from mfpcc_experiments.bags.errors import BagError
from mfpcc_experiments.bags.metadata import QOS, is_metadata, to_yaml
from mfpcc_experiments.bags.provenance import CONFIG_RECORD, custom_data, json_record
from mfpcc_experiments.bags.topics import LOOP_TOPICS

#: Recorded time in one chunk (ns); see the head of this file.
CHUNK_NS = 40_000_000
#: A chunk is closed at this size (bytes), whatever its time.
CHUNK_BYTES = 4 << 20
# Log time between two runs of a drive (ns).
_BETWEEN_RUNS = 1_000_000_000
#: Chunks that may wait for the writing thread.
WAITING_CHUNKS = 2

_pack_message = MESSAGE_HEAD.pack
_MESSAGE, _FIELDS = int(Opcode.MESSAGE), MESSAGE_FIELDS


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
    return path.suffix in (".mcap", ".damaged") or is_metadata(path)


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
        self._custom = custom_data(config)
        new_folder(self.path, force=force)
        self._topics: dict[str, _Topic] = {}
        self._schema_ids: dict[str, int] = {}
        self._buffer = bytearray()
        self._begin = self._end = 0
        self._first: _Topic | None = None  # the topic that began the open chunk
        self._shifts = [0]  # of the runs of a drive
        self._closed = False
        self._error: BaseException | None = None
        self._reported = False
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
        if (
            not self._begin <= log_time_ns < self._end or offset > CHUNK_BYTES
        ) and self._begins_a_chunk(entry, log_time_ns):
            self._next_chunk(entry, log_time_ns)
            offset = len(self._buffer)
        buffer = self._buffer
        entry.index.extend((log_time_ns, offset))
        buffer += _pack_message(
            _MESSAGE, _FIELDS + len(data), entry.channel_id, 0, log_time_ns, log_time_ns
        )
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
        if (self._error is not None or taken) and not self._reported:
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
        self._reported = self._reported or kind is not None
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
                "offered_qos_profiles": to_yaml([QOS]),
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

    def _begins_a_chunk(self, entry: _Topic, log_time_ns: int) -> bool:
        """Whether no period is cut by it: what follows is of the next one.

        Where the topic that began the chunk has fallen silent, another one has to.
        """
        return (
            self._first in (None, entry)
            or log_time_ns >= self._end + CHUNK_NS
            or log_time_ns < self._begin
            or len(self._buffer) > 2 * CHUNK_BYTES
        )

    def _next_chunk(self, entry: _Topic, log_time_ns: int) -> None:
        """Begin a chunk that covers `log_time_ns`, with this topic."""
        self._hand_over()
        self._first = entry
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
            self._reported = True
            raise BagError(self._reason())

    def _write_chunks(self) -> None:
        """Compress and write chunk after chunk; after an error, swallow the rest."""
        while (item := self._queue.get()) is not None:
            if self._error is None:
                try:
                    self._sink.chunk(*item)
                except BaseException as error:  # noqa: BLE001 (else `write` would wait for ever)
                    self._error = error

    def _reason(self) -> str:
        error = self._error
        why = error.strerror if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
        return f"{self.path}: {why}; the recording ends at {self._sink.times[1] * 1e-9:.3f} s"

    def _reason_at_the_end(self) -> str:
        return (
            f"{self.path}: no space left for the end of the recording; it ends at "
            f"{self._sink.times[1] * 1e-9:.3f} s"
        )

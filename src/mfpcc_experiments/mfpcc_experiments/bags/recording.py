"""
Reading recordings into arrays.

The messages of the loop have a fixed layout (`pwm_node.wire`), so thousands of them at once become
one structured array without a Python object per message. A recording is read chunk by chunk, and
only arrays are kept: 600,000 periods with all topics take about 5 s and 1.2 GiB.

A bag need not be ours: any bag with `phase_feedback` and `duty_command` of these message types can
be measured, e.g. one recorded with ``ros2 bag record`` on a real drive (MCAP or sqlite3).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.bags import mcap_file
from mfpcc_experiments.bags.bag import (
    CONFIG_RECORD,
    LOOP_TOPICS,
    SUMMARY_RECORD,
    BagError,
    message_definition,
)
from mfpcc_experiments.notes import Note, warning
from pwm_node import stamps

Progress = Callable[[float], None]
_Periods = NDArray[np.int64]
_Rows = slice | NDArray[np.bool_]

_NEEDED = ("phase_feedback", "duty_command")
_ALIGN = 4  # of the count of a list or the length of a text


@dataclass
class Recording:
    """
    One recording as arrays; one row per message.

    Attributes
    ----------
    path : Path
        Where it was read from.
    config : dict
        The run's configuration, empty for a bag of others.
    summary : dict
        What the run left behind at its end.
    feedback, command, lut, state : ndarray, structured
        The fields of fixed size of `PhaseFeedback`, `DutyCommand`, `LutDiagnostics` and
        `DriveState`, with rising period numbers. `lut` and `state` may be empty or decimated.
    scheme : ndarray of str, shape (len(lut),)
        Who controlled the current.
    i_abc_oversampled : ndarray, shape (len(state), oversampling, 3), or None
        True phase currents within each period (A).
    legs_oversampled : ndarray of uint8, shape (len(state), oversampling), or None
        Leg states at the same instants.
    T_s : float
        PWM period (s).
    n_p : int or None
        Pole pairs, None where neither stored nor to be told from the topics.
    lost_periods : int
        Periods of which a message is missing.
    notes : list of Note
        What is not as it should be with the file.
    """

    path: Path
    config: dict[str, Any]
    summary: dict[str, Any]
    feedback: NDArray[Any]
    command: NDArray[Any]
    lut: NDArray[Any]
    state: NDArray[Any]
    scheme: NDArray[np.str_]
    i_abc_oversampled: NDArray[np.float64] | None
    legs_oversampled: NDArray[np.uint8] | None
    T_s: float = 0.0
    n_p: int | None = None
    lost_periods: int = 0
    notes: list[Note] = field(default_factory=list)

    @property
    def oversampling(self) -> int:
        """Points per period of the oversampled waveforms, 0 without them."""
        return 0 if self.i_abc_oversampled is None else self.i_abc_oversampled.shape[1]

    @property
    def window_s(self) -> tuple[float, float] | None:
        """Evaluation window stored with the run (s)."""
        window = self.config.get("window_s")
        return None if window is None else (float(window[0]), float(window[1]))


def read(
    path: Path, *, namespace: str | None = None, progress: Progress | None = None
) -> Recording:
    """
    Read a recording.

    Parameters
    ----------
    path : Path
        Folder of a bag, or an MCAP file.
    namespace : str, optional
        Which axis, where a bag holds several (``/axis1``).
    progress : callable, optional
        Told the share that is done, 0 to 1.

    Returns
    -------
    Recording
        Its `notes` say what is missing or odd.

    Raises
    ------
    BagError
        If it cannot be used; the text says why and what to do.
    """
    path = Path(path)
    files = bag_files(path)
    collector = _Collector(path, namespace)
    total = sum(file.stat().st_size for file in files) or 1
    done = 0
    for file in files:
        if file.suffix == ".mcap":
            _read_mcap(file, collector, done, total, progress)
        else:
            _read_other(file, collector)
        done += file.stat().st_size
    recording = collector.recording()
    if progress is not None:
        progress(1.0)
    return recording


def bag_files(path: Path) -> list[Path]:
    """
    Data files of a bag, in their order.

    Parameters
    ----------
    path : Path
        Folder of a bag, or one of its files.
    """
    if path.is_file():
        if path.name == "metadata.yaml":
            return bag_files(path.parent)
        return [path]
    if not path.is_dir():
        raise BagError(f"{path}: there is no such file or folder")
    for pattern in ("*.mcap", "*.db3", "*.mcap.zstd", "*.db3.zstd"):
        files = sorted(path.glob(pattern), key=_number)
        if files:
            return files
    raise BagError(f"{path}: no recording here (a bag is a folder with an .mcap file)")


def _number(path: Path) -> tuple[int, str]:
    """Sort the parts of a split bag by number: _2 before _10."""
    digits = re.search(r"_(\d+)\.", path.name)
    return (int(digits[1]) if digits else 0, path.name)


def _read_mcap(
    file: Path, collector: _Collector, done: int, total: int, progress: Progress | None
) -> None:
    channels = mcap_file.Channels(file)
    for record in mcap_file.records(file):
        if record.opcode == 6:  # chunk
            data = mcap_file.unpack_chunk(record.content, file)
            _read_messages(data, channels, collector)
            collector.flush()
            if progress is not None:
                progress((done + record.end) / total)
        elif record.opcode == 5:  # a message outside of a chunk
            content = record.content
            head = bytes([5]) + len(content).to_bytes(8, "little")
            _read_messages(head + content, channels, collector)
            collector.flush_if_large()
        elif record.opcode == 12:
            name, value = mcap_file.metadata(record, file)
            collector.metadata(name, value)
        else:
            channels.see(record.opcode, record.content)
    collector.flush()


def _read_messages(data: bytes, channels: mcap_file.Channels, collector: _Collector) -> None:
    """Sort the messages of a chunk by topic."""
    lists: dict[int, list[bytes] | None] = {}
    unknown: list[bytes] | None = []
    for opcode, begin, end, channel_id, _ in mcap_file.split(data, channels.path):
        if opcode == 5:
            messages = lists.get(channel_id, unknown)
            if messages is unknown:
                messages = lists[channel_id] = collector.messages(channels.topic(channel_id))
            if messages is not None:
                messages.append(data[begin:end])
        else:
            channels.see(opcode, data[begin:end])


def _read_other(file: Path, collector: _Collector) -> None:
    """Read what is no plain MCAP (sqlite3, compressed files) through rosbags."""
    from rosbags.rosbag2 import Reader

    try:
        with Reader(file.parent) as reader:
            for connection, _, data in reader.messages():
                definition = getattr(connection, "msgdef", None)
                text = getattr(definition, "data", "") or ""
                if not text.strip() or "\n" not in text:
                    text = ""
                topic = mcap_file.Topic(connection.topic, connection.msgtype, text, "cdr")
                messages = collector.messages(topic)
                if messages is not None:
                    messages.append(bytes(data))
                    collector.flush_if_large()
    except BagError:
        raise
    except Exception as error:  # noqa: BLE001 (sqlite, zstd, YAML and rosbags have their own)
        raise BagError(
            f"{file}: cannot be read ({type(error).__name__}: {error}). 'ros2 bag convert' to MCAP "
            "may help"
        ) from None
    collector.flush()


# --- From bytes to arrays ----------------------------------------------------------------------


class _Collector:
    """Gathers the messages of the loop's topics, and makes a `Recording` of them."""

    def __init__(self, path: Path, namespace: str | None) -> None:
        self.path = path
        self.config: dict[str, Any] = {}
        self.summary: dict[str, Any] = {}
        self._namespace = None if namespace is None else "/" + namespace.strip("/")
        self._namespaces: set[str] = set()
        self._others: set[str] = set()
        self._known: dict[mcap_file.Topic, list[bytes] | None] = {}
        self._columns = {name: _column(name, path) for name in LOOP_TOPICS}
        self._waiting = 0

    def metadata(self, name: str, value: Any) -> None:
        if name == CONFIG_RECORD and isinstance(value, dict):
            self.config = value
        elif name == SUMMARY_RECORD and isinstance(value, dict):
            self.summary = value

    def messages(self, topic: mcap_file.Topic) -> list[bytes] | None:
        """List that takes the messages of a topic, or None if nobody wants them."""
        if topic not in self._known:
            self._known[topic] = self._judge(topic)
        return self._known[topic]

    def _judge(self, topic: mcap_file.Topic) -> list[bytes] | None:
        namespace, _, name = topic.name.rpartition("/")
        if name not in LOOP_TOPICS:
            self._others.add(topic.name)
            return None
        self._namespaces.add(namespace or "/")
        if self._namespace not in (None, namespace or "/"):
            return None
        _check_type(self.path, topic, LOOP_TOPICS[name])
        return self._columns[name].messages

    def flush(self) -> None:
        """Turn what was gathered into arrays."""
        for column in self._columns.values():
            column.flush()

    def flush_if_large(self) -> None:
        self._waiting += 1
        if self._waiting >= 10_000:
            self._waiting = 0
            self.flush()

    def recording(self) -> Recording:
        if self._namespace is None and len(self._namespaces) > 1:
            names = ", ".join(sorted(self._namespaces))
            raise BagError(f"{self.path}: holds several axes; choose one of {names}")
        missing = [name for name in _NEEDED if not self._columns[name].count]
        if missing:
            others = sorted(self._others)[:8]
            there = f"; there are: {', '.join(others)}" if others else "; it holds no messages"
            raise BagError(
                f"{self.path}: no messages of topic {' and '.join(missing)}"
                + (there if not any(c.count for c in self._columns.values()) else "")
            )
        notes: list[Note] = []
        periods = {name: column.period() for name, column in self._columns.items()}
        keep = {name: _rising(name, period, notes) for name, period in periods.items()}
        if not self.config or all(p[0] > 0 for p in periods.values() if len(p)):
            # Who joins a drive that runs finds the topics one after the other; another recorder,
            # such as `ros2 bag record`, leaves them so too.
            keep = _common(periods, keep, foreign=not self.config)
        rows = {name: column.take(keep[name]) for name, column in self._columns.items()}
        feedback, command = rows["phase_feedback"][0], rows["duty_command"][0]
        lut, scheme = rows["lut_diagnostics"]
        state, waves = rows["drive_state"]
        recording = Recording(
            path=self.path,
            config=self.config,
            summary=self.summary,
            feedback=feedback,
            command=command,
            lut=lut,
            state=state,
            scheme=scheme,
            i_abc_oversampled=None if waves is None else waves[0],
            legs_oversampled=None if waves is None else waves[1],
            notes=notes,
        )
        recording.lost_periods = _lost(recording)
        _complete(recording)
        return recording


def _check_type(path: Path, topic: mcap_file.Topic, type_name: str) -> None:
    """Refuse a topic that has our name but not our message."""
    if topic.type_name.replace("/msg/", "/") != type_name.replace("/msg/", "/"):
        raise BagError(f"{path}: topic {topic.name} is of type {topic.type_name}, not {type_name}")
    if topic.encoding != "cdr":
        raise BagError(f"{path}: topic {topic.name} is encoded as '{topic.encoding}', not as cdr")
    if topic.definition and _fields(topic.definition) != _fields(message_definition(type_name)):
        raise BagError(
            f"{path}: topic {topic.name} was recorded with another definition of {type_name}; "
            "read it with the version of this software that recorded it"
        )


def _fields(definition: str) -> list[str]:
    """Fields of a message definition, type and name, without comments, defaults and layout."""
    lines = (" ".join(line.split("#")[0].split()[:2]) for line in definition.splitlines())
    return [line for line in lines if line]


def _column(name: str, path: Path) -> _Column:
    import mfpcc_msgs.msg

    cls = {"lut_diagnostics": _TextColumn, "drive_state": _WaveColumn}.get(name, _Column)
    return cls(name, getattr(mfpcc_msgs.msg, LOOP_TOPICS[name].split("/")[-1]), path)


class _Column:
    """
    Messages of one topic on their way into a structured array.

    Parameters
    ----------
    name : str
        Topic, for messages.
    msg_class : type
        Generated message class.
    path : Path
        Recording, for messages.
    """

    def __init__(self, name: str, msg_class: Any, path: Path) -> None:
        from pwm_node.wire import fixed_dtype, fixed_size

        self.name, self.path = name, path
        self.messages: list[bytes] = []
        self.count = 0
        self._dtype = fixed_dtype(msg_class)
        self._size = fixed_size(msg_class)
        self._parts: list[NDArray[Any]] = []

    def flush(self) -> None:
        """Convert the waiting messages, in runs of equal length."""
        for length, run in groupby(self.messages, len):
            messages = list(run)
            data = b"".join(messages)
            block = np.frombuffer(data, np.uint8).reshape(len(messages), length)
            self._convert(block)
            self.count += len(messages)
        self.messages.clear()

    def _convert(self, block: NDArray[np.uint8]) -> None:
        n, length = block.shape
        if length < 4 + self._size:
            raise self._wrong(f"{length} bytes are too short")
        if not (block[:, :2] == (0, 1)).all():
            raise self._wrong("not little-endian CDR")
        rows = np.zeros(n, self._dtype)
        rows.view(np.uint8).reshape(n, -1)[:, : self._size] = block[:, 4 : 4 + self._size]
        self._parts.append(rows)

    def _wrong(self, reason: str) -> BagError:
        return BagError(
            f"{self.path}: a message of topic {self.name} has not the layout of its type ({reason})"
        )

    def period(self) -> NDArray[np.int64]:
        """Period numbers of all messages."""
        if not self._parts:
            return np.zeros(0, np.int64)
        return np.concatenate([part["period"] for part in self._parts]).astype(np.int64)

    def take(self, keep: _Rows) -> tuple[NDArray[Any], Any]:
        """Array of the rows to keep, and what a topic has besides; gives up its own copy."""
        return _concatenate(self._parts, keep, np.zeros(0, self._dtype)), None


class _TextColumn(_Column):
    """A topic with a text behind the fixed fields: `LutDiagnostics`."""

    def __init__(self, name: str, msg_class: Any, path: Path) -> None:
        super().__init__(name, msg_class, path)
        self._names: dict[bytes, int] = {}
        self._codes: list[NDArray[np.uint16]] = []

    def _convert(self, block: NDArray[np.uint8]) -> None:
        super()._convert(block)
        tail = block[:, 4 + -(-self._size // _ALIGN) * _ALIGN :]
        codes = np.zeros(len(block), np.uint16)
        if (tail == tail[0]).all():
            codes[:] = self._code(tail[0].tobytes())
        else:
            texts, which = np.unique(tail, axis=0, return_inverse=True)
            each = np.array([self._code(text.tobytes()) for text in texts], np.uint16)
            codes[:] = each[which.reshape(-1)]
        self._codes.append(codes)

    def _code(self, tail: bytes) -> int:
        length = int.from_bytes(tail[:4], "little")
        if len(tail) < 4 or not 1 <= length <= len(tail) - 4:
            raise self._wrong("the text at its end is cut")
        if len(self._names) > 1000:
            raise self._wrong("too many different texts")
        return self._names.setdefault(tail[4 : 3 + length], len(self._names))

    def take(self, keep: _Rows) -> tuple[NDArray[Any], NDArray[np.str_]]:
        rows, _ = super().take(keep)
        codes = _concatenate(self._codes, keep, np.zeros(0, np.uint16))
        names = np.array([name.decode("utf-8", "replace") for name in self._names] or [""])
        return rows, names[codes]


class _WaveColumn(_Column):
    """A topic with oversampled waveforms behind the fixed fields: `DriveState`."""

    def __init__(self, name: str, msg_class: Any, path: Path) -> None:
        super().__init__(name, msg_class, path)
        self._points: int | None = None
        self._currents: list[NDArray[np.float64]] = []
        self._legs: list[NDArray[np.uint8]] = []

    def _convert(self, block: NDArray[np.uint8]) -> None:
        super()._convert(block)
        n = len(block)
        at = 4 + -(-self._size // _ALIGN) * _ALIGN
        values, at = self._list_length(block, at)
        # Elements of 8 bytes lie on multiples of 8 behind the header of 4; no elements, no gap.
        at = 4 + -(-(at - 4) // 8) * 8 if values else at
        currents, at = block[:, at : at + 8 * values], at + 8 * values
        at = 4 + -(-(at - 4) // _ALIGN) * _ALIGN
        legs_count, at = self._list_length(block, at)
        legs = block[:, at : at + legs_count]
        points = values // 3
        if values % 3 or legs_count not in (0, points) or legs.shape[1] != legs_count:
            raise self._wrong("the oversampled waveforms are cut")
        if self._points not in (None, points):
            raise BagError(f"{self.path}: the oversampling changes within the recording")
        self._points = points
        if points:
            self._currents.append(np.ascontiguousarray(currents).view("<f8").reshape(n, points, 3))
            if legs_count:
                self._legs.append(legs.copy())

    def _list_length(self, block: NDArray[np.uint8], at: int) -> tuple[int, int]:
        """Length of the list whose count lies at `at`, the same in all rows; and what follows."""
        count = np.ascontiguousarray(block[:, at : at + 4])
        if count.shape[1] != 4 or not (count == count[0]).all():
            raise self._wrong("a list is cut")
        length = int(count[0].view("<u4")[0])
        if length > block.shape[1]:
            raise self._wrong("a list is cut")
        return length, at + 4

    def take(self, keep: _Rows) -> tuple[NDArray[Any], Any]:
        rows, _ = super().take(keep)
        if not self._points or not self._currents:
            return rows, None
        currents = _concatenate(self._currents, keep, np.zeros((0, self._points, 3)))
        if sum(len(part) for part in self._legs) == self.count:
            legs = _concatenate(self._legs, keep, np.zeros((0, self._points), np.uint8))
        else:
            legs = None
        return rows, (currents, legs)


def _concatenate(parts: list[NDArray[Any]], keep: _Rows, empty: NDArray[Any]) -> NDArray[Any]:
    """Join the parts and empty the list, so that memory holds them once, not twice."""
    if not parts:
        return empty
    whole = np.empty((sum(len(part) for part in parts), *parts[0].shape[1:]), parts[0].dtype)
    begin = 0
    parts.reverse()
    while parts:
        part = parts.pop()
        whole[begin : begin + len(part)] = part
        begin += len(part)
    return whole if isinstance(keep, slice) and keep == slice(None) else whole[keep]


# --- Completeness ------------------------------------------------------------------------------


def _rising(name: str, period: NDArray[np.int64], notes: list[Note]) -> _Rows:
    """Rows with rising period numbers: repeats dropped, of several runs the longest."""
    step = np.diff(period)
    if (step > 0).all():
        return slice(None)
    keep = np.ones(len(period), bool)
    repeats = int(np.count_nonzero(step == 0))
    if repeats:
        notes.append(warning(f"{name}: {repeats} period numbers come twice; the first counts"))
        keep[1:] = step != 0
    back = np.flatnonzero(step < 0) + 1
    if len(back):
        borders = [0, *back.tolist(), len(period)]
        lengths = np.diff(borders)
        longest = int(np.argmax(lengths))
        notes.append(
            warning(
                f"{name}: the period number goes back {len(back)} times (was the drive "
                f"restarted?); only the longest run is used, from period {period[borders[longest]]}"
            )
        )
        keep[: borders[longest]] = False
        keep[borders[longest + 1] :] = False
    return keep


def _common(
    periods: Mapping[str, _Periods], keep: Mapping[str, _Rows], *, foreign: bool
) -> dict[str, _Rows]:
    """Keep of each topic the periods from which on, and to which if foreign, all were recorded."""
    there = {name: period for name, period in periods.items() if len(period)}
    # the command that answers a sample is for the period after it
    lead = {name: int(name == "duty_command") for name in there}
    begin = max(int(p[keep[name]][0]) - lead[name] for name, p in there.items())
    end = min(int(p[keep[name]][-1]) - lead[name] for name, p in there.items())
    common = dict(keep)
    for name, period in there.items():
        inside = np.zeros(len(period), np.bool_)
        inside[keep[name]] = True
        inside &= period >= begin
        if foreign:
            inside &= period <= end + lead[name]
        if inside.any():
            common[name] = inside
    return common


def _lost(recording: Recording) -> int:
    """Count the periods of which a message is missing, and say which topics have gaps."""
    feedback = recording.feedback["period"].astype(np.int64)
    first, last = int(feedback[0]), int(feedback[-1])
    # A command is recorded for the period after its sample. The last one may be missing: the run
    # ended before.
    expected = {
        "phase_feedback": (recording.feedback, first, last),
        "duty_command": (recording.command, first + 1, last),
        "lut_diagnostics": (recording.lut, first, last - 1),
        "drive_state": (recording.state, first, last - 1),
    }
    lost = 0
    for name, (rows, begin, end) in expected.items():
        if not len(rows):
            continue
        period = rows["period"].astype(np.int64)
        step = np.diff(period)
        usual = int(np.median(step)) if len(step) else 1  # above 1 where a topic is decimated
        inside = int(np.sum((step[step > usual] - 1) // usual))
        outside = max(0, int(period[0]) - begin) // usual + max(0, end - int(period[-1])) // usual
        if inside + outside:
            where = period[:-1][step > usual]
            at = f", first after period {where[0]}" if len(where) else ", at its begin or end"
            text = f"{name}: {inside + outside} messages are missing{at}"
            recording.notes.append(warning(text))
        lost = max(lost, (inside + outside) * usual)
    return lost


def _complete(recording: Recording) -> None:
    """Fill in the period and the pole pairs: stored, or else told from the topics."""
    config, feedback = recording.config, recording.feedback
    with suppress(KeyError, TypeError, ValueError):
        recording.T_s = float(config["T_s"])
    if not 0.0 < recording.T_s < 1.0:
        first, last = stamps.nanoseconds(feedback["stamp"][[0, -1]]).tolist()
        periods = int(feedback["period"][-1]) - int(feedback["period"][0])
        with suppress(ValueError):
            recording.T_s = 1.0 / stamps.frequency(first, last, periods)
    if not 0.0 < recording.T_s < 1.0:
        raise BagError(f"{recording.path}: the PWM period cannot be told from the time stamps")
    if not _is_window(config):
        config.pop("window_s", None)
    n_p = config.get("n_p")
    recording.n_p = n_p if isinstance(n_p, int) and n_p > 0 else _pole_pairs(recording)


def _is_window(config: Mapping[str, Any]) -> bool:
    window = config.get("window_s")
    return (
        isinstance(window, list)
        and len(window) == 2
        and all(isinstance(t, (int, float)) for t in window)
    )


def _pole_pairs(recording: Recording) -> int | None:
    """Electrical speed, as the controller estimates it, over the encoder's mechanical speed."""
    feedback, lut = recording.feedback, recording.lut
    if len(feedback) < 10 or len(lut) < 10:
        return None
    seconds = float(int(feedback["period"][-1]) - int(feedback["period"][0])) * recording.T_s
    angle = np.unwrap(feedback["encoder_angle"])
    w_M = float(angle[-1] - angle[0]) / seconds
    ratio = float(np.mean(lut["w_m"])) / w_M if abs(w_M) > 1.0 else 0.0
    n_p = round(ratio) if np.isfinite(ratio) else 0
    return n_p if 1 <= n_p <= 200 and abs(ratio - n_p) < 0.2 else None


def iterate(paths: Iterable[Path], progress: Progress | None = None) -> Iterator[Recording]:
    """
    Read recordings one after the other.

    Parameters
    ----------
    paths : iterable of Path
        Bags.
    progress : callable, optional
        Told the share that is done of all, 0 to 1.
    """
    paths = list(paths)
    for n, path in enumerate(paths):

        def tell(share: float, n: int = n) -> None:
            if progress is not None:
                progress((n + share) / len(paths))

        yield read(path, progress=tell)

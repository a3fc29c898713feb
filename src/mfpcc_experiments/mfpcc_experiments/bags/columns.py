"""
From serialized messages to arrays.

The messages of the loop have a fixed layout (`pwm_node.wire`, `layouts`), so thousands of them at
once become one structured array without a Python object per message.
"""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.bags import layouts
from mfpcc_experiments.bags.disk.mcap_file import Topic
from mfpcc_experiments.bags.errors import BagError
from mfpcc_experiments.bags.layouts import Layout
from mfpcc_experiments.bags.topics import LOOP_TOPICS
from pwm_node import bits

#: Which rows of a column: of all that were read, in this order.
Rows = slice | NDArray[np.int64]

ALL = slice(None)

_ALIGN = 4  # of the count of a list or the length of a text
_PADDING = 3  # bytes that a writer may leave at the end of a message


def column(name: str, path: Path) -> Column:
    """
    Return an empty column for a topic of the loop.

    Parameters
    ----------
    name : str
        Relative name of the topic.
    path : Path
        Recording, for messages.
    """
    import mfpcc_msgs.msg

    kinds = {
        "duty_command": _CommandColumn,
        "lut_diagnostics": _TextColumn,
        "drive_state": _WaveColumn,
    }
    kind = kinds.get(name, Column)
    return kind(name, getattr(mfpcc_msgs.msg, LOOP_TOPICS[name].split("/")[-1]), path)


def layout_of(topic: Topic, type_name: str, path: Path) -> Layout:
    """
    Layout of the messages of a recorded topic.

    Parameters
    ----------
    topic : Topic
        As recorded.
    type_name : str
        The type that it should have.
    path : Path
        Recording, for messages.

    Raises
    ------
    BagError
        If it has the name of a topic of the loop, but not its messages.
    """
    if topic.encoding != "cdr":
        raise BagError(f"{path}: topic {topic.name} is encoded as '{topic.encoding}', not as cdr")
    if topic.type_name.replace("/msg/", "/") != type_name.replace("/msg/", "/"):
        there = f"of type {topic.type_name}" if topic.type_name else "without a type"
        raise BagError(f"{path}: topic {topic.name} is {there}, not {type_name}")
    try:
        return layouts.recorded_layout(type_name, topic.definition, topic.definition_encoding)
    except layouts.LayoutError as error:
        raise BagError(
            f"{path}: topic {topic.name} was recorded with another definition of {type_name}: "
            f"{error}; read it with the version of this software that recorded it"
        ) from None


class Column:
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

    Attributes
    ----------
    count : int
        Messages so far.
    """

    def __init__(self, name: str, msg_class: Any, path: Path) -> None:
        from pwm_node.wire import fixed_dtype

        self.name, self.path = name, path
        self.count = 0
        self._msg_class = msg_class
        self._dtype = fixed_dtype(msg_class)
        self._own = layouts.own_layout(LOOP_TOPICS[name])
        self._parts: list[NDArray[Any]] = []
        self._times: list[NDArray[np.int64]] = []

    def add(self, layout: Layout, messages: list[bytes], log_time: NDArray[np.int64]) -> None:
        """
        Append messages.

        Parameters
        ----------
        layout : Layout
            Of these messages.
        messages : list of bytes
            As serialized by ROS.
        log_time : ndarray of int64, shape (len(messages),)
            (ns)
        """
        for length, run in groupby(messages, len):
            alike = list(run)
            block = np.frombuffer(b"".join(alike), np.uint8).reshape(len(alike), length)
            self._convert(block, layout)
            self.count += len(alike)
        self._times.append(log_time)

    def _convert(self, block: NDArray[np.uint8], layout: Layout) -> None:
        n, length = block.shape
        end = 4 + layout.size
        if length < end:
            raise self._wrong(f"{length} bytes are too short")
        if not layout.tail and length > end + _PADDING:
            raise self._wrong(f"{length} bytes came where {end} are expected")
        if not (block[:, :2] == (0, 1)).all():
            raise self._wrong("not little-endian CDR")
        if layout == self._own:
            rows = np.zeros(n, self._dtype)
            rows.view(np.uint8).reshape(n, -1)[:, : layout.size] = block[:, 4:end]
        else:
            rows = layouts.convert(block[:, 4:end], layout, self._dtype, self._msg_class)
        self._parts.append(rows)

    def _wrong(self, reason: str) -> BagError:
        return BagError(
            f"{self.path}: a message of topic {self.name} has not the layout of its definition "
            f"({reason})"
        )

    def period(self) -> NDArray[np.int64]:
        """Period numbers of all messages."""
        if not self._parts:
            return np.zeros(0, np.int64)
        return np.concatenate([part["period"] for part in self._parts]).astype(np.int64)

    def log_time(self) -> NDArray[np.int64]:
        """Log times of all messages (ns); gives up its own copy."""
        return join(self._times, ALL, np.zeros(0, np.int64))

    def answers_nothing(self, rows: Rows) -> NDArray[np.bool_]:
        """Which of the rows, in the order of time, belong to no period of the loop."""
        return np.zeros(len(np.arange(self.count)[rows]), np.bool_)

    def first_difference(self, one: NDArray[np.int64], other: NDArray[np.int64]) -> int | None:
        """Index of the first pair of rows with other contents, or None if all pairs are alike."""
        differ = np.zeros(len(one), np.bool_)
        for parts in self._contents():
            for n, (a, b) in enumerate(zip(_pick(parts, one), _pick(parts, other), strict=True)):
                differ[n] |= bits.of(a) != bits.of(b)
        where = np.flatnonzero(differ)
        return int(where[0]) if len(where) else None

    def _contents(self) -> list[list[NDArray[Any]]]:
        """All that a row holds, as parts of arrays."""
        return [self._parts]

    def take(self, keep: Rows) -> tuple[NDArray[Any], Any]:
        """Array of the rows to keep, and what a topic has besides; gives up its own copy."""
        return join(self._parts, keep, np.zeros(0, self._dtype)), None


class _CommandColumn(Column):
    """`DutyCommand`: the answers to the samples, and stops."""

    def answers_nothing(self, rows: Rows) -> NDArray[np.bool_]:
        """Which of the rows, in the order of time, are stops.

        A controller that is made inactive, or ends, sends its last command once more for the period
        after, with the gates off. Its stamp is still that of the last answer, while each answer has
        a stamp of its own. It is the last of all, or the answer for its period follows.
        """
        if not self._parts:
            return np.zeros(0, np.bool_)
        stamp, period, enable = (
            np.concatenate([part[name] for part in self._parts])[rows]
            for name in ("stamp", "period", "enable")
        )
        begin = np.flatnonzero(np.concatenate([[True], stamp[1:] != stamp[:-1]]))
        answer = np.repeat(period[begin], np.diff([*begin.tolist(), len(period)]))
        final = np.concatenate([period[1:] == period[:-1], [True]])
        return np.asarray((period == answer + 1) & (enable == 0) & final)


class _TextColumn(Column):
    """A topic with a text behind the fixed fields: `LutDiagnostics`."""

    def __init__(self, name: str, msg_class: Any, path: Path) -> None:
        super().__init__(name, msg_class, path)
        self._names: dict[bytes, int] = {}
        self._codes: list[NDArray[np.uint16]] = []

    def _convert(self, block: NDArray[np.uint8], layout: Layout) -> None:
        super()._convert(block, layout)
        codes = np.zeros(len(block), np.uint16)
        tail = block[:, 4 + -(-layout.size // _ALIGN) * _ALIGN :]
        if not layout.tail:  # recorded before there was a text
            codes[:] = self._names.setdefault(b"", len(self._names))
        elif (tail == tail[0]).all():
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

    def _contents(self) -> list[list[NDArray[Any]]]:
        return [*super()._contents(), self._codes]

    def take(self, keep: Rows) -> tuple[NDArray[Any], NDArray[np.str_]]:
        rows, _ = super().take(keep)
        codes = join(self._codes, keep, np.zeros(0, np.uint16))
        names = np.array([name.decode("utf-8", "replace") for name in self._names] or [""])
        return rows, names[codes]


class _WaveColumn(Column):
    """A topic with oversampled waveforms behind the fixed fields: `DriveState`."""

    def __init__(self, name: str, msg_class: Any, path: Path) -> None:
        super().__init__(name, msg_class, path)
        self._points: int | None = None
        self._currents: list[NDArray[np.float64]] = []
        self._legs: list[NDArray[np.uint8]] = []

    def _convert(self, block: NDArray[np.uint8], layout: Layout) -> None:
        super()._convert(block, layout)
        n = len(block)
        values = legs_count = 0
        currents, legs = block[:, :0], block[:, :0]
        if layout.tail:
            at = 4 + -(-layout.size // _ALIGN) * _ALIGN
            values, at = self._list_length(block, at)
            # Elements of 8 bytes lie on multiples of 8 behind the header of 4; none, no gap.
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

    @property
    def _has_legs(self) -> bool:
        return sum(len(part) for part in self._legs) == self.count

    def _contents(self) -> list[list[NDArray[Any]]]:
        parts = super()._contents()
        if self._points:
            parts.append(self._currents)
            if self._has_legs:
                parts.append(self._legs)
        return parts

    def take(self, keep: Rows) -> tuple[NDArray[Any], Any]:
        rows, _ = super().take(keep)
        if not self._points or not self._currents:
            return rows, None
        currents = join(self._currents, keep, np.zeros((0, self._points, 3)))
        if self._has_legs:
            legs = join(self._legs, keep, np.zeros((0, self._points), np.uint8))
        else:
            legs = None
        return rows, (currents, legs)


def join(parts: list[NDArray[Any]], keep: Rows, empty: NDArray[Any]) -> NDArray[Any]:
    """
    Join the parts and empty the list, so that memory holds them once, not twice.

    Parameters
    ----------
    parts : list of ndarray
        Emptied.
    keep : slice or ndarray of int64
        Rows of the whole to keep.
    empty : ndarray
        What there is without parts.
    """
    if not parts:
        return empty
    whole = np.empty((sum(len(part) for part in parts), *parts[0].shape[1:]), parts[0].dtype)
    begin = 0
    parts.reverse()
    while parts:
        part = parts.pop()
        whole[begin : begin + len(part)] = part
        begin += len(part)
    return whole if isinstance(keep, slice) and keep == ALL else whole[keep]


def _pick(parts: list[NDArray[Any]], rows: NDArray[np.int64]) -> list[NDArray[Any]]:
    """The rows one by one, without joining the parts."""
    ends = np.cumsum([len(part) for part in parts])
    which = np.searchsorted(ends, rows, side="right")
    begins = ends - [len(part) for part in parts]
    return [parts[w][row - begins[w]] for w, row in zip(which.tolist(), rows.tolist(), strict=True)]

"""The black box: the last moments before a fault, in a bag, although nobody recorded.

While a drive runs, what it publishes on the loop also goes through rings in memory. When a node
tells on `drive_status` that it has latched a fault, the box waits for a while of simulated time,
and then writes what its rings hold from before and after: a bag as every other, and a page of
figures beside it.

On the per-period path a ring is a `deque` of fixed length, and to append to it is all there is to
do. The bag is written by a thread of its own, which is in no hurry: it shares the interpreter with
the loop, and lets it go after each few messages.
"""

from __future__ import annotations

import bisect
import heapq
import os
import struct
import tempfile
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import mfpcc_msgs.msg
import numpy as np
import yaml
from mfpcc_msgs.msg import DriveFault, DriveStatus
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.timer import Timer

from mfpcc_experiments.bags import LOOP_TOPICS, BagError, BagWriter, versions
from pmsm_sim import motor
from pwm_node import guard, stamps
from pwm_node.yaml_files import FileError

#: What is kept of the time before a fault and after it (simulated s).
BEFORE, AFTER = 0.2, 0.1

#: Faults of which bag and figures are kept; the oldest makes room.
KEPT = 25

#: The list of them, in the directory; and the same for one, beside its bag.
LIST, PAGE = "trips.yaml", "trip.yaml"

#: The parameter of `BlackBoxNode`, and its default: the directory.
PARAMETER, DIRECTORY = "black_box", "bags/black_box"

# Periods in the rings above what is written: the drive goes on while it is found out that it has
# tripped, and that the time after it is over. Either takes a few milliseconds.
_ROOM = 1000

_LOOK_EVERY = 0.002  # s
_STANDS_STILL_AFTER = 1.0  # s

# The thread that writes gives the interpreter back for so long after so many messages (20 us).
_REST = 5e-4  # s
_AT_ONCE = 20

_STATUS = "drive_status"
_STATUS_KEPT = 20
_STAMP_AND_PERIOD = struct.Struct("<4xiIQ")
_STAMP = struct.Struct("<4xiI")

# Of messages with the same stamp, this is the order of the loop: a command is stamped with the
# begin of the period that it acts in.
_ORDER = ("duty_command", "phase_feedback", "drive_state", "lut_diagnostics", _STATUS)

_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # a tenth of the time

_RPM = 30.0 / 3.141592653589793


class DriveNode(Protocol):
    """What the box has to know of a node of the drive; a `PwmNode` knows it of itself."""

    @property
    def values(self) -> Mapping[str, Any]:
        """Its parameters as they are now; empty where they are not known."""

    @property
    def changes(self) -> Sequence[Mapping[str, Any]]:
        """The latest changes of them: period, name, value, and what it `was` before, if known."""

    @property
    def missed_periods(self) -> int:
        """Total since the start."""

    @property
    def lost_periods(self) -> int:
        """Total since the start."""


class BlackBox:
    """Keeps the last messages of the loop, and writes them when a fault is told.

    Parameters
    ----------
    node : Node
        Listens to `drive_status`, in the namespace of the drive.
    directory : Path
        Where bags and list go. The box of a drive in a namespace has a folder of its own in it.
    nodes : mapping of DriveNode
        The plant and the controller by their names.
    pwm_frequency : float
        PWM frequency (Hz), unless the plant's parameters say it.

    Attributes
    ----------
    rings : dict of deque
        By topic: what is published there is to be appended, serialized.
    """

    def __init__(
        self, node: Node, directory: Path, nodes: Mapping[str, DriveNode], pwm_frequency: float
    ) -> None:
        self.before = round(BEFORE * pwm_frequency)
        self.after = round(AFTER * pwm_frequency)
        length = self.before + self.after + _ROOM
        self.rings: dict[str, deque[bytes]] = {topic: deque(maxlen=length) for topic in LOOP_TOPICS}
        self._node = node
        self._nodes = nodes
        self._pwm_frequency = pwm_frequency
        self._archive = Archive(directory / node.get_namespace().strip("/"))
        self._namespace = node.get_namespace()
        self._statuses: deque[bytes] = deque(maxlen=_STATUS_KEPT)
        self._known: dict[str, set[tuple[str, int]]] = {}
        self._down: set[str] = set()
        self._event: _Event | None = None
        self._timer: Timer | None = None
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="black_box")
        self._writing: Future[None] | None = None
        latest = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        logger = node.get_logger()
        # Whatever comes: a black box is no reason for a drive to end.
        on_status = guard.callback(self._on_status, f"{_STATUS}: message dropped", logger)
        self._look = guard.callback(self._look_on, "black box", logger)
        node.create_subscription(DriveStatus, _STATUS, on_status, latest, raw=True)

    def close(self) -> None:
        """Write what is there of a fault whose time after it has not come."""
        if self._event is not None:
            self._write(self._event)
        self._writer.shutdown(wait=True)

    def _on_status(self, data: bytes) -> None:
        """Look for faults that are new: one opens an event, unless the drive was down already."""
        status = deserialize_message(data, DriveStatus)
        self._statuses.append(data)
        known = self._known.get(status.node, set())
        self._known[status.node] = {(fault.code, fault.period) for fault in status.faults}
        new = [fault for fault in status.faults if (fault.code, fault.period) not in known]
        was_down = bool(self._down)
        if status.state == "tripped" and status.faults:
            self._down.add(status.node)
        else:
            self._down.discard(status.node)
        if self._event is not None:
            self._event.add(status.node, new)
        elif new and not was_down and self._has(min(fault.period for fault in new)):
            self._event = _Event(status.node, new)
            self._timer = self._node.create_timer(
                _LOOK_EVERY, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME)
            )

    def _has(self, period: int) -> bool:
        """Whether a period lies in the ring, or will: from another process, news of a fault may
        come before its sample. A fault from before this box was there does not.
        """
        ring = self.rings["phase_feedback"]
        return bool(ring) and _period(ring[0]) <= period <= _period(ring[-1]) + _ROOM

    def _look_on(self) -> None:
        """Write as soon as the time after the fault is there, or will not come."""
        event = self._event
        assert event is not None
        end = event.period + self.after
        newest = _period(self.rings["phase_feedback"][-1])
        now = time.monotonic()
        began_anew = newest < event.seen
        if newest != event.seen:
            event.seen, event.seen_at = newest, now
        stands_still = now - event.seen_at > _STANDS_STILL_AFTER
        # From another process one topic may come later than another; or no more, at a fault.
        room_is_short = newest >= end + _ROOM // 2
        arrived = all(_reaches(ring, end) for ring in self.rings.values() if ring)
        if arrived or began_anew or stands_still or room_is_short:
            self._write(event)

    def _write(self, event: _Event) -> None:
        """Hand what there is to the thread that writes it."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
        self._event = None
        begin, end = max(0, event.period - self.before), event.period + self.after
        kept = {topic: list(ring) for topic, ring in self.rings.items()}
        nodes = {name: _at_begin(node, begin) for name, node in self._nodes.items()}
        counters = {
            "missed periods": sum(node.missed_periods for node in self._nodes.values()),
            "lost periods": sum(node.lost_periods for node in self._nodes.values()),
        }
        statuses = list(self._statuses)
        if self._writing is not None:
            self._writing.result()  # memory is bounded: one at a time
        self._writing = self._writer.submit(
            self._archived, event, (begin, end), kept, statuses, nodes, counters
        )

    def _archived(
        self,
        event: _Event,
        window: tuple[int, int],
        kept: Mapping[str, Sequence[bytes]],
        statuses: Sequence[bytes],
        nodes: Mapping[str, tuple[dict[str, Any], list[dict[str, Any]]]],
        counters: Mapping[str, int],
    ) -> None:
        """Write bag, page and list; the thread's work."""
        logger = self._node.get_logger()
        begin, end = window
        excerpts = {topic: _excerpt(rows, begin, end, event.period) for topic, rows in kept.items()}
        values = {name: at_begin for name, (at_begin, _) in nodes.items() if at_begin}
        pwm_frequency = values.get("pmsm_sim", {}).get("pwm_frequency", self._pwm_frequency)
        changes = [
            {"node": name, **change}
            for name, (_, recent) in nodes.items()
            for change in recent
            if change["period"] <= end
        ]
        name = f"{event.wall:%Y-%m-%dT%H-%M-%S}.{event.wall.microsecond // 1000:03d}_{event.code}"
        page = {
            **event.page(pwm_frequency),
            "limits": _limits(event.code, values.get(event.node, {})),
            "bag": name,
            "values": {**_figures(excerpts, event.period, values, changes), **counters},
        }
        try:
            with self._archive.new(name) as folder:
                _write_bag(
                    folder,
                    _config(event.code, pwm_frequency, values),
                    self._namespace,
                    _in_order(
                        excerpts,
                        statuses,
                        stamps.at(*stamps.begin(begin, pwm_frequency)),
                        stamps.at(*stamps.begin(end, pwm_frequency)),
                    ),
                    {"trip": page, "parameter_changes": changes},
                )
                (folder / PAGE).write_text(_yaml([page]), encoding="utf-8")
        except (OSError, BagError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            logger.error(
                f"black box: {event.code} in period {event.period} is not kept, the drive goes on: "
                f"{self._archive.directory}: {reason}"
            )
        else:
            logger.info(
                f"black box: {event.code} in period {event.period} with the time around it is in "
                f"{self._archive.directory / name} (see 'mfpcc compare')"
            )


class BlackBoxNode(Node):
    """The node `/black_box`: a black box for nodes of this process.

    Its parameter `black_box` is the directory, at start only; empty: no black box.

    Parameters
    ----------
    nodes : sequence of PwmNode
        Plant and controller, not configured yet.
    **options
        As of `Node`.
    """

    def __init__(self, nodes: Sequence[Any], **options: Any) -> None:
        super().__init__("black_box", **options)
        descriptor = ParameterDescriptor(
            description="Folder of the bags that are written at faults; empty: none", read_only=True
        )
        directory = self.declare_parameter(PARAMETER, DIRECTORY, descriptor).value
        self._box: BlackBox | None = None
        if directory:
            by_name = {node.get_name(): node for node in nodes}
            pwm_frequency = by_name["pmsm_sim"].values["pwm_frequency"]
            box = self._box = BlackBox(self, Path(directory), by_name, pwm_frequency)
            for node in nodes:
                node.tap = lambda topic: box.rings[topic].append

    def destroy_node(self) -> None:
        """Write what is to be written, and leave the graph."""
        if self._box is not None:
            self._box.close()
        super().destroy_node()


# --- The fault -----------------------------------------------------------------------------------


class _Event:
    """A fault that was told, and those that came with it until all is written.

    Parameters
    ----------
    node : str
        Who told it.
    faults : sequence of DriveFault
        What is new there.
    """

    def __init__(self, node: str, faults: Sequence[DriveFault]) -> None:
        self.wall = datetime.now(timezone.utc)
        first = min(faults, key=lambda fault: fault.period)
        self.node, self.period, self.code = node, int(first.period), str(first.code)
        self.seen, self.seen_at = -1, time.monotonic()
        self._faults: list[dict[str, Any]] = []
        self.add(node, faults)

    def add(self, node: str, faults: Sequence[DriveFault]) -> None:
        """Take note of faults."""
        self._faults += [
            {
                "code": fault.code,
                "node": node,
                "period": int(fault.period),
                "seen": fault.detail,
            }
            for fault in faults
        ]

    def page(self, pwm_frequency: float) -> dict[str, Any]:
        """What is known of it without a look at the messages."""
        first = next(fault for fault in self._faults if fault["code"] == self.code)
        more = [fault for fault in self._faults if fault is not first]
        return {
            "code": self.code,
            "node": self.node,
            "seen": first["seen"],
            "wall clock": self.wall.isoformat(timespec="milliseconds"),
            "period": self.period,
            "simulated time (s)": round(self.period / pwm_frequency, 9),
            **({"then": more} if more else {}),
        }


def _at_begin(node: DriveNode, period: int) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Parameters of a node as they were in a period, and what changed since."""
    values, since = dict(node.values), []
    for change in reversed(node.changes):
        if change["period"] <= period:
            break
        if "was" in change:
            values[change["name"]] = change["was"]
        since.append(dict(change))
    return values, since[::-1]


# --- What the rings hold -------------------------------------------------------------------------


@dataclass(frozen=True)
class _Excerpt:
    """Messages of one topic, and their period numbers, which rise."""

    messages: Sequence[bytes]
    periods: Sequence[int]

    def at(self, period: int) -> bytes | None:
        """Message of a period, or the last one before it; None if there is none."""
        row = bisect.bisect_right(self.periods, period) - 1
        return self.messages[row] if row >= 0 else None


def _period(data: bytes) -> int:
    return int(_STAMP_AND_PERIOD.unpack_from(data)[2])


def _reaches(ring: Sequence[bytes], period: int) -> bool:
    """Whether a topic, which may be decimated, has come as far as this period."""
    last = _period(ring[-1])
    step = last - _period(ring[-2]) if len(ring) > 1 else 1
    return last + max(step, 1) > period


def _gently(items: Iterable[Any]) -> Iterator[Any]:
    """Iterate in the thread that writes, without holding up the loop."""
    for n, item in enumerate(items, 1):
        yield item
        if n % _AT_ONCE == 0:
            time.sleep(_REST)


def _excerpt(messages: Sequence[bytes], begin: int, end: int, fault: int) -> _Excerpt:
    """Messages from one period to another; of several runs of the plant, from that of the fault."""
    periods = [_period(data) for data in _gently(messages)]
    borders = [k for k in range(1, len(periods)) if periods[k] < periods[k - 1]]
    runs = list(pairwise([0, *borders, len(periods)]))
    of_fault = [run for run in runs if periods and periods[run[1] - 1] >= fault]
    low = bisect.bisect_left(periods, begin, *(of_fault or runs)[-1])
    high = bisect.bisect_right(periods, end, *(of_fault or runs)[-1])
    return _Excerpt(messages[low:high], periods[low:high])


def _in_order(
    excerpts: Mapping[str, _Excerpt], statuses: Sequence[bytes], begin_ns: int, end_ns: int
) -> Iterator[tuple[int, int, str, bytes]]:
    """Messages of all topics as time passes: stamp (ns), rank, topic, message.

    Of `drive_status`, which is told on change, what was said before is in force at the begin.
    """

    def stamped(topic: str, messages: Sequence[bytes]) -> Iterator[tuple[int, int, str, bytes]]:
        for data in messages:
            yield stamps.at(*_STAMP.unpack_from(data)), _ORDER.index(topic), topic, data

    told = [
        (max(stamp, begin_ns), rank, topic, data)
        for stamp, rank, topic, data in stamped(_STATUS, statuses)
        if stamp <= end_ns
    ]
    streams = [stamped(topic, excerpt.messages) for topic, excerpt in excerpts.items()]
    return heapq.merge(*streams, sorted(told, key=lambda each: each[0]))


def _figures(
    excerpts: Mapping[str, _Excerpt],
    period: int,
    values: Mapping[str, Mapping[str, Any]],
    changes: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """The drive in the period of the fault, for people; only what is known."""
    feedback, command, lut, state = (
        _message(topic, excerpts[topic].at(period))
        for topic in ("phase_feedback", "duty_command", "lut_diagnostics", "drive_state")
    )
    figures: dict[str, Any] = {}
    if feedback is not None:
        figures |= {
            "i_a (A)": feedback.i_a,
            "i_b (A)": feedback.i_b,
            "i_c (A)": feedback.i_c,
            "encoder angle (rad)": feedback.encoder_angle,
            "DC-link voltage (V)": feedback.dc_voltage,
        }
    if lut is not None:
        figures |= {
            "scheme": lut.scheme,
            "i_d, i_q (A)": lut.i_dq,
            "i_d, i_q reference (A)": lut.i_dq_ref,
            "LUT error d, q (A)": lut.prediction_error,
            "electrical speed, estimated (rad/s)": lut.w_m,
            "speed reference (r/min)": lut.speed_ref * _RPM,
        }
    if command is not None:
        figures |= {
            "duty a, b, c": command.duty,
            "active vectors": command.vectors,
            "dwell": command.dwell,
            "gates on by command": command.enable,
        }
    if state is not None:
        figures |= {
            "gates on": state.gates_on,
            "true i_d, i_q (A)": state.i_dq,
            "true speed (r/min)": state.speed * _RPM,
            "torque (N m)": state.torque,
            "load torque (N m)": state.load_torque,
            "winding temperature (degC)": state.temperature,
        }
    parameters = dict(values.get("mfpcc_controller", {}))
    for change in changes:
        if change["node"] == "mfpcc_controller" and change["period"] <= period:
            parameters[change["name"]] = change["value"]
    for name in ("mismatch.inductance", "mismatch.resistance", "mismatch.flux"):
        if name in parameters:
            figures[name] = parameters[name]
    return {name: _readable(value) for name, value in figures.items()}


def _limits(code: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters that a fault depends on: those that are named as it begins."""
    begin = f"fault.{code.split('_')[0].lower()}"
    return {name: value for name, value in parameters.items() if name.startswith(begin)}


def _message(topic: str, data: bytes | None) -> Any:
    if data is None:
        return None
    return deserialize_message(data, getattr(mfpcc_msgs.msg, LOOP_TOPICS[topic].split("/")[-1]))


def _readable(value: Any) -> Any:
    """Plain values of YAML, with six digits."""
    if isinstance(value, (bool, str, int)):
        return value
    if isinstance(value, float):
        return float(f"{value:.6g}")
    return [_readable(each) for each in np.asarray(value).tolist()]


# --- The files -----------------------------------------------------------------------------------


class Archive:
    """The directory of the bags, with the list of what is in them.

    Parameters
    ----------
    directory : Path
        Made when there is something to put into it.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory.absolute()

    @contextmanager
    def new(self, name: str) -> Iterator[Path]:
        """Yield the folder to write bag and page into; whole, it takes its place in the list.

        Parameters
        ----------
        name : str
            Of the bag; in the order of these names the oldest makes room.

        Raises
        ------
        OSError
            Nothing has changed then.
        """
        self.directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".partial-", dir=self.directory) as work:
            folder = Path(work, name)
            yield folder
            folder.rename(self.directory / name)
            pages = sorted(self.directory.glob(f"*/{PAGE}"), reverse=True)
            # each page is a list of one, so one after the other they are the list
            text = "".join(page.read_text(encoding="utf-8") for page in pages[:KEPT])
            Path(work, LIST).write_text(_HEAD + text, encoding="utf-8")
            os.replace(Path(work, LIST), self.directory / LIST)
            for page in pages[KEPT:]:
                page.parent.rename(Path(work, page.parent.name))


_HEAD = f"""\
# The last {KEPT} faults, newest first; the values are those of the period in which each was seen.
# Each has a bag beside this file: 'mfpcc compare BAG'.
"""


def _yaml(data: Any) -> str:
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=100)
    return text


def _config(
    code: str, pwm_frequency: float, values: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """What a recording of the verb `run` has too, as far as it is known."""
    config: dict[str, Any] = {
        "experiment": f"trip {code}",
        "engine": "ros",
        "T_s": 1.0 / pwm_frequency,
        "versions": versions(),
    }
    plant = values.get("pmsm_sim")
    if values:
        config["parameters"] = dict(values)
    if plant is not None:
        with suppress(FileError):  # the file of a node elsewhere may not be here
            machine = motor.load(plant["motor"])
            config |= {"motor": machine.name, "n_p": machine.n_p, "R_s": machine.R_s}
            config["motor_file"] = machine.model_dump(mode="json")
    return config


def _write_bag(
    folder: Path,
    config: Mapping[str, Any],
    namespace: str,
    messages: Iterable[tuple[int, int, str, bytes]],
    summary: Mapping[str, Any],
) -> None:
    oversampling = config.get("parameters", {}).get("pmsm_sim", {}).get("oversampling", 0)
    with BagWriter(folder, config=config, oversampling=oversampling, namespace=namespace) as writer:
        writer.add_topic(_STATUS, "mfpcc_msgs/msg/DriveStatus")
        for stamp, _, topic, data in _gently(messages):
            writer.write(topic, stamp, data)
        writer.close(summary)

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

import time
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from mfpcc_msgs.msg import DriveStatus
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.timer import Timer

from mfpcc_experiments.bags import LOOP_TOPICS, BagError
from mfpcc_experiments.graph import archive, loop_messages
from mfpcc_experiments.graph.archive import Archive
from mfpcc_experiments.graph.excerpt import STATUS, excerpt, in_order
from mfpcc_experiments.graph.remote_node import DriveNode, at_begin
from mfpcc_experiments.graph.trip import Trip, figures, limits
from pwm_node import stamps
from pwm_node.ros import guard

#: What is kept of the time before a fault and after it (simulated s).
BEFORE, AFTER = 0.2, 0.1

#: The parameter of `BlackBoxNode`, and its default: the directory.
PARAMETER, DIRECTORY = "black_box", "bags/black_box"

# Periods in the rings above what is written: the drive goes on while it is found out that it has
# tripped, and that the time after it is over. Either takes a few milliseconds.
_ROOM = 1000

_LOOK_EVERY = 0.002  # s
_STANDS_STILL_AFTER = 1.0  # s
_STATUS_KEPT = 20


class BlackBox:
    """Keeps the last messages of the loop, and writes them when a fault is told.

    Parameters
    ----------
    node : Node
        In the namespace of the drive.
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
    on_status : callable
        To be given each message of `drive_status`, serialized.
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
        self._trip: Trip | None = None
        self._timer: Timer | None = None
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="black_box")
        self._writing: Future[None] | None = None
        logger = node.get_logger()
        # Whatever comes: a black box is no reason for a drive to end.
        self.on_status = guard.callback(self._on_status, f"{STATUS}: message dropped", logger)
        self._look = guard.callback(self._look_on, "black box", logger)

    def close(self) -> None:
        """Write what is there of a fault whose time after it has not come."""
        if self._trip is not None:
            self._write(self._trip)
        self._writer.shutdown(wait=True)

    def _on_status(self, data: bytes) -> None:
        """Look for faults that are new: one opens a trip, unless the drive was down already."""
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
        if self._trip is not None:
            self._trip.add(status.node, new)
        elif new and not was_down and self._has(min(fault.period for fault in new)):
            self._trip = Trip(status.node, new)
            self._timer = self._node.create_timer(
                _LOOK_EVERY, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME)
            )

    def _has(self, period: int) -> bool:
        """Whether a period lies in the ring, or will: from another process, news of a fault may
        come before its sample. A fault from before this box was there does not.
        """
        ring = self.rings["phase_feedback"]
        return (
            bool(ring)
            and loop_messages.period(ring[0]) <= period <= loop_messages.period(ring[-1]) + _ROOM
        )

    def _look_on(self) -> None:
        """Write as soon as the time after the fault is there, or will not come."""
        trip = self._trip
        assert trip is not None
        end = trip.period + self.after
        newest = loop_messages.period(self.rings["phase_feedback"][-1])
        now = time.monotonic()
        began_anew = newest < trip.seen
        if newest != trip.seen:
            trip.seen, trip.seen_at = newest, now
        stands_still = now - trip.seen_at > _STANDS_STILL_AFTER
        # From another process one topic may come later than another; or no more, at a fault.
        room_is_short = newest >= end + _ROOM // 2
        arrived = all(loop_messages.reaches(ring, end) for ring in self.rings.values() if ring)
        if arrived or began_anew or stands_still or room_is_short:
            self._write(trip)

    def _write(self, trip: Trip) -> None:
        """Hand what there is to the thread that writes it."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
        self._trip = None
        begin, end = max(0, trip.period - self.before), trip.period + self.after
        kept = {topic: list(ring) for topic, ring in self.rings.items()}
        nodes = {name: at_begin(node, begin) for name, node in self._nodes.items()}
        counters = {
            "missed periods": sum(node.missed_periods for node in self._nodes.values()),
            "lost periods": sum(node.lost_periods for node in self._nodes.values()),
        }
        statuses = list(self._statuses)
        if self._writing is not None:
            self._writing.result()  # memory is bounded: one at a time
        self._writing = self._writer.submit(
            self._archived, trip, (begin, end), kept, statuses, nodes, counters
        )

    def _archived(
        self,
        trip: Trip,
        window: tuple[int, int],
        kept: Mapping[str, Sequence[bytes]],
        statuses: Sequence[bytes],
        nodes: Mapping[str, tuple[dict[str, Any], list[dict[str, Any]]]],
        counters: Mapping[str, int],
    ) -> None:
        """Write bag, page and list; the thread's work."""
        logger = self._node.get_logger()
        begin, end = window
        excerpts = {topic: excerpt(rows, begin, end, trip.period) for topic, rows in kept.items()}
        values = {name: at_begin for name, (at_begin, _) in nodes.items() if at_begin}
        pwm_frequency = values.get("pmsm_sim", {}).get("pwm_frequency", self._pwm_frequency)
        changes = [
            {"node": name, **change}
            for name, (_, recent) in nodes.items()
            for change in recent
            if change["period"] <= end
        ]
        name = f"{trip.wall:%Y-%m-%dT%H-%M-%S}.{trip.wall.microsecond // 1000:03d}_{trip.code}"
        page = {
            **trip.page(pwm_frequency),
            "limits": limits(trip.code, values.get(trip.node, {})),
            "bag": name,
            "values": {**figures(excerpts, trip.period, values, changes), **counters},
        }
        try:
            with self._archive.new(name) as folder:
                archive.write_bag(
                    folder,
                    archive.configuration(trip.code, pwm_frequency, values),
                    self._namespace,
                    in_order(
                        excerpts,
                        statuses,
                        stamps.at(*stamps.begin(begin, pwm_frequency)),
                        stamps.at(*stamps.begin(end, pwm_frequency)),
                    ),
                    {"trip": page, "parameter_changes": changes},
                )
                (folder / archive.PAGE).write_text(archive.as_yaml([page]), encoding="utf-8")
        except (OSError, BagError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            logger.error(
                f"black box: {trip.code} in period {trip.period} is not kept, the drive goes on: "
                f"{self._archive.directory}: {reason}"
            )
        else:
            logger.info(
                f"black box: {trip.code} in period {trip.period} with the time around it is in "
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
            latest = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self.create_subscription(DriveStatus, STATUS, box.on_status, latest, raw=True)

    def destroy_node(self) -> None:
        """Write what is to be written, and leave the graph."""
        if self._box is not None:
            self._box.close()
        super().destroy_node()

"""The node `/recorder`: everything on the loop, from a running graph into a bag."""

from __future__ import annotations

import argparse
import contextlib
import struct
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import mfpcc_msgs.msg
import rclpy
import rclpy.utilities
from diagnostic_msgs.msg import DiagnosticArray
from mfpcc_msgs.msg import DriveStatus
from rcl_interfaces.msg import ParameterEvent, ParameterValue
from rcl_interfaces.srv import GetParameters
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_parameter_events,
)
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.task import Future

from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.bags import LOOP_TOPICS, BagError, BagWriter
from mfpcc_experiments.graph import loop_messages
from mfpcc_experiments.graph.black_box import BlackBox
from mfpcc_experiments.graph.in_step import InStep
from mfpcc_experiments.graph.remote_node import RemoteNode
from mfpcc_experiments.measuring import latched
from pmsm_sim.parameters import TABLE as PLANT
from pwm_node import interrupts, stamps
from pwm_node.lags import from_text
from pwm_node.ros import guard, ros_parameters, spin

# Keep all and reliable: a recorder that cannot follow slows the loop down instead of losing.
_KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)

# What has come is taken at this interval: to be woken for each message would cost as much again as
# writing it, and nobody waits for a recorder.
_TAKE_EVERY = 0.005  # s

# Both nodes tell theirs on one topic, and who comes late is told what is.
_EVERY_STATUS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)

_ASK_EVERY = 0.05  # s

_TABLES = {"pmsm_sim": PLANT, "mfpcc_controller": CONTROLLER}

# The message by which a node tells that it goes on, and the period that it is working at then over
# that of the message: the controller answers sample k with the command for k + 1.
_DRIVE_NODES = {"pmsm_sim": ("phase_feedback", 0), "mfpcc_controller": ("duty_command", -1)}

# Histograms of a paced run, and as what the plant tells of them.
_LAGS = {"start": "start late by", "round_trip": "round trip"}

# So many messages may be taken before an event of the same time is: those of a recorder that has
# fallen behind as far as the middleware lets it.
_SENT_KEPT = 20_000


class Recorder(Node):
    """Takes the messages of the loop, into a bag or a black box or both.

    A message that is repeated (a node sends its last one again to a peer that came late) is
    taken once.

    Parameters
    ----------
    writer : BagWriter, optional
        Where the messages go; its owner closes it.
    black_box : Path, optional
        Directory of a black box.
    topics : iterable of str
        Topics of the loop; all of them unless given.
    **options
        As of `Node`.

    Attributes
    ----------
    last_period : dict of int
        Last period seen on each topic, -1 before the first.
    gaps : dict of int
        Messages missing on each topic.
    drive : dict of RemoteNode
        The drive's nodes, by name.
    latched : list of dict
        Faults that they told, as they are stored with a recording.
    lags : dict
        Histograms of how late periods were, as the plant of a paced drive told them last.
    error : BagError or None
        Why the recording cannot go on; the run of this process ends then.
    finished : Future
        Done then.
    """

    def __init__(
        self,
        writer: BagWriter | None = None,
        *,
        black_box: Path | None = None,
        topics: Iterable[str] = tuple(LOOP_TOPICS),
        **options: Any,
    ) -> None:
        super().__init__("recorder", **options)
        self.last_period = dict.fromkeys(LOOP_TOPICS, -1)
        self.gaps = dict.fromkeys(LOOP_TOPICS, 0)
        self.drive = {name: RemoteNode() for name in _DRIVE_NODES}
        self.latched: list[dict[str, Any]] = []
        self.lags: dict[str, Any] = {}
        self.error: BagError | None = None
        self.finished = Future()
        self._steps: dict[str, int] = {}
        self._sent: dict[str, deque[tuple[int, int]]] = {
            topic: deque(maxlen=_SENT_KEPT) for topic, _ in _DRIVE_NODES.values()
        }
        self._box: BlackBox | None = None
        self._black_box = black_box
        self._first: tuple[int, int] | None = None
        self._inputs: list[tuple[Subscription, Callable[[bytes, int], None]]] = []
        self._in_step = None if writer is None else InStep(writer.write, self._steps)
        self._awaited = {topic: self._taking(topic) for topic in topics}
        self._subscribe()
        # Taken in bulk as well: the executor does not tell when a message was sent.
        self._events = self.create_subscription(
            ParameterEvent, "/parameter_events", _never, qos_profile_parameter_events
        )
        logger = self.get_logger()
        self._take_event = guard.callback(
            self._on_event, "/parameter_events: message dropped", logger
        )
        on_status = guard.callback(self._on_status, "drive_status: message dropped", logger)
        self._statuses: list[bytes] = []  # those that a black box shall have when it opens
        self.create_subscription(DriveStatus, "drive_status", on_status, _EVERY_STATUS, raw=True)
        on_diagnostics = guard.callback(
            self._on_diagnostics, "/diagnostics: message dropped", logger
        )
        self.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
        self.create_timer(_TAKE_EVERY, self.take_all, clock=Clock(clock_type=ClockType.STEADY_TIME))
        if black_box is not None:
            self._ask_the_drive()

    @property
    def parameter_changes(self) -> list[dict[str, Any]]:
        """Changed parameters of the drive's nodes: period, node, name, value."""
        return [
            {"node": name, **change} for name, node in self.drive.items() for change in node.changes
        ]

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions that an executor shall serve: not those that are taken in bulk."""
        taken = [self._events, *(subscription for subscription, _ in self._inputs)]
        return (each for each in super().subscriptions if each not in taken)

    def _subscribe(self) -> None:
        """Subscribe to those topics that have a publisher by now.

        A publisher waits for its recorders and then begins. So nobody may count as one who does not
        know of it yet: such a subscription gets nothing that is sent before it does.
        """
        for topic in [topic for topic in self._awaited if self.count_publishers(topic)]:
            msg_class = getattr(mfpcc_msgs.msg, LOOP_TOPICS[topic].rsplit("/", 1)[-1])
            subscription = self.create_subscription(msg_class, topic, _never, _KEEP_ALL, raw=True)
            self._inputs.append((subscription, self._awaited.pop(topic)))

    def take_all(self, *, last: bool = False) -> None:
        """Take what has come; at the end say that it is the `last` time."""
        if self.error is not None:
            return
        self._subscribe()
        try:
            for subscription, keep in self._inputs:
                take, msg_class = subscription.handle.take_message, subscription.msg_type
                while (message := take(msg_class, True)) is not None:
                    try:
                        keep(message[0], message[1]["source_timestamp"])
                    except struct.error as error:
                        self.get_logger().error(
                            f"{subscription.topic_name}: message dropped: {error}",
                            throttle_duration_sec=1.0,
                        )
            if self._in_step is not None:
                self._in_step.release(everything=last)
        except BagError as error:
            self.error = error
            self.finished.set_result(None)
        while (event := self._events.handle.take_message(ParameterEvent, False)) is not None:
            self._take_event(event[0], event[1]["source_timestamp"])
        for name, (topic, offset) in _DRIVE_NODES.items():
            node = self.drive[name]
            if node.has_news:
                sent = [(sent_at, period + offset) for sent_at, period in self._sent[topic]]
                node.date(sent, last=last)

    def _taking(self, topic: str) -> Callable[[bytes, int], None]:
        """What takes the messages of a topic: each with the time at which it was sent (ns)."""
        last, steps, in_step = self.last_period, self._steps, self._in_step
        sent = self._sent.get(topic, deque(maxlen=0))
        unpack = loop_messages.stamp_and_period

        def keep(data: bytes, sent_at: int) -> None:
            sec, nanosec, period = unpack(data)
            if period == last[topic]:
                return
            if last[topic] >= 0 and period != last[topic] + steps.get(topic, 0):
                self._out_of_step(topic, period - last[topic])
            last[topic] = period
            sent.append((sent_at, period))
            stamp = stamps.at(sec, nanosec)
            if in_step is not None:
                in_step.add(topic, period, stamp, data)
            if self._box is not None:
                self._box.rings[topic].append(data)
            elif self._black_box is not None and topic == "phase_feedback":
                self._open_box(self._black_box, stamp, period)

        return keep

    def _open_box(self, directory: Path, stamp: int, period: int) -> None:
        """Begin a black box as soon as two stamps tell the length of a period."""
        if self._first is None or period < self._first[1]:
            self._first = stamp, period
        elif period > self._first[1] and stamp > self._first[0]:
            pwm_frequency = stamps.frequency(self._first[0], stamp, period - self._first[1])
            self._box = BlackBox(self, directory, self.drive, pwm_frequency)
            for data in self._statuses:
                self._box.on_status(data)
            self._statuses.clear()

    def _out_of_step(self, topic: str, step: int) -> None:
        """Count what is missing; how many periods apart messages are, the first ones tell."""
        known = self._steps.get(topic)
        if step < 0:
            self.get_logger().warning(f"{topic}: began anew")
        elif known is None or step < known:
            if known is not None:
                self.gaps[topic] += known // step - 1  # so that was a gap
            self._steps[topic] = step
        else:
            self.gaps[topic] += step // known - 1

    def _on_status(self, data: bytes) -> None:
        """Keep the faults that are new: those of before this recorder too, if they last."""
        if self._box is not None:
            self._box.on_status(data)
        elif self._black_box is not None:
            self._statuses.append(data)
        message = deserialize_message(data, DriveStatus)
        reported = [(fault.code, int(fault.period), fault.detail) for fault in message.faults]
        self.latched += [f for f in latched(message.node, reported) if f not in self.latched]

    def _on_event(self, event: ParameterEvent, sent_at: int) -> None:
        namespace, _, name = event.node.rpartition("/")
        if name not in self.drive or namespace != self.get_namespace().rstrip("/"):
            return
        node = self.drive[name]
        if node.values:  # a node that was started again
            node.values |= {
                parameter.name: _value(name, parameter.name, parameter.value)
                for parameter in event.new_parameters
                if parameter.name in _TABLES[name]
            }
        for parameter in event.changed_parameters:
            value = _value(name, parameter.name, parameter.value)
            node.changed(sent_at, parameter.name, value)

    def _ask_the_drive(self) -> None:
        """Learn of the nodes what a black box shall hold: parameters and counters."""
        logger = self.get_logger()
        clients = {
            name: self.create_client(GetParameters, f"{name}/get_parameters") for name in self.drive
        }

        def ask() -> None:
            for name in [name for name, client in clients.items() if client.service_is_ready()]:
                request = GetParameters.Request(names=list(_TABLES[name]))
                future = clients.pop(name).call_async(request)
                take = partial(self._on_values, name, request.names)
                future.add_done_callback(guard.callback(take, f"parameters of {name}", logger))
            if not clients:
                self.destroy_timer(timer)

        timer = self.create_timer(_ASK_EVERY, ask, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_values(self, node: str, names: Sequence[str], future: Any) -> None:
        self.drive[node].values = {
            name: _value(node, name, value)
            for name, value in zip(names, future.result().values, strict=False)
        }

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for part in message.status:
            if part.name == f"{self.get_namespace()}/pmsm_sim: pace".lstrip("/"):
                figures = {item.key: item.value for item in part.values}
                self.lags = {
                    name: from_text(figures[f"{told} histogram (ns:periods)"])
                    for name, told in _LAGS.items()
                }
            for name, node in self.drive.items():
                if part.name == f"{self.get_namespace()}/{name}: loop".lstrip("/"):
                    figures = {item.key: item.value for item in part.values}
                    node.missed_periods = int(figures["missed periods"])
                    node.lost_periods = int(figures["lost periods"])

    def destroy_node(self) -> None:
        """Take what has come until now, and leave the graph."""
        if self.context.ok():
            self.take_all(last=True)
        if self._box is not None:
            self._box.close()
        super().destroy_node()


def _never(message: Any) -> None:
    """Stand for a callback: what comes is taken in bulk."""


def _value(node: str, name: str, value: ParameterValue) -> Any:
    """A parameter's value as the node itself has it."""
    plain = parameter_value_to_python(value)
    table = _TABLES[node]
    return ros_parameters.from_ros(table[name], plain) if name in table else plain


def _arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="record", description="Record everything on the loop of a running drive."
    )
    parser.add_argument("--out", type=Path, help="folder of the new bag")
    parser.add_argument("--force", action="store_true", help="replace a bag that is there")
    parser.add_argument(
        "--black-box",
        type=Path,
        metavar="DIRECTORY",
        help="at a fault, write the last moments before it into a bag in this folder",
    )
    arguments = parser.parse_args(argv)
    if arguments.out is None and arguments.black_box is None:
        parser.error("where to? give --out, --black-box, or both")
    return arguments


def main() -> int:
    """Record until stopped."""
    arguments = _arguments(rclpy.utilities.remove_ros_args(sys.argv)[1:])
    writer: BagWriter | None = None
    recorder: Recorder | None = None

    with contextlib.ExitStack() as stack:

        def make() -> Recorder:
            nonlocal writer, recorder
            if arguments.out is not None:
                stack.enter_context(interrupts.finished())  # from now on there is a bag to finish
                writer = stack.enter_context(
                    BagWriter(arguments.out, config={"engine": "ros"}, force=arguments.force)
                )
            recorder = Recorder(writer, black_box=arguments.black_box)
            if arguments.out is not None:
                recorder.get_logger().info(
                    f"recording into {arguments.out}; what was published before is not in it"
                )
            return recorder

        code = spin.main(make)
        if recorder is None:
            return code
        try:
            if writer is not None:
                writer.close(
                    {
                        "gaps": recorder.gaps,
                        "parameter_changes": recorder.parameter_changes,
                        "lags": recorder.lags,
                        "faults": recorder.latched,
                    }
                )
        except BagError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        if recorder.error is not None:
            print(f"error: {recorder.error}", file=sys.stderr)
            return 1
        return code or _report(recorder.last_period, recorder.gaps)


def _report(last: Mapping[str, int], gaps: Mapping[str, int]) -> int:
    """Say what was recorded; a gap is an error, never a silent loss."""
    for topic, period in last.items():
        print(f"{topic}: {'nothing' if period < 0 else f'up to period {period}'}")
    lost = {topic: count for topic, count in gaps.items() if count}
    for topic, count in lost.items():
        print(f"error: {topic}: {count} messages are missing", file=sys.stderr)
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())

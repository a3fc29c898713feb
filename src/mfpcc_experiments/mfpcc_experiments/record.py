"""The node `/recorder`: everything on the loop, from a running graph into a bag."""

from __future__ import annotations

import argparse
import struct
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import mfpcc_msgs.msg
import rclpy
import rclpy.utilities
from rcl_interfaces.msg import ParameterEvent
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from mfpcc_experiments.bag import LOOP_TOPICS, BagError, BagWriter
from pwm_node import spin

# Keep all and reliable: a recorder that cannot follow slows the loop down instead of losing.
_KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)

# What has come is taken at this interval: to be woken for each message would cost as much again as
# writing it, and nobody waits for a recorder.
_TAKE_EVERY = 0.005  # s

_DRIVE_NODES = ("pmsm_sim", "mfpcc_controller")

_STAMP_AND_PERIOD = struct.Struct("<4xiIQ")


def sink(writer: BagWriter, topic: str) -> Callable[[bytes], None]:
    """Return what appends serialized messages of one topic to a recording."""
    write, unpack = writer.write, _STAMP_AND_PERIOD.unpack_from

    def append(data: bytes) -> None:
        sec, nanosec, _ = unpack(data)
        write(topic, sec * 1_000_000_000 + nanosec, data)

    return append


class Recorder(Node):
    """Writes messages of the loop into a bag.

    A message that is repeated (a node sends its last one again to a peer that came late) is
    written once.

    Parameters
    ----------
    writer : BagWriter
        Where the messages go; its owner closes it.
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
    parameter_changes : list of dict
        Changed parameters of the drive's nodes (period, node, name, value); the period is that of
        the last sample seen before.
    """

    def __init__(
        self, writer: BagWriter, *, topics: Iterable[str] = tuple(LOOP_TOPICS), **options: Any
    ) -> None:
        super().__init__("recorder", **options)
        self.last_period = dict.fromkeys(LOOP_TOPICS, -1)
        self.gaps = dict.fromkeys(LOOP_TOPICS, 0)
        self.parameter_changes: list[dict[str, Any]] = []
        self._steps: dict[str, int] = {}
        self._inputs: list[tuple[Subscription, Callable[[bytes], None]]] = []
        for topic in topics:
            msg_class = getattr(mfpcc_msgs.msg, LOOP_TOPICS[topic].rsplit("/", 1)[-1])
            write = self._writing(writer, topic)
            subscription = self.create_subscription(msg_class, topic, write, _KEEP_ALL, raw=True)
            self._inputs.append((subscription, write))
        self.create_subscription(ParameterEvent, "/parameter_events", self._on_event, 100)
        self.create_timer(_TAKE_EVERY, self.take_all, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions that an executor shall serve: not those of the loop."""
        taken = [subscription for subscription, _ in self._inputs]
        return (each for each in super().subscriptions if each not in taken)

    def take_all(self) -> None:
        """Write what has come."""
        for subscription, write in self._inputs:
            take, msg_class = subscription.handle.take_message, subscription.msg_type
            while (message := take(msg_class, True)) is not None:
                write(message[0])

    def _writing(self, writer: BagWriter, topic: str) -> Callable[[bytes], None]:
        last, steps, write = self.last_period, self._steps, writer.write
        unpack = _STAMP_AND_PERIOD.unpack_from

        def on_message(data: bytes) -> None:
            sec, nanosec, period = unpack(data)
            if period == last[topic]:
                return
            if last[topic] >= 0 and period != last[topic] + steps.get(topic, 0):
                self._out_of_step(topic, period - last[topic])
            last[topic] = period
            write(topic, sec * 1_000_000_000 + nanosec, data)

        return on_message

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

    def _on_event(self, event: ParameterEvent) -> None:
        namespace, _, name = event.node.rpartition("/")
        if name not in _DRIVE_NODES or namespace != self.get_namespace().rstrip("/"):
            return
        period = self.last_period["phase_feedback"]
        for parameter in event.changed_parameters:
            value = parameter_value_to_python(parameter.value)
            self.parameter_changes.append(
                {"period": period, "node": name, "name": parameter.name, "value": value}
            )

    def destroy_node(self) -> None:
        """Write what has come until now, and leave the graph."""
        if self.context.ok():
            self.take_all()
        super().destroy_node()


def _arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="record", description="Record everything on the loop of a running drive."
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the new bag")
    parser.add_argument("--force", action="store_true", help="replace a bag that is there")
    return parser.parse_args(argv)


def main() -> int:
    """Record until stopped."""
    arguments = _arguments(rclpy.utilities.remove_ros_args(sys.argv)[1:])
    writer: BagWriter | None = None
    recorder: Recorder | None = None

    def make() -> Recorder:
        nonlocal writer, recorder
        writer = BagWriter(arguments.out, config={"engine": "ros"}, force=arguments.force)
        recorder = Recorder(writer)
        recorder.get_logger().info(
            f"recording into {arguments.out}; what was published before is not in it"
        )
        return recorder

    code = spin.main(make)
    if writer is None or recorder is None:
        return code
    try:
        writer.close({"gaps": recorder.gaps, "parameter_changes": recorder.parameter_changes})
    except BagError as error:
        print(f"error: {error}", file=sys.stderr)
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

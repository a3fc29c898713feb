"""What the middleware allows: the loop's two messages back and forth, with nothing in between.

These are the references. No executor, no plant, no controller: a sample is published and taken at
once, and so is the command that answers it, as message objects, the way rclpy is usually used; or
as serialized bytes, without any conversion.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import rclpy
from mfpcc_msgs.msg import DutyCommand, PhaseFeedback
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.serialization import serialize_message

from pwm_node.ros.loop_topics import PUBLISH, SUBSCRIBE

_WITHIN = 30.0  # s
_ONCE = 0.3  # s
_NANOSECONDS = 1_000_000_000


class Side:
    """Publishes one of the two messages and takes the other.

    Parameters
    ----------
    context : rclpy.Context
    name : str
        Name of the node.
    sends, takes : type
        Message classes.
    raw : bool
        Serialized bytes instead of message objects.
    """

    def __init__(
        self, context: rclpy.Context, name: str, sends: Any, takes: Any, *, raw: bool
    ) -> None:
        self.node = Node(name, context=context)
        topics = {PhaseFeedback: "bare_feedback", DutyCommand: "bare_command"}
        self._publisher = self.node.create_publisher(sends, topics[sends], PUBLISH)
        self._subscription = self.node.create_subscription(
            takes, topics[takes], lambda message: None, SUBSCRIBE, raw=raw
        )
        self._raw = raw
        self._takes = takes
        self._message = sends()
        self._bytes = serialize_message(sends())
        self._take = self._subscription.handle.take_message
        self._publish_raw = self._publisher.handle.publish_raw
        self._wait_set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, context.handle)

    def send(self, period: int) -> None:
        """Publish one message."""
        if self._raw:
            self._publish_raw(self._bytes)
        else:
            self._message.period = period
            self._publisher.publish(self._message)

    def take(self) -> bool:
        """Take one message, if there is one."""
        return self._take(self._takes, self._raw) is not None

    def wait(self, seconds: float = _WITHIN) -> bool:
        """Wait for one message and take it; False if there was none."""
        wait_set = self._wait_set
        wait_set.clear_entities()
        wait_set.add_subscription(self._subscription.handle)
        wait_set.wait(int(seconds * _NANOSECONDS))
        return self.take()

    def wait_for_answer(self) -> None:
        """Send until the other side answers, and forget what came."""
        deadline = time.monotonic() + _WITHIN
        self.wait_for_peer()
        while not self.wait(_ONCE):
            self.send(0)
            if time.monotonic() > deadline:
                raise TimeoutError("the other side of the bare loop does not answer")
        while self.wait(_ONCE):
            pass

    def wait_for_peer(self) -> None:
        """Wait until somebody publishes and subscribes on the other side."""
        deadline = time.monotonic() + _WITHIN
        while not (
            self._publisher.get_subscription_count()
            and self.node.count_publishers(self._subscription.topic_name)
        ):
            if time.monotonic() > deadline:
                raise TimeoutError("the other side of the bare loop has not come")
            time.sleep(0.01)


@contextlib.contextmanager
def graph() -> Iterator[rclpy.Context]:
    """A context of its own for one measurement."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    try:
        yield context
    finally:
        rclpy.try_shutdown(context=context)


def one_process(periods: int, *, raw: bool = False) -> float:
    """Return the time of one period within one process (us): publish and direct take, twice."""
    with graph() as context:
        plant = Side(context, "bare_plant", PhaseFeedback, DutyCommand, raw=raw)
        controller = Side(context, "bare_controller", DutyCommand, PhaseFeedback, raw=raw)
        plant.wait_for_peer()
        controller.wait_for_peer()
        begin = time.perf_counter()
        for k in range(periods):
            plant.send(k)
            arrived = controller.take()
            controller.send(k + 1)
            if not (arrived and plant.take()):
                raise RuntimeError("a message of the bare loop was lost")
        wall = time.perf_counter() - begin
        plant.node.destroy_node()
        controller.node.destroy_node()
    return wall / periods * 1e6


def two_processes(periods: int, *, raw: bool = False) -> float:
    """Return the time of one period between two processes (us): wait set and take on each side."""
    command = [sys.executable, __file__, "raw" if raw else "objects"]
    with subprocess.Popen(command) as echo, graph() as context:
        try:
            plant = Side(context, "bare_plant", PhaseFeedback, DutyCommand, raw=raw)
            plant.wait_for_answer()
            begin = time.perf_counter()
            for k in range(periods):
                plant.send(k)
                if not plant.wait():
                    raise RuntimeError("a message of the bare loop was lost")
            wall = time.perf_counter() - begin
            plant.node.destroy_node()
        finally:
            echo.terminate()
    return wall / periods * 1e6


def _echo(*, raw: bool) -> None:
    """Answer each sample until terminated, and leave the graph then."""
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit())
    with graph() as context:
        controller = Side(context, "bare_controller", DutyCommand, PhaseFeedback, raw=raw)
        period = 0
        while True:
            if controller.wait(_ONCE):
                period += 1
                controller.send(period)


if __name__ == "__main__":
    _echo(raw=sys.argv[1] == "raw")

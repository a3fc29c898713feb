"""What every run on a graph has in common: a context, a watch, and how its end is judged."""

from __future__ import annotations

import contextlib
import os
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future

from mfpcc_experiments.bags import BagWriter
from mfpcc_experiments.graph import loop_messages
from mfpcc_experiments.measuring import latched
from pmsm_sim.node import PmsmSim
from pwm_node import stamps
from pwm_node.errors import ForPeople
from pwm_node.ros import ros_environment
from pwm_node.ros.node import PwmNode

_LOOK_EVERY = 0.1  # s
_DISCOVERY = 0.3  # s: nodes on this machine are seen within a few hundredths
_LINGERING = 3.0  # s: what has just ended may be seen a while longer
_STALLED_AFTER = 20.0  # s
_START_WITHIN = 300.0  # s


class DriveError(ForPeople):
    """The graph did not do what it should; the text says what happened and what to do."""


# --- Begin ------------------------------------------------------------------------------------


@contextlib.contextmanager
def context() -> Iterator[rclpy.Context]:
    context = rclpy.Context()
    ros_environment.init([], context)
    try:
        yield context
    finally:
        rclpy.try_shutdown(context=context)


def refuse_company(node: Node) -> None:
    """Raise if another drive is on this graph: the two would answer each other's samples."""
    began = time.monotonic()
    while True:
        waited = time.monotonic() - began
        busy = [t for t in ("phase_feedback", "duty_command") if node.count_publishers(t)]
        if not busy and waited > _DISCOVERY:
            return
        if busy and waited > _LINGERING:
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            raise DriveError(
                f"another drive publishes {busy[0]} on this graph (ROS_DOMAIN_ID={domain}): "
                "stop it, or run with another ROS_DOMAIN_ID"
            )
        time.sleep(0.02)


def values(config: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Parameters of the plant and of the controller, from what is stored with a recording."""
    parameters = config["parameters"]
    return dict(parameters["pmsm_sim"]), dict(parameters["mfpcc_controller"])


def nonempty(values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters as ROS takes them: an empty list has no type there, and is the default."""
    return {name: value for name, value in values.items() if value != []}


def overrides(values: Mapping[str, Any]) -> list[Parameter]:
    """Parameters as a node of this process takes them."""
    return [Parameter(name, value=value) for name, value in nonempty(values).items()]


# --- While it goes on -----------------------------------------------------------------------------


def now_and_then(plant: PmsmSim, call: Callable[[], Any]) -> None:
    """Have something called by the plant's executor while it runs, ten times a second."""
    plant.create_timer(_LOOK_EVERY, call, clock=Clock(clock_type=ClockType.STEADY_TIME))


def sink(writer: BagWriter, topic: str) -> Callable[[bytes], None]:
    """Return what appends serialized messages of one topic to a recording."""
    write, unpack = writer.write, loop_messages.stamp_and_period

    def append(data: bytes) -> None:
        sec, nanosec, _ = unpack(data)
        write(topic, stamps.at(sec, nanosec), data)

    return append


class Watch:
    """Looks whether a run goes on, and its controller where that is a process of its own."""

    def __init__(self, plant: PmsmSim, controller: subprocess.Popen[bytes] | None = None) -> None:
        self.over = Future()
        self.trouble = ""
        self._plant = plant
        self._controller = controller
        self._seen = plant.period
        self._seen_at = time.monotonic()

    def look(self) -> int:
        """Return the number of periods done; complete `over` where the run does not go on."""
        now = time.monotonic()
        if self._plant.period != self._seen:
            self._seen, self._seen_at = self._plant.period, now
        # Before the first sample kernels may have to be compiled.
        patience = _STALLED_AFTER if self._seen >= 0 else _START_WITHIN
        code = self._controller.poll() if self._controller is not None else None
        if code is not None:
            self._end(f"mfpcc_controller ended with exit code {code} (see above)")
        elif now - self._seen_at > patience:
            self._end(f"nothing came on duty_command for {patience:.0f} s")
        return max(self._seen, 0)

    def _end(self, trouble: str) -> None:
        self.trouble = trouble
        if not self.over.done():
            self.over.set_result(None)


# --- End ------------------------------------------------------------------------------------------


def outcome(plant: PmsmSim, nodes: Sequence[PwmNode], wall: float) -> dict[str, Any]:
    """What is stored with a recording at its end, as the nodes of this process know it.

    Parameters
    ----------
    plant : PmsmSim
        The plant.
    nodes : sequence of PwmNode
        The nodes of the drive that run in this process, the plant among them.
    wall : float
        Time that the run has taken (s).
    """
    return {
        "missed_periods": plant.missed_periods,
        "parameter_changes": [
            {"node": node.get_name(), **change} for node in nodes for change in node.changes
        ],
        "faults": [fault for node in nodes for fault in latched(node.get_name(), node.latched)],
        "real_time_factor": plant.pace,
        "lags": {name: lags.to_json() for name, lags in (plant.lags or {}).items()},
        "wall_s": wall,
    }


def judge(done: int, periods: int, trouble: str) -> None:
    """Raise if a run has not come to its end."""
    if trouble:
        raise DriveError(f"the run ended at period {done} of {periods}: {trouble}")
    if done < periods:
        raise KeyboardInterrupt  # that is how it was stopped

"""The drive as it is measured: its two nodes, run for so many periods."""

from __future__ import annotations

import contextlib
import os
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import rclpy
import yaml
from ament_index_python.packages import get_package_prefix
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from mfpcc_controller.node import MfpccController
from pmsm_sim.node import PmsmSim
from pwm_node.lags import Lags
from pwm_node.ros import spin
from pwm_node.ros.node import PwmNode

#: The operating point of every measurement: 750 r/min, 2 N m, noisy current sensors.
PLANT = {"load_torque": 2.0, "initial_speed_rpm": 750.0, "noise.current_rms": 0.0245}
CONTROLLER = {"scheme": "mls_mfpcc", "speed_ref_rpm": 750.0}


class TimedPlant(PmsmSim):
    """The plant; notes when the first period begins and when the last one is answered."""

    begin = end = 0.0

    def _begin(self) -> None:
        self.begin = time.perf_counter()
        super()._begin()

    def finish(self) -> None:
        """Note the end."""
        self.end = time.perf_counter()
        super().finish()

    def period_us(self) -> float:
        """Time of one period (us)."""
        if not self.end:
            raise RuntimeError(f"the drive stopped at period {self.period}")
        return (self.end - self.begin) / self.period * 1e6


def own_domain() -> str:
    """A ROS domain that no test run on this machine takes: tests have 1 to 101.

    Those above 101 collide with ephemeral ports on Linux, but for the last ones.
    """
    return str(215 + os.getpid() % 18)


@contextlib.contextmanager
def graph() -> Iterator[rclpy.Context]:
    """A context of its own for one run."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield context
    finally:
        rclpy.try_shutdown(context=context)


def plant(context: rclpy.Context, periods: int, **more: Any) -> TimedPlant:
    """The plant at the operating point; it ends the run after so many periods."""
    return TimedPlant(
        context=context, parameter_overrides=_overrides({**PLANT, "periods": periods, **more})
    )


def controller(context: rclpy.Context) -> MfpccController:
    """The controller at the operating point."""
    return MfpccController(context=context, parameter_overrides=_overrides(CONTROLLER))


def composed(
    periods: int, serve: Callable[[Sequence[PwmNode]], None] | None = None
) -> tuple[TimedPlant, MfpccController]:
    """Run both nodes in this process over real topics, as the executable `drive` does.

    Parameters
    ----------
    periods : int
    serve : callable, optional
        Runs the nodes to the end, instead of `pwm_node.ros.spin.run`.
    """
    with graph() as context:
        nodes = (plant(context, periods), controller(context))
        if serve is None:
            spin.run(nodes, until=Future())
        else:
            serve(nodes)
        for node in nodes:
            node.destroy_node()
    return nodes


def on_single_threaded_executor(nodes: Sequence[PwmNode]) -> None:
    """Serve the nodes with rclpy's default executor."""
    executor = SingleThreadedExecutor(context=nodes[0].context)
    for node in nodes:
        executor.add_node(node)
        node.trigger_configure()
    for node in reversed(nodes):
        node.trigger_activate()
    executor.spin_until_future_complete(nodes[0].finished)
    executor.shutdown()


COMPOSED, IN_TWO_PROCESSES = "composed", "two processes"


class Paced(NamedTuple):
    """What a run by the wall clock showed."""

    in_time: float  # %, of all periods of the clock
    missed: int  # periods without a command
    left_out: int  # periods that went by while the plant had no core
    faults: list[str]
    start: Lags
    round_trip: Lags


def paced(kind: str, frequency: float, seconds: float, folder: Path) -> Paced:
    """Run the drive by the wall clock, `COMPOSED` or `IN_TWO_PROCESSES`, for so many seconds."""
    periods = round(frequency * seconds)
    both = {"pwm_frequency": frequency}
    with graph() as context, contextlib.ExitStack() as stack:
        node = plant(context, periods, real_time_factor=1.0, **both)
        nodes: list[PwmNode] = [node]
        if kind == COMPOSED:
            nodes.append(
                MfpccController(
                    context=context, parameter_overrides=_overrides({**CONTROLLER, **both})
                )
            )
        else:
            stack.enter_context(
                running("mfpcc_controller", "controller", {**CONTROLLER, **both}, folder)
            )
        spin.run(nodes, until=Future())
        lags = node.lags
        assert lags is not None, "it never began"
        left_out = node.periods_left_out
        # a run of so many periods lasts longer by those that were left out
        found = Paced(
            100.0 * (1.0 - (node.missed_periods + left_out) / (periods + left_out)),
            node.missed_periods,
            left_out,
            [code for code, _, _ in node.latched],
            lags["start"],
            lags["round_trip"],
        )
        for each in nodes:
            each.destroy_node()
    return found


class Separate(NamedTuple):
    """What a run in two processes showed."""

    period_us: float
    start_s: float  # from the start of the controller's process to its first command


def separate(periods: int, folder: Path, *, recorded: bool = False) -> Separate:
    """Run the plant in this process and the controller in another, with a recorder in a third."""
    recorders = {"recorders": int(recorded)}
    with graph() as context, contextlib.ExitStack() as stack:
        node = plant(context, periods, **recorders)
        started = time.perf_counter()
        stack.enter_context(
            running("mfpcc_controller", "controller", {**CONTROLLER, **recorders}, folder)
        )
        if recorded:
            stack.enter_context(
                running("mfpcc_experiments", "record", {}, folder, "--out", str(folder / "bag"))
            )
        spin.run([node], until=Future())
        node.destroy_node()
    return Separate(node.period_us(), node.begin - started)


@contextlib.contextmanager
def running(
    package: str, executable: str, values: Mapping[str, Any], folder: Path, *arguments: str
) -> Iterator[subprocess.Popen[bytes]]:
    """An executable of the workspace with these parameters, as `ros2 run` starts it."""
    file = folder / f"{executable}.yaml"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": dict(values)}}))
    program = Path(get_package_prefix(package), "lib", package, executable)
    command = [str(program), *arguments, "--ros-args", "--params-file", str(file)]
    with subprocess.Popen(command, start_new_session=True) as process:
        try:
            yield process
        finally:
            process.terminate()
            process.wait()


def _overrides(values: Mapping[str, Any]) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in values.items()]

"""Plant and controller on a real graph: in one process (the fast way), or in two.

`ros2 run mfpcc_experiments drive` runs both nodes in one process until stopped; the verb `run`
records a scenario with `record_composed` or `record_separate`.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
import yaml
from ament_index_python.packages import get_package_prefix
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future

from mfpcc_controller.controller import Controller
from mfpcc_controller.node import MfpccController
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.bags import BagWriter
from mfpcc_experiments.graph import black_box
from mfpcc_experiments.graph.black_box import BlackBoxNode
from mfpcc_experiments.graph.recorder import Recorder, sink
from mfpcc_experiments.measuring.happened import latched
from mfpcc_experiments.progress import Tell
from pmsm_sim.node import PmsmSim
from pmsm_sim.parameters import TABLE as PLANT
from pmsm_sim.plant import Plant
from pwm_node import interrupts, ros_environment, spin
from pwm_node.errors import ForPeople
from pwm_node.node import PwmNode

_PROGRESS_EVERY = 0.1  # s
_DISCOVERY = 0.3  # s: nodes on this machine are seen within a few hundredths
_LINGERING = 3.0  # s: what has just ended may be seen a while longer
_STALLED_AFTER = 20.0  # s
_START_WITHIN = 300.0  # s
_STOP_WITHIN = 10.0  # s


class DriveError(ForPeople):
    """The graph did not do what it should; the text says what happened and what to do."""


# --- One process --------------------------------------------------------------------------------


def record_composed(config: Mapping[str, Any], path: Path, periods: int, progress: Tell) -> None:
    """Run both nodes in this process over real topics, and record what they publish in line.

    Parameters
    ----------
    config : mapping
        From `run.configuration`.
    path : Path
        The new bag.
    periods : int
        Number of periods; the plant ends the run after them.
    progress : callable
        Told the number of periods done.

    Raises
    ------
    DriveError
        If another drive is on the graph, or the run does not come to its end.
    BagError
        If the recording cannot be written.
    """
    plant_values, controller_values = _values(config)
    with _context() as context:
        plant = PmsmSim(context=context, parameter_overrides=_overrides(plant_values))
        controller = MfpccController(
            context=context, parameter_overrides=_overrides(controller_values)
        )
        _refuse_company(plant)
        nodes: list[PwmNode] = [plant, controller]
        plant.create_timer(
            _PROGRESS_EVERY,
            lambda: progress(max(plant.period, 0)),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        with BagWriter(path, config=config, oversampling=plant_values["oversampling"]) as writer:
            for node in nodes:
                node.tap = lambda topic: sink(writer, topic)
            begin = time.monotonic()
            code = spin.run(nodes, until=Future())
            wall = time.monotonic() - begin
            done, pace = max(plant.period, 0), plant.pace
            median, p99 = controller.step_times.percentiles(50, 99)
            writer.close(
                {
                    "step_time_us": {"median": median, "p99": p99},
                    "lost_periods": controller.lost_periods,
                    "missed_periods": plant.missed_periods,
                    "parameter_changes": _changes(nodes),
                    "faults": _latched(nodes),
                    "real_time_factor": pace,
                    "wall_s": wall,
                }
            )
        for node in nodes:
            node.destroy_node()
    _judge(done, periods, "after an error (see above)" if code else "")
    progress(periods)


@dataclass(frozen=True)
class ComposedRun:
    """
    What is left of a run that was not recorded.

    Attributes
    ----------
    plant, controller : Plant, Controller
        As they were at the end.
    messages : dict
        What was published, serialized, by loop topic.
    """

    plant: Plant
    controller: Controller
    messages: dict[str, list[bytes]]


@contextlib.contextmanager
def composed_runs() -> Iterator[Callable[[Mapping[str, Any], Mapping[str, Any]], ComposedRun]]:
    """
    Run both nodes in this process over real topics, as often as one likes.

    Nothing is recorded, and the nodes say nothing; a run that stands still is ended.

    Yields
    ------
    callable
        Takes a value for every parameter of the two tables; the plant's `periods` end the run.

    Raises
    ------
    DriveError
        If another drive is on the graph, or a node fails.
    """
    with _context() as context:
        scout = Node("scout", context=context)
        _refuse_company(scout)
        scout.destroy_node()

        def once(
            plant_values: Mapping[str, Any], controller_values: Mapping[str, Any]
        ) -> ComposedRun:
            options = {"context": context, "enable_rosout": False}
            plant = PmsmSim(parameter_overrides=_overrides(plant_values), **options)
            controller = MfpccController(
                parameter_overrides=_overrides(controller_values), **options
            )
            nodes: list[PwmNode] = [plant, controller]
            messages: dict[str, list[bytes]] = {}
            for node in nodes:
                node.get_logger().set_level(LoggingSeverity.FATAL)
                node.tap = lambda topic: messages.setdefault(topic, []).append
            watch = _Watch(plant)
            plant.create_timer(
                _PROGRESS_EVERY, watch.look, clock=Clock(clock_type=ClockType.STEADY_TIME)
            )
            code = spin.run(nodes, until=watch.over)
            result = ComposedRun(plant.core, controller.core, messages)
            done = max(plant.period, 0)
            for node in nodes:
                node.destroy_node()
            trouble = "after an error of a node" if code else ""
            _judge(done, done if watch.trouble else plant_values["periods"], trouble)
            return result

        yield once


def main() -> int:
    """Run plant and controller in one process until stopped, with a black box."""
    nodes: list[PwmNode] = []

    def plant() -> Node:
        nodes.append(PmsmSim(also_known=(*CONTROLLER, black_box.PARAMETER)))
        return nodes[-1]

    def controller() -> Node:
        nodes.append(MfpccController(also_known=(*PLANT, black_box.PARAMETER)))
        return nodes[-1]

    def black_box_node() -> Node:
        node = BlackBoxNode(nodes)
        _introduce(*nodes)
        return node

    return spin.main(plant, controller, black_box_node)


def _introduce(plant: PwmNode, controller: PwmNode) -> None:
    """Say what runs here, and what can be typed next."""
    factor = plant.values["real_time_factor"]
    pace = f"at {factor:g} times real time" if factor else "in lock-step, as fast as it goes"
    values = controller.values
    if values["control_mode"] == "speed":
        goal = f"{values['speed_ref_rpm']:g} r/min"
    else:
        goal = f"i_d {values['i_d_ref']:g} A, i_q {values['i_q_ref']:g} A"
    name = controller.get_fully_qualified_name()
    logger = controller.get_logger()
    logger.info(
        f"a simulated drive: motor {plant.values['motor']}, scheme {values['scheme']}, {goal}, "
        f"{pace}; Ctrl-C stops it"
    )
    logger.info(
        f"from another shell: 'ros2 param set {name} speed_ref_rpm 500.0', "
        f"'ros2 topic echo --once {plant.get_namespace().rstrip('/')}/drive_state', "
        f"'ros2 param list {name}'"
    )


# --- Two processes ------------------------------------------------------------------------------


def record_separate(config: Mapping[str, Any], path: Path, periods: int, progress: Tell) -> None:
    """Run the plant in this process and the controller in one of its own, and record both.

    What the plant publishes is recorded in line, what the controller publishes as it arrives here.
    A recorder in a third process would get each of the four messages on its own, which takes the
    two that work about as much time again.

    Parameters and errors are those of `record_composed`.
    """
    plant_values, controller_values = _values(config)
    controller_values["recorders"] = 1
    with contextlib.ExitStack() as stack:
        context = stack.enter_context(_context())
        plant = PmsmSim(context=context, parameter_overrides=_overrides(plant_values))
        stack.callback(plant.destroy_node)
        _refuse_company(plant)
        writer = stack.enter_context(
            BagWriter(path, config=config, oversampling=plant_values["oversampling"])
        )
        plant.tap = lambda topic: sink(writer, topic)
        recorder = Recorder(writer, topics=("duty_command", "lut_diagnostics"), context=context)
        stack.callback(recorder.destroy_node)
        controller = stack.enter_context(
            _process("mfpcc_controller", "controller", controller_values)
        )
        watch = _Watch(plant, controller)
        plant.create_timer(
            _PROGRESS_EVERY,
            lambda: progress(watch.look()),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        begin = time.monotonic()
        code = spin.run([plant, recorder], until=watch.over)
        wall = time.monotonic() - begin
        done = max(plant.period, 0)
        if recorder.error is not None:
            raise recorder.error
        if done == periods:
            _take_the_rest(recorder, periods, controller_values["diagnostics_decimation"])
        recorder.take_all(last=True)
        writer.close(
            {
                "gaps": recorder.gaps,
                "missed_periods": plant.missed_periods,
                "parameter_changes": [
                    *_changes([plant]),
                    *(c for c in recorder.parameter_changes if c["node"] != plant.get_name()),
                ],
                "faults": [
                    *_latched([plant]),
                    *(f for f in recorder.latched if f["node"] != plant.get_name()),
                ],
                "real_time_factor": plant.pace,
                "wall_s": wall,
            }
        )
    _judge(done, periods, "after an error (see above)" if code else watch.trouble)
    lost = {topic: count for topic, count in recorder.gaps.items() if count}
    if lost:
        raise DriveError(f"the recording has gaps: {lost}")
    progress(periods)


def _take_the_rest(recorder: Recorder, periods: int, decimation: int) -> None:
    """Wait for what the controller published last: it comes after the command that ends the run."""
    last = {"duty_command": periods}
    if decimation:
        last["lut_diagnostics"] = (periods - 1) // decimation * decimation
    deadline = time.monotonic() + _STOP_WITHIN
    while True:
        recorder.take_all()
        missing = [topic for topic, end in last.items() if recorder.last_period[topic] < end]
        if not missing:
            return
        if time.monotonic() > deadline:
            raise DriveError(f"the end of {missing[0]} did not arrive in {_STOP_WITHIN:.0f} s")
        time.sleep(0.001)


class _Watch:
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


@contextlib.contextmanager
def _process(
    package: str, executable: str, values: Mapping[str, Any]
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a node with these parameters; stop it at the end, by force where it does not."""
    program = Path(get_package_prefix(package), "lib", package, executable)
    text = yaml.safe_dump({"/**": {"ros__parameters": _nonempty(values)}})
    # A file without a place: should this process be killed, nothing of it is left.
    with os.fdopen(os.memfd_create("parameters"), "w") as file:
        file.write(text)
        file.flush()
        process = subprocess.Popen(
            [program, "--ros-args", "--params-file", f"/dev/fd/{file.fileno()}"],
            pass_fds=[file.fileno()],
            # Ctrl-C is for this process, which stops them in order
            start_new_session=True,
            env=interrupts.ending_with_this_process(),
        )
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(_STOP_WITHIN)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


# --- Both ---------------------------------------------------------------------------------------


def _judge(done: int, periods: int, trouble: str) -> None:
    """Raise if a run has not come to its end."""
    if trouble:
        raise DriveError(f"the run ended at period {done} of {periods}: {trouble}")
    if done < periods:
        raise KeyboardInterrupt  # that is how it was stopped


def _changes(nodes: Sequence[PwmNode]) -> list[dict[str, Any]]:
    """Parameters that changed while it ran: period, node, name, value."""
    return [{"node": node.get_name(), **change} for node in nodes for change in node.changes]


def _latched(nodes: Sequence[PwmNode]) -> list[dict[str, Any]]:
    """Faults that came while it ran."""
    return [fault for node in nodes for fault in latched(node.get_name(), node.latched)]


def _values(config: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    parameters = config["parameters"]
    return dict(parameters["pmsm_sim"]), dict(parameters["mfpcc_controller"])


def _nonempty(values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters as ROS takes them: an empty list has no type there, and is the default."""
    return {name: value for name, value in values.items() if value != []}


def _overrides(values: Mapping[str, Any]) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in _nonempty(values).items()]


@contextlib.contextmanager
def _context() -> Iterator[rclpy.Context]:
    context = rclpy.Context()
    ros_environment.init([], context)
    try:
        yield context
    finally:
        rclpy.try_shutdown(context=context)


def _refuse_company(node: Node) -> None:
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


if __name__ == "__main__":
    sys.exit(main())

"""Paced mode: periods follow the wall clock, and what is not in time is counted, not made up for.

How a machine keeps the pace is its own business, so nothing here is held against its clock: the
plant has one that the test sets, and over a graph it is seen who waits for whom.
"""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from harness import Process, reached, until
from outside import Outside
from rclpy.parameter import Parameter

from mfpcc_experiments.bags import recording
from mfpcc_experiments.graph.replayer import Replayer
from pmsm_sim.node import PmsmSim
from pwm_node.ros.diagnostics import Level

REFERENCE = Path(__file__).resolve().parent.parent / "bags" / "reference" / "mfpcc"

#: 200 periods a second.
FACTOR = 0.02
RATE = 1e4 * FACTOR  # periods per second

Start = Callable[..., Process]


@pytest.fixture
def outside(domain: int) -> Iterator[Outside]:
    it = Outside()
    yield it
    it.close()


def start_nodes(start: Start, package: str, executable: str, *more: str) -> Process:
    values = (f"real_time_factor:={FACTOR}", *more)
    arguments = [part for value in values for part in ("-p", value)]
    return start(package, executable, "--ros-args", *arguments)


class Paced(PmsmSim):
    """The plant with a pace, without anybody who waits for it."""

    def __init__(self, context: rclpy.Context, **more: float) -> None:
        values = {"real_time_factor": FACTOR, "inverter.command_loss_limit": 100000, **more}
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        super().__init__(context=context, parameter_overrides=overrides)
        assert self.trigger_configure() == self.trigger_activate()
        self._advance()  # as if somebody listened
        self._set_pace(self.values["real_time_factor"])

    def left_out(self) -> float:
        (part,) = (each for each in self.diagnostics() if each.name == "inverter")
        return float(part.values["periods left out (wall clock)"])  # type: ignore[arg-type]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """What time it is, for the pace (s)."""
    now = [1000.0]
    monkeypatch.setattr("pwm_node.ros.pace.time.monotonic", lambda: now[0])
    return now


def test_each_tick_is_a_period_and_lost_time_is_left_out(
    context: rclpy.Context, clock: list[float]
) -> None:
    plant = Paced(context)
    assert plant._pace.timer is not None and plant._pace.timer.timer_period_ns == round(1e9 / RATE)
    for tick in range(1, 101):
        clock[0] = 1000.0 + tick / RATE
        plant._pace.on_tick()
        assert plant.period == tick
    assert plant.left_out() == 0

    # 1.0025 s in which the process did not run: 200 periods, and half of one
    clock[0] += 1.0 + 1.5 / RATE
    plant._pace.on_tick()
    assert plant.period == 101, "periods were run in a burst"
    assert plant.left_out() == 200
    # the next ones keep phase: a late one is followed by the next in its own time
    for tick in range(302, 402):
        clock[0] = 1000.0 + tick / RATE
        plant._pace.on_tick()
    assert plant.period == 201
    assert plant.left_out() == 200
    plant.destroy_node()


def test_the_pace_is_that_of_the_parameter_from_the_next_period_on(
    context: rclpy.Context, clock: list[float]
) -> None:
    plant = Paced(context)
    (answer,) = plant.set_parameters([Parameter("real_time_factor", value=0.5 * FACTOR)])
    assert answer.successful, answer.reason
    assert plant._pace.timer is not None and plant._pace.timer.timer_period_ns == round(2e9 / RATE)
    for tick in range(1, 11):
        clock[0] = 1000.0 + 2.0 * tick / RATE
        plant._pace.on_tick()
    assert plant.period == 10 and plant.left_out() == 0
    (answer,) = plant.set_parameters([Parameter("real_time_factor", value=0.0)])
    assert answer.successful and not plant._pace.running
    plant.destroy_node()


def test_a_replay_too_leaves_out_lost_time(context: rclpy.Context, clock: list[float]) -> None:
    bag = recording.read(REFERENCE)
    replay = Replayer(bag, context=context, parameter_overrides=[Parameter("rate", value=1.0)])
    assert replay.trigger_configure()
    replay._set_pace(1.0)
    for tick in range(1, 11):
        clock[0] = 1000.0 + tick * bag.T_s
        replay._pace.on_tick()
    assert replay.sent == 10
    clock[0] += 100.5 * bag.T_s
    replay._pace.on_tick()
    assert replay.sent == 11, "samples were sent in a burst"
    (part,) = replay.diagnostics()
    assert part.values["periods left out (wall clock)"] == 99
    replay.destroy_node()


def test_missed_periods_are_counted_and_published(start: Start, outside: Outside) -> None:
    start_nodes(start, "pmsm_sim", "pmsm_sim", "inverter.command_loss_limit:=100000")
    controller = start("mfpcc_controller", "controller")
    outside.until_beyond(20, "the loop runs")

    def missed() -> float:
        outside.look()
        return outside.diagnostic("pmsm_sim: loop", "missed periods")

    until(lambda: missed() >= 0, "diagnostics come")
    before = missed()
    controller.signal(signal.SIGSTOP)
    try:
        outside.until_beyond(outside.period + 50, "the plant goes on without a controller")
        until(lambda: missed() >= before + 40, "the missed periods are told")
    finally:
        controller.signal(signal.SIGCONT)
    before = outside.diagnostic("pmsm_sim: loop", "period")
    outside.until(
        lambda: outside.diagnostic("pmsm_sim: loop", "period") > before + 50, "the loop goes on"
    )
    # its commands count again: not every period is missed as while it was stopped
    counted, period = missed(), outside.diagnostic("pmsm_sim: loop", "period")

    def commands_come() -> bool:
        more = missed() - counted
        return more < outside.diagnostic("pmsm_sim: loop", "period") - period

    until(commands_come, "the commands count again")


def test_lost_wall_clock_time_is_told(start: Start, outside: Outside) -> None:
    drive = start_nodes(start, "mfpcc_experiments", "drive")
    outside.until_beyond(20, "the drive runs")
    drive.signal(signal.SIGSTOP)
    time.sleep(1.0)  # the disturbance itself: 200 periods of wall-clock time
    drive.signal(signal.SIGCONT)

    def left_out() -> float:
        outside.look()
        return outside.diagnostic("pmsm_sim: inverter", "periods left out (wall clock)")

    until(lambda: left_out() >= 0.5 * RATE, "the periods left out are told")
    outside.until(
        lambda: outside.diagnostic("pmsm_sim: pace", "real-time factor asked for") == FACTOR,
        "the pace is told",
    )


def test_a_pace_beyond_the_machine_is_a_warning(start: Start, outside: Outside) -> None:
    start_nodes(start, "mfpcc_experiments", "drive")
    outside.until_beyond(20, "the drive runs")
    (answer,) = outside.set("pmsm_sim", real_time_factor=100.0)
    assert answer.successful, answer.reason

    def pace(which: str) -> float:
        return outside.diagnostic("pmsm_sim: pace", f"real-time factor {which}")

    outside.until(
        lambda: pace("asked for") == 100.0 and outside.level("pmsm_sim: pace") == Level.WARN,
        "that it falls behind is told",
    )
    assert 0.0 < pace("achieved") < 100.0


def test_the_pace_can_be_changed_while_it_runs(start: Start, outside: Outside) -> None:
    start_nodes(start, "mfpcc_experiments", "drive")
    outside.until_beyond(20, "the drive runs, paced")
    for factor in (0.0, FACTOR, 0.5 * FACTOR):
        (answer,) = outside.set("pmsm_sim", real_time_factor=factor)
        assert answer.successful, answer.reason
        for _ in range(20):
            outside.look()  # what was on its way
        outside.until_beyond(outside.period + 100, f"it goes on at {factor}")
    assert not math.isnan(outside.diagnostic("pmsm_sim: loop", "missed periods"))


SEPARATE = (("pmsm_sim", "pmsm_sim"), ("mfpcc_controller", "controller"))
TOGETHER = (("mfpcc_experiments", "drive"),)


@pytest.mark.parametrize("programs", [TOGETHER, SEPARATE])
def test_a_paced_drive_waits_for_no_recorder(
    start: Start, outside: Outside, tmp_path: Path, programs: tuple[tuple[str, str], ...]
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**/pmsm_sim:\n  ros__parameters: {real_time_factor: 0.5, load_torque: 1.0, "
        "inverter.command_loss_limit: 100000}\n"
        "/**/mfpcc_controller:\n  ros__parameters: {fault.feedback_timeout: 0.0}\n"
    )
    nodes = [start(*each, "--ros-args", "--params-file", str(file)) for each in programs]
    recorder = start("mfpcc_experiments", "record", "--out", str(tmp_path / "bag"))
    recorder.wait_for("recording into")
    outside.until_beyond(100, "the drive runs")

    def recorded() -> bool:
        outside.look()
        return sum(file.stat().st_size for file in tmp_path.glob("**/*.mcap*")) > 100_000

    until(recorded, "it is recorded")
    recorder.signal(signal.SIGSTOP)
    # more than publisher and subscriber keep, 5000 messages each
    outside.until_beyond(outside.period + 15_000, "the drive goes on without its recorder")
    recorder.signal(signal.SIGCONT)
    end = outside.period
    until(lambda: reached(tmp_path / "bag") > end, "the recorder has what comes after the gap")
    assert recorder.end(signal.SIGINT) == 1
    assert "phase_feedback: " in recorder.output and "messages are missing" in recorder.output
    for node in nodes:
        assert "takes no more messages" not in node.output
        assert node.end(signal.SIGINT) == 0

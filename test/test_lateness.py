"""How late periods are: counted by the plant, told on /diagnostics, kept by a recording, drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from harness import until
from mfpcc_msgs.msg import DutyCommand, PhaseFeedback
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

from mfpcc_controller.node import MfpccController
from mfpcc_experiments.bags import recording
from mfpcc_experiments.graph import session
from mfpcc_experiments.graph.recorder import Recorder
from mfpcc_experiments.measuring import Measured, cut, evaluate, signals
from mfpcc_experiments.reporting import compare, figures
from pmsm_sim.node import PmsmSim
from pwm_node.lags import Lags, bins_of
from pwm_node.wire import Wire

REFERENCE = Path(__file__).resolve().parent.parent / "bags" / "reference" / "mfpcc"
STEP = 1e-4  # s


class Clock:
    """The time as the plant sees it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 1000.0
        monkeypatch.setattr("pwm_node.ros.pace.time.monotonic", lambda: self.now)
        monkeypatch.setattr("pmsm_sim.node.time.perf_counter_ns", lambda: round(self.now * 1e9))


@pytest.fixture
def paced(context: rclpy.Context, monkeypatch: pytest.MonkeyPatch) -> Iterator[PmsmSim]:
    """A plant of which each tenth period begins 40 us late, and each command is there 30 us after.

    Commands of every 25th period never come.
    """
    clock = Clock(monkeypatch)
    values = {"real_time_factor": 1.0, "inverter.command_loss_limit": 100000}
    plant = PmsmSim(
        context=context,
        parameter_overrides=[Parameter(name, value=value) for name, value in values.items()],
    )
    assert plant.trigger_configure() == plant.trigger_activate()
    plant._advance()  # as if somebody listened
    plant._set_pace(1.0)
    command = Wire(DutyCommand)
    command.fixed["duty"] = 0.5
    for tick in range(1, 1001):
        clock.now = 1000.0 + tick * STEP + (40e-6 if tick % 10 == 0 else 2e-6)
        plant._pace.on_tick()
        clock.now += 30e-6
        if tick % 25:
            command.fixed["period"] = plant.period + 1
            plant._on_command(command.to_bytes())
    yield plant
    plant.destroy_node()


def test_every_period_is_counted(paced: PmsmSim) -> None:
    lags = paced.lags
    assert lags is not None
    start, round_trip = lags["start"], lags["round_trip"]
    assert (start.count, round_trip.count) == (1000, 960)
    assert start.percentiles((50, 89, 91, 99.9)) == pytest.approx([2, 2, 40, 40], rel=1 / 31)
    assert round_trip.percentiles() == pytest.approx([30, 30, 30], rel=1 / 31)
    assert start.longest == pytest.approx(40e3, rel=1e-3)
    # the last one has not been missed yet
    assert paced.missed_periods == 1000 // 25 - 1


def test_a_new_pace_counts_anew_and_lock_step_not_at_all(paced: PmsmSim) -> None:
    (answer,) = paced.set_parameters([Parameter("real_time_factor", value=0.5)])
    assert answer.successful
    assert paced.lags is not None and paced.lags["start"].count == 0
    (answer,) = paced.set_parameters([Parameter("real_time_factor", value=0.0)])
    assert answer.successful and paced.lags is None


def test_it_is_told_and_recorded_from_outside_as_it_is_in_the_run(
    paced: PmsmSim, context: rclpy.Context
) -> None:
    (part,) = (each for each in paced.diagnostics() if each.name == "pace")
    assert part.values["missed periods"] == 39
    for name, (p50, p99, p999, longest) in {
        "start late by": (2, 40, 40, 40),
        "round trip": (30, 30, 30, 30),
    }.items():
        told = [part.values[f"{name} {p} (us)"] for p in ("50 %", "99 %", "99.9 %", "maximum")]
        assert told == pytest.approx([p50, p99, p999, longest], rel=1 / 31)

    recorder = Recorder(context=context)
    values = [KeyValue(key=key, value=str(value)) for key, value in part.values.items()]
    status = DiagnosticStatus(name="pmsm_sim: pace", values=values)
    recorder._on_diagnostics(DiagnosticArray(status=[status]))
    stored = session.outcome(paced, [paced], 1.0)["lags"]
    assert set(recorder.lags) == set(stored) == {"start", "round_trip"}
    for name, lags in stored.items():
        assert recorder.lags[name]["bins_ns"] == lags["bins_ns"]
        assert recorder.lags[name]["periods"] == lags["periods"]
    recorder.destroy_node()


def test_the_paced_controller_and_its_plant_know_of_it(paced: PmsmSim) -> None:
    assert paced.paced and not any(each.waits for each in paced.loop_publishers)
    (answer,) = paced.set_parameters([Parameter("real_time_factor", value=0.0)])
    assert answer.successful
    assert not paced.paced and all(each.waits for each in paced.loop_publishers)


def test_a_controller_waits_for_listeners_where_its_plant_does(context: rclpy.Context) -> None:
    plant = PmsmSim(context=context, parameter_overrides=[Parameter("real_time_factor", value=1.0)])
    controller = MfpccController(context=context)
    for node in (plant, controller):
        node.trigger_configure()

    def follows(paced: bool) -> bool:
        controller._follow_pace()
        return controller.paced is paced

    until(lambda: follows(True), "the controller sees that the plant goes by itself")
    assert not any(each.waits for each in controller.loop_publishers)
    (answer,) = plant.set_parameters([Parameter("real_time_factor", value=0.0)])
    assert answer.successful
    until(lambda: follows(False), "the controller sees that the plant waits")
    assert all(each.waits for each in controller.loop_publishers)
    for node in (plant, controller):
        node.destroy_node()


def test_a_change_of_pace_loses_no_message(context: rclpy.Context) -> None:
    plant = PmsmSim(context=context)
    plant.trigger_configure()
    publisher = plant.loop_publishers[0]
    everything = QoSProfile(
        history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE, depth=0
    )
    listener = plant.create_subscription(
        PhaseFeedback, "phase_feedback", lambda _: None, everything, raw=True
    )
    until(lambda: publisher.listeners == 1, "they are matched")
    sample = Wire(PhaseFeedback)
    taken: list[int] = []

    def send_until(condition: Callable[[], bool]) -> bool:
        sample.fixed["period"] += 1
        publisher.publish(sample.to_bytes())
        publisher.settle()
        while (message := listener.handle.take_message(PhaseFeedback, False)) is not None:
            taken.append(message[0].period)
        return condition()

    for paced in (True, False, True):
        publisher.waits = not paced
        until(lambda: send_until(lambda: publisher._successor is None), "the other one took over")
    for _ in range(10):
        send_until(lambda: True)
    assert taken == list(range(1, len(taken) + 1)) and len(taken) == sample.fixed["period"][0]
    plant.destroy_subscription(listener)
    plant.destroy_node()


def test_the_figure_shows_how_many_periods_are_later_than_that() -> None:
    lags = Lags()
    for late, periods in ((10_000, 900), (100_000, 99), (1_000_000, 1)):
        for _ in range(periods):
            lags.add(late)
    found = recording.read(REFERENCE)
    run = Measured(
        path=REFERENCE,
        label="A",
        row=evaluate(found),
        window=cut(found),
        signals=signals.signals(found),
    )
    assert figures.lags([run]) is None
    bins = bins_of(lags.to_json())
    assert bins is not None
    figure = figures.lags([replace(run, lags={"start": bins}), run])
    assert figure is not None
    drawn, empty = figure.axes
    (line,) = drawn.lines
    x, y = (np.asarray(values) for values in line.get_data())
    assert x[1:] == pytest.approx([10, 100, 1000], rel=1 / 31)
    assert y == pytest.approx([100, 10, 0.1, 0.05])  # the last one is what stands for none
    assert "not by the wall clock" in empty.texts[0].get_text()


@pytest.mark.parametrize("stored", [None, 5, {}, {"start": 5}, {"start": {"bins_ns": [[1, "x"]]}}])
def test_what_is_no_histogram_in_a_recording_is_left_out(stored: object) -> None:
    assert compare._lags(stored) == {}

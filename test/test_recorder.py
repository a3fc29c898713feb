"""The recorder counts what is missing, and knows a decimated topic from one with gaps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from harness import until
from mfpcc_msgs.msg import DutyCommand, LutDiagnostics, PhaseFeedback
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter as RosParameter

from mfpcc_controller.node import MfpccController
from mfpcc_experiments.graph.recorder import Recorder, _arguments
from pwm_node.wire import Wire


class Kept:
    """Takes the place of the bag."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, int]] = []

    def write(self, topic: str, log_time_ns: int, data: bytes) -> None:
        self.messages.append((topic, log_time_ns))


@pytest.fixture
def recorder(context: rclpy.Context) -> Iterator[Recorder]:
    kept: Any = Kept()
    node = Recorder(kept, context=context)
    yield node
    node.destroy_node()


def feed(recorder: Recorder, topic: str, periods: list[int]) -> None:
    wire = Wire(PhaseFeedback if topic == "phase_feedback" else LutDiagnostics)
    keep = recorder._awaited[topic]
    for period in periods:
        wire.fixed["period"] = period
        keep(wire.to_bytes(), 0)


@pytest.mark.parametrize(
    ("periods", "missing"),
    [
        ([0, 1, 2, 3], 0),
        ([0, 1, 1, 2], 0),  # repeated
        ([0, 1, 2, 5, 6], 2),
        ([0, 4, 5, 6], 3),  # a gap at the very beginning
        ([7, 8, 9], 0),  # joined late
    ],
)
def test_gaps(recorder: Recorder, periods: list[int], missing: int) -> None:
    feed(recorder, "phase_feedback", periods)
    assert recorder.gaps["phase_feedback"] == missing


@pytest.mark.parametrize(("periods", "missing"), [([0, 10, 20, 30], 0), ([0, 10, 40, 50], 2)])
def test_gaps_of_a_decimated_topic(recorder: Recorder, periods: list[int], missing: int) -> None:
    feed(recorder, "lut_diagnostics", periods)
    assert recorder.gaps["lut_diagnostics"] == missing


def test_a_recorder_is_told_where_to(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        _arguments([])
    assert "give --out, --black-box, or both" in capsys.readouterr().err


def test_the_first_answer_of_the_controller_waits_for_its_recorder(context: rclpy.Context) -> None:
    waits = RosParameter("recorders", value=1)
    controller = MfpccController(context=context, parameter_overrides=[waits])
    executor = EventsExecutor(context=context)
    executor.add_node(controller)
    controller.trigger_configure()
    controller.trigger_activate()
    sample = Wire(PhaseFeedback)
    sample.fixed["period"] = 0

    def answered() -> bool:
        executor.spin_once(0.01)
        return controller.period == 0

    controller._on_feedback(sample.to_bytes())
    assert not answered()
    recorder = Recorder(context=context)
    plant = controller.create_subscription(DutyCommand, "duty_command", lambda _: None, 10)
    until(answered, "the sample is answered once everybody is there")
    assert len(list(recorder._inputs)) == 2
    controller.destroy_subscription(plant)
    recorder.destroy_node()
    executor.shutdown()
    controller.stop()
    controller.destroy_node()

"""The recorder counts what is missing, and knows a decimated topic from one with gaps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from mfpcc_msgs.msg import LutDiagnostics, PhaseFeedback

from mfpcc_experiments.graph.recorder import Recorder, _arguments
from pwm_node.wire import Wire


class Kept:
    """Takes the place of the bag."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, int]] = []

    def write(self, topic: str, log_time_ns: int, data: bytes) -> None:
        self.messages.append((topic, log_time_ns))


@pytest.fixture
def recorder(domain: int) -> Iterator[Recorder]:
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    kept: Any = Kept()
    node = Recorder(kept, context=context)
    yield node
    node.destroy_node()
    rclpy.try_shutdown(context=context)


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

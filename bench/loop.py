"""Plant and controller in one process: the fast way to run the drive."""

from __future__ import annotations

import bare
import drives
from figures import Figure, figure, interleaved

_T_S_US = 100.0


def measure(*, quick: bool) -> list[Figure]:
    """Composed drive against the bare loop, and against rclpy's default executor."""
    periods, rounds = (10_000, 2) if quick else (40_000, 5)
    steps: list[float] = []

    def composed() -> float:
        plant, controller = drives.composed(periods)
        steps.extend(controller.step_times.percentiles(50))
        return plant.period_us()

    def default_executor() -> float:
        plant, _ = drives.composed(periods // 10, drives.on_single_threaded_executor)
        return plant.period_us()

    us = interleaved(
        rounds,
        composed=composed,
        objects=lambda: bare.one_process(periods),
        raw=lambda: bare.one_process(periods, raw=True),
        default=default_executor,
    )
    factors = [_T_S_US / each for each in us["composed"]]
    return [
        figure(
            "composed drive, mls_mfpcc, lut_diagnostics every period",
            us["composed"],
            "us per period",
            "bare publish + direct take, message objects",
            us["objects"],
            bar="ratio <= 1.6",
        ),
        figure(
            "the same",
            us["composed"],
            "us per period",
            "bare publish + direct take, serialized bytes",
            us["raw"],
            bar="ratio <= 2.0",
        ),
        figure(
            "the same: real-time factor at 10 kHz",
            factors,
            "",
            "real time",
            1.0,
            bar="ratio >= 2.2",
        ),
        figure(
            "the same loop on SingleThreadedExecutor",
            us["default"],
            "us per period",
            "composed drive",
            us["composed"],
        ),
        figure("one step from the node, call included", steps, "us", bar="value <= 5"),
    ]

"""Plant and controller as two processes."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bare
import drives
from figures import Figure, figure, interleaved


def measure(*, quick: bool) -> list[Figure]:
    """Rate against the bare ping-pong of the same messages; time until the first command."""
    periods, rounds = (3_000, 2) if quick else (20_000, 5)
    starts: list[float] = []

    def separate() -> float:
        with tempfile.TemporaryDirectory() as folder:
            run = drives.separate(periods, Path(folder))
        starts.append(run.start_s)
        return 1e6 / run.period_us

    rates = interleaved(
        rounds,
        separate=separate,
        objects=lambda: 1e6 / bare.two_processes(periods),
        raw=lambda: 1e6 / bare.two_processes(periods, raw=True),
    )
    return [
        figure(
            "drive in two processes",
            rates["separate"],
            "periods/s",
            "bare ping-pong, wait set + take, message objects",
            rates["objects"],
            bar="ratio >= 0.85",
        ),
        figure(
            "the same",
            rates["separate"],
            "periods/s",
            "bare ping-pong, wait set + take, serialized bytes",
            rates["raw"],
        ),
        figure(
            "controller: from its start to its first command, kernels compiled",
            starts,
            "s",
            bar="value <= 3",
        ),
    ]

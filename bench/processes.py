"""Plant and controller as two processes."""

from __future__ import annotations

import os
import tempfile
import time
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
            bar="ratio >= 1.3",
        ),
        figure(
            "controller: from its start to its first command, kernels compiled",
            starts,
            "s",
            bar="value <= 3",
        ),
        figure(
            "a plant that nobody answers, share of a core",
            _idle_share(3.0 if quick else 20.0),
            "%",
            bar="value <= 10",
        ),
    ]


def _idle_share(seconds: float) -> float:
    """Processor time of a plant that waits for a controller, in percent of the time."""
    with (
        tempfile.TemporaryDirectory() as folder,
        drives.running("pmsm_sim", "pmsm_sim", drives.PLANT, Path(folder)) as process,
    ):
        time.sleep(15.0)  # it has started, and waits
        before = _processor_s(process.pid)
        time.sleep(seconds)
        return (_processor_s(process.pid) - before) / seconds * 100.0


def _processor_s(pid: int) -> float:
    """Processor time of a process so far (s)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

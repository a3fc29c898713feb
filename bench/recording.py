"""The drive with everything on the loop recorded to MCAP."""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drives
from figures import Figure, figure, interleaved

from mfpcc_experiments.bags import recording
from mfpcc_experiments.running import Scenario, run


def measure(*, quick: bool) -> list[Figure]:
    """Real-time factor while recording, and what was lost."""
    long, short = (3.0, 1.0) if quick else (60.0, 10.0)
    separate = _record(short, separate=True)
    waveform = _record(short, oversampling=20)
    plain = _record(long)  # after the others: memory that any run takes once is taken by then
    return [
        figure(
            f"composed drive, all messages recorded, {long:g} s simulated",
            plain.factor,
            "",
            "real time",
            1.0,
            bar="ratio >= 1.4",
        ),
        figure("the same: periods lost", plain.lost, "periods", bar="value <= 0"),
        figure("the same: growth of memory meanwhile", plain.memory, "MB"),
        figure("the same: recording", plain.size / long, "MB/s simulated"),
        figure(
            "composed drive, recorded with the waveform, 20 points per period",
            waveform.factor,
            "",
            "real time",
            1.0,
        ),
        figure("drive in two processes, all messages recorded", separate.factor * 1e4, "periods/s"),
        figure("the same: periods lost", separate.lost, "periods", bar="value <= 0"),
        *_third_process(3_000 if quick else 20_000, 2 if quick else 5),
    ]


def _third_process(periods: int, rounds: int) -> list[Figure]:
    """What the executable `record` costs a drive in two processes, and what it misses of it."""
    lost: list[float] = []

    def recorded() -> float:
        with tempfile.TemporaryDirectory(prefix="mfpcc_bench_") as folder:
            run = drives.separate(periods, Path(folder), recorded=True)
            bag = recording.read(Path(folder, "bag"))
        lost.append(bag.lost_periods + periods - len(bag.feedback))
        return 1e6 / run.period_us

    def alone() -> float:
        with tempfile.TemporaryDirectory(prefix="mfpcc_bench_") as folder:
            return 1e6 / drives.separate(periods, Path(folder)).period_us

    rates = interleaved(rounds, recorded=recorded, alone=alone)
    return [
        figure(
            "drive in two processes, `record` as a third",
            rates["recorded"],
            "periods/s",
            "the same without it",
            rates["alone"],
        ),
        figure("the same: periods lost", max(lost), "periods", bar="value <= 0"),
    ]


class _Run:
    """What one recorded run showed."""

    factor: float
    lost: float
    memory: float
    size: float


def _record(seconds: float, *, oversampling: int = 0, separate: bool = False) -> _Run:
    scenario = Scenario(
        name="bench",
        motor="seed_750",
        speed_rpm=drives.CONTROLLER["speed_ref_rpm"],
        duration=seconds,
        window_s=(0.0, seconds),
        plant={
            "load_torque": drives.PLANT["load_torque"],
            "noise.current_rms": drives.PLANT["noise.current_rms"],
            "oversampling": oversampling,
        },
    )
    ticks: list[tuple[float, float]] = []  # (wall clock, periods done)
    found = _Run()
    with tempfile.TemporaryDirectory(prefix="mfpcc_bench_") as folder:
        before = _peak_memory()
        run.run(scenario, "mls_mfpcc", "ros", Path(folder), 0, _noting(ticks), separate=separate)
        found.memory = _peak_memory() - before
        bag = Path(folder, "mls_mfpcc")
        found.size = sum(file.stat().st_size for file in bag.iterdir()) / 1e6
        recorded = recording.read(bag)
        found.lost = recorded.lost_periods + scenario.periods - len(recorded.feedback)
    # from the first look after the start to the last before the end
    (begin, first), (end, last) = ticks[0], ticks[-2]
    found.factor = (last - first) / scenario.pwm_frequency / (end - begin)
    return found


def _noting(ticks: list[tuple[float, float]]) -> Callable[[float], Any]:
    def note(done: float) -> None:
        if done > 0:
            ticks.append((time.perf_counter(), done))

    return note


def _peak_memory() -> float:
    """Largest resident memory of this process so far (MB)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0

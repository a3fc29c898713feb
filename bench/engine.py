"""The in-process engine: the whole loop compiled, without ROS."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from figures import Figure, figure, interleaved

from mfpcc_controller.controller import Controller
from mfpcc_experiments.proofs.effects import SETS
from mfpcc_experiments.running import Scenario
from mfpcc_experiments.running.engine import Engine, parallel, step_time
from pwm_node import yaml_files

_SCHEMES = ("mfpcc", "mls_mfpcc", "mls_mfpcc_paper", "neso_mfpcc")
_MOTULATOR = Path(__file__).with_name("motulator_drive.py")
_NEEDS_MOTULATOR = "motulator is not installed (`make bench` does it; needs Python 3.12)"


def measure(*, quick: bool) -> list[Figure]:
    """Speed against real time and motulator; a step against that of the simplest scheme."""
    rounds = 2 if quick else 5
    seconds = 1.0 if quick else 5.0
    measures = {
        "plain": _real_time_factor(0, seconds),
        "oversampled": _real_time_factor(20, seconds),
        "servo": _real_time_factor(0, seconds, SETS["servo"]),
        "many": _many(seconds, together=True),
        "many_one_core": _many(seconds, together=False),
    }
    if motulator := _has_motulator():
        measures["motulator"] = lambda: _motulator_factor(0.05 if quick else 0.2)
    factors = interleaved(rounds, **measures)
    steps = interleaved(4 * rounds, **{scheme: _step_us(scheme, seconds) for scheme in _SCHEMES})
    name = "in-process engine, steady_750_2, mls_mfpcc"
    return [
        figure(name, factors["plain"], "x", "real time", 1.0, bar="ratio >= 100"),
        figure(
            "the same, 20 points of the waveform per period",
            factors["oversampled"],
            "x",
            "real time",
            1.0,
            bar="ratio >= 40",
        ),
        figure(
            "the same with a true servo drive (dead time, drops, encoder, ADC, noise, friction)",
            factors["servo"],
            "x",
            "without any effect",
            factors["plain"],
            bar="ratio >= 0.31",
        ),
        figure(
            "eight of these at once, on all cores",
            factors["many"],
            "x",
            "one after the other",
            factors["many_one_core"],
            bar="ratio >= 1.8",
        ),
        figure(
            name,
            factors["plain"],
            "x",
            "motulator, switching level, same motor and carrier",
            factors["motulator"],
            bar="ratio >= 1000",
        )
        if motulator
        else figure(name, factors["plain"], "x", _NEEDS_MOTULATOR),
        figure(
            "one step of mls_mfpcc inside the compiled loop",
            steps["mls_mfpcc"],
            "us",
            "mfpcc (seven candidates)",
            steps["mfpcc"],
            bar="ratio <= 1.5",
        ),
        figure(
            "one step of mls_mfpcc_paper inside the compiled loop",
            steps["mls_mfpcc_paper"],
            "us",
            "mfpcc (seven candidates)",
            steps["mfpcc"],
            bar="ratio <= 1.09",
        ),
        figure(
            "one step of neso_mfpcc inside the compiled loop",
            steps["neso_mfpcc"],
            "us",
            "mfpcc (seven candidates)",
            steps["mfpcc"],
        ),
    ]


def engine_of(
    scheme: str, oversampling: int, effects: Mapping[str, Any] = MappingProxyType({})
) -> Engine:
    """`steady_750_2` in process, with so many points of the waveform per period."""
    scenario = yaml_files.load(yaml_files.find("experiments", "steady_750_2"), Scenario)
    plant, controller = scenario.node_parameters(scheme, 0)
    return Engine({**plant, **effects, "oversampling": oversampling}, controller)


def _real_time_factor(
    oversampling: int, seconds: float, effects: Mapping[str, Any] = MappingProxyType({})
) -> Callable[[], float]:
    engine = engine_of("mls_mfpcc", oversampling, effects)
    for _ in engine.run(100):  # kernels compiled or loaded
        pass

    def factor() -> float:
        begin = time.perf_counter()
        for _ in engine.run(round(seconds * 10_000)):
            pass
        return seconds / (time.perf_counter() - begin)

    return factor


def _many(seconds: float, *, together: bool) -> Callable[[], float]:
    """Simulated over wall-clock time of eight servo drives, all of them counted."""
    drives = [engine_of("mls_mfpcc", 0, SETS["servo"]) for _ in range(8)]
    periods = round(seconds * 10_000)

    def factor() -> float:
        begin = time.perf_counter()
        # what passed is kept of all of them in either case, since memory costs time too
        if together:
            passed = parallel(drives, periods)
        else:
            passed = [list(drive.run(periods)) for drive in drives]
        return len(passed) * seconds / (time.perf_counter() - begin)

    return factor


def _step_us(scheme: str, seconds: float) -> Callable[[], float]:
    engine = engine_of(scheme, 0)
    samples = np.concatenate([trace.feedback for trace in engine.run(round(seconds * 10_000))])
    return lambda: step_time(Controller(engine.controller.values), samples)["median"]


def _has_motulator() -> bool:
    probe = [sys.executable, "-c", "import motulator"]
    return subprocess.run(probe, capture_output=True, check=False).returncode == 0


def _motulator_factor(seconds: float) -> float:
    """Simulated over wall-clock time of motulator, in a process of its own."""
    command = [sys.executable, str(_MOTULATOR), str(seconds)]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    if answer.returncode:
        raise RuntimeError(f"motulator failed: {answer.stderr.strip().splitlines()[-1]}")
    return seconds / float(answer.stdout)

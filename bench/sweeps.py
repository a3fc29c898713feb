"""What a sweep costs: runs per second of one worker and of two, and memory.

The sweep is `config/sweeps/million_runs.yaml`; `mfpcc sweep million_runs` does all of it.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from figures import Figure, figure

from mfpcc_experiments.sweeping import local, work
from mfpcc_experiments.sweeping.plan import Plan
from mfpcc_experiments.sweeping.spec import load
from pwm_node import yaml_files


def measure(*, quick: bool) -> list[Figure]:
    """One worker and two in turns, the time of a million runs, and memory."""
    plan = Plan(load(yaml_files.find("sweeps", "million_runs")))
    chunks, rounds = (4, 1) if quick else (12, 3)
    with local.pool(1) as one, local.pool(2) as two:
        run_here = {1: one.run, 2: two.run}
        for run in run_here.values():
            _rate(plan, 2, run)  # processes started, kernels loaded
        rates: dict[int, list[float]] = {1: [], 2: []}
        for _ in range(rounds):
            for workers, run in run_here.items():
                rates[workers].append(_rate(plan, chunks, run))
        memory = sum(map(_peak, [os.getpid(), *two.processes]))
    million = [1e6 / rate / 60.0 for rate in rates[2]]
    return [
        figure(
            "sweep, two workers", rates[2], "runs/s", "one worker", rates[1], bar="ratio >= 1.8"
        ),
        figure("sweep, a million runs of 1000 periods", million, "min", bar="value <= 10"),
        figure("sweep, memory of all processes", memory, "MiB", bar="value <= 2048"),
    ]


def _rate(plan: Plan, chunks: int, run: Any) -> float:
    """Runs per second of so many chunks."""
    begin = time.perf_counter()
    done = sum(1 for _ in run(work.jobs(plan, range(chunks))))
    assert done == chunks
    return chunks * plan.chunk_rows / (time.perf_counter() - begin)


def _peak(process: int) -> float:
    """Largest memory that a process has had (MiB)."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024.0 for line in lines if line.startswith("VmHWM"))

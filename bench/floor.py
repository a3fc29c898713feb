"""What the machine itself does to a thread that only waits for its next period (cyclictest)."""

from __future__ import annotations

import os
import time

from pwm_node.lags import Lags


def lateness(frequency: float, seconds: float, *, sleeping: bool = False) -> Lags:
    """Wait for one period after the other, and do nothing in it.

    Parameters
    ----------
    frequency : float
        Periods per second.
    seconds : float
        For how long.
    sleeping : bool
        Sleep until a period is due, as cyclictest does, instead of looking for it and giving the
        core away in between, as the drive does.

    Returns
    -------
    Lags
        How late this thread was, of every period. As in the drive, whole periods that went by
        meanwhile are left out.
    """
    lags = Lags()
    clock = time.perf_counter_ns
    step = round(1e9 / frequency)
    due = clock() + step
    end = due + round(seconds * 1e9)
    while due < end:
        if sleeping:
            time.sleep(max(due - clock(), 0) * 1e-9)
        while (now := clock()) < due:
            os.sched_yield()
        late = now - due
        lags.add(late)
        due += step * (1 + late // step)
    return lags


def in_time(lags: Lags, frequency: float, seconds: float) -> float:
    """Share of all periods that began before the next one was due (%)."""
    return 100.0 * min(lags.count / (frequency * seconds), 1.0)

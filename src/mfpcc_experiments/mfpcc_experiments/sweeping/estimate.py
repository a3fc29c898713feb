"""How long a sweep takes on this machine, by two of its runs."""

from __future__ import annotations

import time
from dataclasses import replace

from mfpcc_experiments.running.batch import Batch
from mfpcc_experiments.sweeping import local
from mfpcc_experiments.sweeping.drives import Drives
from mfpcc_experiments.sweeping.plan import Plan

#: So many points of grids are more often a mistake than meant.
MANY_POINTS = 100_000

# Nobody is asked below this time (s).
_LONG = 3600.0
# The least time that a period can take (s), to see quickly what is short in any case.
_QUICKEST = 1e-6
# Of a longer run so many periods tell what all of it takes.
_ENOUGH = 20_000


def may_be_long(plan: Plan) -> bool:
    """Whether a sweep takes more than an hour here."""
    if plan.rows * plan.base.periods * 50 * _QUICKEST / local.cores() < _LONG:
        return False  # even with all effects of the plant
    return seconds(plan) > _LONG


def seconds(plan: Plan) -> float:
    """Time that a sweep takes on all cores of this machine (s)."""
    total, base = 0.0, plan.base
    periods, window = base.periods, base.window_s
    if periods > _ENOUGH:
        periods, window = _ENOUGH, (0.0, _ENOUGH / base.pwm_frequency)
    for scheme in plan.schemes:
        drives = Drives(base, scheme, plan.places, plan.motors)
        plant, _ = base.node_parameters(scheme, 0)
        batch = Batch(periods, window, base.pwm_frequency, plant["oversampling"])
        _, values = plan.row(0)
        drive = drives.drive(values)
        drive = replace(drive, changes=tuple(c for c in drive.changes if c[0] < periods))
        batch.run([drive])  # compiled, or loaded
        begin = time.process_time()
        batch.run([drive, drive])
        run = 0.5 * (time.process_time() - begin) * (base.periods / periods)
        total += run * plan.rows_per_scheme
    return total / local.cores()


def shown(plan: Plan) -> str:
    """The same for people."""
    s = seconds(plan)
    for unit, length in (("days", 86_400.0), ("hours", 3_600.0), ("minutes", 60.0)):
        if s >= 2.0 * length:
            return f"{s / length:,.0f} {unit}"
    return f"{s:.0f} s"

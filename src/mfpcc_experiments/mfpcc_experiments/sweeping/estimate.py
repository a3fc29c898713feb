"""How long a sweep takes on this machine, by two of its runs."""

from __future__ import annotations

import time

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


def may_be_long(plan: Plan) -> bool:
    """Whether a sweep takes more than an hour here."""
    if plan.rows * plan.base.periods * 50 * _QUICKEST / local.cores() < _LONG:
        return False  # even with all effects of the plant
    return seconds(plan) > _LONG


def seconds(plan: Plan) -> float:
    """Time that a sweep takes on all cores of this machine (s)."""
    total = 0.0
    for scheme in plan.schemes:
        drives = Drives(plan.base, scheme, plan.places, plan.motors)
        plant, _ = plan.base.node_parameters(scheme, 0)
        base = plan.base
        batch = Batch(base.periods, base.window_s, base.pwm_frequency, plant["oversampling"])
        _, values = plan.row(0)
        drive = drives.drive(values)
        batch.run([drive])  # compiled, or loaded
        begin = time.process_time()
        batch.run([drive, drive])
        total += 0.5 * (time.process_time() - begin) * plan.rows_per_scheme
    return total / local.cores()


def shown(plan: Plan) -> str:
    """The same for people."""
    s = seconds(plan)
    for unit, length in (("days", 86_400.0), ("hours", 3_600.0), ("minutes", 60.0)):
        if s >= 2.0 * length:
            return f"{s / length:,.0f} {unit}"
    return f"{s:.0f} s"

"""How many periods lie between a command and its effect, by what explains the current best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfpcc_experiments.identifying.fit import fit
from mfpcc_experiments.identifying.steps import Steps

#: Delays that are tried.
TRIED = range(-1, 5)
# Natural logarithm of how much likelier the best delay has to be than any other: a million.
_SURE = 14.0
# However many samples there are, an advantage below this is the model's own error.
_CLEAR = 1.01
# Steps that are used: those with the most change of the voltage.
_STRETCH = 3_000


@dataclass(frozen=True)
class Delay:
    """
    An estimated delay.

    Attributes
    ----------
    periods : int
        How much later a voltage acts than was taken for granted.
    rms : dict of float
        What the simulated current leaves of the measured one (A), by delay.
    sure : bool
        Whether no other delay explains the data nearly as well.
    """

    periods: int
    rms: dict[int, float]
    sure: bool

    def __str__(self) -> str:
        second = min(
            (delay for delay in self.rms if delay != self.periods), key=self.rms.__getitem__
        )
        return (
            f"{self.periods} (it leaves {self.rms[self.periods]:.3g} A rms of the current "
            f"unexplained; the second best, {second}, {self.rms[second]:.3g} A)"
        )


def estimate(steps: Steps, tried: range = TRIED) -> Delay | None:
    """
    Find the delay with which the voltages explain the current best.

    One step ahead would not do: in a closed loop a later command holds the noise of the sample
    that it answers, and explains that.

    Parameters
    ----------
    steps : Steps
        With the voltages as they are recorded.
    tried : range
        Delays to try (periods), at least two.

    Returns
    -------
    Delay or None
        None where there are too few steps. A single sinusoid at standstill does not tell the
        delay, since another resistance explains a shift as well: then it is not sure.
    """
    stretch = steps.cut(_busiest(steps))
    rms: dict[int, float] = {}
    count, nearest = 0, None
    for delay in sorted(tried, key=abs):
        found = fit(stretch.later(delay), most=_STRETCH, rough=True, near=nearest)
        if found is None:
            return None
        if nearest is None or found.rms < nearest.rms:
            nearest = found
        rms[delay], count = found.rms, found.steps
    best = min(rms, key=rms.__getitem__)
    floor = max(rms[best], 1e-9)
    ratio = min(other for delay, other in rms.items() if delay != best) / floor
    sure = ratio > _CLEAR and 2 * count * np.log(ratio) > _SURE
    return Delay(best, rms, bool(sure))


def _busiest(steps: Steps) -> slice:
    """Of the longest stretch without a gap, the part in which the voltage changes most."""
    longest = steps.longest(len(steps.period))
    begins = range(longest.start, max(longest.start + 1, longest.stop - _STRETCH), _STRETCH // 2)
    parts = [slice(begin, min(begin + _STRETCH, longest.stop)) for begin in begins]

    def change(rows: slice) -> float:
        turned = steps.u_s_ab[rows] * np.exp(-1j * steps.theta_m[rows])
        jumps = np.abs(np.diff(turned)) ** 2
        return float(np.nansum(jumps))

    return max(parts, key=change)

"""What a choice of parameters is worth: its figures on a set of drives."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.measuring.compiled import I_D, I_D_REF, I_Q, I_Q_REF
from mfpcc_experiments.running.batch import FIGURES, Batch
from mfpcc_experiments.sweeping import work
from mfpcc_experiments.sweeping.plan import Plan
from mfpcc_experiments.sweeping.spec import Spec
from mfpcc_experiments.tuning.scenarios import Choice, Drives, of_repeat


@dataclass(frozen=True)
class Criterion:
    """
    One figure that a choice is judged by; less is better.

    Attributes
    ----------
    name, title, unit : str
        As a key, and for people.
    digits : int
        Behind the point.
    """

    name: str
    title: str
    unit: str
    digits: int


#: What the score is the geometric mean of.
CRITERIA = (
    Criterion("distortion", "THD", "%", 2),
    Criterion("settling", "settling", "ms", 2),
    Criterion("step_error", "error after steps", "A", 3),
    Criterion("mismatch_error", "error, wrong model", "A", 3),
    Criterion("lost", "random drives lost", "%", 1),
    Criterion("prediction_error", "prediction error", "A", 3),
)

#: The same questions where a ripple that stays as it is counts for nothing.
RIPPLE_BLIND = (
    Criterion("settling_own", "settling, own band", "ms", 2),
    Criterion("mismatch_mean", "mean error, wrong model", "A", 3),
    Criterion("lost_any_ripple", "random drives lost, any ripple", "%", 1),
    Criterion("prediction_error", "prediction error", "A", 3),
)

#: What is told besides.
BESIDES = (
    Criterion("switching_frequency", "switching frequency", "Hz", 0),
    Criterion("pwm_frequency", "PWM frequency", "Hz", 0),
)

#: Switching frequencies that differ by this share are equal.
NEAR = 0.01
# How often a PWM frequency is tried for it, and what it may be (Hz).
_TRIES = 8
_SLOWEST, _FASTEST = 2e3, 5e4

# A distortion (%) for drives that have none, since they are not steady or have tripped.
_NO_THD = 100.0
# The current is there within this share of its limit: 0.2 A of 12 A.
_BAND = 1.0 / 60.0
# Its own band is so many times the largest distance in the last half of the window.
_OWN = 1.1
# Mean errors below this share of the current limit are none.
_NO_ERROR = 1e-3
# Current errors of the random drives may ripple so much where ripple shall not count (A).
_ANY_RIPPLE = 3.0

_RIPPLE = ("span_pp.d", "span_pp.q")


@dataclass(frozen=True)
class Judgement:
    """
    A job: the figures of one choice.

    Attributes
    ----------
    number : int
        By which its result is known.
    drives : Drives
        By which it is judged.
    scheme : str
        Whose choice it is.
    choice : dict
        Values of parameters that are not at their defaults.
    repeat : int
        Which draws and which noise.
    switching_frequency : float
        That the legs shall have in the steady drives (Hz); 0: that of the experiments' PWM.
    """

    number: int
    drives: Drives
    scheme: str
    choice: Choice
    repeat: int
    switching_frequency: float = 0.0

    def run(self) -> dict[str, float]:
        """All figures, by the names of the criteria."""
        choice = dict(self.choice)
        if self.switching_frequency:
            choice["pwm_frequency"] = self._pwm_frequency()
        return figures(self.drives, self.scheme, choice, self.repeat)

    def _pwm_frequency(self) -> float:
        """Of the PWM, with which the legs switch as often as they shall (Hz)."""
        f = self.switching_frequency
        for _ in range(_TRIES):
            choice = {**self.choice, "pwm_frequency": f}
            specs = [of_repeat(spec, choice, self.repeat) for spec in self.drives.steady]
            ratio = _run(specs, self.scheme).switching_frequency / self.switching_frequency
            if abs(ratio - 1.0) < NEAR:
                break
            f = min(max(round(f / ratio, -1), _SLOWEST), _FASTEST)
        return f


def figures(drives: Drives, scheme: str, choice: Choice, repeat: int) -> dict[str, float]:
    """
    The figures of a choice on a set of drives.

    A figure that is not there (a drive that tripped, or is not steady) counts as 100 % of
    distortion, or as the current limit; a current that does not settle within the window, as the
    window's length.

    Returns
    -------
    dict
        By the names of `CRITERIA`, `RIPPLE_BLIND` and `BESIDES`.
    """

    def all_of(specs: Iterable[Spec], look: Look | None = None) -> _Outcomes:
        return _run([of_repeat(spec, choice, repeat) for spec in specs], scheme, look)

    settled: list[tuple[float, float]] = []
    steady = all_of(drives.steady)
    steps = all_of(drives.steps, lambda batch, i_max: settled.append(settling(batch, i_max)))
    disturbed = all_of(drives.disturbed)
    mismatched = all_of(drives.mismatched)
    random = all_of([drives.random.spec]).outcome
    limits = drives.random.spec.survived
    any_ripple = {**limits, **{name: _ANY_RIPPLE for name in _RIPPLE if name in limits}}
    mean = np.hypot(mismatched["i_d_error_mean"], mismatched["i_q_error_mean"])
    settled_ms = 1e3 * np.array(settled)
    return {
        "distortion": _geometric(steady.with_missing("thd_percent.oversampled", _NO_THD)),
        "settling": _geometric(settled_ms[:, 0]),
        "step_error": _geometric(
            np.concatenate([steps.size("deviation_rms"), disturbed.size("deviation_rms")])
        ),
        "mismatch_error": _geometric(mismatched.size("deviation_rms")),
        "lost": _percent_lost(work.survived(random, limits)),
        "prediction_error": _geometric(
            np.concatenate([steady.size("lut_error_rms"), steps.size("lut_error_rms")])
        ),
        "settling_own": _geometric(settled_ms[:, 1]),
        "mismatch_mean": _geometric(
            np.maximum(np.nan_to_num(mean, nan=mismatched.i_max), _NO_ERROR * mismatched.i_max)
        ),
        "lost_any_ripple": _percent_lost(work.survived(random, any_ripple)),
        "switching_frequency": steady.switching_frequency,
        "pwm_frequency": steady.pwm_frequency,
    }


Look = Callable[[Batch, float], None]


def _run(specs: Iterable[Spec], scheme: str, look: Look | None = None) -> _Outcomes:
    plans = [Plan(spec, (scheme,)) for spec in specs]
    found = [work.outcomes(job, look) for plan in plans for job in work.jobs(plan)]
    i_max = min(motor.i_max for plan in plans for motor in plan.motors.values())
    return _Outcomes(np.concatenate(found), i_max, plans[0].base.pwm_frequency)


@dataclass(frozen=True)
class _Outcomes:
    """Runs, the smallest current limit of their motors (A), and the PWM frequency (Hz)."""

    outcome: NDArray[np.void]
    i_max: float
    pwm_frequency: float

    @property
    def switching_frequency(self) -> float:
        """Of the legs, mean of all runs (Hz)."""
        return float(np.mean(self["switching_frequency_hz"]))

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        found: NDArray[np.float64] = self.outcome["figures"][:, FIGURES.index(name)]
        return found

    def with_missing(self, name: str, missing: float) -> NDArray[np.float64]:
        """A figure of each run, or what counts where it is not there."""
        return np.nan_to_num(self[name], nan=missing)

    def size(self, name: str) -> NDArray[np.float64]:
        """Of a figure of both axes, the root of the sum of squares."""
        both = np.hypot(self[f"{name}.d"], self[f"{name}.q"])
        return np.nan_to_num(both, nan=self.i_max)


def settling(batch: Batch, i_max: float) -> tuple[float, float]:
    """
    How long the current takes from the beginning of the window on to stay at its reference (s).

    Parameters
    ----------
    batch : Batch
        After a run.
    i_max : float
        Current limit of the motor (A).

    Returns
    -------
    settled, settled_own : float
        Within 1/60 of the limit; and within the band that it keeps in the last half of the window,
        where that is wider. The window's length where it does not stay there for its last third.
    """
    signals = batch.signals
    distance = np.hypot(signals[I_D] - signals[I_D_REF], signals[I_Q] - signals[I_Q_REF])
    n = len(distance)
    band = _BAND * i_max
    own = max(band, _OWN * float(distance[n // 2 :].max()))
    found = []
    for width in (band, own):
        outside = np.flatnonzero(~(distance <= width))
        last = int(outside[-1]) + 1 if len(outside) else 1
        found.append((last if last <= 2 * n // 3 else n) * batch.T_s)
    return found[0], found[1]


def score(found: dict[str, float], criteria: Iterable[Criterion] = CRITERIA) -> float:
    """Logarithm of the geometric mean of criteria."""
    return float(np.mean([math.log(found[criterion.name]) for criterion in criteria]))


def _geometric(values: NDArray[np.float64]) -> float:
    return float(np.exp(np.mean(np.log(values))))


def _percent_lost(survived: NDArray[np.bool_]) -> float:
    """Share that is lost, with two more lost and two more survived (Agresti and Coull 1998)."""
    return 100.0 * float((np.sum(~survived) + 2) / (len(survived) + 4))

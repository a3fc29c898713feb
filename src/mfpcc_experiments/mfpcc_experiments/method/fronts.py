"""Where each scheme can stand between speed of response, calm and survival."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from mfpcc_controller.parameters import SCHEMES
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_controller.schemes import BUILT_IN
from mfpcc_experiments.method.drives import ENCODER
from mfpcc_experiments.running.closed_loop import run
from mfpcc_experiments.sweeping.plan import Plan
from mfpcc_experiments.sweeping.spec import load
from mfpcc_experiments.sweeping.work import jobs, outcomes, survived
from pwm_node import yaml_files

RIPPLE_LIMITS = (0.6, 3.0)  # A
_RIPPLE = ("span_pp.d", "span_pp.q")


@dataclass(frozen=True)
class Point:
    """
    A place that a scheme can choose: speed of response against distortion against survival.

    Attributes
    ----------
    scheme, choice : str
        The choice as it is set, and `own` whether it is the default.
    periods : float
        From a step of i_q (1 to 5 A at 750 r/min) until the true current stays within 0.2 A;
        median of five seeds, infinite where it does not.
    thd, ripple : float
        At 750 r/min and 2 N m (ratio; A); medians of five seeds.
    survived : tuple of float
        Share of the random drives that settle, by each limit of the ripple in `RIPPLE_LIMITS`.
    largest : float
        Largest current of all of them (A).
    """

    scheme: str
    choice: str
    own: bool
    periods: float
    thd: float
    ripple: float
    survived: tuple[float, ...]
    largest: float


def _periods_to_settle(scheme: str, seed: int, controller: dict[str, Any]) -> float:
    r = run(
        scheme,
        0.36,
        seed=seed,
        plant={**ENCODER, "load.kind": "speed", "load.speed_rpm": 750.0},
        controller={"control_mode": "current", "i_q_ref": 1.0, **controller},
        schedule=["0.3 i_q_ref 5.0"],
    )
    off = np.abs(r.state["i_dq"][r.rows(0.3), 1] - 5.0) > 0.2
    return float(np.flatnonzero(off)[-1] + 1) if not off[-100:].any() else np.inf


def choices(scheme: str) -> list[tuple[str, float, bool]]:
    """The parameter of speed against calm, its values, and which is the scheme's own."""
    if scheme == "pi_foc":
        own = float(CONTROLLER["pi.bandwidth"].default)  # type: ignore[arg-type]
        return [("pi.bandwidth", x, x == own) for x in (500.0, 700.0, own, 1400.0, 2000.0)]
    own = next(s.gain for s in BUILT_IN if s.name == scheme)
    return [("deadbeat.gain", x, x == own) for x in (0.15, 0.24, 0.35, 0.5, 0.7, 1.0)]


def _random_drives(scheme: str, choice: dict[str, float]) -> tuple[tuple[float, ...], float]:
    """Share of the random drives that settle, by each limit; and their largest current (A)."""
    spec = load(yaml_files.find("sweeps", "random_drives"))
    plan = Plan(spec.model_copy(update={"set": {**spec.set, **choice}}), (scheme,))
    found = np.concatenate([outcomes(job) for job in jobs(plan)])
    good = [
        survived(found, {**spec.survived, **dict.fromkeys(_RIPPLE, limit)}).mean()
        for limit in RIPPLE_LIMITS
    ]
    return tuple(map(float, good)), float(found["i_peak"].max())


@functools.cache
def points() -> list[Point]:
    """Every scheme, at every choice, judged by the same criteria."""
    found = []
    for scheme in SCHEMES:
        for name, value, own in choices(scheme):
            choice = {name: value}
            steady = [
                run(scheme, 0.4, seed=seed, oversampling=20, plant=ENCODER, controller=choice)
                for seed in range(1, 6)
            ]
            good, largest = _random_drives(scheme, choice)
            found.append(
                Point(
                    scheme,
                    f"{value:g}",
                    own,
                    float(np.median([_periods_to_settle(scheme, s, choice) for s in range(1, 6)])),
                    float(np.median([r.thd(0.2) for r in steady])),
                    float(np.median([r.ripple(0.2).max() for r in steady])),
                    good,
                    largest,
                )
            )
    return found

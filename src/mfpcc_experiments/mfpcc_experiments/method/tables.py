"""The tables of docs/method.md."""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from typing import Any

import numpy as np

from mfpcc_controller.controller import Controller
from mfpcc_controller.parameters import SCHEMES
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.method.drives import (
    ENCODER,
    LOAD_STEP,
    MISMATCH,
    REALITY,
    dirty_drive,
    real_deviation,
    real_run,
    wrong_model,
)
from mfpcc_experiments.method.fronts import RIPPLE_LIMITS, points
from mfpcc_experiments.running.closed_loop import Run, run
from mfpcc_experiments.running.engine import step_time

DIRTY_DRAWS = 1000
# the sturdiest rivals with a wrong model
DIRTY_SCHEMES = ("mls_mfpcc", "neso_mfpcc", "pi_foc")
SEEDS = range(1, 11)

Rows = list[list[str]]


def _steady_runs(scheme: str, rpm: float, load: float, plant: dict[str, Any]) -> list[Run]:
    return [
        run(scheme, 0.4, rpm=rpm, load=load, seed=seed, oversampling=20, plant=plant)
        for seed in (1, 2, 3)
    ]


def steady() -> Rows:
    """THD at four operating points, with an encoder and with an ideal angle."""
    points = ((750.0, 2.0), (750.0, 5.0), (300.0, 2.0), (1000.0, 2.0))
    rows = [["scheme", *(f"{rpm:.0f} r/min, {load:.0f} N m" for rpm, load in points)]]
    for scheme in SCHEMES:
        cells = []
        for rpm, load in points:
            values = [
                100.0 * np.mean([r.thd(0.2) for r in _steady_runs(scheme, rpm, load, plant)])
                for plant in (ENCODER, {})
            ]
            cells.append(f"{values[0]:.2f} ({values[1]:.2f})")
        rows.append([f"`{scheme}`", *cells])
    return rows


def _ripple_and_error(scheme: str, seed: int, plant: dict[str, Any]) -> list[float]:
    steady = run(scheme, 0.4, seed=seed, plant=plant)
    error = np.abs(steady.lut["prediction_error"][steady.rows(0.2)]).max(axis=0)
    load = run(scheme, 0.4, seed=seed, plant=plant, schedule=LOAD_STEP)
    faster = ("0.2 speed_ref_rpm 1000.0",)
    speed = run(scheme, 0.6, rpm=500.0, seed=seed, plant=plant, schedule=faster)
    return [*steady.ripple(0.2), *error, load.lut_error(0.1), speed.lut_error(0.1)]


def ripple_and_error() -> Rows:
    """Ripple and table error in steady state and through both steps."""
    rows = [
        [
            "scheme",
            "ripple d / q (A)",
            "prediction error d / q, max (A)",
            "load step, max (A)",
            "speed step, max (A)",
        ]
    ]
    for scheme in SCHEMES:
        real, ideal = (
            [f"{x:.2f}" for x in np.mean([_ripple_and_error(scheme, s, p) for s in (1, 2, 3)], 0)]
            for p in (ENCODER, {})
        )
        pairs = [f"{real[n]} / {real[n + 1]} ({ideal[n]} / {ideal[n + 1]})" for n in range(0, 4, 2)]
        steps = [f"{real[n]} ({ideal[n]})" for n in (4, 5)]
        rows.append([f"`{scheme}`", *pairs, *steps])
    return rows


def mismatch() -> Rows:
    """Mean errors and ripple after a load step with three wrong models."""
    rows = [
        ["scheme", *(f"{case}: L {m[0]}, R {m[1]}, psi {m[2]}" for case, m in MISMATCH.items())]
    ]
    for scheme in SCHEMES:
        cells = []
        for ratios in MISMATCH.values():
            wrong = wrong_model(*ratios)
            figures = []
            for plant in (ENCODER, {}):
                r = run(scheme, 0.6, plant=plant, controller=wrong, schedule=LOAD_STEP)
                mean = r.error(0.4).mean(axis=0)
                figures.append(f"{mean[1]:.2f}, {mean[0]:.2f}, {r.ripple(0.4)[0]:.2f}")
            cells.append(f"{figures[0]} ({figures[1]})".replace("-0.00", "0.00"))
        rows.append([f"`{scheme}`", *cells])
    return rows


def fronts() -> Rows:
    """Speed of response against distortion against survival, at every choice."""
    limits = [f"settled, ripple below {limit:g} A" for limit in RIPPLE_LIMITS]
    rows = [
        [
            "scheme",
            "`deadbeat.gain`, or `pi.bandwidth` (rad/s)",
            "step within 0.2 A (periods)",
            "THD (%)",
            "ripple (A)",
            *limits,
            "largest current (A)",
        ]
    ]
    for p in points():
        rows.append(
            [
                f"`{p.scheme}`",
                f"**{p.choice}**" if p.own else p.choice,
                f"{p.periods:.0f}" if np.isfinite(p.periods) else "never",
                f"{100.0 * p.thd:.2f}",
                f"{p.ripple:.2f}",
                *(f"{100.0 * x:.1f} %" for x in p.survived),
                f"{p.largest:.1f}",
            ]
        )
    return rows


def motors() -> Rows:
    """MLS-MFPCC against MBPCC with true parameters on other motors."""
    rows = [["motor", "r/min", "N m", "`mbpcc` THD (%)", "`mls_mfpcc` THD (%)", "ratio"]]
    for motor, rpm, load in (
        ("textbook_spmsm", 100.0, 2.0),
        ("textbook_spmsm", 750.0, 5.0),
        ("textbook_spmsm", 1500.0, 5.0),
        ("ipmsm", 100.0, 5.0),
        ("ipmsm", 300.0, 5.0),
        ("ipmsm", 750.0, 2.0),
        ("ipmsm", 750.0, 8.0),
        ("ipmsm", 1500.0, 5.0),
    ):
        thd = [
            np.mean(
                [
                    run(
                        scheme,
                        0.5,
                        motor=motor,
                        rpm=rpm,
                        load=load,
                        seed=seed,
                        oversampling=20,
                        plant=ENCODER,
                    ).thd(0.3)
                    for seed in (1, 2, 3)
                ]
            )
            for scheme in ("mbpcc", "mls_mfpcc")
        ]
        rows.append(
            [
                f"`{motor}`",
                f"{rpm:.0f}",
                f"{load:.0f}",
                f"{100 * thd[0]:.2f}",
                f"{100 * thd[1]:.2f}",
                f"{thd[1] / thd[0]:.3f}",
            ]
        )
    return rows


def sector_search() -> Rows:
    """Both sector searches, on a machine without saliency and on a salient one."""
    rows = [["THD (%)", "`ranking`", "`dwell`"]]
    for motor in ("seed_750", "ipmsm"):
        ranking = run("mls_mfpcc_paper", 0.4, motor=motor, oversampling=20, plant=ENCODER).thd(0.2)
        rows.append([f"`mls_mfpcc_paper`, `{motor}`", f"{100.0 * ranking:.2f}", ""])
        for scheme in ("mbpcc", "mls_mfpcc"):
            thd = [
                run(
                    scheme,
                    0.4,
                    motor=motor,
                    oversampling=20,
                    plant=ENCODER,
                    controller={"sector_search": search},
                ).thd(0.2)
                for search in ("ranking", "dwell")
            ]
            rows.append([f"`{scheme}`, `{motor}`", *(f"{100.0 * x:.2f}" for x in thd)])
    return rows


@functools.cache
def _judged(scheme: str, case: str) -> tuple[float, float, float, float, float]:
    """Ripple d and q (A), THD and deviations (%) with a piece of reality; medians of ten seeds."""
    runs = [real_run(scheme, case, seed, 20) for seed in SEEDS]
    d, q = np.median([r.ripple(0.2) for r in runs], axis=0)
    thd = np.median([r.thd(0.2) for r in runs])
    first, third = np.median([real_deviation(scheme, case, seed) for seed in SEEDS], axis=0)
    return float(d), float(q), 100.0 * float(thd), 100.0 * float(first), 100.0 * float(third)


def reality() -> Rows:
    """Ripple, distortion and deviation with what simulations leave out; medians of ten seeds."""
    schemes = ("mbpcc", "pi_foc", "neso_mfpcc", "mls_mfpcc_paper", "mls_mfpcc")
    what = "ripple d / q (A); THD (%); deviation at the first / third step (%)"
    rows = [[what, *(f"`{scheme}`" for scheme in schemes)]]
    for case in REALITY:
        cells = []
        for scheme in schemes:
            d, q, thd, first, third = _judged(scheme, case)
            cells.append(f"{d:.2f} / {q:.2f}; {thd:.2f}; {first:.1f} / {third:.1f}")
        rows.append([case, *cells])
    return rows


def over_true_models() -> Rows:
    """MLS-MFPCC over the rivals that know the true model, by each piece of reality."""
    rows = [
        [
            "`mls_mfpcc` over",
            "ripple d / q: the better of `mbpcc`, `pi_foc`",
            "THD: the better of both",
            "THD: `mbpcc`",
            "deviation, first / third step: `mbpcc`",
            "the same: `pi_foc`",
        ]
    ]
    for case in REALITY:
        ours, mbpcc, pi = (np.array(_judged(s, case)) for s in ("mls_mfpcc", "mbpcc", "pi_foc"))
        best = ours / np.minimum(mbpcc, pi)
        pairs = [f"{best[0]:.2f} / {best[1]:.2f}", f"{best[2]:.2f}"]
        pairs.append(f"{ours[2] / mbpcc[2]:.2f}")
        for rival in (mbpcc, pi):
            first, third = ours[3:] / rival[3:]
            pairs.append(f"{first:.2f} / {third:.2f}")
        rows.append([case, *pairs])
    return rows


def _or_fault(error: float) -> str:
    return f"{error:.2f}" if np.isfinite(error) else "fault"


def _dirty_run(scheme: str, wrong: bool, seed: int) -> tuple[bool, float]:
    """Whether a dirty drive settles, and its rms error (A), infinite where it trips."""
    options = dirty_drive(seed)
    if not wrong:
        frequency = options["controller"]["pwm_frequency"]
        options["controller"] = {"pwm_frequency": frequency}
    r = run(scheme, 0.3, **options)
    if r.controller.faults() != []:
        return False, float("inf")
    return bool(r.ripple(0.2).max() < 0.9), float(np.sqrt(np.mean(r.error(0.2) ** 2)))


def dirty() -> Rows:
    """Random drives none of whose parts is ideal."""
    seeds = range(5000, 5000 + DIRTY_DRAWS)
    who = [("mbpcc", False), ("pi_foc", False), *((scheme, True) for scheme in DIRTY_SCHEMES)]
    # the kernels are compiled, or loaded, once
    _dirty_run("mls_mfpcc", True, seeds[0])
    with ProcessPoolExecutor() as pool:
        found = {
            (scheme, wrong): list(
                pool.map(_dirty_run, repeat(scheme), repeat(wrong), seeds, chunksize=20)
            )
            for scheme, wrong in who
        }
    rms = {key: np.array([error for _, error in pairs]) for key, pairs in found.items()}
    best = np.minimum(rms["mbpcc", False], rms["pi_foc", False])
    held = np.isfinite(best)  # where both trip, there is nothing to compare with
    rows = [
        [
            "scheme, its model",
            "settled",
            f"error over that of the better of both true models, {held.sum()} drives: median",
            "90 %",
            "largest",
        ]
    ]
    for (scheme, wrong), pairs in found.items():
        over = rms[scheme, wrong][held] / best[held]
        rows.append(
            [
                f"`{scheme}`, {'wrong' if wrong else 'true'}",
                f"{100.0 * np.mean([good for good, _ in pairs]):.1f} %",
                *(_or_fault(np.quantile(over, q, method="higher")) for q in (0.5, 0.9, 1.0)),
            ]
        )
    return rows


def times() -> Rows:
    """Time of one step inside compiled code, everything included."""
    samples = {scheme: run(scheme, 0.2).feedback for scheme in SCHEMES}
    best: dict[str, float] = dict.fromkeys(SCHEMES, np.inf)
    # many short rounds, so that some fall between whatever else the machine does
    for _ in range(60):
        for scheme in SCHEMES:
            controller = Controller(CONTROLLER.complete({"scheme": scheme, "speed_ref_rpm": 750.0}))
            best[scheme] = min(best[scheme], step_time(controller, samples[scheme])["median"])
    rows = [["scheme", "one step (ns)", "over `mfpcc`"]]
    for scheme in SCHEMES:
        rows.append(
            [f"`{scheme}`", f"{1e3 * best[scheme]:.0f}", f"{best[scheme] / best['mfpcc']:.2f}"]
        )
    return rows


TABLES: dict[str, Callable[[], Rows]] = {
    "steady": steady,
    "ripple": ripple_and_error,
    "wrong_models": mismatch,
    "fronts": fronts,
    "motors": motors,
    "sectors": sector_search,
    "reality": reality,
    "over_true_models": over_true_models,
    "dirty": dirty,
    "times": times,
}

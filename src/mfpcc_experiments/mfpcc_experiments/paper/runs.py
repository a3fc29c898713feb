"""What is run of the paper, and what is measured: its experiments, over many seeds of the noise.

The recordings of one seed are what the figures show. The verdicts rest on all seeds: the others
run in process, where a run takes milliseconds, and leave no recording.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_controller.controller import Controller
from mfpcc_experiments.bags import Recording, recording
from mfpcc_experiments.measuring import Window, latched, metrics, waveform, window
from mfpcc_experiments.measuring.signals import Signal, signals
from mfpcc_experiments.running import Scenario, scenario
from mfpcc_experiments.running.configuration import configuration
from mfpcc_experiments.running.engine import Engine, Trace, step_time
from pwm_node.units import RPM

Progress = Callable[[float], None]

STEADY = ("steady_750_2", "steady_750_5", "steady_300_2", "steady_1000_2")
STEPS = ("load_step", "speed_step")
MISMATCHES = ("mismatch_a", "mismatch_b", "mismatch_c")

_THREE = ("mbpcc", "mls_mfpcc", "mfpcc")
_TWO = ("mfpcc", "mls_mfpcc")
_ROBUST = ("mbpcc", "neso_mfpcc", "mls_mfpcc")

#: Figures of the paper: the experiments and the schemes that each shows.
FIGURES: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "6": (STEADY, _THREE),
    "7": (STEADY, _TWO),
    "8": (STEPS, _THREE),
    "9": (STEPS, _TWO),
    "10": (MISMATCHES, _ROBUST),
}

#: Published computing times of one control period (us).
TIMES: Mapping[str, float] = {"mfpcc": 46.0, "mls_mfpcc": 50.0, "neso_mfpcc": 65.0}

#: The time of the step in all experiments that have one (s).
STEP = 0.2

# Around a step: what is looked at before it, in the transient, and right behind the step; and how
# long a jump of the reference takes at most (s).
_BEFORE, _TRANSIENT, _SPIKE, _JUMP = 0.05, 0.05, 0.02, 0.005

# The end of a recording with a step, where the drive has settled again (s).
_SETTLED = 0.05

#: Parts of a recording that the figures show (s).
SHOWN: Mapping[str, tuple[float, float]] = {
    **dict.fromkeys(STEADY, (0.3, 0.4)),
    "load_step": (0.15, 0.35),
    "speed_step": (0.15, 0.35),
    **dict.fromkeys(MISMATCHES, (0.15, 0.35)),
}

# Each scheme is timed so often; the fastest round counts.
_TIMING_ROUNDS = 15


@dataclass(frozen=True)
class Run:
    """
    One run, measured.

    Attributes
    ----------
    experiment, scheme, seed : str, str, int
        What it is of.
    row : dict
        Its object of ``metrics.json``.
    more : dict of float
        Figures that only the statements need, see `_more`.
    """

    experiment: str
    scheme: str
    seed: int
    row: dict[str, Any]
    more: dict[str, float]


@dataclass(frozen=True)
class Shown:
    """
    What the figures show of a run.

    Attributes
    ----------
    window : window.Window
        Signals of the evaluated time.
    shown : window.Window
        Signals of the time that the figures show.
    signals : dict of Signal
        ``speed`` and ``speed_ref`` (r/min) over the whole run.
    """

    window: Window
    shown: Window
    signals: dict[str, Signal]


class Results:
    """
    The runs, to be asked by experiment, scheme and seed.

    Parameters
    ----------
    runs : sequence of Run
        The same experiments and schemes for each seed; the first seed is the one that is shown.
    shown : mapping of (str, str) to Shown
        By experiment and scheme, of the first seed.
    times : mapping of str to float
        From `step_times`; empty where nothing was timed.
    """

    def __init__(
        self,
        runs: Sequence[Run],
        shown: Mapping[tuple[str, str], Shown],
        times: Mapping[str, float],
    ) -> None:
        self.runs = runs
        self.shown = shown
        self.times = times
        self.seeds = list(dict.fromkeys(run.seed for run in runs))
        self._runs = {(run.experiment, run.scheme, run.seed): run for run in runs}

    def run(self, experiment: str, scheme: str, seed: int | None = None) -> Run:
        """One run; without a seed, the one that is shown."""
        return self._runs[experiment, scheme, self.seeds[0] if seed is None else seed]

    @property
    def recorded(self) -> list[Run]:
        """The runs of the seed that is shown, in the order of the plan."""
        return [run for run in self.runs if run.seed == self.seeds[0]]


# --- Runs ----------------------------------------------------------------------------------------


def plan(figures: Iterable[str]) -> list[tuple[str, str]]:
    """Experiment and scheme of each run that some of the figures need."""
    return list(
        dict.fromkeys(
            (experiment, scheme)
            for figure in figures
            for experiment in FIGURES[figure][0]
            for scheme in FIGURES[figure][1]
        )
    )


def measure(found: Recording) -> Run:
    """
    Measure one run.

    Parameters
    ----------
    found : Recording
        Read from a bag, or from `simulate`.
    """
    experiment, scheme = found.config["experiment"], found.config["scheme"]
    return Run(
        experiment=experiment,
        scheme=scheme,
        seed=found.config["seed"],
        row=metrics.evaluate(found),
        more=_more(found, has_step=experiment not in STEADY),
    )


def shown(found: Recording) -> Shown:
    """
    Take out of a run what the figures show.

    Parameters
    ----------
    found : Recording
        Read from a bag, or from `simulate`.
    """
    whole = signals(found)
    return Shown(
        window=window.cut(found),
        shown=window.cut(found, SHOWN[found.config["experiment"]]),
        signals={name: whole[name] for name in ("speed", "speed_ref")},
    )


def simulate(wanted: Scenario, scheme: str, seed: int) -> Recording:
    """
    Run an experiment in process, and keep what a recording of it would hold.

    Parameters
    ----------
    wanted : Scenario
        The experiment.
    scheme : str
        Who controls the current.
    seed : int
        Seed of all noise.
    """
    config = configuration(wanted, scheme, "inprocess", seed)
    engine = Engine(*(config["parameters"][node] for node in ("pmsm_sim", "mfpcc_controller")))
    traces = list(engine.run(wanted.periods))

    def joined(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(trace, name) for trace in traces])

    legs = joined("legs")
    return Recording(
        path=Path(f"{wanted.name}/{scheme}"),
        config=config,
        summary={
            "faults": [
                *latched("pmsm_sim", engine.plant.faults()),
                *latched("mfpcc_controller", engine.controller.faults()),
            ]
        },
        feedback=joined("feedback"),
        command=joined("command"),
        lut=joined("lut"),
        state=joined("state"),
        scheme=np.concatenate([_names(trace) for trace in traces]),
        i_abc_oversampled=joined("i_abc").reshape(*legs.shape, 3) if legs.size else None,
        legs_oversampled=legs if legs.size else None,
        T_s=config["T_s"],
        n_p=config["n_p"],
    )


def _names(trace: Trace) -> NDArray[np.str_]:
    """Who controlled in each period."""
    return np.where(trace.fallen, trace.fallback, trace.scheme)


def measure_seeds(
    pairs: Sequence[tuple[str, str]], seeds: Sequence[int], progress: Progress | None = None
) -> list[Run]:
    """
    Run and measure in process, on all cores; the compiled loop lets the other threads work.

    Parameters
    ----------
    pairs : sequence of (str, str)
        Experiments and schemes, from `plan`.
    seeds : sequence of int
        Each pair is run with each of them.
    progress : callable, optional
        Told the number of runs done.

    Returns
    -------
    list of Run
        Seed by seed, each in the order of `pairs`.
    """
    scenarios = {experiment: scenario.load(experiment) for experiment, _ in pairs}

    def one(experiment: str, scheme: str, seed: int) -> Run:
        return measure(simulate(scenarios[experiment], scheme, seed))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        waiting = [pool.submit(one, *pair, seed) for seed in seeds for pair in pairs]
        try:
            for n, done in enumerate(as_completed(waiting), 1):
                done.result()
                if progress is not None:
                    progress(n)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [future.result() for future in waiting]


def _more(found: Recording, *, has_step: bool) -> dict[str, float]:
    """
    Figures that no comparison shows.

    Returns
    -------
    dict
        ``deviation_rms``: of the current from its reference, both axes together (A).
        ``mean_error``: amplitude of its mean (A). ``current``: mean of i_q (A). ``bias_q``: mean
        of predicted minus measured i_q (A). ``bias``: amplitude of that of both axes (A).
        ``ripple_d``, ``ripple_q``, ``error_d``, ``error_q``: peak to peak value of the current and
        largest prediction error within one electrical period, median of those of the window (A).
        ``zero_bias``, ``zero_size``: amplitudes of the mean difference of the zero vector's entry
        from the true response, and of the mean of this (A per period). ``repeated``, ``renewed``:
        share of the periods whose output is that of the period before, and in which all seven
        entries of the table were updated. With a step: ``before_error``, ``after_error`` and
        ``spike`` (largest prediction error in the 50 ms before and after it, and right behind it,
        A), ``after_deviation`` and ``oscillation`` (rms deviation in the 50 ms after it, and less
        its first 5 ms, A), ``settled`` (rms deviation in the last 50 ms), ``speed_dip`` (largest
        deviation of the speed, r/min), and ``torque_error`` (rms deviation of the torque from what
        is asked for in these 50 ms, N m).
    """
    w = window.cut(found)
    rows = window.window_rows(found.lut["period"], (w.begin, w.end), found.T_s)
    updated = found.lut["updated"][rows]
    duty = found.command["duty"][
        window.window_rows(found.command["period"], (w.begin, w.end), found.T_s)
    ]
    error = _required(w.error)
    more = {
        "deviation_rms": _deviation_rms(w),
        "mean_error": abs(complex(np.mean(w.i_dq - _required(w.i_dq_ref)))),
        "current": abs(float(np.mean(w.i_dq.imag))),
        "bias_q": -float(np.mean(error[:, 1])),
        "bias": float(np.hypot(*np.mean(error, axis=0))),
        "repeated": float(np.mean((duty[1:] == duty[:-1]).all(axis=1))),
        "renewed": float(np.mean(updated == 127)),
        **_of_one_period(w),
        **_zero_entry(found, w),
    }
    if has_step:
        end = len(found.feedback) * found.T_s
        before = window.cut(found, (STEP - _BEFORE, STEP))
        after = window.cut(found, (STEP, STEP + _TRANSIENT))
        spike = window.cut(found, (STEP, STEP + _SPIKE))
        later = window.cut(found, (STEP + _JUMP, STEP + _TRANSIENT))
        rows = window.window_rows(found.state["period"], (STEP, w.end), found.T_s)
        speed = found.state["speed"][rows] / RPM
        more |= {
            "before_error": _largest(before.error),
            "after_error": _largest(after.error),
            "after_deviation": _deviation_rms(after),
            "oscillation": _deviation_rms(later),
            "spike": _largest(spike.error),
            "settled": _deviation_rms(window.cut(found, (end - _SETTLED, end))),
            "speed_dip": float(np.max(np.abs(speed - speed[-1]))),
            "torque_error": _torque_per_ampere(found)
            * waveform.rms(after.i_dq.imag - _required(after.i_dq_ref).imag),
        }
    return more


def _of_one_period(w: Window) -> dict[str, float]:
    """Ripple and largest error within one electrical period, which is what a figure shows."""
    turned = waveform.turns(w.theta)
    borders = np.searchsorted(turned, np.arange(math.floor(turned[-1]) + 1))
    spans = [slice(*span) for span in pairwise(borders.tolist())]
    error = np.abs(_required(w.error))
    found = {}
    for axis, part in enumerate(("real", "imag")):
        i = getattr(w.i_dq, part)
        name = "dq"[axis]
        found[f"ripple_{name}"] = float(np.median([np.ptp(i[span]) for span in spans]))
        found[f"error_{name}"] = float(np.median([error[span, axis].max() for span in spans]))
    return found


def _zero_entry(found: Recording, w: Window) -> dict[str, float]:
    """
    The entry of the zero vector against what the machine does without a voltage.

    With e = R_s / L_s + j w_m a machine without saliency goes from i to i_0 + (i - i_0) exp(-e T_s)
    within a period, where i_0 = -j w_m psi_f / (L_s e): the voltage equation, solved.
    """
    motor = found.config["motor_file"]
    rows = window.window_rows(found.lut["period"], (w.begin, w.end), found.T_s)
    lut = found.lut[rows]
    w_m, i = lut["w_m"], lut["i_dq"][:, 0] + 1j * lut["i_dq"][:, 1]
    pole = motor["R_s"] / motor["L_d"] + 1j * w_m
    i_0 = -1j * w_m * motor["psi_f"] / (motor["L_d"] * pole)
    true = (i_0 - i) * (1.0 - np.exp(-pole * found.T_s))
    entry = lut["gradient_re"][:, 0] + 1j * lut["gradient_im"][:, 0]
    return {
        "zero_bias": abs(complex(np.mean(entry - true))),
        "zero_size": abs(complex(np.mean(true))),
    }


def _required(values: Any) -> Any:
    """What every run of ours records."""
    if values is None:
        raise window.MetricsError("the recording lacks lut_diagnostics")
    return values


def _deviation_rms(w: Window) -> float:
    return waveform.rms(np.abs(w.i_dq - _required(w.i_dq_ref)))


def _torque_per_ampere(found: Recording) -> float:
    """1.5 n_p psi_f of a machine without saliency (N m/A)."""
    motor = found.config["motor_file"]
    return 1.5 * float(motor["n_p"]) * float(motor["psi_f"])


def _largest(error: NDArray[np.float64] | None) -> float:
    return float(np.max(np.abs(_required(error))))


def step_times(path: Path, progress: Progress | None = None) -> dict[str, float]:
    """
    Computing time of one control period, by scheme, on the same recorded samples (us).

    The schemes take turns and the fastest round of each counts, so that other work of the machine
    falls on none of them.

    Parameters
    ----------
    path : Path
        A recording.
    progress : callable, optional
        Told the share that is done, 0 to 1.
    """
    found = recording.read(path)
    values = found.config["parameters"]["mfpcc_controller"]
    best = dict.fromkeys((*TIMES, "mbpcc"), math.inf)
    for n in range(_TIMING_ROUNDS):
        for scheme in best:
            controller = Controller({**values, "scheme": scheme})
            median = step_time(controller, found.feedback)["median"]
            best[scheme] = min(best[scheme], median)
        if progress is not None:
            progress((n + 1) / _TIMING_ROUNDS)
    return best

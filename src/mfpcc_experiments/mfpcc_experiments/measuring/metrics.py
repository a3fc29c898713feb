"""
The metrics: one entry for each figure of merit, and all of them for a recording.

An entry of `METRICS` says where a figure stands in ``metrics.json``, how it is computed, what a
window must offer for it, and how it is shown. The file, the tables, the reports and the reference
page are made from the entries; to add a metric is to add its entry.

Definitions
-----------
*Ripple* is the peak-to-peak value (and, separately, the rms deviation from the mean) of i_d and
i_q over the window, on the control samples and on the oversampled waveform.

*THD* is the total harmonic content of a phase current over its fundamental, both over a whole
number of electrical periods, from DC (excluded) to half the sampling rate. "Total" is meant: noise
and inter-harmonics count as well as the multiples of the fundamental. It therefore depends on the
sampling rate, which is stated with it.

THD and ripple are figures of a steady state (`steadiness`). Where there is none, the *deviation*
can be told: rms of measured minus reference.

*Prediction error* is the difference of measured and predicted current per axis: largest absolute
value, and rms. It is the LUT error of schemes with look-up tables; the keys bear that name.

*Settling* is the number of periods from a step of the reference until the error stays inside 5 %
of the step.

*Copper loss* is 1.5 R |i|^2 with the resistance that the winding had, warm or drifted.

*Speed* is the true one where the plant has told it, else the encoder's.

Mean errors are *measured minus reference*. Angles are in rad, currents in A, times in s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.measuring.content import Content, RunContent
from mfpcc_experiments.measuring.steadiness import Fitness, Need
from mfpcc_experiments.measuring.steps import current_steps
from mfpcc_experiments.measuring.waveform import (
    TWO_PI,
    Array,
    Fundamental,
    ripple_pp,
    ripple_rms,
    rms,
)
from mfpcc_experiments.measuring.window import (
    Window,
    cut,
    parts,
    window_periods,
)
from mfpcc_experiments.notes import Note, info, warning
from pwm_node.units import RPM

if TYPE_CHECKING:
    from mfpcc_experiments.bags import Recording


# --- The entries --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Metric:
    """
    One figure of merit.

    Attributes
    ----------
    key : str
        Where it stands in ``metrics.json``; a dot goes into a group.
    title, unit : str
        How it is called, and its unit there.
    meaning : str
        Definition, for the reference page.
    value : callable
        Computes it from a `Content`, or from a `RunContent` if it is not of `parts`; None where
        there is nothing to compute it from.
    needs : frozenset of Need
        What a window must offer; else the figure is not given.
    less_is_better : bool
        Whether the lowest of several recordings is marked.
    in_table : bool
        Whether tables show it.
    of_parts : bool
        Whether it can be told of a part of a window, too: then its scatter is known.
    shown_unit, factor : str, float
        Unit in tables, if another, and what to multiply with.
    """

    key: str
    title: str
    unit: str
    meaning: str
    value: Callable[[Any], float | None]
    needs: frozenset[Need] = frozenset()
    less_is_better: bool = True
    in_table: bool = True
    of_parts: bool = True
    shown_unit: str = ""
    factor: float = 1.0

    @property
    def path(self) -> tuple[str, ...]:
        """Keys from the outside in."""
        return tuple(self.key.split("."))


def _needs(*needs: Need) -> frozenset[Need]:
    return frozenset(needs)


_STEADY = _needs(Need.STEADY, Need.DRIVEN, Need.FEEDBACK)
_CURRENT = _needs(Need.DRIVEN, Need.FEEDBACK)
_REFERENCE = _needs(Need.DRIVEN, Need.FEEDBACK, Need.DIAGNOSTICS)
_PREDICTION = _REFERENCE | {Need.ONE_SCHEME}
_TORQUE = _needs(Need.DRIVEN, Need.STATE)
_STEP_TIME = _needs(Need.DRIVEN, Need.ONE_SCHEME, Need.THROUGHOUT)


def _percent(part: Fundamental | None) -> float | None:
    return None if part is None else 100.0 * part.thd


def _axis(values: NDArray[Any], axis: str) -> Array:
    """One axis of complex currents."""
    return values.real if axis == "d" else values.imag


def _of_axis(
    function: Callable[[Array], float], signal: Callable[[Content], Any], axis: str
) -> Callable[[Content], float | None]:
    """Apply a function of waveforms to one axis of a complex signal, if there is any of it."""

    def value(c: Content) -> float | None:
        values = signal(c)
        return None if values is None or not len(values) else function(_axis(values, axis))

    return value


def _errors(function: Callable[[Array], float], axis: str) -> Callable[[Content], float | None]:
    def value(c: Content) -> float | None:
        error = c.w.error
        return None if error is None or not len(error) else function(error[:, "dq".index(axis)])

    return value


def _torque(function: Callable[[Array], float]) -> Callable[[Content], float | None]:
    return lambda c: function(c.w.torque) if len(c.w.torque) else None


def _largest(x: Array) -> float:
    return float(np.max(np.abs(x)))


def _mean(x: Array) -> float:
    return float(np.mean(x))


def _axes(
    make: Callable[[str], Metric],
) -> tuple[Metric, Metric]:
    """An entry for each axis."""
    return make("d"), make("q")


#: All figures of merit, in the order of the tables.
METRICS: tuple[Metric, ...] = (
    Metric(
        "thd_percent.oversampled", "THD, oversampled", "%",
        "total harmonic content of phase current a over its fundamental, on the true current",
        lambda c: _percent(c.oversampled), _STEADY | {Need.STATE},
    ),
    Metric(
        "thd_percent.control", "THD, control samples", "%",
        "the same on the control samples",
        lambda c: _percent(c.control), _STEADY,
    ),
    *_axes(lambda axis: Metric(
        f"ripple_pp.{axis}", f"Ripple {axis}, peak to peak", "A",
        f"peak-to-peak value of i_{axis} on the control samples",
        _of_axis(ripple_pp, lambda c: c.w.i_dq, axis), _STEADY,
    )),
    *_axes(lambda axis: Metric(
        f"ripple_pp.{axis}_oversampled", f"Ripple {axis}, peak to peak, oversampled", "A",
        f"peak-to-peak value of the true i_{axis}",
        _of_axis(ripple_pp, lambda c: c.w.fine_dq, axis), _STEADY | {Need.STATE}, in_table=False,
    )),
    *_axes(lambda axis: Metric(
        f"ripple_rms.{axis}", f"Ripple {axis}, rms", "A",
        f"rms deviation of i_{axis} from its mean, on the control samples",
        _of_axis(ripple_rms, lambda c: c.w.i_dq, axis), _STEADY,
    )),
    *_axes(lambda axis: Metric(
        f"deviation_rms.{axis}", f"Deviation {axis}, rms", "A",
        f"rms of measured minus reference i_{axis}, also outside of a steady state",
        _of_axis(rms, lambda c: c.deviation, axis), _REFERENCE,
    )),
    *_axes(lambda axis: Metric(
        f"lut_error_max.{axis}", f"Prediction error {axis}, max", "A",
        f"largest absolute value of measured minus predicted i_{axis}",
        _errors(_largest, axis), _PREDICTION,
    )),
    *_axes(lambda axis: Metric(
        f"lut_error_rms.{axis}", f"Prediction error {axis}, rms", "A",
        f"rms of measured minus predicted i_{axis}",
        _errors(rms, axis), _PREDICTION,
    )),
    Metric(
        "i_d_mean", "Mean i_d", "A", "mean of i_d",
        _of_axis(_mean, lambda c: c.w.i_dq, "d"), _CURRENT, less_is_better=False,
    ),
    Metric(
        "i_q_error_mean", "Mean error of i_q", "A", "mean of measured minus reference i_q",
        _of_axis(_mean, lambda c: c.deviation, "q"), _REFERENCE, less_is_better=False,
    ),
    Metric(
        "speed_rpm_mean", "Mean speed", "r/min",
        "mean speed: the true one where recorded, else the encoder's",
        lambda c: c.speed / RPM, _needs(Need.SPEED), less_is_better=False, of_parts=False,
    ),
    Metric(
        "torque_mean", "Mean torque", "N m", "mean electromagnetic torque",
        _torque(_mean), _TORQUE, less_is_better=False, in_table=False,
    ),
    Metric(
        "torque_ripple_pp", "Torque ripple, peak to peak", "N m",
        "peak-to-peak value of the torque",
        _torque(ripple_pp), _STEADY | _TORQUE, in_table=False,
    ),
    Metric(
        "torque_ripple_rms", "Torque ripple, rms", "N m",
        "rms deviation of the torque from its mean",
        _torque(ripple_rms), _STEADY | _TORQUE,
    ),
    Metric(
        "i_rms", "Phase current, rms", "A", "rms of the phase currents",
        lambda c: math.sqrt(c.square / 2.0), _CURRENT | {Need.STATE},
        in_table=False, of_parts=False,
    ),
    Metric(
        "copper_loss_w", "Copper loss", "W",
        "1.5 R i^2 with the resistance that the winding had, warm or drifted",
        lambda c: None if c.resistance is None else 1.5 * c.resistance * c.square,
        _CURRENT | {Need.STATE}, of_parts=False,
    ),
    Metric(
        "switching_frequency_hz", "Switching frequency", "Hz",
        "on-off cycles of a leg per second, mean of the three",
        lambda c: c.switching_frequency, _needs(Need.COMMAND),
        less_is_better=False, of_parts=False, shown_unit="kHz", factor=1e-3,
    ),
    Metric(
        "step_time_us.median", "Step time, median", "us",
        "computing time of a control step, median over the run",
        lambda c: c.step_time("median"), _STEP_TIME, of_parts=False,
    ),
    Metric(
        "step_time_us.p99", "Step time, 99 %", "us",
        "computing time of a control step, below which 99 % are",
        lambda c: c.step_time("p99"), _STEP_TIME, of_parts=False,
    ),
    Metric(
        "lost_periods", "Lost periods", "", "periods of the recording that lack a message",
        lambda c: c.recording.lost_periods, of_parts=False,
    ),
    Metric(
        "sampling_rate_hz.control", "Sampling rate, control", "Hz",
        "rate of the control samples",
        lambda c: 1.0 / c.recording.T_s, less_is_better=False, in_table=False, of_parts=False,
    ),
    Metric(
        "sampling_rate_hz.oversampled", "Sampling rate, oversampled", "Hz",
        "rate of the oversampled waveform",
        lambda c: c.recording.oversampling / c.recording.T_s if c.recording.oversampling else None,
        less_is_better=False, in_table=False, of_parts=False,
    ),
    Metric(
        "fundamental.amplitude_a", "Fundamental, amplitude", "A",
        "peak value of the fundamental of phase current a",
        lambda c: c.control.amplitude if c.control else None, _STEADY,
        less_is_better=False, in_table=False, of_parts=False,
    ),
    Metric(
        "fundamental.frequency_hz", "Fundamental, frequency", "Hz", "electrical frequency",
        lambda c: abs(c.speed) * (c.recording.n_p or 1) / TWO_PI,
        less_is_better=False, in_table=False, of_parts=False,
    ),
    Metric(
        "fundamental.periods", "Fundamental, periods", "",
        "whole electrical periods in the window",
        lambda c: c.control.periods if c.control else 0,
        less_is_better=False, in_table=False, of_parts=False,
    ),
)  # fmt: skip


#: The same by key.
METRIC = {metric.key: metric for metric in METRICS}


# --- One row of metrics.json --------------------------------------------------------------------

_NO_SCATTER: dict[str, Any] = {"parts": 0, "mean": {}, "std": {}}


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Figures by their keys with dots, as groups."""
    row: dict[str, Any] = {}
    for key, value in values.items():
        *path, last = key.split(".")
        group = row
        for name in path:
            group = group.setdefault(name, {})
        group[last] = value
    return row


def scatter(w: Window, kept: Sequence[str] | None = None) -> dict[str, Any]:
    """
    Mean and standard deviation of each figure over the parts of a window.

    They say how much a figure moves within a run, not whether two runs differ by more than chance:
    runs of two seeds differ by more than their parts do. The peak-to-peak and largest values of a
    part are smaller than those of the whole window.

    Parameters
    ----------
    w : Window
        From `window.cut`.
    kept : sequence of str, optional
        Figures that the window can give, by their keys joined with dots; default: all.

    Returns
    -------
    dict
        ``parts`` (their number), and ``mean`` and ``std``: figures by their keys joined with dots.
    """
    contents = [Content(part) for part in parts(w)]
    mean, std = {}, {}
    for metric in METRICS if len(contents) > 1 else ():
        if not metric.of_parts or (kept is not None and metric.key not in kept):
            continue
        values = [metric.value(content) for content in contents]
        known = [v for v in values if v is not None and math.isfinite(v)]
        if len(known) == len(contents):
            mean[metric.key] = float(np.mean(known))
            std[metric.key] = float(np.std(known, ddof=1))
    return {"parts": len(contents), "mean": mean, "std": std}


def _clean(value: Any) -> Any:
    """NumPy numbers as Python's; NaN and infinity, which JSON does not know, as None."""
    if isinstance(value, dict):
        return {key: _clean(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_clean(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _changes(config: Mapping[str, Any]) -> list[Note]:
    """What the run was to do otherwise than its experiment says."""
    scenario = config.get("scenario")
    changes = scenario.get("changes") if isinstance(scenario, dict) else None
    if not isinstance(changes, dict) or not changes:
        return []
    listed = ", ".join(f"{name} = {value}" for name, value in changes.items())
    return [info(f"not as the experiment says: {listed}")]


@np.errstate(all="ignore")  # a figure that is no number is not given
def evaluate(recording: Recording, window_s: Sequence[float] | None = None) -> dict[str, Any]:
    """
    Measure one recording.

    Parameters
    ----------
    recording : Recording
        From `recording.read`.
    window_s : sequence of two floats, optional
        Evaluation window (s); default: the one stored in the recording, else all of it.

    Returns
    -------
    dict
        One object of ``metrics.json``; a figure that the recording cannot give, or that would not
        be what its label says, is None, and its ``notes`` say why.
    """
    w = cut(recording, window_s)
    config, content = recording.config, RunContent(recording, w)
    past = content.past
    first, end = window_periods((w.begin, w.end), recording.T_s)
    fitness = Fitness(recording, w, past, first, end)
    scheme = past.scheme_in(first, end)
    values = {
        metric.key: None if metric.needs & fitness.lacks else metric.value(content)
        for metric in METRICS
    }
    given = [key for key, value in values.items() if value is not None]
    figures = _nested(values)
    if content.deviation is None:
        # nothing to compare with anywhere in the window: no such groups at all
        figures |= dict.fromkeys(("deviation_rms", "lut_error_max", "lut_error_rms"))
    loss = [info(content.of_resistance)] if content.of_resistance else []
    if METRIC["copper_loss_w"].needs & fitness.lacks:
        loss = []
    row = {
        "experiment": config.get("experiment"),
        "scheme": scheme,
        "motor": config.get("motor"),
        "engine": config.get("engine"),
        "seed": config.get("seed"),
        "periods": len(recording.feedback),
        "window_s": [w.begin, w.end],
        "steady": fitness.steady,
        **figures,
        "current_steps": current_steps(recording, past, scheme),
        "scatter": scatter(w, given) if fitness.steady else _NO_SCATTER,
        "notes": [
            note.to_json()
            for note in (
                *past.notes(first, end),
                *fitness.notes,
                *_changes(config),
                *recording.notes,
                *of_the_run(recording),
                *loss,
            )
        ],
    }
    cleaned: dict[str, Any] = _clean(row)
    return cleaned


# A pace that is kept within this share is kept.
_PACE_KEPT = 0.98


def of_the_run(recording: Recording) -> list[Note]:
    """What the run left behind at its end: its pace, and commands that came too late."""
    summary = recording.summary
    found = []
    if recording.lost_periods:
        text = f"{recording.lost_periods} periods of the recording are incomplete"
        found.append(warning(text))
    pace = summary.get("real_time_factor")
    if isinstance(pace, dict) and pace["achieved"] < _PACE_KEPT * pace["asked"]:
        found.append(
            warning(
                f"the pace was not kept: real_time_factor {pace['asked']:.3g} asked for, "
                f"{pace['achieved']:.3g} achieved"
            )
        )
    missed = summary.get("missed_periods")
    if isinstance(missed, int) and missed > 0:
        found.append(warning(f"in {missed} periods no command had come in time"))
    return found

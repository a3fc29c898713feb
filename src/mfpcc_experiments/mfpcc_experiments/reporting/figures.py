"""
Figures of recordings side by side, as for a paper, on white, axes with units: each as a PNG file,
and as vectors (SVG and PDF) for a page of one's own.

All schemes of one figure share their scales, so that what looks smaller is smaller.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, MaxNLocator

from mfpcc_experiments.measuring import Measured, Window, waveform
from mfpcc_experiments.reporting.style import (
    COLOURS,
    FORMATS,
    PHASE_MARKS,
    PHASES,
    REFERENCE,
    STYLE,
)
from pwm_node.lags import end_of, percentiles

#: Electrical periods shown of the phase currents: in a steady state, and around a transient.
STEADY_PERIODS, TRANSIENT_PERIODS = 2.0, 5.0

#: Columns side by side in a figure; more of them go on below.
MOST_COLUMNS = 4


def draw(runs: Sequence[Measured], folder: Path) -> dict[str, Path]:
    """
    Draw all figures of a comparison.

    Parameters
    ----------
    runs : sequence of Measured
        What is compared, in this order.
    folder : Path
        Where the files go; it exists.

    Returns
    -------
    dict of Path
        PNG file of each figure, by name; a figure that no recording has data for is not there.
    """
    drawn = {}
    painters: dict[str, Callable[[Sequence[Measured]], Figure | None]] = {
        "phase_currents": phase_currents,
        "i_dq": i_dq,
        "lut_error": lut_error,
        "spectrum": spectrum,
        "speed_torque": speed_torque,
        "lags": lags,
    }
    with mpl.rc_context(STYLE):
        for name, painter in painters.items():
            figure = painter(runs)
            if figure is not None:
                drawn[name] = save(figure, folder / name)
    return drawn


def save(figure: Figure, path: Path) -> Path:
    """
    Write a figure in all `FORMATS`; with `STYLE` in force.

    Parameters
    ----------
    figure : Figure
        What was drawn.
    path : Path
        Its files without their ending.

    Returns
    -------
    Path
        The PNG file.
    """
    for ending, metadata in FORMATS.items():
        figure.savefig(path.with_name(path.name + ending), metadata=metadata)
        figure.set_layout_engine("none")  # all stands where the first put it
    return path.with_name(f"{path.name}.png")


def panels(
    titles: Sequence[str], rows: Sequence[str], height: float, x_label: str
) -> tuple[Figure, list[list[Axes]]]:
    """
    One column per title, one row per quantity; rows of more columns than a page is wide for wrap.

    The scale of a quantity is the same in all columns; the time is each column's own.

    Parameters
    ----------
    titles : sequence of str
        What stands above the columns.
    rows : sequence of str
        Quantities, with their units.
    height : float
        Height of a row (inches).
    x_label : str
        What stands below the columns.

    Returns
    -------
    figure : Figure
    axes : list of list of Axes
        By row and title.
    """
    n = len(titles)
    blocks = -(-n // MOST_COLUMNS)
    columns = -(-n // blocks)
    width = max(3.5, 0.45 + 2.25 * columns)
    tall = 0.75 + height * len(rows) + (blocks - 1) * (0.45 + height * len(rows))
    layout = ConstrainedLayoutEngine(w_pad=0.03, h_pad=0.03, wspace=0.06)
    figure = Figure(figsize=(width, tall), layout=layout)
    grid = figure.subplots(blocks * len(rows), columns, squeeze=False)
    axes: list[list[Axes]] = [[] for _ in rows]
    for place in range(blocks * columns):
        block, column = divmod(place, columns)
        cells = grid[block * len(rows) : (block + 1) * len(rows), column]
        if place >= n:
            for axis in cells:
                axis.remove()
            continue
        for row, (axis, label) in enumerate(zip(cells, rows, strict=True)):
            if place == 0:
                axis.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
            else:
                axis.sharey(axes[row][0])
            if row == 0:
                axis.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
                axis.set_title(_wrapped(titles[place]))
            else:
                axis.sharex(cells[0])
            if column == 0:
                axis.set_ylabel(label)
            axis.tick_params(labelleft=column == 0, labelbottom=row == len(rows) - 1)
            axes[row].append(axis)
        cells[-1].set_xlabel(x_label)
    figure.align_ylabels()
    return figure, axes


def _titles(runs: Sequence[Measured]) -> list[str]:
    return [run.label for run in runs]


def _wrapped(label: str) -> str:
    return label.replace(", ", "\n", 1) if len(label) > 26 else label


def note(axis: Axes, text: str) -> None:
    """A figure of merit in the upper right corner, above the data."""
    axis.text(
        0.99,
        0.985,
        text,
        transform=axis.transAxes,
        ha="right",
        va="top",
        fontsize=7.5,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5},
        zorder=5,
    )


def limits(axes: Sequence[Axes], values: Sequence[Any], *, top: float = 0.2) -> None:
    """The same y limits for all, around all values, with room for a note at the top."""
    low = min(float(np.nanmin(v)) for v in values)
    high = max(float(np.nanmax(v)) for v in values)
    span = (high - low) or max(abs(high), 1.0) * 0.1
    for axis in axes:
        axis.set_ylim(low - 0.06 * span, high + top * span)


#: In the place of a figure that is not given.
NO_FIGURE = "no figure: see the notes"


def format_value(value: float | None, unit: str) -> str:
    """Three significant digits with a unit."""
    if value is None:
        return "–"
    digits = 2 if value == 0 else max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(digits, 4)}f} {unit}"


def phase_currents(runs: Sequence[Measured]) -> Figure:
    """The three phase currents: two electrical periods and the THD, or five around a transient."""
    figure, ((*axes,),) = panels(_titles(runs), ["Phase current (A)"], 1.75, "Time (s)")
    shown = []
    for axis, run in zip(axes, runs, strict=True):
        w = run.window
        time, i_abc, fine = w.time, w.i_abc, False
        if w.fine_time is not None and w.fine_abc is not None:
            time, i_abc, fine = w.fine_time, w.fine_abc, True
        frequency = run.row["fundamental"]["frequency_hz"]
        steady = run.row["steady"]
        span = STEADY_PERIODS if steady else TRANSIENT_PERIODS
        span = min(span / frequency if frequency > 1.0 else 1.0, time[-1] - time[0])
        begin = time[0] if steady else min(_transient(w) - 0.3 * span, time[-1] - span)
        begin = max(begin, time[0])
        rows = slice(*np.searchsorted(time, (begin, begin + span)))
        # a mark here and there, as far from those of the other phases: prints may be grey
        every = max(3, (rows.stop - rows.start) // 8)
        for n, (name, colour, mark) in enumerate(zip("abc", PHASES, PHASE_MARKS, strict=True)):
            axis.plot(
                time[rows],
                i_abc[rows, n],
                color=colour,
                label=f"$i_{name}$",
                marker=mark,
                markevery=((2 * n + 1) * every // 6, every),
                markersize=4.0,
                markeredgecolor="white",
                markeredgewidth=0.5,
            )
        axis.set_xlim(begin, begin + span)
        shown.append(i_abc[rows])
        thd = run.row["thd_percent"]["oversampled" if fine else "control"]
        if thd is not None:
            note(axis, f"THD {format_value(thd, '%')}")
    limits(axes, shown)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3, columnspacing=1.2
    )
    return figure


def _transient(w: Window) -> float:
    """Time of the largest change of the current from one electrical period to the next (s)."""
    means = waveform.period_means(w.i_dq, w.theta)
    samples = len(w.time) - len(means)  # of about one period, which each mean looks ahead
    if len(means) <= samples or samples == 0:
        return float(w.time[0])
    change = np.abs(means[samples:] - means[:-samples])
    return float(w.time[int(np.argmax(change)) + samples])


def i_dq(runs: Sequence[Measured]) -> Figure:
    """i_d and i_q with their references over the window, and their ripple."""
    figure, axes = panels(_titles(runs), ["$i_d$ (A)", "$i_q$ (A)"], 1.35, "Time (s)")
    for row, axis_name in enumerate("dq"):
        shown = []
        for axis, run in zip(axes[row], runs, strict=True):
            w = run.window
            i = w.i_dq.real if row == 0 else w.i_dq.imag
            axis.plot(w.time, i, color=COLOURS[row], lw=0.5, label="measured")
            shown.append(i)
            if w.i_dq_ref is not None:
                ref = w.i_dq_ref.real if row == 0 else w.i_dq_ref.imag
                axis.plot(w.lut_time, ref, color=REFERENCE, lw=0.9, ls="--", label="reference")
                shown.append(ref)
            axis.set_xlim(w.begin, w.end)
            note(axis, _ripple(run, axis_name))
        limits(axes[row], shown, top=0.25)
    figure.legend(
        *_handles(axes[0][0], axes[1][0]),
        loc="outside upper right",
        ncols=3,
        columnspacing=1.2,
    )
    return figure


def _ripple(run: Measured, axis_name: str) -> str:
    """The ripple, or in its place the deviation, or that there is none of either."""
    ripple, deviation = run.row["ripple_pp"][axis_name], run.row["deviation_rms"]
    if ripple is not None:
        return f"peak to peak {format_value(ripple, 'A')}"
    if deviation is not None and deviation[axis_name] is not None:
        return f"not steady\nrms deviation {format_value(deviation[axis_name], 'A')}"
    return NO_FIGURE


def _handles(*axes: Axes) -> tuple[list[Any], list[str]]:
    """Legend entries of several panels, each text once."""
    entries: dict[str, Any] = {}
    for axis, name in zip(axes, ("$i_d$", "$i_q$"), strict=False):
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            entries.setdefault(label if label == "reference" else f"{name} {label}", handle)
    names = sorted(entries, key=lambda name: name == "reference")  # last, of both
    return [entries[name] for name in names], names


def lut_error(runs: Sequence[Measured]) -> Figure | None:
    """Difference of measured and predicted current over the window."""
    if all(run.window.error is None for run in runs):
        return None
    figure, axes = panels(
        _titles(runs), ["Prediction error, d (A)", "Prediction error, q (A)"], 1.3, "Time (s)"
    )
    for row, axis_name in enumerate("dq"):
        shown = [np.zeros(1)]
        for axis, run in zip(axes[row], runs, strict=True):
            w = run.window
            axis.set_xlim(w.begin, w.end)
            if w.error is None:
                note(axis, "not recorded")
                continue
            axis.plot(w.lut_time, w.error[:, row], color=COLOURS[row], lw=0.5)
            shown.append(w.error[:, row])
            largest = run.row["lut_error_max"][axis_name]
            note(axis, NO_FIGURE if largest is None else f"max {format_value(largest, 'A')}")
        limits(axes[row], shown, top=0.25)
    return figure


def spectrum(runs: Sequence[Measured]) -> Figure | None:
    """Spectrum of the phase current relative to its fundamental, to half the sampling rate."""
    parts: list[tuple[tuple[Any, Any], float, float] | None] = []
    for run in runs:
        w = run.window
        if w.fine_abc is not None and w.fine_theta is not None:
            part, key = waveform.fundamental(w.fine_abc[:, 0], w.fine_theta), "oversampled"
        else:
            part, key = waveform.fundamental(w.i_abc[:, 0], w.theta), "control"
        rate = run.row["sampling_rate_hz"][key]
        if part is None or run.row["thd_percent"][key] is None:
            parts.append(None)
        else:
            parts.append((waveform.spectrum(part, rate), rate, part.thd))
    if not any(parts):
        return None
    figure, ((*axes,),) = panels(
        _titles(runs), ["Amplitude of $i_a$\n(% of the fundamental)"], 1.85, "Frequency (kHz)"
    )
    floor = 1e-2  # %
    for axis, entry in zip(axes, parts, strict=True):
        axis.set_yscale("log")
        axis.set_ylim(floor, 300.0)
        axis.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))
        if entry is None:
            note(axis, "no steady electrical period")
            continue
        (frequency, amplitude), rate, thd = entry
        # Up to the second harmonic of the switching frequency; what lies above is in the THD too.
        highest = min(rate / 2.0, 25e3)
        rows = frequency <= highest
        # One curve of separate strokes: thousands of line objects would take seconds.
        x = np.repeat(frequency[rows] * 1e-3, 3)
        y = np.full((np.count_nonzero(rows), 3), np.nan)
        y[:, 0], y[:, 1] = floor, np.maximum(100.0 * amplitude[rows], floor)
        axis.plot(x, y.ravel(), color=COLOURS[0], lw=0.6)
        axis.set_xlim(-0.02 * highest * 1e-3, highest * 1e-3)  # the fundamental stands free
        note(axis, f"THD {format_value(100.0 * thd, '%')}\nsampled at {rate * 1e-3:g} kHz")
    return figure


def speed_torque(runs: Sequence[Measured]) -> Figure | None:
    """Speed and torque over the whole recording, the evaluation window shaded."""
    names = ("speed", "torque")
    if not any(name in run.signals for run in runs for name in names):
        return None
    figure, axes = panels(_titles(runs), ["Speed (r/min)", "Torque (N m)"], 1.3, "Time (s)")
    entries: dict[str, Any] = {}
    for row, (name, other, text) in enumerate(
        (("speed", "speed_ref", "reference"), ("torque", "load_torque", "load"))
    ):
        shown = []
        for axis, run in zip(axes[row], runs, strict=True):
            axis.axvspan(run.window.begin, run.window.end, color="#eeeeee", lw=0, zorder=0)
            for signal, style in ((name, {}), (other, {"ls": "--", "color": REFERENCE})):
                if signal not in run.signals:
                    continue
                s = run.signals[signal]
                time = s.begin + s.step * np.arange(len(s.values))
                options: dict[str, Any] = {"color": COLOURS[row], "lw": 0.8, **style}
                (line,) = axis.plot(time, s.values, **options)
                entries.setdefault(name if signal == name else text, line)
                shown.append(s.values)
                axis.set_xlim(time[0], time[-1])
        shown = [v for v in shown if np.isfinite(v).any()]
        if shown:
            limits(axes[row], shown, top=0.08)
            _at_least(axes[row], 10.0 if name == "speed" else 0.5)
    figure.legend(
        list(entries.values()), list(entries), loc="outside upper right", ncols=4, columnspacing=1.2
    )
    return figure


def lags(runs: Sequence[Measured]) -> Figure | None:
    """Of paced runs: how many periods began later than that, or had their command later."""
    if not any(run.lags for run in runs):
        return None
    figure, ((*axes,),) = panels(_titles(runs), ["Periods later than that (%)"], 1.85, "Time (us)")
    entries: dict[str, Any] = {}
    for axis, run in zip(axes, runs, strict=True):
        axis.set_xscale("log")
        axis.set_yscale("log")
        texts = []
        for colour, (name, text) in zip(
            COLOURS,
            {"start": "start after its time", "round_trip": "command after the start"}.items(),
            strict=False,
        ):
            bins = run.lags.get(name)
            if bins is None:
                continue
            ends = np.array([end_of(int(first)) for first in bins[:, 0]]) * 1e-3
            later = 100.0 * (1.0 - np.cumsum(bins[:, 1]) / bins[:, 1].sum())
            # a step at each end; the last one falls to nothing, which a logarithm has not
            shown = 100.0 / bins[:, 1].sum()
            times, shares = np.r_[ends[0], ends], np.r_[100.0, np.maximum(later, 0.5 * shown)]
            (line,) = axis.plot(times, shares, color=colour, lw=0.9, drawstyle="steps-post")
            entries.setdefault(text, line)
            texts.append("  ".join(f"{us:.0f}" for us in (*percentiles(bins), ends[-1])))
        if not texts:
            note(axis, "not by the wall clock")
            continue
        axis.set_ylim(top=1e4)  # free for the numbers
        axis.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}" if y <= 100.0 else ""))
        note(axis, "\n".join(["50 %, 99 %, 99.9 %, max (us)", *texts]))
    figure.legend(
        list(entries.values()), list(entries), loc="outside upper right", ncols=2, columnspacing=1.2
    )
    return figure


def _at_least(axes: Sequence[Axes], span: float) -> None:
    """Widen the scale to `span`, so that a constant does not look like noise."""
    low, high = axes[0].get_ylim()
    if high - low < span:
        middle = (low + high) / 2.0
        for axis in axes:
            axis.set_ylim(middle - span / 2.0, middle + span / 2.0)

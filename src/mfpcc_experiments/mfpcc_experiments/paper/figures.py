"""The paper's figures 6 to 10 with our runs, panel by panel, as PNG files.

A block holds the panels of one row of the paper's figure, one column per panel (a), (b), ...; all
panels of a block share the scale of each quantity, so that what looks smaller is smaller.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator

from mfpcc_experiments.measuring import scheme_title
from mfpcc_experiments.paper.runs import MISMATCHES, STEADY, STEPS, Results, Run, Shown
from mfpcc_experiments.paper.statements import FITTED
from mfpcc_experiments.reporting import COLOURS, REFERENCE, STYLE
from mfpcc_experiments.reporting.figures import format_value, limits, note, save

_CONDITIONS = {
    "steady_750_2": "750 r/min, 2 N m",
    "steady_750_5": "750 r/min, 5 N m",
    "steady_300_2": "300 r/min, 2 N m",
    "steady_1000_2": "1000 r/min, 2 N m",
    "load_step": "Load 2 to 5 N m at 750 r/min",
    "speed_step": "Speed 500 to 1000 r/min at 2 N m",
    "mismatch_a": "L × 0.5, R × 0.1, ψ × 2",
    "mismatch_b": "L × 2, R × 10, ψ × 0.7",
    "mismatch_c": "L × 2, R × 1, ψ × 2",
}

_THREE = ("mbpcc", "mls_mfpcc", "mfpcc")
_TWO = ("mfpcc", "mls_mfpcc")
_ROBUST = ("mbpcc", "neso_mfpcc", "mls_mfpcc")


@dataclass(frozen=True)
class Quantity:
    """
    One row of panels in a block.

    Attributes
    ----------
    label : str
        What stands at its axis.
    draw : callable
        Draws a run into a panel; returns what was drawn, for the scale.
    remark : callable
        Figure of merit for the corner of a panel; empty for none.
    """

    label: str
    draw: Callable[[Axes, Shown], list[Any]]
    remark: Callable[[Run], str] = lambda run: ""


# --- Quantities ----------------------------------------------------------------------------------


def _phase_current(axis: Axes, run: Shown) -> list[Any]:
    w = run.shown
    time, current = w.time, w.i_abc[:, 0]
    if w.fine_time is not None and w.fine_abc is not None:
        time, current = w.fine_time, w.fine_abc[:, 0]
    axis.plot(time, current, color=COLOURS[2], lw=0.5)
    return [current]


def _current(part: str) -> Callable[[Axes, Shown], list[Any]]:
    def draw(axis: Axes, run: Shown) -> list[Any]:
        w = run.shown
        values = getattr(w.i_dq, part)
        axis.plot(w.time, values, color=COLOURS[part == "imag"], lw=0.5)
        if w.i_dq_ref is None:
            return [values]
        reference = getattr(w.i_dq_ref, part)
        axis.plot(w.lut_time, reference, color=REFERENCE, lw=0.7, ls="--")
        return [values, reference]

    return draw


def _error(n: int, *, evaluated: bool) -> Callable[[Axes, Shown], list[Any]]:
    def draw(axis: Axes, run: Shown) -> list[Any]:
        w = run.window if evaluated else run.shown
        assert w.error is not None  # every run of ours records it
        axis.plot(w.lut_time, w.error[:, n], color=COLOURS[n], lw=0.4)
        return [w.error[:, n]]

    return draw


def _speed(axis: Axes, run: Shown) -> list[Any]:
    drawn = []
    styles: dict[str, dict[str, Any]] = {
        "speed": {"color": COLOURS[3], "lw": 0.9},
        "speed_ref": {"color": REFERENCE, "lw": 0.7, "ls": "--"},
    }
    for name, options in styles.items():
        signal = run.signals[name]
        time = signal.begin + signal.step * np.arange(len(signal.values))
        rows = slice(*np.searchsorted(time, (run.shown.begin, run.shown.end)))
        axis.plot(time[rows], signal.values[rows], **options)
        drawn.append(signal.values[rows])
    return drawn


def _thd(run: Run) -> str:
    return f"THD {format_value(run.row['thd_percent']['oversampled'], '%')}"


def _ripple(name: str) -> Callable[[Run], str]:
    return lambda run: f"p-p {format_value(run.row['ripple_pp'][name], 'A')}"


def _worst(name: str) -> Callable[[Run], str]:
    return lambda run: f"max {format_value(run.row['lut_error_max'][name], 'A')}"


def _mean(name: str) -> Callable[[Run], str]:
    def remark(run: Run) -> str:
        value = run.row["i_d_mean" if name == "d" else "i_q_error_mean"]
        return f"mean error {value:+.2f} A".replace("-0.00", "0.00").replace("+0.00", "0.00")

    return remark


_STEADY_ROWS = (
    Quantity("$i_a$ (A)", _phase_current, _thd),
    Quantity("$i_q$ (A)", _current("imag"), _ripple("q")),
    Quantity("$i_d$ (A)", _current("real"), _ripple("d")),
)
_STEP_ROWS = (
    Quantity("Speed\n(r/min)", _speed),
    Quantity("$i_a$ (A)", _phase_current),
    Quantity("$i_q$ (A)", _current("imag")),
    Quantity("$i_d$ (A)", _current("real")),
)
_MISMATCH_ROWS = (
    Quantity("$i_a$ (A)", _phase_current),
    Quantity("$i_q$ (A)", _current("imag"), _mean("q")),
    Quantity("$i_d$ (A)", _current("real"), _mean("d")),
)


def _error_rows(*, evaluated: bool) -> tuple[Quantity, ...]:
    return (
        Quantity("Prediction\nerror, d (A)", _error(0, evaluated=evaluated), _worst("d")),
        Quantity("Prediction\nerror, q (A)", _error(1, evaluated=evaluated), _worst("q")),
    )


# --- Figures -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Block:
    """
    Panels side by side, all with the same quantities.

    Attributes
    ----------
    title : str
        What they have in common.
    runs : sequence of (Run, Shown)
        One per column.
    letters : str
        Of the paper's panels, one per column.
    """

    title: str
    runs: Sequence[tuple[Run, Shown]]
    letters: str


def draw(results: Results, figures: Iterable[str], folder: Path) -> Iterator[tuple[str, Path, str]]:
    """
    Draw figures of the paper with our runs.

    Parameters
    ----------
    results : Results
        The runs that they need.
    figures : iterable of str
        Keys of `runs.FIGURES`.
    folder : Path
        Where the PNG files go; it exists.

    Yields
    ------
    figure, path, caption : str, Path, str
        Key of the figure, its file, and what it shows.
    """
    with mpl.rc_context(STYLE):
        for figure in figures:
            for name, caption, picture in _PAINTERS[figure](results):
                yield figure, save(picture, folder / name), caption


Picture = tuple[str, str, Figure]


def _both(r: Results, experiment: str, scheme: str) -> tuple[Run, Shown]:
    return r.run(experiment, scheme), r.shown[experiment, scheme]


def _figure_6(r: Results) -> Iterator[Picture]:
    for part, experiments, what in (
        ("i", STEADY[:2], "at 750 r/min under 2 and 5 N m"),
        ("ii", STEADY[2:], "under 2 N m at 300 and 1000 r/min"),
    ):
        blocks = [
            Block(_CONDITIONS[e], [_both(r, e, s) for s in _THREE], letters)
            for e, letters in zip(experiments, ("abc", "def"), strict=True)
        ]
        yield (
            f"figure_6_{part}",
            f"Figure 6({part}): steady state {what}. Phase current (true, oversampled), and "
            "measured currents in the rotor frame with their references (dashed). THD and ripple "
            "(peak to peak on the control samples) are of 0.2 s.",
            _draw(blocks, [scheme_title(s) for s in _THREE], _STEADY_ROWS),
        )


def _figure_7(r: Results) -> Iterator[Picture]:
    for part, experiments, what in (
        ("i", STEADY[:2], "at 750 r/min under 2 and 5 N m"),
        ("ii", STEADY[2:], "under 2 N m at 300 and 1000 r/min"),
    ):
        blocks = [
            Block(scheme_title(s), [_both(r, e, s) for e in experiments], letters)
            for s, letters in zip(_TWO, ("ab", "cd"), strict=True)
        ]
        yield (
            f"figure_7_{part}",
            f"Figure 7({part}): prediction error, measured minus predicted current, {what}.",
            _draw(
                blocks,
                [_CONDITIONS[e] for e in experiments],
                _error_rows(evaluated=True),
                common=True,
            ),
        )


def _figure_8(r: Results) -> Iterator[Picture]:
    blocks = [
        Block(_CONDITIONS[e], [_both(r, e, s) for s in _THREE], letters)
        for e, letters in zip(STEPS, ("abc", "def"), strict=True)
    ]
    yield (
        "figure_8",
        "Figure 8: load step at 750 r/min, and speed step at 2 N m, each at 0.2 s. References are "
        "dashed.",
        _draw(blocks, [scheme_title(s) for s in _THREE], _STEP_ROWS),
    )


def _figure_9(r: Results) -> Iterator[Picture]:
    blocks = [
        Block(scheme_title(s), [_both(r, e, s) for e in STEPS], letters)
        for s, letters in zip(_TWO, ("ab", "cd"), strict=True)
    ]
    yield (
        "figure_9",
        "Figure 9: prediction error, measured minus predicted current, during the load step and "
        "the speed step, each at 0.2 s.",
        _draw(blocks, [_CONDITIONS[e] for e in STEPS], _error_rows(evaluated=False), common=True),
    )


def _figure_10(r: Results) -> Iterator[Picture]:
    blocks = [
        Block(scheme_title(s), [_both(r, e, s) for e in MISMATCHES], letters)
        for s, letters in zip(_ROBUST, ("abc", "def", "ghi"), strict=True)
    ]
    yield (
        "figure_10",
        "Figure 10: load step from 2 to 5 N m at 750 r/min (at 0.2 s) with wrong parameters in the "
        "controller: model over actual above each column. The mean error is that of the steady "
        "state afterwards (0.4 to 0.6 s).",
        _draw(blocks, [_CONDITIONS[e] for e in MISMATCHES], _MISMATCH_ROWS, common=True),
    )


_PAINTERS: dict[str, Callable[[Results], Iterator[Picture]]] = {
    "6": _figure_6,
    "7": _figure_7,
    "8": _figure_8,
    "9": _figure_9,
    "10": _figure_10,
}


def _draw(
    blocks: Sequence[Block],
    columns: Sequence[str],
    rows: Sequence[Quantity],
    *,
    common: bool = False,
) -> Figure:
    """Draw blocks one below the other; `common`: all of them share the scales too."""
    n = len(columns)
    height = 0.95 * len(blocks) * len(rows) + 0.3 * len(blocks) + 0.45
    figure = Figure(figsize=(7.4, height), layout=ConstrainedLayoutEngine(h_pad=0.05, w_pad=0.04))
    figure.supxlabel(FITTED, fontsize=6.5, color="#555555", x=0.01, ha="left")
    parts = figure.subfigures(len(blocks), 1, squeeze=False)[:, 0]
    drawn: dict[int, list[tuple[list[Axes], list[Any]]]] = {}
    for part, block in zip(parts, blocks, strict=True):
        axes = part.subplots(len(rows), n, sharex=True, sharey="row", squeeze=False)
        part.suptitle(block.title, x=0.01, ha="left", fontsize=9.0, fontweight="bold")
        for column, title in enumerate(columns):
            axes[0][column].set_title(f"({block.letters[column]}) {title}", fontsize=8.5)
            axes[-1][column].set_xlabel("Time (s)")
            axes[-1][column].xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        for n_row, quantity in enumerate(rows):
            values: list[Any] = []
            for axis, (run, shown) in zip(axes[n_row], block.runs, strict=True):
                values += quantity.draw(axis, shown)
                if quantity.remark(run):
                    note(axis, quantity.remark(run))
                axis.margins(x=0)
            axes[n_row][0].set_ylabel(quantity.label)
            axes[n_row][0].yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
            drawn.setdefault(n_row, []).append((list(axes[n_row]), values))
        part.align_ylabels()
    for panels in drawn.values():
        if common:
            together = [axis for line, _ in panels for axis in line]
            panels = [(together, [value for _, values in panels for value in values])]
        for line, values in panels:
            limits(line, values, top=0.3)
    return figure

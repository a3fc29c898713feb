"""The figures of a sweep's report, as PNG files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from mfpcc_experiments.measuring import scheme_title
from mfpcc_experiments.measuring.metrics import METRIC
from mfpcc_experiments.reporting.style import COLOURS, STYLE
from mfpcc_experiments.sweeping.rows import (
    Array,
    Axis,
    Rows,
    axis,
    by_cell,
    cells_for,
    front,
    share_by_cell,
)

# Points of a violin: so many quantiles have the shape of a million rows.
_QUANTILES = 2_000
# Marks of the schemes
_MARKERS = ("o", "s", "^", "v", "D", "P", "X", "*", "<", ">")
# Axes whose pairs are drawn.
_MOST_AXES = 4

#: Figures that a report shows where a sweep keeps them, the first ones first.
_PREFERRED = (
    "deviation_rms.q", "thd_percent.oversampled", "thd_percent.control", "ripple_pp.q",
    "lut_error_rms.q", "i_q_error_mean", "torque_ripple_rms", "copper_loss_w",
)  # fmt: skip
_MOST_FIGURES = 3


def shown_figures(rows: Rows) -> list[str]:
    """Figures of merit that the report shows."""
    kept = [name for name in rows.names if name in METRIC]
    wanted = [name for name in _PREFERRED if name in kept]
    found: list[str] = []
    for name in (*wanted, *(name for name in kept if name not in wanted)):
        if len(found) < _MOST_FIGURES and np.isfinite(rows[name]).any():
            found.append(name)
    return found


def title(name: str) -> str:
    """A figure's name and unit."""
    if name not in METRIC:
        return name
    metric = METRIC[name]
    return f"{metric.title} ({metric.unit})" if metric.unit else metric.title


def axes_of(rows: Rows) -> list[Axis]:
    """What varies and can be an axis of a map."""
    found: list[Axis] = []
    for name, space in rows.plan.spec.spaces.items():
        if name != "seed" and len(found) < _MOST_AXES:
            each = axis(name, space, rows[name], cells_for(rows.plan.rows_per_scheme))
            found += [] if each is None else [each]
    return found


def draw(rows: Rows, folder: Path) -> list[tuple[Path, str]]:
    """
    Draw all figures.

    Returns
    -------
    list of (Path, str)
        Files, and what each shows.
    """
    folder.mkdir(exist_ok=True)
    axes, figures = axes_of(rows), shown_figures(rows)
    found: list[tuple[Path, str]] = []
    with mpl.rc_context(STYLE):
        if len(axes) == 1:
            found.append(_along(rows, axes[0], folder / "survived.png"))
        for x, y in combinations(axes, 2):
            path = folder / f"survived_{_safe(x.name)}_{_safe(y.name)}.png"
            found.append(_map(rows, x, y, "survived", "share", path))
        if len(axes) >= 2:
            x, y = axes[:2]
            for name in figures:
                for statistic in ("median", "worst"):
                    path = folder / f"{statistic}_{_safe(name)}.png"
                    found.append(_map(rows, x, y, name, statistic, path))
        if figures:
            found.append(_violins(rows, figures, folder / "violins.png"))
            found.append(_fronts(rows, figures, folder / "front.png"))
    return found


def _safe(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name)


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=130, metadata={"Software": None})


def _map(rows: Rows, x: Axis, y: Axis, name: str, statistic: str, path: Path) -> tuple[Path, str]:
    """A heat map for each scheme, all with one scale."""
    schemes = rows.plan.schemes
    values: Any = rows.survived if name == "survived" else rows[name]
    cell = x.cell_of(rows[x.name]) * y.cells + y.cell_of(rows[y.name])
    pictures = []
    for scheme in schemes:
        part, cells = rows.of(scheme), x.cells * y.cells
        if statistic == "share":
            found = share_by_cell(cell[part], cells, values[part])
        else:
            found = by_cell(cell[part], cells, values[part], statistic)
        pictures.append(found.reshape(x.cells, y.cells).T)
    everything = np.concatenate([picture.ravel() for picture in pictures])
    known = everything[np.isfinite(everything)]
    low, high = 0.0, 1.0
    if statistic != "share" and known.size:
        low, high = float(known.min()), float(np.quantile(known, 0.98))
        high = high if high > low else low + 1e-9
    columns = min(len(schemes), 3)
    height = -(-len(schemes) // columns)
    figure = Figure(figsize=(2.9 * columns + 0.9, 2.6 * height + 0.5), layout="constrained")
    colours = mpl.colormaps["viridis" if statistic == "share" else "viridis_r"].with_extremes(
        bad="#ffffff"
    )
    image = None
    for n, (scheme, picture) in enumerate(zip(schemes, pictures, strict=True)):
        ax = figure.add_subplot(height, columns, n + 1)
        ax.grid(visible=False)
        x_edges, y_edges = _drawn_edges(x), _drawn_edges(y)
        image = ax.pcolormesh(x_edges, y_edges, picture, cmap=colours, vmin=low, vmax=high)
        for each, set_scale, set_ticks in (
            (x, ax.set_xscale, ax.set_xticks), (y, ax.set_yscale, ax.set_yticks)
        ):  # fmt: skip
            if each.labels:
                set_ticks(np.arange(each.cells) + 0.5, each.labels)
            elif each.log:
                set_scale("log")
                ticks = _log_ticks(each)
                set_ticks(ticks, [f"{tick:g}" for tick in ticks])
                set_ticks([], minor=True)
        ax.set_title(scheme_title(scheme))
        ax.set_xlabel(x.name)
        if n % columns == 0:
            ax.set_ylabel(y.name)
    label = "share that survived" if statistic == "share" else f"{statistic}: {title(name)}"
    assert image is not None
    bar = figure.colorbar(
        image, ax=figure.axes, label=label, extend="neither" if statistic == "share" else "max"
    )
    bar.outline.set_visible(False)  # type: ignore[operator]
    _save(figure, path)
    what = "Share of the runs that survived" if statistic == "share" else (
        f"{statistic.capitalize()} of {title(name)}, of those runs that have it"
    )  # fmt: skip
    return path, f"{what}, over {x.name} and {y.name}. White: no run."


def _log_ticks(each: Axis) -> list[float]:
    """Round numbers along an axis whose cells are equally wide in the logarithm."""
    low, high = each.edges[0], each.edges[-1]
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1.0, 2.0, 5.0) if high < 1e3 * low else (1.0,)
    return [x for d in decades for step in steps if low <= (x := step * 10.0**d) <= high]


def _drawn_edges(each: Axis) -> Array:
    return np.arange(each.cells + 1.0) if each.labels else each.edges


def _along(rows: Rows, x: Axis, path: Path) -> tuple[Path, str]:
    """Survival along the only axis there is."""
    figure = Figure(figsize=(5.5, 3.0), layout="constrained")
    ax = figure.add_subplot()
    cell = x.cell_of(rows[x.name])
    centre = np.arange(x.cells) + 0.5 if x.labels else 0.5 * (x.edges[1:] + x.edges[:-1])
    for n, scheme in enumerate(rows.plan.schemes):
        share = share_by_cell(cell[rows.of(scheme)], x.cells, rows.survived[rows.of(scheme)])
        colour = COLOURS[n % len(COLOURS)]
        ax.plot(centre, 100.0 * share, "o-", markersize=3, color=colour, label=scheme_title(scheme))
    if x.labels:
        ax.set_xticks(centre, x.labels)
    elif x.log:
        ax.set_xscale("log")
    ax.set_xlabel(x.name)
    ax.set_ylabel("survived (%)")
    ax.legend()
    _save(figure, path)
    return path, f"Share of the runs that survived, along {x.name}."


def _violins(rows: Rows, figures: Sequence[str], path: Path) -> tuple[Path, str]:
    """How each figure is distributed, scheme by scheme."""
    schemes = rows.plan.schemes
    figure = Figure(
        figsize=(6.5, 0.5 + len(figures) * (0.7 + 0.28 * len(schemes))), layout="constrained"
    )
    for n, name in enumerate(figures):
        ax = figure.add_subplot(len(figures), 1, n + 1)
        values = np.abs(rows[name])
        known = values[np.isfinite(values) & (values > 0.0)]
        log = known.size > 0 and np.quantile(known, 0.99) > 20.0 * np.quantile(known, 0.01)
        for k, scheme in enumerate(schemes):
            mine = values[rows.of(scheme)]
            mine = mine[np.isfinite(mine) & ((mine > 0.0) | (not log))]
            if mine.size < 2:
                continue
            quantiles = np.quantile(mine, np.linspace(0.0, 1.0, _QUANTILES))
            drawn = np.log10(quantiles) if log else quantiles
            if np.ptp(drawn) > 0.0:
                parts = ax.violinplot(
                    [drawn], positions=[k], orientation="horizontal", widths=0.85,
                    showextrema=False,
                )  # fmt: skip
                for body in parts["bodies"]:  # type: ignore[attr-defined]
                    body.set_facecolor(COLOURS[k % len(COLOURS)])
                    body.set_alpha(0.6)
            low, mid, high = np.quantile(drawn, (0.05, 0.5, 0.95))
            ax.plot([low, high], [k, k], color="#000000", linewidth=0.8)
            ax.plot([mid], [k], "o", color="#000000", markersize=3)
        ax.set_yticks(range(len(schemes)), [scheme_title(scheme) for scheme in schemes])
        ax.invert_yaxis()
        ax.set_xlabel(title(name))
        if log:
            ticks = np.arange(np.floor(np.log10(known.min())), np.ceil(np.log10(known.max())) + 1)
            ax.set_xticks(ticks, [f"{10.0**tick:g}" for tick in ticks])
    _save(figure, path)
    return path, (
        "How the figures are distributed over all runs that have them: median, and from 5 to 95 %. "
        "Sizes, where a figure has a sign."
    )


def _fronts(rows: Rows, figures: Sequence[str], path: Path) -> tuple[Path, str]:
    """What of survival costs what of the figures, for each scheme at each point of the grids."""
    plan = rows.plan
    figure = Figure(figsize=(3.1 * len(figures) + 0.3, 3.2), layout="constrained")
    good = rows.survived.reshape(len(plan.schemes), plan.points, plan.spec.runs)
    lost = 100.0 * (1.0 - good.mean(axis=2))
    for n, name in enumerate(figures):
        ax = figure.add_subplot(1, len(figures), n + 1)
        values = np.abs(rows[name]).reshape(good.shape)
        with np.errstate(all="ignore"):
            empty = ~np.isfinite(values).any(axis=2)
            values = np.where(empty[..., None], 0.0, values)
            medians = np.where(empty, np.nan, np.nanmedian(values, axis=2))
        best = front(lost.ravel(), medians.ravel()).reshape(lost.shape)
        for k, scheme in enumerate(plan.schemes):
            colour = COLOURS[k % len(COLOURS)]
            ax.plot(lost[k], medians[k], _MARKERS[k % len(_MARKERS)], color=colour, markersize=4,
                    alpha=0.45, label=scheme_title(scheme))  # fmt: skip
            for x, y in zip(lost[k][best[k]], medians[k][best[k]], strict=True):
                ax.plot([x], [y], _MARKERS[k % len(_MARKERS)], color=colour, markersize=7,
                        markeredgecolor="#000000", markeredgewidth=0.8)  # fmt: skip
        order = np.argsort(lost[best])
        ax.plot(lost[best][order], medians[best][order], color="#000000", linewidth=0.6)
        ax.set_xlabel("not survived (%)")
        ax.set_ylabel(f"median of {title(name)}")
        if n == 0:
            ax.legend(fontsize=6.5)
    _save(figure, path)
    each = "scheme, and each point of the grids," if plan.points > 1 else "scheme"
    return path, (
        f"Pareto fronts: each {each} by what did not survive and by the median of a figure. "
        "Ringed: no other one is better in both."
    )

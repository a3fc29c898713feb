"""The report of a sweep: one HTML file that needs nothing but itself, and its figures."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from mfpcc_experiments.files import write_whole
from mfpcc_experiments.measuring import scheme_title
from mfpcc_experiments.reporting import html
from mfpcc_experiments.sweeping.folder import Folder
from mfpcc_experiments.sweeping.pictures import axes_of, draw, shown_figures, title
from mfpcc_experiments.sweeping.rows import (
    STATISTICS,
    Axis,
    Rows,
    by_cell,
    interval,
    share_by_cell,
    worst,
)

_WORST = 10


def write(folder: Folder) -> Path:
    """
    Write ``report.html`` and ``figures/`` into the folder of a finished sweep.

    Returns
    -------
    Path
        The report.
    """
    rows = Rows(folder)
    plan, spec = folder.plan, folder.plan.spec
    pictures = draw(rows, folder.path / "figures")
    axes, figures = axes_of(rows), shown_figures(rows)
    page = html.page(
        "sweep.html",
        name=spec.name,
        description=spec.description,
        subtitle=f"{plan.rows:,} runs of {plan.base.periods:,} periods · experiment "
        f"{plan.base.name} · motor {plan.base.motor}",
        survived=_survived(rows, figures),
        figure_titles=[title(name) for name in figures],
        criterion=_criterion(rows),
        varies=[(name, _space(given)) for name, given in spec.vary.items()],
        draws=f"{spec.runs:,} draws ({spec.draw})"
        + (f" for each of {plan.points:,} points of the grids" if plan.points > 1 else ""),
        worst=_worst(rows, figures),
        pictures=[(html.embedded(path), text) for path, text in pictures],
        maps=json.dumps(_maps(rows, axes, figures), separators=(",", ":")).replace("<", "\\u003c"),
        has_maps=len(axes) >= 2,
        script=html.source("sweep.js"),
    )
    path = folder.path / "report.html"
    write_whole(path, page)
    return path


def _space(given: Any) -> str:
    return json.dumps(given, ensure_ascii=False).replace('"', "")


def _criterion(rows: Rows) -> str:
    limits = [f"{name} below {limit:g}" for name, limit in rows.plan.spec.survived.items()]
    return ", ".join(["no fault, no fallback", *limits])


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "–"


def _survived(rows: Rows, figures: list[str]) -> list[dict[str, Any]]:
    """Of each scheme the share that survived, and the medians."""
    found = []
    columns = {name: np.abs(rows[name]) for name in figures}
    for scheme in rows.plan.schemes:
        part = rows.of(scheme)
        good, n = int(np.count_nonzero(rows.survived[part])), rows.plan.rows_per_scheme
        low, high = interval(good, n)
        medians = []
        for values in columns.values():
            known = values[part][np.isfinite(values[part])]
            medians.append(_number(float(np.median(known)) if known.size else np.nan))
        found.append(
            {
                "scheme": scheme_title(scheme),
                "share": f"{100.0 * good / n:.2f}",
                "interval": f"{100.0 * low:.2f} to {100.0 * high:.2f}",
                "medians": medians,
            }
        )
    return found


def _worst(rows: Rows, figures: list[str]) -> list[dict[str, Any]]:
    """The worst rows, each with the command that runs it again."""
    found = []
    columns = {name: rows[name] for name in ("i_peak_over_limit", "ran_away", *figures)}
    faults = rows["faults"]
    for number in worst(rows, _WORST):
        scheme, values = rows.plan.row(number)
        found.append(
            {
                "row": number,
                "scheme": scheme_title(scheme),
                "survived": bool(rows.survived[number]),
                "why": "beyond what can be simulated"
                if columns["ran_away"][number]
                else str(faults[number]) or "–",
                "peak": _number(float(columns["i_peak_over_limit"][number])),
                "values": ", ".join(
                    f"{name} = {value:.4g}" if isinstance(value, float) else f"{name} = {value}"
                    for name, value in values.items()
                ),
                "command": f"mfpcc run --from {shlex.quote(str(rows.folder.path))} --row {number}",
            }
        )
    return found


def _maps(rows: Rows, axes: list[Axis], figures: list[str]) -> dict[str, Any]:
    """What the maps of the page are drawn from: every pair of axes, every statistic."""
    cell_of = [each.cell_of(rows[each.name]) for each in axes]
    shown = {
        f"{statistic}: {title(name)}": (name, statistic)
        for name in figures
        for statistic in STATISTICS
    }
    pairs: dict[str, Any] = {}
    columns = {name: rows[name] for name in figures}
    for i in range(len(axes)):
        for j in range(i + 1, len(axes)):
            cell = cell_of[i] * axes[j].cells + cell_of[j]
            cells = axes[i].cells * axes[j].cells
            for scheme in rows.plan.schemes:
                part = rows.of(scheme)
                key = f"{i},{j},{scheme_title(scheme)}"
                share = share_by_cell(cell[part], cells, rows.survived[part])
                pairs[f"{key},share that survived"] = _rounded(share)
                for label, (name, statistic) in shown.items():
                    values = by_cell(cell[part], cells, columns[name][part], statistic)
                    pairs[f"{key},{label}"] = _rounded(values)
    return {
        "axes": [
            {"name": a.name, "edges": _rounded(a.edges), "labels": a.labels, "log": a.log}
            for a in axes
        ],
        "schemes": [scheme_title(scheme) for scheme in rows.plan.schemes],
        "shown": ["share that survived", *shown],
        "cells": pairs,
    }


def _rounded(values: Any) -> list[float | None]:
    return [float(f"{v:.3g}") if np.isfinite(v) else None for v in values.tolist()]

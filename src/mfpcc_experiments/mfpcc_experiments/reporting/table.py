"""
The table of a comparison: which figures, how they are printed, and which of them are best.

A column is of one recording, or of several that differ in the seed of the noise alone: then of
their mean and standard deviation. Only such columns can be said to differ beyond chance.

Terminal, report and `mfpcc reproduce` show the same lines, made here from the entries of
`metrics.METRICS`.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mfpcc_experiments import notes
from mfpcc_experiments.measuring import METRICS, Metric, labels

#: In the place of a figure that there is not.
NONE = "–"

#: What stands with the first prediction error.
EXPLAINED = "measured minus predicted current"


@dataclass(frozen=True)
class Line:
    """
    One line of a table.

    Attributes
    ----------
    metric : Metric
        Whose figures these are.
    cells : list of str
        The figure of each column.
    best : list of bool
        Whether it is among the best, beyond chance.
    explained : str
        What has to be said of it here, where it comes first.
    """

    metric: Metric
    cells: list[str]
    best: list[bool]
    explained: str = ""

    @property
    def title(self) -> str:
        """What stands before the figures."""
        return self.metric.title

    @property
    def unit(self) -> str:
        """Unit of the printed figures."""
        return self.metric.shown_unit or self.metric.unit


def columns(rows: Sequence[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """
    Rows that make up one column: those with the same `setup`, in the order of the first of them.

    Parameters
    ----------
    rows : sequence of dict
        Objects of ``metrics.json``. One without `setup` is a column of its own.
    """
    found: dict[Any, list[dict[str, Any]]] = {}
    for n, row in enumerate(rows):
        found.setdefault(row.get("setup", f"row {n}"), []).append(row)
    return list(found.values())


def titles(rows: Sequence[dict[str, Any]]) -> list[str]:
    """What stands above the columns."""
    groups = columns(rows)
    firsts = [group[0] if len(group) == 1 else {**group[0], "seed": None} for group in groups]
    names = labels(firsts, [Path(str(n)) for n in range(1, len(groups) + 1)])
    return [
        name if len(group) == 1 else f"{name} ({len(group)} seeds)"
        for name, group in zip(names, groups, strict=True)
    ]


def lines(rows: Sequence[dict[str, Any]]) -> list[Line]:
    """
    Make the lines of a table; a figure that no recording has is left out.

    Parameters
    ----------
    rows : sequence of dict
        Objects of ``metrics.json``.
    """
    groups = columns(rows)
    found: list[Line] = []
    for metric in METRICS:
        if not metric.in_table:
            continue
        values = [[value(row, metric.path) for row in group] for group in groups]
        if all(v is None for each in values for v in each):
            continue
        marks = best(values) if metric.less_is_better else [False] * len(groups)
        prediction = metric.key.startswith("lut_error")
        first = prediction and not any(line.explained for line in found)
        cells = _cells(values, metric.factor)
        found.append(Line(metric, cells, marks, EXPLAINED if first else ""))
    return found


def _cells(values: Sequence[Sequence[float | None]], factor: float) -> list[str]:
    """The figure of each column: one value, or mean and standard deviation."""
    means: list[float | None] = []
    for each in values:
        known = [v for v in each if v is not None]
        if len(known) < len(each):
            means.append(None)
        else:  # a count that is the same in all stays one
            means.append(known[0] if min(known) == max(known) else statistics.fmean(known))
    cells = texts(means, factor)
    for n, each in enumerate(values):
        known = [v for v in each if v is not None]
        if means[n] is None and known:
            cells[n] = f"{len(known)} of {len(each)} seeds"
        elif len(known) > 1 and not isinstance(means[n], int):
            decimals = len(cells[n].partition(".")[2])
            cells[n] += f" ± {factor * statistics.stdev(known):.{decimals}f}"
    return cells


#: Probability that a figure of columns that differ by nothing but chance gets a mark.
LEVEL = 0.01


def can_be_told(rows: Sequence[dict[str, Any]]) -> bool:
    """Whether at least two columns have several seeds, so that a mark is possible at all."""
    return sum(len(group) > 1 for group in columns(rows)) > 1


def legend(rows: Sequence[dict[str, Any]]) -> str:
    """What the marks of a table stand for, or why there are none; nothing of a single column."""
    if len(columns(rows)) < 2:
        return ""
    if can_be_told(rows):
        return (
            f"bold: best beyond chance, judged from the seeds (error below {100 * LEVEL:.0f} % for "
            "each figure); ±: standard deviation over the seeds"
        )
    return (
        "no best is marked: only several seeds of each can tell a difference from chance "
        "(mfpcc run --seeds 5)"
    )


def best(values: Sequence[Sequence[float | None]]) -> list[bool]:
    """
    Which columns are best in a figure of which less is better, beyond chance.

    How much of a difference is chance only the seeds of the noise can tell: figures of parts of
    one run scatter less than those of two runs, since a limit cycle that a run has fallen into
    stays. Columns are compared by Welch's test, each with that of the lowest mean. The lowest is
    marked if at least one other is worse, with a probability of error of `LEVEL` for the whole
    figure (Bonferroni over all pairs, since which is the lowest is not known before), and with it
    those of which that cannot be said. A single recording has no scatter: it is neither marked nor
    compared, and nor is a column of which a recording lacks the figure.

    Parameters
    ----------
    values : sequence of sequence of float or None
        The figure in the recordings of each column.

    Returns
    -------
    list of bool
        One per column.
    """
    samples = {
        n: [float(v) for v in each if v is not None]
        for n, each in enumerate(values)
        if len(each) > 1 and None not in each
    }
    marks = [False] * len(values)
    if len(samples) < 2:
        return marks
    from scipy.stats import ttest_ind  # a second of import, for several seeds of several columns

    lowest = min(samples, key=lambda n: statistics.fmean(samples[n]))
    level = LEVEL / math.comb(len(samples), 2)
    among = set()
    for n, sample in samples.items():
        if n == lowest:
            worse = False
        elif min(sample) == max(sample) and min(samples[lowest]) == max(samples[lowest]):
            worse = sample[0] > samples[lowest][0]  # the noise does not matter, as to a count
        else:
            worse = bool(ttest_ind(sample, samples[lowest], equal_var=False).pvalue < level)
        if not worse:
            among.add(n)
    if len(among) < len(samples):
        for n in among:
            marks[n] = True
    return marks


def value(row: dict[str, Any], key: Sequence[str]) -> Any:
    """
    Find a figure in a row of ``metrics.json``.

    Parameters
    ----------
    row : dict
        One row.
    key : sequence of str
        Keys from the outside in.
    """
    found: Any = row
    for part in key:
        found = None if found is None else found.get(part)
    return found


# Above the first a figure has at most three decimals; below it, as many as it needs: the currents
# of a small motor are milliamperes. Below the second it is nothing.
_SMALL, _NOTHING = 0.01, 5e-4


def texts(values: Sequence[float | None], factor: float = 1.0) -> list[str]:
    """
    Print one figure of several recordings, with three significant digits.

    Parameters
    ----------
    values : sequence of float or None
        The figures. The largest decides how small a figure may be to count as nothing, for all.
    factor : float
        What to multiply them with; whole numbers are printed as they are.
    """
    numbers = [v if v is None or isinstance(v, int) else v * factor for v in values]
    largest = max((abs(n) for n in numbers if n is not None), default=0.0)
    small = _NOTHING <= largest < _SMALL
    most = 2 - math.floor(math.log10(largest)) if small else 3
    return [_text(number, most) for number in numbers]


def _text(number: float | None, most: int) -> str:
    if number is None:
        return NONE
    if isinstance(number, int):
        return str(number)
    if abs(number) >= 100:
        return f"{number:.1f}"
    if abs(number) < _SMALL:
        shown = f"{number:.{most}f}"
        return shown.lstrip("-") if float(shown) == 0.0 else shown
    return f"{number:.{min(most, 2 - math.floor(math.log10(abs(number))))}f}"


def print_table(rows: Sequence[dict[str, Any]]) -> None:
    """
    Print metrics to the terminal, one column per recording.

    Parameters
    ----------
    rows : sequence of dict
        Objects of ``metrics.json``. What does not fit side by side comes below one another.
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    names, shown = titles(rows), lines(rows)
    widths = [
        max(len(name), *(len(line.cells[n]) for line in shown)) for n, name in enumerate(names)
    ]
    console = Console(highlight=False)
    for n, block in enumerate(_side_by_side(widths, console.width)):
        table = Table(box=None, pad_edge=False, header_style="bold")
        table.add_column("")
        for name in names[block]:
            table.add_column(escape(name), justify="right", overflow="fold")
        table.add_column("", style="dim")
        for line in shown:
            cells = [
                f"[bold]{cell}[/bold]" if mark else cell
                for cell, mark in zip(line.cells, line.best, strict=True)
            ]
            table.add_row(line.title, *cells[block], line.unit)
        if n:
            console.print()
        console.print(table)
    for line in shown:
        if line.explained:
            console.print(f"{line.title.split()[0]} error: {line.explained}", style="dim")
    if legend(rows):
        console.print(legend(rows), style="dim")
    every = labels(rows, [Path(str(n)) for n in range(1, len(rows) + 1)])
    for text in notes.lines(rows, every):
        console.print(escape(text), soft_wrap=True)


def _side_by_side(widths: Sequence[int], width: int) -> list[slice]:
    """Columns that fit into so many characters beside titles and units, block by block."""
    shown = [metric for metric in METRICS if metric.in_table]
    titles = max(len(metric.title) for metric in shown)
    left = width - titles - 2 - max(len(metric.shown_unit or metric.unit) for metric in shown)
    blocks, start, used = [], 0, 0
    for n, needed in enumerate(widths):
        needed += 2  # keeps the columns apart
        if n > start and used + needed > left:
            blocks.append(slice(start, n))
            start, used = n, 0
        used += needed
    return [*blocks, slice(start, len(widths))]

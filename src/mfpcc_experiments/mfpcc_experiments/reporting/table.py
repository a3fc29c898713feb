"""
The table of a comparison: which figures, how they are printed, and which of them are best.

Terminal, report and `mfpcc reproduce` show the same lines, made here from the entries of
`metrics.METRICS`.
"""

from __future__ import annotations

import math
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
        The figure of each recording.
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


def lines(rows: Sequence[dict[str, Any]]) -> list[Line]:
    """
    Make the lines of a table; a figure that no recording has is left out.

    Parameters
    ----------
    rows : sequence of dict
        Objects of ``metrics.json``.
    """
    found: list[Line] = []
    for metric in METRICS:
        if not metric.in_table:
            continue
        cells = texts([value(row, metric.path) for row in rows], metric.factor)
        if all(cell == NONE for cell in cells):
            continue
        marks = best(rows, metric.path) if metric.less_is_better else [False] * len(rows)
        prediction = metric.key.startswith("lut_error")
        first = prediction and not any(line.explained for line in found)
        found.append(Line(metric, cells, marks, EXPLAINED if first else ""))
    return found


def best(rows: Sequence[dict[str, Any]], key: Sequence[str]) -> list[bool]:
    """
    Which recordings are best in a figure of which less is better, beyond chance.

    The parts of the windows (`metrics.scatter`) are compared by Welch's test: a recording is among
    the best unless it is worse than the lowest with a probability of error below 1 %. Where that
    leaves all of them, none is marked.

    Parameters
    ----------
    rows : sequence of dict
        Objects of ``metrics.json``.
    key : sequence of str
        Keys of the figure from the outside in.

    Returns
    -------
    list of bool
        One per row.
    """
    from scipy.stats import ttest_ind_from_stats

    name = ".".join(key)
    known = []
    for row in rows:
        spread = row["scatter"]
        mean, std = spread["mean"].get(name), spread["std"].get(name)
        known.append(None if mean is None else (mean, std, spread["parts"]))
    if sum(entry is not None for entry in known) < 2:
        return [False] * len(rows)
    lowest = min(entry for entry in known if entry is not None)
    among = []
    for entry in known:
        if entry is None:
            among.append(False)
        elif entry[0] == lowest[0]:
            among.append(True)
        elif entry[1] == 0.0 and lowest[1] == 0.0:
            among.append(False)
        else:
            test = ttest_ind_from_stats(*entry, *lowest, equal_var=False, alternative="greater")
            among.append(bool(test.pvalue >= 0.01))
    return [False] * len(rows) if all(among) else among


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

    names = labels(rows, [Path(str(n)) for n in range(1, len(rows) + 1)])
    shown = lines(rows)
    console = Console(highlight=False)
    for n, block in enumerate(_side_by_side(names, console.width)):
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
    for text in notes.lines(rows, names):
        console.print(escape(text), soft_wrap=True)


def _side_by_side(names: Sequence[str], width: int) -> list[slice]:
    """Columns that fit into so many characters beside titles and units, block by block."""
    shown = [metric for metric in METRICS if metric.in_table]
    titles = max(len(metric.title) for metric in shown)
    left = width - titles - 2 - max(len(metric.shown_unit or metric.unit) for metric in shown)
    blocks, start, used = [], 0, 0
    for n, name in enumerate(names):
        # a figure has up to nine characters; two keep the columns apart
        needed = max(9, len(name)) + 2
        if n > start and used + needed > left:
            blocks.append(slice(start, n))
            start, used = n, 0
        used += needed
    return [*blocks, slice(start, len(names))]

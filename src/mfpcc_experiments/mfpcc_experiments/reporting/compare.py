"""From recordings to a comparison: metrics, figures and a report in one folder."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mfpcc_experiments import notes
from mfpcc_experiments.bags import BagError, recording
from mfpcc_experiments.measuring import metrics
from mfpcc_experiments.measuring.measured import Measured, labels, signals
from pwm_node import interrupts

Progress = Callable[[float], None]

# Shares of the time that a comparison takes: reading, figures, report.
_READING, _DRAWING = 0.6, 0.9


def compare(
    paths: Sequence[Path],
    out: Path,
    *,
    window_s: Sequence[float] | None = None,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """
    Measure recordings and compare them.

    Parameters
    ----------
    paths : sequence of Path
        Bags, in the order in which they shall appear.
    out : Path
        Folder for ``metrics.json``, ``figures/`` and ``report.html``; made if it is missing.
    window_s : sequence of two floats, optional
        Evaluation window of all (s); default: the one stored in each recording, else all of it.
    progress : callable, optional
        Told the share that is done, 0 to 1.

    Returns
    -------
    list of dict
        The objects of ``metrics.json``, one per recording.

    Raises
    ------
    BagError, MetricsError
        If a recording cannot be read or measured. Nothing is written then.
    """
    # matplotlib takes its time to load
    from mfpcc_experiments.reporting import figures, report

    if not paths:
        raise BagError("no recordings to compare")

    def tell(share: float) -> None:
        if progress is not None:
            progress(share)

    runs = measure(paths, lambda share: tell(_READING * share), window_s)
    rows = [run.row for run in runs]
    out = Path(out)
    (out / "figures").mkdir(parents=True, exist_ok=True)
    drawn = figures.draw(runs, out / "figures")
    tell(_DRAWING)
    write_whole(out / "report.html", report.render(runs, drawn))
    write_whole(out / "metrics.json", json.dumps(rows, indent=2, ensure_ascii=False) + "\n")
    tell(1.0)
    return rows


def measure(
    paths: Sequence[Path],
    progress: Progress | None = None,
    window_s: Sequence[float] | None = None,
) -> list[Measured]:
    """
    Read and measure recordings one after the other, so that only one is in memory at a time.

    Parameters
    ----------
    paths : sequence of Path
        Bags.
    progress : callable, optional
        Told the share that is done, 0 to 1.
    window_s : sequence of two floats, optional
        See `compare`.

    Returns
    -------
    list of Measured
        With labels that tell them apart.
    """
    parts = []
    for n, path in enumerate(paths):

        def tell(share: float, n: int = n) -> None:
            if progress is not None:
                progress((n + share) / len(paths))

        parts.append(_measure_one(Path(path), tell, window_s))
    names = labels([part["row"] for part in parts], [Path(path) for path in paths])
    return [
        Measured(path=Path(path), label=name, **part)
        for path, name, part in zip(paths, names, parts, strict=True)
    ]


def _measure_one(
    path: Path, progress: Progress, window_s: Sequence[float] | None
) -> dict[str, Any]:
    found = recording.read(path, progress=progress)
    return {
        "row": metrics.evaluate(found, window_s),
        "window": metrics.cut(found, window_s),
        "signals": signals(found),
        "config": found.config,
    }


def write_whole(path: Path, text: str) -> None:
    """
    Write a file that is there whole or not at all.

    Parameters
    ----------
    path : Path
        File; replaced if it is there.
    text : str
        Content.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    with interrupts.finished():
        try:
            temporary.write_text(text, encoding="utf-8")
            os.replace(temporary, path)
        except OSError:
            temporary.unlink(missing_ok=True)
            raise


# --- Differences -------------------------------------------------------------------------------


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


# --- The table ---------------------------------------------------------------------------------

#: What the tables show: text, unit, how to find it in a row, and whether less is better.
COLUMNS: tuple[tuple[str, str, tuple[str, ...], bool], ...] = (
    ("THD, oversampled", "%", ("thd_percent", "oversampled"), True),
    ("THD, control samples", "%", ("thd_percent", "control"), True),
    ("Ripple d, peak to peak", "A", ("ripple_pp", "d"), True),
    ("Ripple q, peak to peak", "A", ("ripple_pp", "q"), True),
    ("Ripple d, rms", "A", ("ripple_rms", "d"), True),
    ("Ripple q, rms", "A", ("ripple_rms", "q"), True),
    ("Deviation d, rms", "A", ("deviation_rms", "d"), True),
    ("Deviation q, rms", "A", ("deviation_rms", "q"), True),
    ("LUT error d, max", "A", ("lut_error_max", "d"), True),
    ("LUT error q, max", "A", ("lut_error_max", "q"), True),
    ("LUT error d, rms", "A", ("lut_error_rms", "d"), True),
    ("LUT error q, rms", "A", ("lut_error_rms", "q"), True),
    ("Mean i_d", "A", ("i_d_mean",), False),
    ("Mean error of i_q", "A", ("i_q_error_mean",), False),
    ("Mean speed", "r/min", ("speed_rpm_mean",), False),
    ("Torque ripple, rms", "N m", ("torque_ripple_rms",), True),
    ("Copper loss", "W", ("copper_loss_w",), True),
    ("Switching frequency", "kHz", ("switching_frequency_hz",), False),
    ("Step time, median", "us", ("step_time_us", "median"), True),
    ("Step time, 99 %", "us", ("step_time_us", "p99"), True),
    ("Lost periods", "", ("lost_periods",), True),
)


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


def text(row: dict[str, Any], key: Sequence[str], unit: str = "") -> str:
    """
    Print a figure of a row with three significant digits.

    Parameters
    ----------
    row : dict
        One row.
    key : sequence of str
        See `value`.
    unit : str
        ``kHz`` shows a figure in Hz divided by 1000.
    """
    number = value(row, key)
    if number is None:
        return "–"
    if isinstance(number, int):
        return str(number)
    if unit == "kHz":
        number *= 1e-3
    if abs(number) < _NOTHING:
        return "0.000"
    digits = max(0, 2 - math.floor(math.log10(abs(number))))
    if abs(number) >= _SMALL:
        digits = min(digits, 3)
    return f"{number:.{digits if abs(number) < 100 else 1}f}"


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
    lines = []
    for title, unit, key, less_is_better in COLUMNS:
        cells = [text(row, key, unit) for row in rows]
        marks = best(rows, key) if less_is_better else [False] * len(rows)
        cells = [f"[bold]{c}[/bold]" if m else c for c, m in zip(cells, marks, strict=True)]
        if any(cell != "–" for cell in cells):
            lines.append((title, unit, cells))

    console = Console(highlight=False)
    for n, block in enumerate(_side_by_side(names, console.width)):
        table = Table(box=None, pad_edge=False, header_style="bold")
        table.add_column("")
        for name in names[block]:
            table.add_column(escape(name), justify="right", overflow="fold")
        table.add_column("", style="dim")
        for title, unit, cells in lines:
            table.add_row(title, *cells[block], unit)
        if n:
            console.print()
        console.print(table)
    if any(title.startswith("LUT error") for title, *_ in lines):
        console.print("LUT error: measured minus predicted current", style="dim")
    for line in notes.lines(rows, names):
        console.print(escape(line), soft_wrap=True)


def _side_by_side(names: Sequence[str], width: int) -> list[slice]:
    """Columns that fit into so many characters beside titles and units, block by block."""
    left = width - max(len(title) for title, *_ in COLUMNS) - 2 - max(len(c[1]) for c in COLUMNS)
    blocks, start, used = [], 0, 0
    for n, name in enumerate(names):
        # a figure has up to nine characters; two keep the columns apart
        needed = max(9, len(name)) + 2
        if n > start and used + needed > left:
            blocks.append(slice(start, n))
            start, used = n, 0
        used += needed
    return [*blocks, slice(start, len(names))]

"""What is measured, what it is held against, and how the two are measured side by side."""

from __future__ import annotations

import json
import operator
import os
import platform
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

_COMPARISONS: dict[str, Callable[[float, float], bool]] = {"<=": operator.le, ">=": operator.ge}


@dataclass(frozen=True)
class Figure:
    """One row of the table.

    Attributes
    ----------
    figure : str
        What was measured.
    value : float
        The median.
    unit : str
    reference : str
        What it is held against.
    reference_value : float, optional
        The median of that, in the same unit.
    ratio : float, optional
        Value over reference: the median over the rounds, each of which measures both.
    bar : str
        What is asked for, such as ``ratio <= 1.6``; empty where the figure is only reported.
    met : bool, optional
        Whether it is reached.
    """

    figure: str
    value: float
    unit: str
    reference: str = ""
    reference_value: float | None = None
    ratio: float | None = None
    bar: str = ""
    met: bool | None = None


def figure(
    name: str,
    values: Sequence[float] | float,
    unit: str,
    reference: str = "",
    references: Sequence[float] | float | None = None,
    *,
    bar: str = "",
) -> Figure:
    """Make a row from the values of all rounds.

    Parameters
    ----------
    name : str
    values : float, or one per round
    unit : str
    reference : str
        Name of what it is held against.
    references : float, or one per round, optional
    bar : str
        ``ratio >= 0.85`` or ``value <= 5``, for instance.
    """
    measured = _listed(values)
    value = statistics.median(measured)
    reference_value = ratio = met = None
    if references is not None:
        others = _listed(references) * (1 if isinstance(references, Sequence) else len(measured))
        reference_value = statistics.median(others)
        ratio = statistics.median(a / b for a, b in zip(measured, others, strict=True))
    if bar:
        what, comparison, limit = bar.split()
        found = {"ratio": ratio, "value": value}[what]
        assert found is not None
        met = _COMPARISONS[comparison](found, float(limit))
    return Figure(name, value, unit, reference, reference_value, ratio, bar, met)


def _listed(values: Sequence[float] | float) -> list[float]:
    return list(values) if isinstance(values, Sequence) else [values]


def interleaved(rounds: int, **measures: Callable[[], float]) -> dict[str, list[float]]:
    """Call every measure once per round, A B A B ..., so that a busy spell meets all of them."""
    found: dict[str, list[float]] = {name: [] for name in measures}
    for _ in range(rounds):
        for name, measure in measures.items():
            found[name].append(measure())
    return found


def write(path: Path, figures: Sequence[Figure]) -> None:
    """Write the results; the file appears whole or not at all."""
    temporary = path.with_name(f".{path.name}.new")
    temporary.write_text(json.dumps([asdict(each) for each in figures], indent=1) + "\n")
    os.replace(temporary, path)


def machine() -> Mapping[str, Any]:
    """What the figures were measured on, in a few words."""
    model = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    except OSError:
        pass  # not Linux
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
    }

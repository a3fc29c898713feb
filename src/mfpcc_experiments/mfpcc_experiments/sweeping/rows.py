"""The rows of a sweep as arrays, and what of many rows can be told at once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.sweeping.folder import Folder
from mfpcc_experiments.sweeping.space import Space

Array = NDArray[np.float64]

# Cells of a map along one axis, at least and at most, and rows of a scheme in each of the map.
_FEWEST_CELLS, _MOST_CELLS = 6, 24
_ROWS_PER_CELL = 12

# Standard normal quantile of a two-sided 95 % interval.
_Z = 1.959963984540054


class Rows:
    """
    All rows of a finished sweep; columns are read when they are asked for.

    Parameters
    ----------
    folder : Folder
        Whose chunks are all there.
    """

    def __init__(self, folder: Folder) -> None:
        self.folder, self.plan = folder, folder.plan
        self._files = [folder.file(n) for n in range(self.plan.chunks)]

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column; numbers that are not there are NaN."""
        from pyarrow import dataset

        column = dataset.dataset(self._files).to_table(columns=[f"{name}"])[name]
        return np.asarray(column.to_numpy(zero_copy_only=False))

    @cached_property
    def names(self) -> list[str]:
        """The columns."""
        from pyarrow import parquet

        return list(parquet.read_schema(self._files[0]).names)

    @cached_property
    def survived(self) -> NDArray[np.bool_]:
        """Whether each row did."""
        return self["survived"].astype(np.bool_)

    def of(self, scheme: str) -> slice:
        """The rows of a scheme."""
        first = self.plan.schemes.index(scheme) * self.plan.rows_per_scheme
        return slice(first, first + self.plan.rows_per_scheme)


def cells_for(rows: int) -> int:
    """Cells along an axis of a map of so many rows: coarse enough that each holds some."""
    return min(max(math.isqrt(rows // _ROWS_PER_CELL), _FEWEST_CELLS), _MOST_CELLS)


@dataclass(frozen=True)
class Axis:
    """
    An axis of a map.

    Attributes
    ----------
    name : str
        What varies.
    edges : ndarray, shape (cells + 1,)
        Of the cells.
    labels : tuple of str
        One for each cell, where it is one value of a grid.
    log : bool
        Whether cells are equally wide in the logarithm.
    """

    name: str
    edges: Array
    labels: tuple[str, ...]
    log: bool

    @property
    def cells(self) -> int:
        """How many."""
        return len(self.edges) - 1

    def cell_of(self, values: Array) -> NDArray[np.int64]:
        """The cell that each value is in."""
        cell = np.searchsorted(self.edges, values, side="right") - 1
        return np.clip(cell, 0, self.cells - 1).astype(np.int64)


def axis(name: str, space: Space, values: Array, cells: int) -> Axis | None:
    """
    An axis for something that varies.

    Parameters
    ----------
    name : str
        Its name.
    space : Space
        Where its values come from.
    values : ndarray
        Its values.
    cells : int
        How many there shall be, where it is no grid.

    Returns
    -------
    Axis or None
        None where it is no number, or does not vary.
    """
    if values.dtype.kind not in "if" or values.size == 0 or values.min() == values.max():
        return None
    low, high = float(values.min()), float(values.max())
    if space.kind in ("grid", "choice") and len(space.values) <= _MOST_CELLS and not space.sign_of:
        points = np.unique(values).astype(np.float64)
        middle = 0.5 * (points[1:] + points[:-1])
        edges = np.concatenate([[low - 1e-9 * abs(low) - 1e-12], middle, [high]])
        return Axis(name, edges, tuple(f"{point:g}" for point in points), log=False)
    log = space.kind == "log_uniform" and low > 0.0
    edges = np.geomspace(low, high, cells + 1) if log else np.linspace(low, high, cells + 1)
    return Axis(name, edges, (), log=log)


#: What a map tells of the rows in a cell.
STATISTICS = ("median", "worst")


def by_cell(cell: NDArray[np.int64], cells: int, values: Array, statistic: str) -> Array:
    """
    Median, or largest size, of the values in each cell; NaN where there are none.

    Parameters
    ----------
    cell : ndarray, shape (n,)
        In which cell each row is.
    cells : int
        How many cells there are.
    values : ndarray, shape (n,)
        May be NaN: those do not count.
    statistic : str
        Of `STATISTICS`.
    """
    there = np.isfinite(values)
    cell, values = cell[there], np.abs(values[there])
    found = np.full(cells, np.nan)
    if statistic == "worst":
        np.fmax.at(found, cell, values)
        return found
    order = np.lexsort((values, cell))
    cell, values = cell[order], values[order]
    starts = np.searchsorted(cell, np.arange(cells))
    counts = np.searchsorted(cell, np.arange(cells), side="right") - starts
    filled = np.flatnonzero(counts)
    low = starts[filled] + (counts[filled] - 1) // 2
    high = starts[filled] + counts[filled] // 2
    found[filled] = 0.5 * (values[low] + values[high])
    return found


def share_by_cell(cell: NDArray[np.int64], cells: int, good: NDArray[np.bool_]) -> Array:
    """Share of the rows in each cell that are good; NaN where there are none."""
    count = np.bincount(cell, minlength=cells)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.bincount(cell, good, minlength=cells) / count)


def interval(good: int, n: int) -> tuple[float, float]:
    """
    Interval that a share lies in with 95 %.

    Wilson 1927, doi:10.1080/01621459.1927.10502953.
    """
    p, z = good / n, _Z
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, centre - half), min(1.0, centre + half)


def worst(rows: Rows, count: int) -> list[int]:
    """
    Numbers of the worst rows: those that did not survive before those that did.

    Among either, the largest current over its limit is the worst; one beyond what can be simulated
    is worse than any.
    """
    peak = np.where(rows["ran_away"].astype(np.bool_), np.inf, rows["i_peak_over_limit"])
    order = np.lexsort((np.arange(len(peak)), -peak, rows.survived))
    return [int(row) for row in order[:count]]


def front(x: Array, y: Array) -> NDArray[np.bool_]:
    """Which points no other one beats in both of two figures, of which less is better."""
    better = (x[None, :] <= x[:, None]) & (y[None, :] <= y[:, None])
    better &= (x[None, :] < x[:, None]) | (y[None, :] < y[:, None])
    found: NDArray[np.bool_] = ~better.any(axis=1)
    return found & np.isfinite(x) & np.isfinite(y)

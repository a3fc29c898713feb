"""A piece of a table, whatever file it is of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.importing.errors import ImportFailedError
from pwm_node.names import nearest, shown

#: Rows that are read at once: bounded memory, whatever the size of the file.
ROWS_AT_ONCE = 10_000

#: Columns that are wanted: by name, or by place from 1.
Wanted = Sequence[str | int]


@dataclass(frozen=True)
class Block:
    """
    Consecutive rows of a table.

    Attributes
    ----------
    line : ndarray of int64, shape (n,)
        Line of the file, or number of the row from 1 where it has no lines.
    values : dict of ndarray, shape (n,)
        By column; NaN where a cell is empty.
    done : float
        Share of the file that has been read, 0 to 1.
    """

    line: NDArray[np.int64]
    values: Mapping[str | int, NDArray[np.float64]]
    done: float


def missing_column(path: Path, name: str | int, there: Sequence[str]) -> ImportFailedError:
    """The error of a column that is not there, with the nearest that is."""
    listed = ", ".join(shown(column) for column in there[:20])
    more = f" and {len(there) - 20} more" if len(there) > 20 else ""
    if isinstance(name, int):
        return ImportFailedError(f"{path}: there is no column {name}; there are {len(there)}")
    best = nearest(name, there)
    meant = f"; is it '{best}'?" if best else ""
    return ImportFailedError(
        f"{path}: there is no column '{name}'{meant} There are: {listed or 'none'}{more}".replace(
            "' There", "'. There"
        )
    )

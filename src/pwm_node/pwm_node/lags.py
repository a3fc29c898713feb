"""How late things were, of every period: a histogram of fixed size, and what it tells.

Its bins have the same width relative to their value, at most 1/32, from 1 ns to hours, so that a
percentile is right within some 3 per cent whatever came, and the longest one is exact.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

_BITS = 5  # of a value that its bin keeps, below the first
_BINS = (48 - _BITS + 1) << _BITS  # up to 2^48 ns, 78 hours
_LONGEST = (1 << 48) - 1

#: What is told of a histogram, in percent.
PERCENTILES = (50.0, 99.0, 99.9)


class Lags:
    """A histogram of durations.

    Attributes
    ----------
    count : int
        How many there were.
    longest : int
        The longest one (ns), 0 before the first.
    """

    def __init__(self) -> None:
        self._bins = array("q", bytes(8 * _BINS))
        self.count = 0
        self.longest = 0

    def add(self, nanoseconds: int) -> None:
        """Count one duration (ns); a negative one counts as none."""
        if nanoseconds > self.longest:
            self.longest = nanoseconds
        n = nanoseconds if 0 < nanoseconds < _LONGEST else 0 if nanoseconds <= 0 else _LONGEST
        shift = n.bit_length() - _BITS - 1
        if shift < 0:
            shift = 0
        self._bins[(n >> shift) + (shift << _BITS)] += 1
        self.count += 1

    def percentiles(self, which: Iterable[float] = PERCENTILES) -> list[float]:
        """Return percentiles (us), each the upper edge of its bin; NaN if there is nothing."""
        if not self.count:
            return [float("nan") for _ in which]
        found = percentiles(np.array(self.bins(), np.int64), which)
        return [min(value, self.longest * 1e-3) for value in found]

    def bins(self) -> list[tuple[int, int]]:
        """Return the first value (ns) and the count of each bin that is not empty."""
        counts = np.frombuffer(self._bins, np.int64)
        return [(_first(int(i)), int(counts[i])) for i in np.flatnonzero(counts)]

    def to_json(self) -> dict[str, object]:
        """What is stored with a recording; `bins_of` reads the bins."""
        p50, p99, p999 = self.percentiles()
        return {
            "periods": self.count,
            "p50_us": p50,
            "p99_us": p99,
            "p99_9_us": p999,
            "max_us": self.longest * 1e-3,
            "bins_ns": [list(each) for each in self.bins()],
        }

    def to_text(self) -> str:
        """The bins in one line: first value (ns) and count of each."""
        return " ".join(f"{first}:{count}" for first, count in self.bins())


def from_text(text: str) -> dict[str, object]:
    """Return what `Lags.to_text` told, as it is stored with a recording."""
    bins = [[int(number) for number in each.split(":")] for each in text.split()]
    rows = bins_of({"bins_ns": bins})
    if rows is None:
        return {"periods": 0, "bins_ns": []}
    p50, p99, p999 = percentiles(rows)
    return {
        "periods": int(rows[:, 1].sum()),
        "p50_us": p50,
        "p99_us": p99,
        "p99_9_us": p999,
        "bins_ns": bins,
    }


def bins_of(stored: object) -> NDArray[np.int64] | None:
    """Return the stored bins as rows of first value (ns) and count; None if they are none."""
    if not isinstance(stored, Mapping):
        return None
    bins = stored.get("bins_ns")
    try:
        rows = np.array(bins, np.int64)
    except (TypeError, ValueError, OverflowError):
        return None
    if rows.ndim != 2 or rows.shape[1:] != (2,) or not rows.size:
        return None
    good = (rows[:, 0] >= 0) & (rows[:, 0] <= _LONGEST) & (rows[:, 1] > 0) & (rows[:, 1] < 1 << 40)
    if not good.all() or (np.diff(rows[:, 0]) <= 0).any():
        return None
    return rows


def percentiles(bins: NDArray[np.int64], which: Iterable[float] = PERCENTILES) -> list[float]:
    """Return percentiles (us) of bins as `bins_of` returns them, each the end of its bin."""
    passed = np.cumsum(bins[:, 1])
    ranks = [max(math.ceil(p * 1e-2 * int(passed[-1])), 1) for p in which]
    return [end_of(int(bins[np.searchsorted(passed, rank), 0])) * 1e-3 for rank in ranks]


def end_of(first: int) -> int:
    """Return the value at which the bin that begins with `first` ends (ns)."""
    return first + (1 << max(first.bit_length() - _BITS - 1, 0))


def _first(index: int) -> int:
    """The first value of a bin (ns)."""
    shift = max((index >> _BITS) - 1, 0)
    return (index - (shift << _BITS)) << shift

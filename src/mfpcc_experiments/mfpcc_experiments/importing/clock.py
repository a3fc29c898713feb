"""From the time column of a measured file to the numbers of PWM periods."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.importing.errors import ImportFailedError

# Of the sample time: what a single time may be off, as by rounding, and the mean of many.
_JITTER = 0.25
_DRIFT = 0.02
_MANY = 100
# The first steps say what the sample time is.
_FIRST = 20


def sample_time(time: NDArray[np.float64], line: NDArray[np.int64], path: Path, unit: str) -> float:
    """
    The time between two rows, from the first rows of a file.

    Parameters
    ----------
    time : ndarray, shape (n,)
        (s)
    line : ndarray of int64, shape (n,)
        Where they stand.
    path, unit
        The file, and what its rows are called.

    Returns
    -------
    float
        (s), with as few digits as the times agree with.

    Raises
    ------
    ImportFailedError
        If it cannot be told.
    """
    step = np.diff(time)
    if not len(step) or not np.isfinite(time).all():
        where = line[np.argmax(~np.isfinite(time))] if len(step) else line[0]
        raise ImportFailedError(f"{path}: {unit} {where}: the time is no number, or the only one")
    first = float(np.median(step[:_FIRST]))
    if first <= 0.0:
        raise ImportFailedError(
            f"{path}: {unit} {line[1]}: the time does not rise; are its digits too few? Give "
            "'sample_time' in the place of 'time'"
        )
    # As far as every row is one sample after the row before it.
    irregular = np.abs(step - first) > _JITTER * first
    for begin in range(0, len(step), _MANY):
        part = step[begin : begin + _MANY]
        irregular[begin : begin + len(part)] |= abs(float(part.mean()) - first) > _DRIFT * first
    end = int(np.argmax(irregular)) if irregular.any() else len(step)
    if end == 0:
        return first
    span = float(time[end] - time[0])
    # Of all frequencies that the times allow, by how evenly they come, the roundest.
    uncertain = max(1e-9, float(np.std(step[:end]))) / span
    exact = end / span
    for digits in range(-5, 12):
        rounded = round(exact, digits)
        if rounded > 0.0 and abs(rounded / exact - 1.0) <= uncertain:
            return 1.0 / rounded
    return 1.0 / exact


class Clock:
    """
    Numbers the rows of a file, period by period; a gap is left out of the count, not closed.

    Parameters
    ----------
    T : float
        Time between two rows (s).
    path, unit
        The file, and what its rows are called, for errors.

    Attributes
    ----------
    missing : int
        Rows that are not there, so far.
    first_gap : int
        Where the first gap is; 0 if there is none.
    """

    def __init__(self, T: float, path: Path, unit: str) -> None:
        self.missing = self.first_gap = 0
        self._T, self._path, self._unit = T, path, unit
        self._last: tuple[float, int] | None = None

    def number(self, time: NDArray[np.float64], line: NDArray[np.int64]) -> NDArray[np.int64]:
        """
        Number the next rows, from 0.

        Parameters
        ----------
        time : ndarray, shape (n,)
            (s)
        line : ndarray of int64, shape (n,)
            Where they stand.

        Raises
        ------
        ImportFailedError
            If the time is no number, does not rise, or the sample time changes.
        """
        if not np.isfinite(time).all():
            raise self._wrong(line[np.argmin(np.isfinite(time))], "the time is no number")
        before, number = self._last or (float(time[0]) - self._T, -1)
        step = np.diff(time, prepend=before) / self._T
        if (step <= 0.0).any():
            raise self._wrong(line[np.argmax(step <= 0.0)], "the time does not rise")
        whole = np.rint(step)
        odd = np.abs(step - whole) > _JITTER
        odd |= whole < 1
        if odd.any():
            k = int(np.argmax(odd))
            raise self._changes(line[k], step[k])
        # Many small differences of one sign are another sample time.
        for begin in range(0, len(step), _MANY):
            part = slice(begin, begin + _MANY)
            mean = float(step[part].sum() / whole[part].sum())
            if len(step[part]) == _MANY and abs(mean - 1.0) > _DRIFT:
                raise self._changes(line[begin], mean)
        gaps = np.flatnonzero(whole > 1)
        if len(gaps):
            self.missing += int((whole[gaps] - 1).sum())
            self.first_gap = self.first_gap or int(line[gaps[0]])
        numbers: NDArray[np.int64] = number + np.cumsum(whole.astype(np.int64))
        self._last = float(time[-1]), int(numbers[-1])
        return numbers

    def _changes(self, line: int, step: float) -> ImportFailedError:
        us = 1e6 * self._T
        return self._wrong(line, f"the sample time changes from {us:.6g} us to {us * step:.6g} us")

    def _wrong(self, line: int, text: str) -> ImportFailedError:
        return ImportFailedError(f"{self._path}: {self._unit} {line}: {text}")

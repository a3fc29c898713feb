"""Rows of a measured file as the samples and commands of a drive."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.importing.block import Block
from mfpcc_experiments.importing.clock import Clock, sample_time
from mfpcc_experiments.importing.errors import ImportFailedError
from mfpcc_experiments.importing.mapping import Column, Map
from mfpcc_experiments.importing.tables import Table

_SQRT3 = math.sqrt(3.0)
_TWO_PI = 2.0 * math.pi
# What rounding may put a duty beyond its limits; it is cut off.
_ROUNDING = 1e-3


@dataclass
class Rows:
    """
    Consecutive samples, one row each; NaN where something is missing.

    Attributes
    ----------
    period : ndarray of int64, shape (n,)
    line : ndarray of int64, shape (n,)
        Where they stand in the file.
    i_abc : ndarray, shape (n, 3)
        (A)
    angle : ndarray, shape (n,)
        Mechanical angle (rad), in [0, 2 pi).
    u_dc : ndarray, shape (n,)
        (V)
    duty : ndarray, shape (n, 3)
    enable : ndarray of bool, shape (n,)
    vectors, dwell : ndarray, shape (n, 2), or None
    i_ref : ndarray, shape (n, 2), or None
        References of d and q (A).
    done : float
        Share of the file that has been read, 0 to 1.
    """

    period: NDArray[np.int64]
    line: NDArray[np.int64]
    i_abc: NDArray[np.float64]
    angle: NDArray[np.float64]
    u_dc: NDArray[np.float64]
    duty: NDArray[np.float64]
    enable: NDArray[np.bool_]
    vectors: NDArray[np.float64] | None
    dwell: NDArray[np.float64] | None
    i_ref: NDArray[np.float64] | None
    done: float

    @property
    def sampled(self) -> NDArray[np.bool_]:
        """Rows of which all that a sample holds is there."""
        there: NDArray[np.bool_] = np.isfinite(self.i_abc).all(axis=1)
        return there & np.isfinite(self.angle) & np.isfinite(self.u_dc)

    @property
    def commanded(self) -> NDArray[np.bool_]:
        """Rows in which a command stands."""
        there: NDArray[np.bool_] = np.isfinite(self.duty).all(axis=1)
        return there


@dataclass
class Seen:
    """What was met on the way through a file, to be told at the end."""

    rows: int = 0
    without_sample: int = 0
    first_without: int = 0
    clipped: int = 0
    sum_squared: float = 0.0  # of the three currents' sum (A^2)
    squared: float = 0.0  # of one of them
    notes: list[str] = field(default_factory=list)


class Samples:
    """
    The samples of a measured file.

    Parameters
    ----------
    table : Table
        The file.
    chart : Map
        What its columns are.
    n_p : int
        Pole pairs.
    path : Path
        The file, for errors.

    Attributes
    ----------
    T_s : float
        PWM period (s).
    """

    def __init__(self, table: Table, chart: Map, n_p: int, path: Path) -> None:
        self._table, self._map, self._n_p, self._path = table, chart, n_p, path
        self._columns = chart.columns()
        first = next(table.blocks(), None)
        if first is None or len(first.line) < 2:
            raise ImportFailedError(f"{path}: there are no rows, or a single one")
        if chart.sample_time is not None:
            self._T = chart.sample_time
        else:
            time = self._si(first, "time")
            self._T = sample_time(time, first.line, path, table.unit)
        self.T_s = self._T * chart.samples_per_period

    def rows(self, seen: Seen) -> Iterator[Rows]:
        """
        All samples, in pieces of bounded size.

        Parameters
        ----------
        seen : Seen
            Takes down what is odd.

        Raises
        ------
        ImportFailedError
            At the first row that makes no sense.
        """
        clock = Clock(self._T, self._path, self._table.unit)
        m = self._map.samples_per_period
        turn = 0.0
        counted = 0
        for block in self._table.blocks():
            if self._map.time is None:
                number = counted + np.arange(len(block.line))
                counted += len(block.line)
            else:
                number = clock.number(self._si(block, "time"), block.line)
            keep = number % m == 0
            angle, turn = self._angle(block, number, turn)
            duty = self._duty(block, angle, seen)
            rows = Rows(
                period=number[keep] // m,
                line=block.line[keep],
                i_abc=self._currents(block)[keep],
                angle=(angle / self._n_p % _TWO_PI)[keep]
                if self._map.angle is None
                else self._mechanical(block)[keep],
                u_dc=self._si(block, "dc_voltage")[keep],
                duty=duty[keep],
                enable=self._enable(block)[keep],
                vectors=self._pair(block, "vectors", keep),
                dwell=self._pair(block, "dwell", keep),
                i_ref=None
                if self._map.references is None
                else self._several(block, ("references.d", "references.q"))[keep],
                done=block.done,
            )
            self._look(rows, seen)
            yield rows
        if clock.missing:
            seen.notes.append(
                f"{clock.missing} rows are missing, the first before {self._table.unit} "
                f"{clock.first_gap}: these periods are lost"
            )

    # --- Quantities ------------------------------------------------------------------------------

    def _si(self, block: Block, name: str) -> NDArray[np.float64]:
        column: Column = self._columns[name]
        if column.column is None:
            assert column.constant is not None
            numbers = np.full(len(block.line), column.constant)
        else:
            numbers = block.values[column.column]
            numbers = np.where(np.isfinite(numbers), numbers, np.nan)
        # Left alone where there is nothing to do, so that no bit changes.
        if column.zero:
            numbers = numbers - column.zero
        return numbers if column.scale == 1.0 else column.scale * numbers

    def _several(self, block: Block, names: tuple[str, ...]) -> NDArray[np.float64]:
        return np.stack([self._si(block, name) for name in names], axis=1)

    def _pair(self, block: Block, name: str, keep: NDArray[np.bool_]) -> NDArray[np.float64] | None:
        if getattr(self._map, name) is None:
            return None
        return self._several(block, (f"{name}.first", f"{name}.second"))[keep]

    def _currents(self, block: Block) -> NDArray[np.float64]:
        given = {
            leg: self._si(block, f"currents.{leg}")
            for leg in "abc"
            if f"currents.{leg}" in self._columns
        }
        for leg in "abc":
            if leg not in given:
                given[leg] = -np.sum(list(given.values()), axis=0)
        return np.stack([given[leg] for leg in "abc"], axis=1)

    def _mechanical(self, block: Block) -> NDArray[np.float64]:
        angle = self._si(block, "angle")
        zero = self._map.encoder_zero
        if zero == 0.0 and ((angle >= 0.0) & (angle < _TWO_PI)).all():
            return angle
        return (angle - zero) % _TWO_PI

    def _angle(
        self, block: Block, number: NDArray[np.int64], turn: float
    ) -> tuple[NDArray[np.float64], float]:
        """Electrical angle (rad, any number of turns), and where the next block begins."""
        n_p, zero = self._n_p, self._map.encoder_zero
        if self._map.angle is not None:
            return n_p * self._mechanical(block), 0.0
        if self._map.electrical_angle is not None:
            angle = self._si(block, "electrical_angle") - zero
            # Turns are counted, since a mechanical turn has several of them.
            there = np.isfinite(angle)
            if there.any():
                followed = np.unwrap(np.concatenate([[turn], angle[there]]))[1:]
                angle[there] = followed
                turn = float(followed[-1])
            return angle, turn
        if self._map.speed is not None or self._map.electrical_speed is not None:
            w = (
                n_p * self._si(block, "speed")
                if self._map.speed is not None
                else self._si(block, "electrical_speed")
            )
            steps = np.diff(number, append=number[-1:] + 1) * self._T
            ends = turn + np.cumsum(np.nan_to_num(w) * steps)
            return np.concatenate([[turn], ends[:-1]]) - zero, float(ends[-1])
        return np.full(len(block.line), -zero), 0.0

    def _duty(self, block: Block, angle: NDArray[np.float64], seen: Seen) -> NDArray[np.float64]:
        if self._map.duties is not None:
            duty = self._several(block, ("duties.a", "duties.b", "duties.c"))
            if self._map.duties.full != 1.0:
                duty = duty / self._map.duties.full
        else:
            u = self._voltages(block, angle)
            # Half of the DC voltage in the middle of the largest and the smallest.
            middle = 0.5 * (u.max(axis=1) + u.min(axis=1))
            duty = 0.5 + (u - middle[:, None]) / self._si(block, "dc_voltage")[:, None]
            out = (np.abs(duty - 0.5) > 0.5 + _ROUNDING).any(axis=1)
            seen.clipped += int(out.sum())
            duty = np.clip(duty, 0.0, 1.0)
        with np.errstate(invalid="ignore"):
            wrong = np.abs(duty - 0.5) > 0.5 + _ROUNDING
        if wrong.any():
            k, leg = (int(n[0]) for n in np.nonzero(wrong))
            raise ImportFailedError(
                f"{self._path}: {self._table.unit} {block.line[k]}: the duty of leg {'abc'[leg]} "
                f"is {duty[k, leg]:.6g}, and has to be within 0 to 1; is 'full' of 'duties' right?"
            )
        return np.clip(duty, 0.0, 1.0)

    def _voltages(self, block: Block, angle: NDArray[np.float64]) -> NDArray[np.float64]:
        """Phase voltages (V), shape (n, 3)."""
        if "voltages.a" in self._columns:
            return self._several(block, ("voltages.a", "voltages.b", "voltages.c"))
        if "voltages.alpha" in self._columns:
            u = self._si(block, "voltages.alpha") + 1j * self._si(block, "voltages.beta")
        else:
            u = self._si(block, "voltages.d") + 1j * self._si(block, "voltages.q")
            u = u * np.exp(1j * angle)
        beta = 0.5 * _SQRT3 * u.imag
        return np.stack([u.real, -0.5 * u.real + beta, -0.5 * u.real - beta], axis=1)

    def _enable(self, block: Block) -> NDArray[np.bool_]:
        if self._map.enable is None:
            return np.ones(len(block.line), np.bool_)
        on = self._si(block, "enable")
        return np.isfinite(on) & (on != 0.0)

    def _look(self, rows: Rows, seen: Seen) -> None:
        there = rows.sampled
        seen.rows += len(there)
        if not there.all():
            seen.without_sample += int((~there).sum())
            seen.first_without = seen.first_without or int(rows.line[np.argmin(there)])
        i_abc = rows.i_abc[there]
        seen.sum_squared += float((i_abc.sum(axis=1) ** 2).sum())
        seen.squared += float((i_abc**2).sum()) / 3.0

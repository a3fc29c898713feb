"""The rows of a sweep: what varies in each of them, and the run that it is."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pmsm_sim.motor
from mfpcc_experiments.running import Scenario
from mfpcc_experiments.running import scenario as scenarios
from mfpcc_experiments.sweeping.drives import Drives, Place, check, place
from mfpcc_experiments.sweeping.errors import SweepError
from mfpcc_experiments.sweeping.spec import MOST_ROWS, Spec
from pmsm_sim.motor import MotorPars
from pwm_node.parameters import ParameterError
from pwm_node.yaml_files import FileError

# Periods of a chunk: one to two seconds of work of one core.
_CHUNK_PERIODS = 1_500_000


class Plan:
    """
    All rows of a sweep, in an order that depends on its file alone.

    Rows are counted from 0: scheme by scheme, within a scheme grid point by grid point (the last
    grid of the file changes first), and within a grid point draw by draw. They are done in chunks
    of equal length, none of which holds rows of two schemes.

    Parameters
    ----------
    spec : Spec
        The sweep.
    schemes : sequence of str, optional
        Who controls, in place of the file's.

    Raises
    ------
    SweepError
        If there are no such runs: a parameter that is not there, a value that it cannot have.
    """

    def __init__(self, spec: Spec, schemes: tuple[str, ...] = ()) -> None:
        self.spec = spec
        self.schemes = schemes or tuple(spec.schemes)
        try:
            self.base = _base(spec)
            for scheme in self.schemes:
                self.base.node_parameters(scheme, spec.seed)
            self.places: dict[str, Place] = {name: place(self.base, name) for name in spec.vary}
        except (ParameterError, FileError) as error:
            raise SweepError(f"{spec.name}: {error}") from None
        self._spaces = spec.spaces
        self._grids = {n: space for n, space in self._spaces.items() if space.is_grid}
        self.points = math.prod(len(space.values) for space in self._grids.values())
        self.rows_per_scheme = self.points * spec.runs
        self.rows = self.rows_per_scheme * len(self.schemes)
        self.chunk_rows = max(1, _CHUNK_PERIODS // self.base.periods)
        self._chunks_per_scheme = -(-self.rows_per_scheme // self.chunk_rows)
        self.chunks = self._chunks_per_scheme * len(self.schemes)

    def check(self) -> None:
        """
        Look at all values that there will be.

        Raises
        ------
        SweepError
            If there are too many rows, or a parameter cannot have a value that was drawn.
        """
        if self.rows > MOST_ROWS:
            raise SweepError(
                f"{self.spec.name}: {self.rows:,} runs are more than the {MOST_ROWS:,} that a "
                "sweep can have: divide it"
            )
        for scheme in self.schemes:
            Drives(self.base, scheme, self.places, self.motors)
        for name in self.places:
            for value in self._extremes(name):
                try:
                    check(self.base, name, self.places[name], value)
                except (ParameterError, FileError, ValueError) as error:
                    where = "" if f"'{name}'" in str(error) else f"'{name}': "
                    raise SweepError(f"{self.spec.name}: {where}{error}") from None

    @cached_property
    def motors(self) -> dict[str, MotorPars]:
        """The motor files of the runs, by their names."""
        space = self._spaces.get("motor")
        names = self.base.motor, *(map(str, space.values) if space else ())
        return {name: pmsm_sim.motor.load(name) for name in names}

    def columns(self, start: int, stop: int) -> dict[str, NDArray[Any]]:
        """What varies in the rows from `start` to before `stop`, by name; and their seeds."""
        within = np.arange(start, stop) % self.rows_per_scheme
        point, draw = within // self.spec.runs, within % self.spec.runs
        found: dict[str, NDArray[Any]] = {}
        stride = self.points
        for name, space in self._spaces.items():
            if space.is_grid:
                stride //= len(space.values)
                found[name] = np.array(space.values)[point // stride % len(space.values)]
            else:
                found[name] = self._drawn[name][draw]
        for name, space in self._spaces.items():
            if space.sign_of:
                found[name] = np.copysign(found[name], found[space.sign_of])
        if "seed" not in found:
            found["seed"] = self.spec.seed + draw
        return found

    def chunk(self, number: int) -> tuple[str, int, int]:
        """Scheme of a chunk, its first row, and the one after its last."""
        of_scheme, part = divmod(number, self._chunks_per_scheme)
        first = of_scheme * self.rows_per_scheme
        start = first + part * self.chunk_rows
        stop = min(start + self.chunk_rows, first + self.rows_per_scheme)
        return self.schemes[of_scheme], start, stop

    def row(self, number: int) -> tuple[str, dict[str, Any]]:
        """Scheme of a row, and what varies in it; its seed too."""
        if not 0 <= number < self.rows:
            raise SweepError(f"there is no row {number}: the sweep has rows 0 to {self.rows - 1}")
        values = {name: v[0].item() for name, v in self.columns(number, number + 1).items()}
        return self.schemes[number // self.rows_per_scheme], values

    @cached_property
    def _drawn(self) -> dict[str, NDArray[Any]]:
        """Of each parameter that is drawn, the value of each draw."""
        names = [name for name in self._spaces if name not in self._grids]
        u = _uniform(self.spec, len(names))
        return {
            name: self._spaces[name].drawn(u[:, n], whole=self.places[name].whole)
            for n, name in enumerate(names)
        }

    def _extremes(self, name: str) -> Iterator[Any]:
        """Values of a parameter that all others lie between; or all of them."""
        space = self._spaces[name]
        values: list[Any] = list(space.values)
        if space.kind not in ("grid", "choice"):
            drawn = self._drawn[name]
            values = [drawn.min().item(), drawn.max().item()]
        if space.sign_of:
            values = [v for value in values for v in (value, -value)]
        yield from values


def _base(spec: Spec) -> Scenario:
    """The experiment with what is otherwise in all runs."""
    found = scenarios.load(spec.experiment)
    scheduled = {n: value for n, value in spec.set.items() if scenarios.scheduled(found, n)}
    rest = (
        f"{name}={value if isinstance(value, str) else json.dumps(value)}"
        for name, value in spec.set.items()
        if name not in scheduled
    )
    return scenarios.changed(scenarios.varied(found, scheduled), rest)


def _uniform(spec: Spec, dimensions: int) -> NDArray[np.float64]:
    """The draws as uniform numbers, shape (runs, dimensions)."""
    if dimensions == 0:
        return np.empty((spec.runs, 0))
    if spec.draw == "random":
        return np.random.default_rng(spec.seed).random((spec.runs, dimensions))
    if spec.draw == "by_number":
        own = (np.random.default_rng(spec.seed + k) for k in range(spec.runs))
        return np.array([generator.random(dimensions) for generator in own])
    from scipy.stats import qmc

    if spec.draw == "sobol":
        drawn = qmc.Sobol(dimensions, rng=np.random.default_rng(spec.seed)).random(spec.runs)
    else:
        drawn = qmc.LatinHypercube(dimensions, rng=np.random.default_rng(spec.seed)).random(
            spec.runs
        )
    return np.asarray(drawn)

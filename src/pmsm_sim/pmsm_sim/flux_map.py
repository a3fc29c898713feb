"""Flux maps: the flux linkage of a saturated machine as a file, and the spline the plant uses.

A flux map gives psi_d and psi_q on a grid of i_d and i_q, as finite elements or a test bench yield
it. The plant needs derivatives, and it needs a field that stores energy without making any:
dpsi_d/di_q = dpsi_q/di_d. So the map is replaced by the gradient of one function, the co-energy
W'(i_d, i_q), a bivariate quintic B-spline whose gradient fits the given values best (least
squares). A map that is far from any gradient, or not invertible, is refused.

Along each current the spline has as many cells as the grid has steps, at most 80, all of one width.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from pwm_node import yaml_files
from pwm_node.compiled import inlined, kernel
from pwm_node.yaml_files import FileError

# Most cells along one current, and the spline coefficients they need
_CELLS = 80
_SIZE = _CELLS + 5
# So many functions after one, there are others that are not zero where it is not.
_WIDTH = 5

#: The spline as a record
MAP = np.dtype(
    [
        ("start", np.float64, (2,)),  # smallest i_d, i_q (A)
        ("rate", np.float64, (2,)),  # cells per ampere
        ("cells", np.int64, (2,)),
        ("beyond", np.float64, (2,)),  # inductances L_dd, L_qq outside of them (H)
        ("spline", np.float64, (_SIZE, _SIZE)),  # B-spline coefficients of the co-energy (J)
    ],
    align=True,
)

# How far the given flux may be from the nearest gradient, over the largest flux in the map.
_TOLERANCE = 0.01
# The part of the distance between spline and values that no field would take away, from which on it
# is not the spline's cells that are too wide.
_NO_FIELD = 0.2
# Points per cell along each axis at which invertibility is checked.
_CHECKS_PER_CELL = 4
# Weight of the spline's roughness against the data: fixes what the data leave open.
_SMOOTHING = 1e-4


@inlined
def _basis(u):
    """Uniform B-splines that are not zero in a cell, at the place u in 0..1 in it.

    By Cox's and de Boor's recursion. Returns the six of degree 5, and their first and second
    derivatives, which are differences of those of degree 4 and 3.
    """
    v = 1.0 - u
    a_0, a_1 = v, u
    b_0, b_1, b_2 = 0.5 * v * a_0, 0.5 * ((1.0 + u) * a_0 + (1.0 + v) * a_1), 0.5 * u * a_1
    t = 1.0 / 3.0
    c_0 = t * v * b_0
    c_1 = t * ((2.0 + u) * b_0 + (1.0 + v) * b_1)
    c_2 = t * ((1.0 + u) * b_1 + (2.0 + v) * b_2)
    c_3 = t * u * b_2
    d_0 = 0.25 * v * c_0
    d_1 = 0.25 * ((3.0 + u) * c_0 + (1.0 + v) * c_1)
    d_2 = 0.25 * ((2.0 + u) * c_1 + (2.0 + v) * c_2)
    d_3 = 0.25 * ((1.0 + u) * c_2 + (3.0 + v) * c_3)
    d_4 = 0.25 * u * c_3
    value = (
        0.2 * v * d_0,
        0.2 * ((4.0 + u) * d_0 + (1.0 + v) * d_1),
        0.2 * ((3.0 + u) * d_1 + (2.0 + v) * d_2),
        0.2 * ((2.0 + u) * d_2 + (3.0 + v) * d_3),
        0.2 * ((1.0 + u) * d_3 + (4.0 + v) * d_4),
        0.2 * u * d_4,
    )
    first = (-d_0, d_0 - d_1, d_1 - d_2, d_2 - d_3, d_3 - d_4, d_4)
    second = (
        c_0,
        c_1 - 2.0 * c_0,
        c_0 - 2.0 * c_1 + c_2,
        c_1 - 2.0 * c_2 + c_3,
        c_2 - 2.0 * c_3,
        c_3,
    )
    return value, first, second


@inlined
def _row(spline, row, column, q_0, q_1, q_2):
    """Six coefficients of a row, weighted in three ways."""
    a_0, a_1, a_2 = spline[row, column], spline[row, column + 1], spline[row, column + 2]
    a_3, a_4, a_5 = spline[row, column + 3], spline[row, column + 4], spline[row, column + 5]
    return (
        (a_0 * q_0[0] + a_1 * q_0[1] + a_2 * q_0[2]) + (a_3 * q_0[3] + a_4 * q_0[4] + a_5 * q_0[5]),
        (a_0 * q_1[0] + a_1 * q_1[1] + a_2 * q_1[2]) + (a_3 * q_1[3] + a_4 * q_1[4] + a_5 * q_1[5]),
        (a_0 * q_2[0] + a_1 * q_2[1] + a_2 * q_2[2]) + (a_3 * q_2[3] + a_4 * q_2[4] + a_5 * q_2[5]),
    )


@inlined
def _product(d, rows, n):
    """Rows, weighted; of each the n-th of the three sums."""
    return (d[0] * rows[0][n] + d[1] * rows[1][n] + d[2] * rows[2][n]) + (
        d[3] * rows[3][n] + d[4] * rows[4][n] + d[5] * rows[5][n]
    )


@inlined
def _cell(map_, axis, i):
    """Cell of the map and place in it, and by how much (A) the current lies outside the map."""
    x = (i - map_.start[axis]) * map_.rate[axis]
    last = map_.cells[axis]
    inside = min(max(x, 0.0), float(last))
    cell = min(int(inside), last - 1)
    return cell, inside - cell, (x - inside) / map_.rate[axis]


@kernel
def co_energy(map_, i_d, i_q):
    """Co-energy of the flux map and its derivatives (W', psi_d, psi_q, L_dd, L_dq, L_qd, L_qq).

    L_dq is dpsi_d/di_q, and L_qd is dpsi_q/di_d: the same in the map. Outside, the flux linkage of
    the border goes on with the smallest inductances of the map. That has an inverse everywhere, but
    no energy that is exactly its own.
    """
    cell_d, u_d, over_d = _cell(map_, 0, i_d)
    cell_q, u_q, over_q = _cell(map_, 1, i_q)
    d_0, d_1, d_2 = _basis(u_d)
    q_0, q_1, q_2 = _basis(u_q)
    rows = (
        _row(map_.spline, cell_d, cell_q, q_0, q_1, q_2),
        _row(map_.spline, cell_d + 1, cell_q, q_0, q_1, q_2),
        _row(map_.spline, cell_d + 2, cell_q, q_0, q_1, q_2),
        _row(map_.spline, cell_d + 3, cell_q, q_0, q_1, q_2),
        _row(map_.spline, cell_d + 4, cell_q, q_0, q_1, q_2),
        _row(map_.spline, cell_d + 5, cell_q, q_0, q_1, q_2),
    )
    W, psi_d, psi_q = _product(d_0, rows, 0), _product(d_1, rows, 0), _product(d_0, rows, 1)
    L_dd, L_dq, L_qq = _product(d_2, rows, 0), _product(d_1, rows, 1), _product(d_0, rows, 2)
    rate_d, rate_q = map_.rate[0], map_.rate[1]
    psi_d *= rate_d
    psi_q *= rate_q
    L_dd *= rate_d * rate_d
    L_dq *= rate_d * rate_q
    L_qq *= rate_q * rate_q
    L_qd = L_dq
    if over_d != 0.0:
        L_dd, L_qd = map_.beyond[0], 0.0
        W += (psi_d + 0.5 * L_dd * over_d) * over_d
        psi_d += L_dd * over_d
    if over_q != 0.0:
        L_qq, L_dq = map_.beyond[1], 0.0
        W += (psi_q + 0.5 * L_qq * over_q) * over_q
        psi_q += L_qq * over_q
    return W, psi_d, psi_q, L_dd, L_dq, L_qd, L_qq


class FluxMapFile(BaseModel):
    """
    A flux map file (`config/flux_maps/*.yaml`), SI units.

    Attributes
    ----------
    name, description, source : str
        What it is and where the values come from.
    i_d, i_q : list of float
        Grid (A), each increasing; negative i_q must be there too.
    psi_d, psi_q : list of lists of float
        Flux linkage (V s), one row for each i_d, one column for each i_q.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    description: str
    source: str
    i_d: list[float] = Field(min_length=4, max_length=200, description="A, increasing")
    i_q: list[float] = Field(min_length=4, max_length=200, description="A, increasing")
    psi_d: list[list[float]] = Field(description="V s, one row per i_d")
    psi_q: list[list[float]] = Field(description="V s, one row per i_d")

    @field_validator("i_d", "i_q")
    @classmethod
    def _increasing(cls, grid: list[float]) -> list[float]:
        if not all(a < b for a, b in pairwise(grid)) or not all(map(math.isfinite, grid)):
            raise ValueError("the currents must be finite and increase from one to the next")
        return grid

    @model_validator(mode="after")
    def _shapes(self) -> FluxMapFile:
        for name in ("psi_d", "psi_q"):
            rows = getattr(self, name)
            if len(rows) != len(self.i_d) or any(len(row) != len(self.i_q) for row in rows):
                raise ValueError(
                    f"'{name}' must have {len(self.i_d)} rows (i_d) of {len(self.i_q)} values (i_q)"
                )
            if not np.all(np.isfinite(rows)):
                raise ValueError(f"'{name}' has values that are not finite numbers")
        return self


@dataclass(frozen=True)
class FluxMap:
    """
    The co-energy spline of a flux map.

    Attributes
    ----------
    map_ : array of length 1 of `MAP`
    psi_f : float
        Flux linkage of the magnets: psi_d without current (V s).
    residual : float
        Largest distance between the spline and the values given (V s).
    """

    map_: NDArray[np.void]
    psi_f: float
    residual: float

    def flux(self, i_d: float, i_q: float) -> tuple[float, float]:
        """Flux linkage (psi_d, psi_q) (V s)."""
        _, psi_d, psi_q, _, _, _, _ = co_energy(self.map_[0], i_d, i_q)
        return psi_d, psi_q

    def inductances(self, i_d: float, i_q: float) -> NDArray[np.float64]:
        """Incremental inductances [[L_dd, L_dq], [L_qd, L_qq]] (H)."""
        _, _, _, L_dd, L_dq, L_qd, L_qq = co_energy(self.map_[0], i_d, i_q)
        return np.array([[L_dd, L_dq], [L_qd, L_qq]])

    def current(self, psi_d: float, psi_q: float, *, start: complex = 0j) -> tuple[float, float]:
        """The inverse map: current (i_d, i_q) (A) of a flux linkage, by damped Newton steps.

        `start`, i_d + 1j i_q, makes it faster where the answer is nearly known.
        """
        i = np.array([start.real, start.imag])
        target = np.array([psi_d, psi_q])

        def error(i: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.array(self.flux(i[0], i[1])) - target

        e = error(i)
        for _ in range(100):
            if np.abs(e).max() < 1e-14:
                break
            move = np.linalg.solve(self.inductances(i[0], i[1]), -e)
            for _ in range(30):
                e_next = error(i + move)
                if np.linalg.norm(e_next) < np.linalg.norm(e):
                    break
                move = 0.5 * move
            else:
                break  # at rounding
            i, e = i + move, e_next
        return float(i[0]), float(i[1])


def load(name_or_path: str) -> FluxMap:
    """Flux map of this name in `config/flux_maps`, or of this file.

    Raises
    ------
    pwm_node.yaml_files.FileError
        If there is none, or it cannot be used; the text says what is wrong, and where.
    """
    path = yaml_files.find("flux_maps", name_or_path)
    return _load(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=8)
def _load(path: Path, _: int) -> FluxMap:
    """Read and fit the file as it is now; many runs of a sweep share one map."""
    return fit(yaml_files.load(path, FluxMapFile), path)


def fit(file: FluxMapFile, path: Path | str = "flux map") -> FluxMap:
    """The co-energy whose gradient is nearest to the values of the file."""
    # needed by few, and slow to import
    from scipy.linalg import solveh_banded

    i_d, i_q = np.array(file.i_d), np.array(file.i_q)
    psi_d, psi_q = np.array(file.psi_d), np.array(file.psi_q)
    if not (i_d[0] <= 0.0 <= i_d[-1] and i_q[0] < 0.0 < i_q[-1]):
        raise FileError(f"{path}: the grid must contain zero current, and i_q of both signs")

    map_ = np.zeros(1, MAP)
    cells = [min(len(grid) - 1, _CELLS) for grid in (i_d, i_q)]
    rate = [n / (grid[-1] - grid[0]) for n, grid in zip(cells, (i_d, i_q), strict=True)]
    map_["start"], map_["rate"], map_["cells"] = (i_d[0], i_q[0]), rate, cells
    B_d, D_d = _collocation(map_, 0, i_d)
    B_q, D_q = _collocation(map_, 1, i_q)
    scale = max(np.abs(psi_d).max(), np.abs(psi_q).max())

    # Normal equations of: psi_d and psi_q at the grid points; roughness; W' = 0 without current.
    # The spline is a product of two, so they are made of small matrices, with few entries each.
    n_d, n_q = B_d.shape[1], B_q.shape[1]
    third_d, third_q = np.diff(np.eye(n_d), 3, axis=0), np.diff(np.eye(n_q), 3, axis=0)
    zero = _kron(_collocation(map_, 0, [0.0])[0], _collocation(map_, 1, [0.0])[0])
    rough = (_SMOOTHING * max(rate)) ** 2
    normal = (
        _kron(D_d.T @ D_d, B_q.T @ B_q)
        + _kron(B_d.T @ B_d, D_q.T @ D_q)
        + rough * _kron(third_d.T @ third_d, np.eye(n_q))
        + rough * _kron(np.eye(n_d), third_q.T @ third_q)
        + max(rate) ** 2 * zero.T @ zero
    )
    right = D_d.T @ psi_d @ B_q + B_d.T @ psi_q @ D_q
    diagonals = range(_WIDTH * n_q + _WIDTH + 1)
    band = [np.pad(normal.diagonal(-k), (0, k)) for k in diagonals]
    W = solveh_banded(np.array(band), right.ravel(), lower=True).reshape(n_d, n_q)
    map_["spline"][0, :n_d, :n_q] = W

    off = np.hypot(D_d @ W @ B_q.T - psi_d, B_d @ W @ D_q.T - psi_q)
    residual = float(off.max())
    if residual > _TOLERANCE * scale:
        d, q = map(int, np.unravel_index(off.argmax(), off.shape))
        if _distance_from_a_field(file, (d, q)) < _NO_FIELD * residual:
            raise FileError(
                f"{path}: the flux bends too sharply near i_d = {i_d[d]:g} A, i_q = {i_q[q]:g} A: "
                f"a spline of {cells[0]} x {cells[1]} cells, {1 / rate[0]:.3g} x {1 / rate[1]:.3g} "
                f"A each, misses it by {residual:.3g} V s; at most {_TOLERANCE:.0%} of the largest "
                f"flux ({_TOLERANCE * scale:.3g} V s) is accepted. Along a current it has as many "
                f"cells as the grid has steps, at most {_CELLS}: give a finer or a smaller grid, "
                "with equal steps"
            )
        raise FileError(
            f"{path}: no field has this flux map: dpsi_d/di_q and dpsi_q/di_d differ too much. The "
            f"nearest one that stores energy is {residual:.3g} V s away at i_d = {i_d[d]:g} A, "
            f"i_q = {i_q[q]:g} A; at most {_TOLERANCE:.0%} of the largest flux "
            f"({_TOLERANCE * scale:.3g} V s) is accepted"
        )
    map_["beyond"] = _smallest_inductances(map_, path)
    _, psi_f, *_ = co_energy(map_[0], 0.0, 0.0)
    return FluxMap(map_, psi_f, residual)


def _kron(a: NDArray[np.float64], b: NDArray[np.float64]) -> Any:
    """Kronecker product of matrices with few entries, as a sparse one."""
    from scipy.sparse import csr_array, kron

    return csr_array(kron(csr_array(a), csr_array(b)))


def _distance_from_a_field(file: FluxMapFile, place: tuple[int, int]) -> float:
    """How far (V s) the values are from any field at least, by what goes around beside a place.

    The integral of the flux along a closed path is zero in a field; over the path's length, it says
    how far the nearest one is. The paths are rectangles of grid lines with a corner at the place.
    """
    i_d, i_q = np.array(file.i_d), np.array(file.i_q)
    psi_d, psi_q = np.array(file.psi_d), np.array(file.psi_q)
    furthest = 0.0
    n_d, n_q = len(i_d) - 1, len(i_q) - 1
    for m, before, above in product(range(1, max(n_d, n_q) + 1), (0, 1), (0, 1)):
        a, b = max(place[0] - before * m, 0), min(place[0] + (1 - before) * m, n_d)
        c, d = max(place[1] - above * m, 0), min(place[1] + (1 - above) * m, n_q)
        along_d = np.trapezoid(psi_d[a : b + 1, c] - psi_d[a : b + 1, d], i_d[a : b + 1])
        along_q = np.trapezoid(psi_q[b, c : d + 1] - psi_q[a, c : d + 1], i_q[c : d + 1])
        length = 2.0 * (i_d[b] - i_d[a] + i_q[d] - i_q[c])
        if length > 0.0:
            furthest = max(furthest, abs(along_d + along_q) / length)
    return float(furthest)


def _collocation(
    map_: NDArray[np.void], axis: int, points: NDArray[np.float64] | list[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values and derivatives of the basis functions of one axis, shapes (points, functions)."""
    from scipy.interpolate import BSpline

    start, rate = float(map_["start"][0, axis]), float(map_["rate"][0, axis])
    cells = int(map_["cells"][0, axis])
    knots = start + np.arange(-5, cells + 6) / rate
    basis = BSpline(knots, np.eye(cells + 5), 5)
    return basis(points), basis(points, 1)


def _smallest_inductances(map_: NDArray[np.void], path: Path | str) -> tuple[float, float]:
    """Smallest L_dd and L_qq in a map (H).

    Refuses one in which more current does not always give more flux, in any direction.
    """
    smallest_d = smallest_q = math.inf
    axes = []
    for axis in range(2):
        start, rate = map_["start"][0, axis], map_["rate"][0, axis]
        cells = map_["cells"][0, axis]
        axes.append(start + np.arange(_CHECKS_PER_CELL * cells + 1) / (_CHECKS_PER_CELL * rate))
    for i_d in axes[0]:
        for i_q in axes[1]:
            _, _, _, L_dd, L_dq, _, L_qq = co_energy(map_[0], i_d, i_q)
            smallest_d, smallest_q = min(smallest_d, L_dd), min(smallest_q, L_qq)
            if not (L_dd > 0.0 and L_qq > 0.0 and L_dd * L_qq > L_dq * L_dq):
                raise FileError(
                    f"{path}: the flux map is not monotone, so it has no inverse: near "
                    f"i_d = {i_d:.4g} A, i_q = {i_q:.4g} A the incremental inductances are "
                    f"L_dd = {L_dd:.3g}, L_qq = {L_qq:.3g}, L_dq = {L_dq:.3g} H; L_dd and L_qq "
                    "must be above 0 and L_dq^2 below L_dd L_qq"
                )
    return smallest_d, smallest_q

"""Flux maps: the flux linkage of a saturated machine as a file, and the spline the plant uses.

A flux map gives psi_d and psi_q on a grid of i_d and i_q, as finite elements or a test bench yield
it. The plant needs derivatives, and it needs a field that stores energy without making any:
dpsi_d/di_q = dpsi_q/di_d. So the map is replaced by the gradient of one function, the co-energy
W'(i_d, i_q), a bivariate quintic B-spline whose gradient fits the given values best (least
squares). A map that is far from any gradient, or not invertible, is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from pwm_node import yaml_files
from pwm_node.compiled import kernel
from pwm_node.yaml_files import FileError

# Most cells along one current, and the spline coefficients they need
_CELLS = 24
_SIZE = _CELLS + 5

#: The spline as a record
MAP = np.dtype(
    [
        ("start", np.float64, (2,)),  # smallest i_d, i_q (A)
        ("rate", np.float64, (2,)),  # cells per ampere
        ("cells", np.int64, (2,)),
        ("spline", np.float64, (_SIZE, _SIZE)),  # B-spline coefficients of the co-energy (J)
    ],
    align=True,
)

# Polynomials of the quintic B-spline with unit knots: row j, power k, of the j-th of the six basis
# functions that are not zero in a cell, over the place u in 0..1 in it.
_QUINTIC = (
    np.array(
        [
            [1, -5, 10, -10, 5, -1],
            [26, -50, 20, 20, -20, 5],
            [66, 0, -60, 0, 30, -10],
            [26, 50, 20, -20, -20, 10],
            [1, 5, 10, 10, 5, -5],
            [0, 0, 0, 0, 0, 1],
        ],
        dtype=np.float64,
    )
    / 120.0
)

# How far the given flux may be from the nearest gradient, over the largest flux in the map.
_TOLERANCE = 0.01
# Points per cell along each axis at which invertibility is checked.
_CHECKS_PER_CELL = 4
# Weight of the spline's roughness against the data: fixes what the data leave open.
_SMOOTHING = 1e-4


@kernel
def _basis(u, j):
    """Basis function j at u: its value, first and second derivative."""
    p = _QUINTIC[j]
    value = p[0] + u * (p[1] + u * (p[2] + u * (p[3] + u * (p[4] + u * p[5]))))
    first = p[1] + u * (2.0 * p[2] + u * (3.0 * p[3] + u * (4.0 * p[4] + u * 5.0 * p[5])))
    second = 2.0 * p[2] + u * (6.0 * p[3] + u * (12.0 * p[4] + u * 20.0 * p[5]))
    return value, first, second


@kernel
def _cell(map_, axis, i):
    """Cell of the map and place in it, and by how much (A) the current lies outside the map."""
    x = (i - map_.start[axis]) * map_.rate[axis]
    last = map_.cells[axis]
    inside = min(max(x, 0.0), float(last))
    cell = min(int(inside), last - 1)
    return cell, inside - cell, (x - inside) / map_.rate[axis]


@kernel
def co_energy(map_, i_d, i_q):
    """Co-energy of the flux map and its derivatives (W', psi_d, psi_q, L_dd, L_dq, L_qq).

    Outside the map its border goes on with constant incremental inductances.
    """
    cell_d, u_d, over_d = _cell(map_, 0, i_d)
    cell_q, u_q, over_q = _cell(map_, 1, i_q)
    basis_q = (
        _basis(u_q, 0),
        _basis(u_q, 1),
        _basis(u_q, 2),
        _basis(u_q, 3),
        _basis(u_q, 4),
        _basis(u_q, 5),
    )
    W = psi_d = psi_q = L_dd = L_dq = L_qq = 0.0
    for j in range(6):
        row = row_1 = row_2 = 0.0
        for k in range(6):
            a = map_.spline[cell_d + j, cell_q + k]
            b_0, b_1, b_2 = basis_q[k]
            row += a * b_0
            row_1 += a * b_1
            row_2 += a * b_2
        b_0, b_1, b_2 = _basis(u_d, j)
        W += b_0 * row
        psi_d += b_1 * row
        psi_q += b_0 * row_1
        L_dd += b_2 * row
        L_dq += b_1 * row_1
        L_qq += b_0 * row_2
    rate_d, rate_q = map_.rate[0], map_.rate[1]
    psi_d *= rate_d
    psi_q *= rate_q
    L_dd *= rate_d * rate_d
    L_dq *= rate_d * rate_q
    L_qq *= rate_q * rate_q
    if over_d != 0.0 or over_q != 0.0:
        W += psi_d * over_d + psi_q * over_q
        W += 0.5 * (L_dd * over_d**2 + L_qq * over_q**2) + L_dq * over_d * over_q
        psi_d += L_dd * over_d + L_dq * over_q
        psi_q += L_dq * over_d + L_qq * over_q
    return W, psi_d, psi_q, L_dd, L_dq, L_qq


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
        _, psi_d, psi_q, _, _, _ = co_energy(self.map_[0], i_d, i_q)
        return psi_d, psi_q

    def inductances(self, i_d: float, i_q: float) -> tuple[float, float, float]:
        """Incremental inductances (L_dd, L_dq, L_qq) (H)."""
        _, _, _, L_dd, L_dq, L_qq = co_energy(self.map_[0], i_d, i_q)
        return L_dd, L_dq, L_qq

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
            L_dd, L_dq, L_qq = self.inductances(i[0], i[1])
            move = np.linalg.solve([[L_dd, L_dq], [L_dq, L_qq]], -e)
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
    # The spline is a product of two, so they are made of small matrices.
    n_d, n_q = B_d.shape[1], B_q.shape[1]
    third_d, third_q = np.diff(np.eye(n_d), 3, axis=0), np.diff(np.eye(n_q), 3, axis=0)
    zero = np.kron(_collocation(map_, 0, [0.0])[0], _collocation(map_, 1, [0.0])[0])
    rough = (_SMOOTHING * max(rate)) ** 2
    normal = (
        np.kron(D_d.T @ D_d, B_q.T @ B_q)
        + np.kron(B_d.T @ B_d, D_q.T @ D_q)
        + rough * np.kron(third_d.T @ third_d, np.eye(n_q))
        + rough * np.kron(np.eye(n_d), third_q.T @ third_q)
        + max(rate) ** 2 * zero.T @ zero
    )
    right = D_d.T @ psi_d @ B_q + B_d.T @ psi_q @ D_q
    W = np.linalg.solve(normal, right.ravel()).reshape(n_d, n_q)
    map_["spline"][0, :n_d, :n_q] = W

    off = np.hypot(D_d @ W @ B_q.T - psi_d, B_d @ W @ D_q.T - psi_q)
    residual = float(off.max())
    if residual > _TOLERANCE * scale:
        d, q = np.unravel_index(off.argmax(), off.shape)
        raise FileError(
            f"{path}: no field has this flux map: dpsi_d/di_q and dpsi_q/di_d differ too much. The "
            f"nearest one that stores energy is {residual:.3g} V s away at i_d = {i_d[d]:g} A, "
            f"i_q = {i_q[q]:g} A; at most {_TOLERANCE:.0%} of the largest flux "
            f"({_TOLERANCE * scale:.3g} V s) is accepted"
        )
    _check_monotone(map_, path)
    _, psi_f, _, _, _, _ = co_energy(map_[0], 0.0, 0.0)
    return FluxMap(map_, psi_f, residual)


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


def _check_monotone(map_: NDArray[np.void], path: Path | str) -> None:
    """Refuse a map in which more current does not always give more flux, in any direction."""
    axes = []
    for axis in range(2):
        start, rate = map_["start"][0, axis], map_["rate"][0, axis]
        cells = map_["cells"][0, axis]
        axes.append(start + np.arange(_CHECKS_PER_CELL * cells + 1) / (_CHECKS_PER_CELL * rate))
    for i_d in axes[0]:
        for i_q in axes[1]:
            _, _, _, L_dd, L_dq, L_qq = co_energy(map_[0], i_d, i_q)
            if not (L_dd > 0.0 and L_qq > 0.0 and L_dd * L_qq > L_dq * L_dq):
                raise FileError(
                    f"{path}: the flux map is not monotone, so it has no inverse: near "
                    f"i_d = {i_d:.4g} A, i_q = {i_q:.4g} A the incremental inductances are "
                    f"L_dd = {L_dd:.3g}, L_qq = {L_qq:.3g}, L_dq = {L_dq:.3g} H; L_dd and L_qq "
                    "must be above 0 and L_dq^2 below L_dd L_qq"
                )

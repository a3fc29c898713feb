"""Flux maps: what is accepted, what is refused, and the inverse map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmsm_sim import flux_map
from pmsm_sim.flux_map import FluxMapFile, fit
from pmsm_sim.parameters import TABLE
from pmsm_sim.plant import Plant
from pwm_node.yaml_files import FileError

_GRID = np.linspace(-20.0, 20.0, 9)


def _file(psi_d=None, psi_q=None, grid=(_GRID, _GRID), **changes):
    """A linear map, but for what is given: functions of i_d and i_q."""
    i_d, i_q = np.meshgrid(*grid, indexing="ij")
    values = {
        "name": "made",
        "description": "",
        "source": "",
        "i_d": grid[0].tolist(),
        "i_q": grid[1].tolist(),
        "psi_d": (psi_d or _linear_d)(i_d, i_q).tolist(),
        "psi_q": (psi_q or _linear_q)(i_d, i_q).tolist(),
    }
    return FluxMapFile(**{**values, **changes})


def _linear_d(i_d, i_q):
    return 0.1 + 2e-3 * i_d + 0.0 * i_q


def _linear_q(i_d, i_q):
    return 4e-3 * i_q + 0.0 * i_d


def test_a_map_that_is_not_monotone_is_refused_with_the_place():
    with pytest.raises(FileError, match=r"not monotone.*i_q = .*L_qq = -"):
        fit(_file(psi_q=lambda d, q: 4e-3 * q - 5e-6 * q**3))


@pytest.mark.parametrize(
    "more",
    [
        lambda d, q: 2e-3 * q,
        lambda d, q: 0.03 * np.exp(-((d - 5.0) ** 2 + q**2) / 30.0),
        lambda d, q: 5e-3 * np.sin(0.3 * q),
    ],
)
def test_a_map_without_a_field_is_refused(more):
    with pytest.raises(FileError, match=r"no field has this flux map.*i_d = "):
        fit(_file(psi_d=lambda d, q: 0.1 + 2e-3 * d + more(d, q)))


def test_a_map_with_a_sharp_knee_is_followed():
    """As sharp as its grid can show, and exactly reciprocal: all cross terms are zero."""
    map_ = fit(
        _file(
            grid=(np.linspace(-20.0, 20.0, 81), _GRID),
            psi_d=lambda d, q: 0.06 * np.tanh(d / 0.75) + 0.004 * d + 0.0 * q,
            psi_q=lambda d, q: 0.02 * q + 0.0 * d,
        )
    )
    assert map_.residual < 1e-6
    assert map_.inductances(0.0, 0.0)[0, 0] == pytest.approx(0.06 / 0.75 + 0.004, rel=0.02)


def test_a_map_too_sharp_for_the_spline_is_refused_for_that_reason():
    i_d = np.array([-20.0, -9.0, -4.0, -1.0, -0.1, 0.0, 0.1, 1.0, 4.0, 9.0, 20.0])
    with pytest.raises(
        FileError, match=r"bends too sharply near i_d = .*a finer or a smaller grid"
    ):
        fit(
            _file(
                grid=(i_d, _GRID),
                psi_d=lambda d, q: 0.06 * np.tanh(d / 0.05) + 4e-3 * d + 0.0 * q,
            )
        )


@pytest.mark.parametrize(("points", "limit"), [(21, 3e-3), (41, 3e-4)])
def test_the_rule_for_the_grid(points, limit):
    """Between its points the map follows the field energy it comes from: worst current error (A).

    The field energy is that of `ipmsm_saturated`; its grid has 21 points.
    """
    grid = np.linspace(-30.0, 30.0, points)
    field = np.array([[_flux_of(d, q) for q in grid] for d in grid])
    map_ = fit(
        _file(
            grid=(grid, grid),
            psi_d=lambda d, q: field[..., 0],
            psi_q=lambda d, q: field[..., 1],
        )
    )
    worst = 0.0
    for i_d in np.linspace(-27.7, 27.1, 19):
        for i_q in np.linspace(-27.3, 27.9, 19):
            back = map_.current(*_flux_of(i_d, i_q), start=complex(i_d, i_q))
            worst = max(worst, np.hypot(back[0] - i_d, back[1] - i_q))
    assert worst < limit


def _flux_of(i_d, i_q):
    """Flux linkage of the field energy behind `ipmsm_saturated` (V s), by Newton's method."""
    x, y = 2e-3 * i_d, 5e-3 * i_q
    for _ in range(50):
        off_d = (476.2 + 1.2e5 * x**2 + 1.5e4 * y**2) * x - i_d
        off_q = (166.7 + 5e4 * abs(y) ** 3 + 1.5e4 * x**2) * y - i_q
        slope = [
            [476.2 + 3.6e5 * x**2 + 1.5e4 * y**2, 3e4 * x * y],
            [3e4 * x * y, 166.7 + 2e5 * abs(y) ** 3 + 1.5e4 * x**2],
        ]
        move = np.linalg.solve(slope, [off_d, off_q])
        x, y = x - move[0], y - move[1]
        if np.abs(move).max() < 1e-15:
            break
    return x + 0.12, y


def test_a_grid_without_zero_or_negative_i_q_is_refused():
    grid = np.linspace(0.0, 20.0, 9)
    with pytest.raises(FileError, match="both signs"):
        fit(_file(i_q=grid.tolist()))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"i_d": [0.0, 1.0, 1.0, 2.0]}, "increase"),
        ({"i_d": [-1.0, 0.0, 1.0, 2.0]}, "4 rows"),
        ({"i_q": [0.0, float("nan"), 1.0, 2.0]}, "finite"),
    ],
)
def test_bad_files_are_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        _file(**changes)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(i_d=st.floats(-150.0, 150.0), i_q=st.floats(-150.0, 150.0))
def test_the_inverse_map(i_d, i_q):
    map_ = flux_map.load("ipmsm_saturated")
    assert map_.current(*map_.flux(i_d, i_q)) == pytest.approx((i_d, i_q), abs=1e-8)


def test_the_example_saturates_and_couples():
    map_ = flux_map.load("ipmsm_saturated")
    assert map_.psi_f == pytest.approx(0.12, abs=1e-6)
    (L_dd, L_dq), (_, L_qq) = map_.inductances(0.0, 0.0)
    assert (L_dd, L_qq) == pytest.approx((2.1e-3, 6.0e-3), rel=5e-3)
    assert abs(L_dq) < 1e-6
    (_, L_dq), (_, L_qq) = map_.inductances(-10.0, 20.0)
    assert L_qq < 0.6 * 6.0e-3 and abs(L_dq) > 1e-4
    assert map_.residual < 1e-5


@pytest.mark.parametrize(
    "i",
    [(-7.0, 3.0), (4.4, -12.0), (25.0, 28.0), (50.0, 10.0), (-3.0, -70.0), (-90.0, 40.0)],
)
def test_the_derivatives_belong_to_each_other(i):
    """In the map, where they are symmetric, and outside, where they are not."""
    map_ = flux_map.load("ipmsm_saturated")
    h = 1e-5
    i_d, i_q = i
    L = map_.inductances(i_d, i_q)
    assert np.linalg.det(L) > 0.0
    by_d = (np.array(map_.flux(i_d + h, i_q)) - map_.flux(i_d - h, i_q)) / (2 * h)
    by_q = (np.array(map_.flux(i_d, i_q + h)) - map_.flux(i_d, i_q - h)) / (2 * h)
    assert np.column_stack([by_d, by_q]) == pytest.approx(L, abs=1e-9)


def test_an_unknown_map_is_told_with_the_nearest():
    with pytest.raises(FileError, match="did you mean 'ipmsm_saturated'"):
        Plant(TABLE.complete({"machine.flux_map": "ipmsm_saturted"}))

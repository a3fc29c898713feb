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


def _file(psi_d=None, psi_q=None, **changes):
    """A linear map, but for what is given: functions of i_d and i_q."""
    i_d, i_q = np.meshgrid(_GRID, _GRID, indexing="ij")
    values = {
        "name": "made",
        "description": "",
        "source": "",
        "i_d": _GRID.tolist(),
        "i_q": _GRID.tolist(),
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


def test_a_map_without_a_field_is_refused():
    with pytest.raises(FileError, match=r"no field has this flux map.*i_d = "):
        fit(_file(psi_d=lambda d, q: 0.1 + 2e-3 * d + 2e-3 * q))


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
@given(i_d=st.floats(-40.0, 40.0), i_q=st.floats(-40.0, 40.0))
def test_the_inverse_map(i_d, i_q):
    map_ = flux_map.load("ipmsm_saturated")
    assert map_.current(*map_.flux(i_d, i_q)) == pytest.approx((i_d, i_q), abs=1e-8)


def test_the_example_saturates_and_couples():
    map_ = flux_map.load("ipmsm_saturated")
    assert map_.psi_f == pytest.approx(0.12, abs=1e-6)
    L_dd, L_dq, L_qq = map_.inductances(0.0, 0.0)
    assert (L_dd, L_qq) == pytest.approx((2.1e-3, 6.0e-3), rel=5e-3)
    assert abs(L_dq) < 1e-6
    L_dd, L_dq, L_qq = map_.inductances(-10.0, 20.0)
    assert L_qq < 0.6 * 6.0e-3 and abs(L_dq) > 1e-4
    assert map_.residual < 1e-5


def test_the_derivatives_belong_to_each_other():
    map_ = flux_map.load("ipmsm_saturated")
    h = 1e-5
    for i_d, i_q in [(-7.0, 3.0), (4.4, -12.0), (25.0, 28.0)]:
        L_dd, L_dq, L_qq = map_.inductances(i_d, i_q)
        by_d = (np.array(map_.flux(i_d + h, i_q)) - map_.flux(i_d - h, i_q)) / (2 * h)
        by_q = (np.array(map_.flux(i_d, i_q + h)) - map_.flux(i_d, i_q - h)) / (2 * h)
        assert by_d == pytest.approx([L_dd, L_dq], abs=1e-9)
        assert by_q == pytest.approx([L_dq, L_qq], abs=1e-9)


def test_an_unknown_map_is_told_with_the_nearest():
    with pytest.raises(FileError, match="did you mean 'ipmsm_saturated'"):
        Plant(TABLE.complete({"machine.flux_map": "ipmsm_saturted"}))

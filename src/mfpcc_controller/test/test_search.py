"""The three-vector search against brute force over all sectors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mfpcc_controller import search
from mfpcc_controller.records import CONTROL_CFG, OUTPUT
from mfpcc_controller.vectors import DIRECTIONS, leg_duties, set_output
from pwm_node.compiled import kernel

# the first call may compile
settings.register_profile("kernels", deadline=None)
settings.load_profile("kernels")

number = st.floats(-3.0, 3.0)
angle = st.floats(0.0, 6.28)


@kernel
def choose(cfg, x, G_1, G_2, out):
    search.choose(cfg[0], x, G_1, G_2, out[0])


@kernel
def duties(out, a, b, d_a, d_b, duty):
    set_output(out[0], a, b, d_a, d_b)
    leg_duties(out[0], duty)


def gradients(saliency: float, turn: float) -> np.ndarray:
    """G[0..6] of a machine whose q axis answers weaker, rotor frame at this angle."""
    u = DIRECTIONS * np.exp(-1j * turn)
    return u.real + 1j * u.imag / saliency


def search_settings(**values: bool) -> np.ndarray:
    cfg = np.zeros(1, CONTROL_CFG)
    for name, value in values.items():
        cfg[name] = value
    return cfg


def increment(G: np.ndarray, out: np.ndarray) -> complex:
    o = out[0]
    return o["d_a"] * G[o["a"]] + o["d_b"] * G[o["b"]]


@given(x=st.builds(complex, number, number), saliency=st.floats(1.0, 4.0), turn=angle)
def test_the_dwell_times_make_the_increment_within_the_hexagon(x, saliency, turn):
    G, out = gradients(saliency, turn), np.zeros(1, OUTPUT)
    choose(search_settings(), x, G[1], G[2], out)
    o = out[0]
    assert 1 <= o["a"] <= 6 and o["b"] == o["a"] % 6 + 1
    assert o["d_a"] >= 0.0 and o["d_b"] >= 0.0 and o["d_a"] + o["d_b"] <= 1.0 + 1e-12
    made = increment(G, out)
    if o["d_a"] + o["d_b"] < 1.0 - 1e-9:
        assert made == pytest.approx(x, abs=1e-9)
    else:
        # scaled: shorter, in the same direction
        assert abs(made) <= abs(x) + 1e-9
        assert (made * x.conjugate()).imag == pytest.approx(0.0, abs=1e-9)
    mean = 2.0 / 3.0 * (o["d_a"] * DIRECTIONS[o["a"]] + o["d_b"] * DIRECTIONS[o["b"]])
    assert o["u"] == pytest.approx(mean, abs=1e-12)


@given(x=st.builds(complex, number, number), saliency=st.floats(1.0, 4.0), turn=angle)
def test_projection_is_the_nearest_point_of_the_hexagon(x, saliency, turn):
    G, out = gradients(saliency, turn), np.zeros(1, OUTPUT)
    choose(search_settings(project=True), x, G[1], G[2], out)
    made = increment(G, out)
    share = np.linspace(0.0, 1.0, 400)
    edges = [np.outer(1.0 - share, G[a]).ravel() + share * G[a % 6 + 1] for a in range(1, 7)]
    nearest = np.min(np.abs(np.concatenate(edges) - x))
    if out[0]["d_a"] + out[0]["d_b"] < 1.0 - 1e-9:
        assert made == pytest.approx(x, abs=1e-9)
    else:
        assert abs(made - x) <= nearest + 1e-9


@given(x=st.builds(complex, number, number), turn=angle)
def test_ranking_finds_the_same_sector_without_saliency(x, turn):
    G = gradients(1.0, turn)
    by_dwell, by_ranking = np.zeros(1, OUTPUT), np.zeros(1, OUTPUT)
    choose(search_settings(), x, G[1], G[2], by_dwell)
    choose(search_settings(rank_sectors=True), x, G[1], G[2], by_ranking)
    assert increment(G, by_ranking) == pytest.approx(increment(G, by_dwell), abs=1e-6)


@given(j=st.integers(0, 6), turn=angle, saliency=st.floats(1.0, 4.0), x=st.builds(complex, number))
def test_nearest_vector(j, turn, saliency, x):
    G = gradients(saliency, turn)
    found = search.nearest_vector(G[j] + 1e-3 * x, G[1], G[2])
    assert abs(G[found] - (G[j] + 1e-3 * x)) <= np.min(np.abs(G - (G[j] + 1e-3 * x))) + 1e-12


@given(a=st.integers(1, 6), d_a=st.floats(0.0, 1.0), share=st.floats(0.0, 1.0))
def test_leg_duties_make_the_mean_voltage(a, d_a, share):
    d_b = (1.0 - d_a) * share
    out, duty = np.zeros(1, OUTPUT), np.zeros(3)
    duties(out, a, a % 6 + 1, d_a, d_b, duty)
    assert np.all((duty >= 0.0) & (duty <= 1.0))
    u = 2.0 / 3.0 * (duty @ np.exp(2j * np.pi / 3.0 * np.arange(3)))
    assert u == pytest.approx(out[0]["u"], abs=1e-12)
    # the zero vector is shared between V0 and V7
    assert 1.0 - duty.max() == pytest.approx(duty.min(), abs=1e-12)


@given(x=st.builds(complex, number, number), saliency=st.floats(1.0, 4.0), turn=angle)
def test_ranking_takes_the_two_best_of_every_second_vector(x, saliency, turn):
    """Written down once more from its definition, right or wrong as the sector may be."""
    G = gradients(saliency, turn)
    costs = sorted(abs(x - G[j]) ** 2 for j in (1, 3, 5))
    assume(min(costs[1] - costs[0], costs[2] - costs[1]) > 1e-9)  # of two that are equal, any
    a, b, d_a, d_b = search.by_ranking(x, G[1], G[2])
    first, second, _ = sorted((1, 3, 5), key=lambda j: abs(x - G[j]) ** 2)
    between = {frozenset((1, 3)): (1, 2, 3), frozenset((3, 5)): (3, 4, 5)}
    low, middle, high = between.get(frozenset((first, second)), (5, 6, 1))
    assert (a, b) == ((low, middle) if first == low else (middle, high))
    det = (G[a].conjugate() * G[b]).imag
    wanted = [(x.conjugate() * G[b]).imag / det, (G[a].conjugate() * x).imag / det]
    assert [d_a, d_b] == pytest.approx([max(share, 0.0) for share in wanted], abs=1e-9)


def test_without_a_voltage_there_is_nothing_to_choose():
    assert search.by_dwell(1.0 + 1.0j, 0j, 0j) == (1, 2, 0.0, 0.0)
    assert search.by_ranking(1.0 + 1.0j, 0j, 0j)[2:] == (0.0, 0.0)
    a, b, d_a, d_b = search.onto_hexagon(1.0 + 1.0j, 0j, 0j, 1)
    assert b == a % 6 + 1 and d_a + d_b == 1.0
    # an edge without length is a point
    assert search._onto_edge(3.0 + 0.0j, 1.0 + 0.0j, 1.0 + 0.0j) == (0.0, 4.0)

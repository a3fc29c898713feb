"""Sine, cosine, exponential and length: their errors against extended precision."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pwm_node import trigonometry

extended = pytest.mark.skipif(
    np.finfo(np.longdouble).nmant < 63, reason="no extended precision to compare with here"
)


def ulps(found: list[float], true: np.ndarray) -> float:
    """Largest error in units in the last place of the true value."""
    unit = np.spacing(np.abs(true.astype(np.float64))).astype(np.longdouble)
    return float(np.max(np.abs(np.array(found, np.longdouble) - true) / unit))


def angles() -> np.ndarray:
    """Of every size, on both sides of the multiples of pi/4, and 0."""
    rng = np.random.default_rng(1)
    near = np.arange(-400, 401) * (math.pi / 4.0)
    return np.concatenate(
        [
            rng.uniform(-7.0, 7.0, 20_000),
            rng.uniform(-1e5, 1e5, 20_000),
            10.0 ** rng.uniform(-300.0, 0.0, 2_000),
            near,
            np.nextafter(near, 1e9),
            np.nextafter(near, -1e9),
        ]
    )


@extended
@pytest.mark.parametrize("name", ["sin", "cos"])
def test_sine_and_cosine(name):
    x = angles()
    found = [getattr(trigonometry, name)(each) for each in x.tolist()]
    quarter, rest = _reduced(x)
    if name == "cos":
        quarter = quarter + 1
    true = np.where(quarter % 2 == 0, np.sin(rest), np.cos(rest))
    assert ulps(found, np.where(quarter % 4 < 2, true, -true)) < 0.8


def _reduced(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quarters of a turn, and what is left of the angle: by integers of 230 binary digits."""
    digits = 230
    quarter = (
        31415926535897932384626433832795028841971693993751058209749445923078164 << digits
    ) // (2 * 10**70)
    quarters, rest = [], []
    for each in x.tolist():
        numerator, denominator = each.as_integer_ratio()
        scaled = (numerator << digits) // denominator
        n = (2 * scaled + quarter) // (2 * quarter)
        left = scaled - n * quarter
        # an extended number takes 64 digits: the first of them in three pieces
        shift = max(abs(left).bit_length() - 90, 0)
        pieces, left = left >> shift, 0
        total = np.longdouble(0)
        for at in (60, 30, 0):
            total += np.ldexp(np.longdouble((abs(pieces) >> at) & (2**30 - 1)), at + shift - digits)
        quarters.append(n)
        rest.append(total if pieces >= 0 else -total)
    tiny = np.abs(x) < 1e-3
    return np.array(quarters), np.where(
        tiny, x.astype(np.longdouble), np.array(rest, np.longdouble)
    )


@extended
def test_the_exponential():
    rng = np.random.default_rng(2)
    x = np.concatenate([rng.uniform(-708.0, 709.7, 20_000), rng.uniform(-1.0, 1.0, 20_000), [0.0]])
    found = [trigonometry.exp(each) for each in x.tolist()]
    assert ulps(found, np.exp(x.astype(np.longdouble))) < 0.85


@extended
def test_the_length():
    rng = np.random.default_rng(3)
    x, y = 10.0 ** rng.uniform(-300.0, 300.0, (2, 5_000))
    near = 10.0 ** rng.uniform(-3.0, 3.0, (2, 20_000))
    x, y = np.concatenate([[x, y], near], axis=1)
    found = [trigonometry.hypot(*pair) for pair in zip(x.tolist(), y.tolist(), strict=True)]
    assert ulps(found, np.hypot(x.astype(np.longdouble), y.astype(np.longdouble))) < 1.3


def test_what_is_no_number_or_has_no_end():
    assert all(
        math.isnan(f(x)) for f in (trigonometry.sin, trigonometry.cos) for x in (math.nan, math.inf)
    )
    assert math.isnan(trigonometry.exp(math.nan))
    assert trigonometry.exp(math.inf) == math.inf == trigonometry.exp(709.8)
    assert trigonometry.exp(-math.inf) == 0.0 == trigonometry.exp(-746.0)
    assert trigonometry.hypot(math.nan, -math.inf) == math.inf
    assert math.isnan(trigonometry.hypot(math.nan, 1.0))
    assert trigonometry.hypot(0.0, -0.0) == 0.0


def test_a_sine_is_odd_to_the_last_bit():
    x = angles()[:3000].tolist()
    assert all(trigonometry.sin(-each) == -trigonometry.sin(each) for each in x)
    assert all(trigonometry.cos(-each) == trigonometry.cos(each) for each in x)

"""Stamps against exact rational arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pwm_node import stamps


def _exact(period: int, pwm_frequency: float) -> tuple[int, int]:
    # Fraction takes a float as the number that it is; round() of it is exact, ties to even
    return divmod(round(period * 10**9 / Fraction(pwm_frequency)), 10**9)


@settings(deadline=None)  # the first one compiles
@given(
    st.integers(0, 2**53),
    st.one_of(st.floats(1e3, 1e5), st.integers(1_000, 100_000).map(float)),
)
@example(70_000, 70_000.0)  # one second: 20 us late with a period of 14286 ns
@example(2, 10_240.0)  # 195312.5 ns: to the even one
@example(6, 10_240.0)  # 585937.5 ns
@example(999_999, 1e5 + 2**-36)  # rounded up into the next second
@example(2**53, 99_999.999999)
@example(2**53, 1e3)
def test_the_stamp_is_the_nearest_nanosecond(period: int, pwm_frequency: float) -> None:
    assert stamps.begin(period, pwm_frequency) == _exact(period, pwm_frequency)


def test_a_whole_second_is_a_second() -> None:
    """The last period of a long second: nanosec never reaches 10^9."""
    # 1e9 (1 - 1e-10) rounds up: found by a frequency just above the period's number
    sec, nanosec = stamps.begin(50_000, 50_000.000001)
    assert (sec, nanosec) == (1, 0) == _exact(50_000, 50_000.000001)


def test_every_period_of_three_seconds_at_70_khz() -> None:
    k = np.arange(0, 210_000, dtype=np.int64)
    told = np.array([sec * 10**9 + ns for sec, ns in (stamps.begin(int(n), 7e4) for n in k)])
    # in whole numbers: 10^9 k / 70000 = 10^5 k / 7, never a tie
    np.testing.assert_array_equal(told, (2 * 100_000 * k + 7) // 14)


def test_it_is_put_into_a_record() -> None:
    stamp = np.zeros(1, [("sec", np.int32), ("nanosec", np.uint32)])
    stamps.put(stamp[0], np.uint64(70_001), 7e4)
    assert (stamp["sec"][0], stamp["nanosec"][0]) == (1, 14_286)
    assert stamps.nanoseconds(stamp).tolist() == [1_000_014_286]


@pytest.mark.parametrize("hertz", [10_000.0, 70_000.0, 16_384.0, 12_345.678, 33_333.3])
@pytest.mark.parametrize("periods", [20, 4_000, 10_000_000])
def test_the_frequency_is_told_from_two_stamps(hertz: float, periods: int) -> None:
    at = [s * 10**9 + ns for s, ns in (stamps.begin(k, hertz) for k in (7, 7 + periods))]
    found = stamps.frequency(*at, periods)
    # as well as the stamps say, and where it has few decimals exactly
    assert found == pytest.approx(hertz, rel=2.0 * hertz / (1e9 * periods))
    if periods > 10_000:
        assert found == hertz


def test_no_frequency_without_time() -> None:
    for first, last, periods in ((5, 5, 1), (5, 9, 0), (9, 5, 2)):
        with pytest.raises(ValueError, match="no PWM period"):
            stamps.frequency(first, last, periods)

"""The stamp of a message: the simulated time at which its PWM period begins.

Period k begins at k / f, with f the PWM frequency, and its stamp is that time to the nearest
nanosecond, for each k by itself. A duration of a period in whole nanoseconds, multiplied, would
drift wherever a period is none: at 70 kHz by 20 us in each second.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pwm_node.compiled import kernel

SECOND = 1_000_000_000  # ns
LAST_SECOND = 2**31 - 1  # s, that a stamp can hold

_BITS = 53  # of the mantissa of a float


@kernel
def begin(period, pwm_frequency):
    """Time at which a period begins, rounded to the nearest nanosecond, a tie to the even one.

    Exact for the frequency as the float that it is: nothing but integers is rounded.

    Parameters
    ----------
    period : int
        Number of the period, 0 to 2^53.
    pwm_frequency : float
        Frequency (Hz).

    Returns
    -------
    sec, nanosec : int
        As in a stamp: nanosec is below 10^9.
    """
    whole = np.int64(pwm_frequency)
    if whole == pwm_frequency:  # as nearly always, and six times as fast
        number = np.int64(period)
        sec = number // whole
        scaled = (number - sec * whole) * SECOND
        nanosec = scaled // whole
        left = scaled - nanosec * whole
    else:
        # What is left of the number after whole seconds; the remainder of floats is exact.
        rest = float(period) % pwm_frequency
        sec = np.int64(round((float(period) - rest) / pwm_frequency))
        # Frequency and rest over the same power of two are integers below 2^53, and a thousand
        # times that is still one of 64 bits: nine digits of the quotient in three steps.
        mantissa, exponent = math.frexp(pwm_frequency)
        whole = np.int64(math.ldexp(mantissa, _BITS))
        left = np.int64(math.ldexp(rest, _BITS - exponent))
        nanosec = np.int64(0)
        for _ in range(3):
            left *= 1000
            nanosec = 1000 * nanosec + left // whole
            left %= whole
    if 2 * left > whole or (2 * left == whole and nanosec % 2 == 1):
        nanosec += 1
    if nanosec == SECOND:
        return sec + 1, 0
    return sec, nanosec


@kernel
def put(stamp, period, pwm_frequency):
    """Set a stamp (a record of `sec` and `nanosec`) to the begin of a period."""
    stamp.sec, stamp.nanosec = begin(period, pwm_frequency)


def at(sec: int, nanosec: int) -> int:
    """A stamp in ns."""
    return sec * SECOND + nanosec


def nanoseconds(stamp: NDArray[np.void]) -> NDArray[np.int64]:
    """Stamps of messages (structured array of `sec` and `nanosec`) in ns."""
    total: NDArray[np.int64] = stamp["sec"].astype(np.int64) * SECOND + stamp["nanosec"]
    return total


def frequency(first: int, last: int, periods: int) -> float:
    """
    The PWM frequency (Hz) from two stamps: the one of fewest decimals that both agree with.

    Parameters
    ----------
    first, last : int
        Stamps (ns), each rounded by up to half a nanosecond.
    periods : int
        Number of periods between them, above 0.

    Raises
    ------
    ValueError
        If the later stamp is not the greater.
    """
    if periods <= 0 or last <= first:
        raise ValueError(f"no PWM period follows from {periods} periods in {last - first} ns")
    exact = SECOND * periods / (last - first)
    for digits in range(-5, 12):
        rounded = round(exact, digits)
        if rounded > 0.0 and abs(SECOND * periods / rounded - (last - first)) <= 1.0:
            return rounded
    return exact

"""Sine, cosine, exponential and length as kernels: the same bits on every machine.

A C library rounds the last digit of a sine as it likes, and two of them differ; sums, products and
roots are rounded the same way everywhere (IEEE 754). These kernels use nothing else.

*Sine and cosine.* The angle less the nearest multiple of pi/2, which is subtracted in three parts:
the first two have so few digits that their products with the multiple are exact up to 10^5 rad.
What is left is within pi/4, where the first terms of the power series are good to 1e-19. *The
exponential* in the same way, by multiples of ln 2.

Errors in units in the last place, which test_trigonometry.py measures: below 0.8 of the sine and
the cosine up to 10^5 rad, 0.85 of the exponential, 1.3 of the length.
"""

from __future__ import annotations

import math
from typing import Any

from pwm_node.compiled import kernel

# pi/2 in parts of 33, 33 and 53 bits, and ln 2 in parts of 33 and 53 bits
_HALF_PI_1 = 1.5707963267341256
_HALF_PI_2 = 6.077100506303966e-11
_HALF_PI_3 = 2.0222662487959506e-21
_PER_HALF_PI = 2.0 / math.pi
_LN_2_1 = 0.6931471804855391
_LN_2_2 = 7.440617110012397e-11
_PER_LN_2 = 1.0 / math.log(2.0)

# Beyond these the exponential is infinite, or nothing.
_MOST, _LEAST = 709.782712893384, -745.1332191019412
# Between these a square is neither infinite nor rounded as a denormal number.
_SMALL, _LARGE = 1e-140, 1e140


@kernel
def _reduced(angle):
    """The nearest multiple of pi/2, modulo 4, and what is left of the angle in two parts."""
    n = math.floor(angle * _PER_HALF_PI + 0.5)
    k = float(n)
    first = angle - k * _HALF_PI_1
    product = k * _HALF_PI_2
    high = first - product
    low = (first - high) - product - k * _HALF_PI_3
    rest = high + low
    return n % 4, rest, (high - rest) + low


@kernel
def _sine(x, low):
    """Sine of x + low, within pi/4."""
    z = x * x
    series = 1.0 / 6227020800 - z * (1.0 / 1307674368000 - z * (1.0 / 355687428096000))
    series = 1.0 / 362880 - z * (1.0 / 39916800 - z * series)
    series = 1.0 / 6 - z * (1.0 / 120 - z * (1.0 / 5040 - z * series))
    return x - (z * x * series - low * (1.0 - 0.5 * z))


@kernel
def _cosine(x, low):
    """Cosine of x + low, within pi/4."""
    z = x * x
    series = 1.0 / 479001600 - z * (1.0 / 87178291200 - z * (1.0 / 20922789888000))
    series = 1.0 / 24 - z * (1.0 / 720 - z * (1.0 / 40320 - z * (1.0 / 3628800 - z * series)))
    half = 0.5 * z
    most = 1.0 - half
    return most + (((1.0 - most) - half) + (z * z * series - x * low))


@kernel
def sin(angle):
    """Sine of an angle (rad)."""
    quarter, x, low = _reduced(angle)
    if quarter == 0:
        return _sine(x, low)
    if quarter == 1:
        return _cosine(x, low)
    if quarter == 2:
        return -_sine(x, low)
    return -_cosine(x, low)


@kernel
def cos(angle):
    """Cosine of an angle (rad)."""
    quarter, x, low = _reduced(angle)
    if quarter == 0:
        return _cosine(x, low)
    if quarter == 1:
        return -_sine(x, low)
    if quarter == 2:
        return -_cosine(x, low)
    return _sine(x, low)


@kernel
def exp(x):
    """e to the power of x."""
    if x > _MOST:
        return math.inf
    if x < _LEAST:
        return 0.0
    n = math.floor(x * _PER_LN_2 + 0.5)
    k = float(n)
    high = x - k * _LN_2_1
    low = k * _LN_2_2
    r = high - low
    low = (high - r) - low
    series = 1.0 / 39916800 + r * (1.0 / 479001600 + r * (1.0 / 6227020800))
    series = 1.0 / 40320 + r * (1.0 / 362880 + r * (1.0 / 3628800 + r * series))
    series = 1.0 / 24 + r * (1.0 / 120 + r * (1.0 / 720 + r * (1.0 / 5040 + r * series)))
    series = r * r * (0.5 + r * (1.0 / 6 + r * series))
    return math.ldexp(1.0 + (r + (series + low)), n)


@kernel
def hypot(x, y):
    """Length of the vector (x, y)."""
    a, b = abs(x), abs(y)
    if a == math.inf or b == math.inf:
        return math.inf
    largest = max(a, b)
    if largest > _LARGE:
        return 1e160 * math.sqrt((a * 1e-160) * (a * 1e-160) + (b * 1e-160) * (b * 1e-160))
    if largest < _SMALL:
        return 1e-160 * math.sqrt((a * 1e160) * (a * 1e160) + (b * 1e160) * (b * 1e160))
    return math.sqrt(a * a + b * b)


#: What is called in the place of the C library's.
STAND_INS: dict[Any, Any] = {math.sin: sin, math.cos: cos, math.exp: exp, math.hypot: hypot}

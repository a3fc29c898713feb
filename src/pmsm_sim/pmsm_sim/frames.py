"""Between frames: from a space vector to phases (amplitude-invariant)."""

from __future__ import annotations

import math

from pwm_node.compiled import inlined

_SQRT3_2 = 0.5 * math.sqrt(3.0)


@inlined
def stationary(d, q, c, s):
    """A vector of the rotor frame in the stationary one; c, s: cosine and sine of its angle."""
    return c * d - s * q, s * d + c * q


@inlined
def phases(alpha, beta):
    """Values of phases a, b, c of a vector in the stationary frame."""
    return alpha, -0.5 * alpha + _SQRT3_2 * beta, -0.5 * alpha - _SQRT3_2 * beta

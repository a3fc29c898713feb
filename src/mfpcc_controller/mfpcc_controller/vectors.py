"""The inverter's basic vectors as the controller sees them."""

from __future__ import annotations

import math

import numpy as np

from pwm_node.compiled import kernel

#: V0..V6 over u_dc, stationary frame: `2/3 exp(1j (j - 1) pi / 3)`, V0 = 0 (method section 1)
BASIC_VECTORS = np.array(
    [0.0] + [2.0 / 3.0 * np.exp(1j * (j - 1) * math.pi / 3.0) for j in range(1, 7)],
    dtype=np.complex128,
)

#: Upper switches (a, b, c) of V0..V6
LEGS = np.array(
    [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 1.0, 1.0],
        [0.0, 0.0, 1.0],
        [1.0, 0.0, 1.0],
    ]
)


@kernel
def mean_voltage(out, u_dc):
    """Mean stator voltage (V, stationary frame) of one period with output `out`."""
    return u_dc * (out.d_a * BASIC_VECTORS[out.a] + out.d_b * BASIC_VECTORS[out.b])


@kernel
def leg_duties(out, duty):
    """Centre-aligned leg duties of one output: `d_x = d_0/2 + d_a S_a,x + d_b S_b,x`.

    A single vector (d_a = 1) gives duties of 0 and 1.
    """
    d_0 = 1.0 - out.d_a - out.d_b
    for x in range(3):
        d = 0.5 * d_0 + out.d_a * LEGS[out.a, x] + out.d_b * LEGS[out.b, x]
        # rounding may leave 0..1 by one unit in the last place; the inverter would refuse it
        duty[x] = min(max(d, 0.0), 1.0)

"""The inverter's basic vectors and outputs, and small operations on space vectors."""

from __future__ import annotations

import math

import numpy as np

from pwm_node.compiled import kernel

#: Directions of V0..V6, stationary frame: `exp(1j (j - 1) pi / 3)`, and 0 for V0
DIRECTIONS = np.array(
    [0.0] + [np.exp(1j * (j - 1) * math.pi / 3.0) for j in range(1, 7)], dtype=np.complex128
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

SIN_60 = 0.5 * math.sqrt(3.0)
_INV_SQRT3 = 1.0 / math.sqrt(3.0)
_THIRD = 1.0 / 3.0

#: Length of an active vector over u_dc (method section 1)
ACTIVE_LENGTH = 2.0 / 3.0


@kernel
def scaled(factor, z):
    """Real factor times complex z; written as a product, the compiler would multiply 0j too."""
    return complex(factor * z.real, factor * z.imag)


@kernel
def square(z):
    """|z|^2."""
    return z.real * z.real + z.imag * z.imag


@kernel
def cross(u, v):
    """Area of the parallelogram that u and v span, positive if v is ahead of u."""
    return u.real * v.imag - u.imag * v.real


@kernel
def next_vector(u):
    """u turned by 60 degrees: from a basic vector to the one after it."""
    return complex(0.5 * u.real - SIN_60 * u.imag, 0.5 * u.imag + SIN_60 * u.real)


@kernel
def set_output(out, a, b, d_a, d_b):
    """Fill an `OUTPUT` record: vectors, dwell times, mean voltage."""
    out.a, out.b, out.d_a, out.d_b = a, b, d_a, d_b
    out.u = scaled(ACTIVE_LENGTH * d_a, DIRECTIONS[a]) + scaled(ACTIVE_LENGTH * d_b, DIRECTIONS[b])


@kernel
def copy_output(source, target):
    """Copy an `OUTPUT` record."""
    target.a, target.b = source.a, source.b
    target.d_a, target.d_b = source.d_a, source.d_b
    target.u, target.on = source.u, source.on


@kernel
def leg_duties(out, duty):
    """Centre-aligned leg duties of one output: `d_x = d_0/2 + d_a S_a,x + d_b S_b,x`.

    A single vector (d_a = 1) gives duties of 0 and 1.
    """
    half = 0.5 * (1.0 - out.d_a - out.d_b)
    for x in range(3):
        d = half + out.d_a * LEGS[out.a, x] + out.d_b * LEGS[out.b, x]
        # rounding may leave 0..1 by one unit in the last place; the inverter would refuse it
        duty[x] = min(max(d, 0.0), 1.0)


@kernel
def signs(slope, i_dq, turn):
    """Space vector (dq) of the signs of the phase currents."""
    i_ab = i_dq * turn.conjugate()
    i_a = i_ab.real
    i_b = -0.5 * i_a + SIN_60 * i_ab.imag
    s_a = min(max(slope * i_a, -1.0), 1.0)
    s_b = min(max(slope * i_b, -1.0), 1.0)
    s_c = min(max(-slope * (i_a + i_b), -1.0), 1.0)
    return complex(_THIRD * (2.0 * s_a - s_b - s_c), _INV_SQRT3 * (s_b - s_c)) * turn

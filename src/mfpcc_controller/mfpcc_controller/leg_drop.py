"""Voltage that the inverter's legs lose against their currents, learned from prediction errors.

Dead time and on-state voltages take away from each leg a voltage V whose sign is that of its
current: together `-V s` with the space vector s of the three signs, which jumps by 60 degrees six
times per turn (Bose and Leggate's classical picture of dead time; see Choi and Sul 1996,
doi:10.1109/28.511645). A table of gradients follows such jumps with a delay each time. They can be
told apart from everything else just because they move: V is fitted to the deviation of their effect
from its mean, as the map of `mls_mfpcc` is to that of the voltage.
"""

from __future__ import annotations

import numpy as np

from mfpcc_controller.vectors import SIN_60, scaled, square
from pwm_node.compiled import kernel

_RATE = 0.01

# Currents of this share of the limit have a sign; below it goes over smoothly, as that of a leg
# does (the current of a leg ripples, and is clamped at zero).
_WIDTH = 0.01

# Movement of the effect below which little is learned, over its square: slower than this it moves
# at very low speed, where the table follows it anyway.
_FLOOR = 0.01

# Largest voltage, over u_dc
_MOST = 0.1

MEMORY = np.dtype(
    [
        ("volts", np.float64),  # lost in each leg (V)
        ("effect", np.complex128),  # of 1 V (A, dq), its mean and mean square deviation
        ("mean", np.complex128),
        ("variance", np.float64),
    ],
    align=True,
)


@kernel
def signs(cfg, i_ab):
    """Space vector of the signs of the phase currents (stationary frame)."""
    slope = 1.0 / (_WIDTH * cfg.i_max)
    i_a = i_ab.real
    i_b = -0.5 * i_a + SIN_60 * i_ab.imag
    s_a = min(max(slope * i_a, -1.0), 1.0)
    s_b = min(max(slope * i_b, -1.0), 1.0)
    s_c = min(max(-slope * (i_a + i_b), -1.0), 1.0)
    return complex((2.0 * s_a - s_b - s_c) / 3.0, (s_b - s_c) * SIN_60 / 1.5)


@kernel
def learn(drop, e, u_dc, gamma):
    """Correct V by the part of the error e (A) that moves with `drop.effect`.

    `drop` is a `MEMORY`; its effect is that of 1 V in the period of the error. `gamma` is the share
    of a period in the memory of the means.
    """
    moving = drop.effect - drop.mean
    moving_sq = square(moving)
    scale = drop.variance + moving_sq + _FLOOR * square(drop.effect)
    if scale > 0.0:
        drop.volts += _RATE * (e.real * moving.real + e.imag * moving.imag) / scale
        drop.volts = min(max(drop.volts, 0.0), _MOST * u_dc)
    drop.mean += scaled(gamma, moving)
    drop.variance += gamma * (moving_sq - drop.variance)

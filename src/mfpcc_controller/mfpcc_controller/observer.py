"""Rotor observer: electrical speed from the encoder angle by a phase-locked loop."""

from __future__ import annotations

import math

from pwm_node.compiled import kernel

_TWO_PI = 2.0 * math.pi
_TURNS = 1.0 / _TWO_PI


@kernel
def wrapped(angle):
    """The same angle in [-pi, pi)."""
    return angle - _TWO_PI * math.floor(angle * _TURNS + 0.5)


@kernel
def observe(cfg, mem):
    """Update `mem.w_m` from the measured angle `mem.theta_m`.

    Second-order tracking with both poles at the bandwidth. The second sample sets the speed from
    the difference of two angles, so the loop starts in lock at any speed. `mem.jitter` is by how
    much the encoder's own error (its steps, its noise) has changed since the sample before: what
    the loop is too slow to follow.
    """
    error = wrapped(mem.theta_m - mem.pll_theta)
    mem.jitter = 0.0
    if not abs(error) < 4.0:
        # an angle that is no number must not stay in the loop
        mem.pll_samples = 0
        return
    if mem.pll_samples >= 2:
        mem.jitter = error - mem.pll_error
        mem.pll_error = error
        mem.w_m += cfg.T_s * cfg.pll_k_i * error
        mem.pll_theta = wrapped(mem.pll_theta + cfg.T_s * (mem.w_m + cfg.pll_k_p * error))
        return
    mem.pll_error = 0.0
    # the first sample knows an angle only
    mem.w_m = 0.0 if mem.pll_samples == 0 else error / cfg.T_s
    mem.pll_theta = wrapped(mem.theta_m + cfg.T_s * mem.w_m)
    mem.pll_samples += 1


@kernel
def turned_by(angle):
    """exp(-1j angle), cheaply where the angle is small: to rounding error below 0.1 rad."""
    x = angle * angle
    if x > 0.01:
        return complex(math.cos(angle), -math.sin(angle))
    c = 1.0 - x * (0.5 - x * (1.0 / 24 - x * (1.0 / 720 - x * (1.0 / 40320))))
    s = angle * (1.0 - x * (1.0 / 6 - x * (1.0 / 120 - x * (1.0 / 5040 - x * (1.0 / 362880)))))
    return complex(c, -s)

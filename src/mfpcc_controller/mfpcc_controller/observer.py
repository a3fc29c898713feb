"""Rotor observer: electrical speed from the encoder angle by a phase-locked loop."""

from __future__ import annotations

import math

from pwm_node.compiled import kernel

_TWO_PI = 2.0 * math.pi


@kernel
def wrapped(angle):
    """The same angle in [-pi, pi)."""
    return angle - _TWO_PI * math.floor(angle / _TWO_PI + 0.5)


@kernel
def observe(cfg, mem):
    """Update `mem.w_m` from the measured angle `mem.theta_m`.

    Second-order tracking with both poles at the bandwidth. The second sample sets the speed from
    the difference of two angles, so the loop starts in lock at any speed.
    """
    error = wrapped(mem.theta_m - mem.pll_theta)
    if mem.pll_samples == 0:
        mem.w_m = 0.0
        error = 0.0
        mem.pll_theta = mem.theta_m
    elif mem.pll_samples == 1:
        mem.w_m = error / cfg.T_s
        error = 0.0
        mem.pll_theta = mem.theta_m
    else:
        mem.w_m += cfg.T_s * cfg.pll_k_i * error
    if mem.pll_samples < 2:
        mem.pll_samples += 1
    mem.pll_theta = wrapped(mem.pll_theta + cfg.T_s * (mem.w_m + cfg.pll_k_p * error))

"""Torques on the shaft: load, friction and cogging.

Friction and brakes oppose the motion. Around standstill, where their sign is not defined, they
grow smoothly with speed, sign(w) ~ w / sqrt(w^2 + w_0^2), so a shaft held by them creeps below
w_0 instead of standing still.
"""

from __future__ import annotations

import math

from pmsm_sim.records import LOAD_KINDS
from pwm_node.compiled import kernel

_BRAKE = LOAD_KINDS.index("brake")

# Speed below which friction is not fully there (rad/s; 1 r/min).
STANDSTILL = 0.1


@kernel
def _sign(w):
    return w / math.sqrt(w * w + STANDSTILL * STANDSTILL)


@kernel
def friction(par, w_M):
    """Viscous and Coulomb friction (N m): B w + tau_C sign(w)."""
    return par.B * w_M + par.coulomb * _sign(w_M)


@kernel
def cogging(par, theta_M):
    """Cogging torque (N m): -tau sin(N theta_M), N periods per turn."""
    if par.cogging_torque == 0.0:
        return 0.0
    return -par.cogging_torque * math.sin(par.cogging_periods * theta_M)


@kernel
def profile(par, t):
    """Load torque (N m) of the profile at the simulated time t (s): straight lines between its
    points, constant before and after them."""
    last = par.profile_points - 1
    if last < 0:
        return 0.0
    if t <= par.profile_t[0]:
        return par.profile_tau[0]
    for n in range(last):
        t_0, t_1 = par.profile_t[n], par.profile_t[n + 1]
        if t < t_1:
            x = (t - t_0) / (t_1 - t_0)
            return par.profile_tau[n] + x * (par.profile_tau[n + 1] - par.profile_tau[n])
    return par.profile_tau[last]


@kernel
def load_torque(par, period, t, w, tau_brake):
    """Torque of the load (N m) at the speed w (rad/s), t (s) after the period began.

    `torque`: as given, whatever the speed. `brake`: a magnetic powder brake, whose torque opposes
    the motion and follows its command with a first-order lag. Both: plus quadratic part (fan,
    pump) k w |w| and profile.
    """
    tau = tau_brake * _sign(w) if par.load_kind == _BRAKE else par.tau_L
    tau += par.quadratic * w * abs(w)
    if par.profile_points > 0:
        tau += profile(par, period * par.T_s + t)
    return tau

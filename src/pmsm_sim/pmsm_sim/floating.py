"""One step of the general model while some leg carries no current, or none does.

The machine current in the rotor frame is integrated here, by the classical fourth-order
Runge-Kutta method: the terminal of a floating leg has the voltage at which the current of its phase
has no derivative (`bridge.solve`).
"""

from __future__ import annotations

import math

from pmsm_sim.bridge import rail_current, solve
from pmsm_sim.columns import N_INTEGRATED, column
from pmsm_sim.frames import stationary
from pmsm_sim.parts.dc_link import charge
from pmsm_sim.parts.machine import cogging, flux
from pmsm_sim.parts.mechanics import move
from pmsm_sim.parts.sensors import low_pass
from pwm_node.compiled import kernel

_I_D, _I_Q = column("i_d"), column("i_q")
_W_M, _TURN_M, _U_DC = column("w_M"), column("turn_M"), column("u_dc")
_W_L, _TWIST, _TAU_BRAKE = column("w_L"), column("twist"), column("tau_brake")
_SUPPLY, _DC, _INVERTER = column("supply"), column("dc"), column("inverter")
_COPPER, _IRON, _FRICTION = column("copper"), column("iron"), column("friction")
_LOAD, _CHOPPER = column("load"), column("chopper")
_I_F_ALPHA, _I_F_BETA = column("i_f_alpha"), column("i_f_beta")
_C, _S, _TAU_M = column("c"), column("s"), column("tau_M")
_PSI_ALPHA, _PSI_BETA = column("psi_alpha"), column("psi_beta")
_I_ALPHA, _I_BETA = column("i_alpha"), column("i_beta")
_PSI_D, _PSI_Q = column("psi_d"), column("psi_q")
_L_DD, _L_DQ, _L_QQ = column("L_dd"), column("L_dq"), column("L_qq")

# Rows of the work space for the four derivatives
_K = 3


@kernel
def solve_at(par, st, y):
    """Fill `st.electric` for the instant y."""
    theta_m = par.n_p * (st.theta_M + y[_TURN_M])
    w_m = par.n_p * y[_W_M]
    c, s = math.cos(theta_m), math.sin(theta_m)
    solve(par, st.bridge, st.electric, y[_I_D], y[_I_Q], w_m, c, s, y[_U_DC])


@kernel
def complete(par, st, y):
    """Fill what follows from current, angle and speed at the instant y."""
    theta_M = st.theta_M + y[_TURN_M]
    c, s = math.cos(par.n_p * theta_M), math.sin(par.n_p * theta_M)
    i_d, i_q = y[_I_D], y[_I_Q]
    psi_d, psi_q, turn_d, turn_q, L_dd, L_dq, L_qq = flux(par, i_d, i_q, c, s)
    y[_C], y[_S] = c, s
    y[_I_ALPHA], y[_I_BETA] = stationary(i_d, i_q, c, s)
    y[_PSI_ALPHA], y[_PSI_BETA] = stationary(psi_d, psi_q, c, s)
    y[_PSI_D], y[_PSI_Q] = psi_d, psi_q
    y[_L_DD], y[_L_DQ], y[_L_QQ] = L_dd, L_dq, L_qq
    tau = psi_d * i_q - psi_q * i_d + turn_d * i_d + turn_q * i_q
    y[_TAU_M] = 1.5 * par.n_p * tau + cogging(par, theta_M)


@kernel
def _derivative(par, st, t, y, dy):
    """Time derivative of all integrated quantities, t (s) after the period began.

    Returns the stator current (A) in the stationary frame.
    """
    solve_at(par, st, y)
    el = st.electric
    dy[_I_D], dy[_I_Q] = el.di_d, el.di_q
    dy[_COPPER] = 1.5 * par.R_s * (el.i_alpha**2 + el.i_beta**2)
    dy[_IRON] = 1.5 * par.iron_conductance * (el.e_alpha**2 + el.e_beta**2)
    i_dc, dy[_INVERTER] = rail_current(st.bridge, el)
    u_dc = y[_U_DC]
    dy[_DC] = u_dc * i_dc
    dy[_U_DC], dy[_SUPPLY], dy[_CHOPPER] = charge(par, st.period, t, st.chopping, u_dc, i_dc)
    tau_M = el.torque + cogging(par, st.theta_M + y[_TURN_M])
    dy[_TURN_M] = y[_W_M]
    dy[_W_M], dy[_W_L], dy[_TWIST], dy[_TAU_BRAKE], dy[_FRICTION], dy[_LOAD] = move(
        par, st.period, t, y[_W_M], y[_W_L], y[_TWIST], y[_TAU_BRAKE], tau_M
    )
    return el.i_alpha, el.i_beta


@kernel
def floating_step(par, st, y, y_end, t, h):
    """Step of length h (s) from the instant y at t (s) to y_end, which is not complete then."""
    k_1, k_2, k_3, k_4 = st.work[_K], st.work[_K + 1], st.work[_K + 2], st.work[_K + 3]
    half = 0.5 * h
    start = _derivative(par, st, t, y, k_1)
    for n in range(N_INTEGRATED):
        y_end[n] = y[n] + half * k_1[n]
    _derivative(par, st, t + half, y_end, k_2)
    for n in range(N_INTEGRATED):
        y_end[n] = y[n] + half * k_2[n]
    middle = _derivative(par, st, t + half, y_end, k_3)
    for n in range(N_INTEGRATED):
        y_end[n] = y[n] + h * k_3[n]
    end = _derivative(par, st, t + h, y_end, k_4)
    sixth = h / 6.0
    for n in range(N_INTEGRATED):
        y_end[n] = y[n] + sixth * (k_1[n] + 2.0 * (k_2[n] + k_3[n]) + k_4[n])
    if par.filter_rate > 0.0:
        i_f = y[_I_F_ALPHA], y[_I_F_BETA]
        y_end[_I_F_ALPHA], y_end[_I_F_BETA] = low_pass(par, h, i_f, start, middle, end)

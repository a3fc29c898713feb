"""One step of the general model while some leg carries no current, and there is no iron loss.

The machine current in the rotor frame is integrated here, by the classical fourth-order
Runge-Kutta method: the terminal of a floating leg has the voltage at which the current of its phase
has no derivative (`bridge.solve`).
"""

from __future__ import annotations

import math

from pmsm_sim import columns as col
from pmsm_sim.bridge import rail_current, solve
from pmsm_sim.frames import stationary
from pmsm_sim.parts.dc_link import charge
from pmsm_sim.parts.machine import cogging, flux
from pmsm_sim.parts.mechanics import move
from pmsm_sim.parts.sensors import low_pass
from pwm_node.compiled import kernel

# Rows of the work space for the four derivatives
_K = 3


@kernel
def solve_at(par, st, y):
    """Fill `st.electric` for the instant y."""
    theta_m = par.n_p * (st.theta_M + y[col.TURN_M])
    w_m = par.n_p * y[col.W_M]
    c, s = math.cos(theta_m), math.sin(theta_m)
    solve(par, st.bridge, st.electric, y[col.I_D], y[col.I_Q], w_m, c, s, y[col.U_DC])


@kernel
def complete(par, st, y):
    """Fill what follows from current, angle and speed at the instant y."""
    theta_M = st.theta_M + y[col.TURN_M]
    c, s = math.cos(par.n_p * theta_M), math.sin(par.n_p * theta_M)
    i_d, i_q = y[col.I_D], y[col.I_Q]
    psi_d, psi_q, turn_d, turn_q, L_dd, L_dq, L_qd, L_qq = flux(par, i_d, i_q, c, s)
    y[col.C], y[col.S] = c, s
    y[col.I_ALPHA], y[col.I_BETA] = stationary(i_d, i_q, c, s)
    y[col.PSI_ALPHA], y[col.PSI_BETA] = stationary(psi_d, psi_q, c, s)
    y[col.PSI_D], y[col.PSI_Q] = psi_d, psi_q
    y[col.L_DD], y[col.L_DQ], y[col.L_QD], y[col.L_QQ] = L_dd, L_dq, L_qd, L_qq
    tau = psi_d * i_q - psi_q * i_d + turn_d * i_d + turn_q * i_q
    y[col.TAU_M] = 1.5 * par.n_p * tau + cogging(par, theta_M)


@kernel
def _derivative(par, st, t, y, dy):
    """Time derivative of all integrated quantities, t (s) after the period began.

    Returns the stator current (A) in the stationary frame.
    """
    solve_at(par, st, y)
    el = st.electric
    dy[col.I_D], dy[col.I_Q] = el.di_d, el.di_q
    dy[col.COPPER] = 1.5 * par.R_s * (el.i_alpha**2 + el.i_beta**2)
    dy[col.IRON] = 0.0
    i_dc, dy[col.INVERTER] = rail_current(st.bridge, el)
    u_dc = y[col.U_DC]
    dy[col.DC] = u_dc * i_dc
    dy[col.U_DC], dy[col.SUPPLY], dy[col.CHOPPER] = charge(
        par, st.period, t, st.chopping, u_dc, i_dc
    )
    tau_M = el.torque + cogging(par, st.theta_M + y[col.TURN_M])
    dy[col.TURN_M] = y[col.W_M]
    dy[col.W_M], dy[col.W_L], dy[col.TWIST], dy[col.TAU_BRAKE], dy[col.FRICTION], dy[col.LOAD] = (
        move(par, st.period, t, y[col.W_M], y[col.W_L], y[col.TWIST], y[col.TAU_BRAKE], tau_M)
    )
    return el.i_alpha, el.i_beta


@kernel
def floating_step(par, st, y, y_end, t, h):
    """Step of length h (s) from the instant y at t (s) to y_end, which is not complete then."""
    k_1, k_2, k_3, k_4 = st.work[_K], st.work[_K + 1], st.work[_K + 2], st.work[_K + 3]
    half = 0.5 * h
    start = _derivative(par, st, t, y, k_1)
    for n in range(col.N_INTEGRATED):
        y_end[n] = y[n] + half * k_1[n]
    alpha_2, beta_2 = _derivative(par, st, t + half, y_end, k_2)
    for n in range(col.N_INTEGRATED):
        y_end[n] = y[n] + half * k_2[n]
    alpha_3, beta_3 = _derivative(par, st, t + half, y_end, k_3)
    for n in range(col.N_INTEGRATED):
        y_end[n] = y[n] + h * k_3[n]
    end = _derivative(par, st, t + h, y_end, k_4)
    sixth = h / 6.0
    for n in range(col.N_INTEGRATED):
        y_end[n] = y[n] + sixth * (k_1[n] + 2.0 * (k_2[n] + k_3[n]) + k_4[n])
    if par.filter_rate > 0.0:
        i_f = y[col.I_F_ALPHA], y[col.I_F_BETA]
        middle = 0.5 * (alpha_2 + alpha_3), 0.5 * (beta_2 + beta_3)
        y_end[col.I_F_ALPHA], y_end[col.I_F_BETA] = low_pass(par, h, i_f, start, middle, end)

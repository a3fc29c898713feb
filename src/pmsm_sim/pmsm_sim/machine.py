"""Machine and mechanics between two switching instants.

Rotor-frame equations of method section 1, integrated with the classical fourth-order
Runge-Kutta method. The stator voltage is constant in the stationary frame, so it turns in the
rotor frame; the turn inside one step is small, and its sine and cosine are polynomials.
"""

from __future__ import annotations

from pwm_node.compiled import kernel

# Largest electrical angle (rad) that one step may cover: keeps the error of the integration
# below 1e-9 A per period and the polynomials below rounding error.
MAX_STEP_ANGLE = 0.06


@kernel
def small_rotation(x):
    """(cos x, sin x) for |x| below 0.15, to rounding error."""
    y = x * x
    c = 1.0 - y * (0.5 - y * (1.0 / 24 - y * (1.0 / 720 - y * (1.0 / 40320 - y / 3628800))))
    s = x * (1.0 - y * (1.0 / 6 - y * (1.0 / 120 - y * (1.0 / 5040 - y / 362880))))
    return c, s


@kernel
def flux(par, i_d, i_q):
    """Flux linkage (psi_d, psi_q) (V s) and incremental inductances (L_dd, L_dq, L_qq) (H)."""
    return par.psi_f + par.L_d * i_d, par.L_q * i_q, par.L_d, 0.0, par.L_q


@kernel
def torque(par, i_d, i_q):
    """Electromagnetic torque (N m)."""
    return 1.5 * par.n_p * (par.psi_f + (par.L_d - par.L_q) * i_d) * i_q


@kernel
def derivative(par, i_d, i_q, w_M, u_d, u_q):
    """(di_d/dt, di_q/dt, dw_M/dt) in A/s and rad/s^2."""
    w_m = par.n_p * w_M
    di_d = (u_d - par.R_s * i_d + w_m * par.L_q * i_q) / par.L_d
    di_q = (u_q - par.R_s * i_q - w_m * (par.L_d * i_d + par.psi_f)) / par.L_q
    tau_M = torque(par, i_d, i_q)
    return di_d, di_q, (tau_M - par.tau_L - par.B * w_M) / par.J


@kernel
def step(par, i_d, i_q, w_M, c, s, u_alpha, u_beta, h):
    """One Runge-Kutta step of length h (s) at constant stator voltage.

    Parameters
    ----------
    i_d, i_q, w_M : float
        State at the start (A, A, rad/s).
    c, s : float
        Cosine and sine of the electrical angle at the start.
    u_alpha, u_beta : float
        Stator voltage in the stationary frame (V).

    Returns
    -------
    (i_d, i_q, w_M, turn_M, energy) : state at the end, mechanical angle turned (rad), energy
        taken in (J).
    """
    u_d = c * u_alpha + s * u_beta
    u_q = c * u_beta - s * u_alpha
    half = 0.5 * h

    d_1, q_1, w_1 = derivative(par, i_d, i_q, w_M, u_d, u_q)
    p_1 = u_d * i_d + u_q * i_q

    c_2, s_2 = small_rotation(par.n_p * w_M * half)
    u_d2 = c_2 * u_d + s_2 * u_q
    u_q2 = c_2 * u_q - s_2 * u_d
    i_d2, i_q2, w_M2 = i_d + half * d_1, i_q + half * q_1, w_M + half * w_1
    d_2, q_2, w_2 = derivative(par, i_d2, i_q2, w_M2, u_d2, u_q2)
    p_2 = u_d2 * i_d2 + u_q2 * i_q2

    c_3, s_3 = small_rotation(par.n_p * w_M2 * half)
    u_d3 = c_3 * u_d + s_3 * u_q
    u_q3 = c_3 * u_q - s_3 * u_d
    i_d3, i_q3, w_M3 = i_d + half * d_2, i_q + half * q_2, w_M + half * w_2
    d_3, q_3, w_3 = derivative(par, i_d3, i_q3, w_M3, u_d3, u_q3)
    p_3 = u_d3 * i_d3 + u_q3 * i_q3

    c_4, s_4 = small_rotation(par.n_p * w_M3 * h)
    u_d4 = c_4 * u_d + s_4 * u_q
    u_q4 = c_4 * u_q - s_4 * u_d
    i_d4, i_q4, w_M4 = i_d + h * d_3, i_q + h * q_3, w_M + h * w_3
    d_4, q_4, w_4 = derivative(par, i_d4, i_q4, w_M4, u_d4, u_q4)
    p_4 = u_d4 * i_d4 + u_q4 * i_q4

    sixth = h / 6.0
    return (
        i_d + sixth * (d_1 + 2.0 * (d_2 + d_3) + d_4),
        i_q + sixth * (q_1 + 2.0 * (q_2 + q_3) + q_4),
        w_M + sixth * (w_1 + 2.0 * (w_2 + w_3) + w_4),
        sixth * (w_M + 2.0 * (w_M2 + w_M3) + w_M4),
        1.5 * sixth * (p_1 + 2.0 * (p_2 + p_3) + p_4),
    )

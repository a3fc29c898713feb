"""One PWM period without any effect that costs time: ideal switches, linear machine, one mass.

Rotor-frame equations of method section 1. Between two switching instants everything is smooth, so
the solution is a power series; its coefficients follow from one another by the equations
themselves (Taylor-series integration: Corliss and Chang 1982, doi:10.1145/355993.355995). With
x = t / h in 0..1,

    i_d(t) = sum_n d_n x^n,    w_m i_q = sum_n x^n sum_j w_j q_(n-j),    ...

A step costs half of what a Runge-Kutta step of the same order does, the order can follow the length
of the interval, and the series gives the waveform at any instant besides.
"""

from __future__ import annotations

import math

from pmsm_sim.frames import phases, stationary
from pmsm_sim.parts.inverter import leg_voltage, set_pattern
from pmsm_sim.parts.part import MOST_STEPS
from pwm_node.compiled import inlined, kernel

# Largest electrical angle (rad) that one step may cover: keeps the error of the integration
# below 1e-9 A per period and the polynomials of `small_rotation` below rounding error.
MAX_STEP_ANGLE = 0.06

# Up to these lengths of a step (in periods) order 3 and 4 are enough; beyond, it is 5.
_ORDER_3 = 0.04
_ORDER_4 = 0.2


@inlined
def small_rotation(x):
    """(cos x, sin x) for |x| up to `MAX_STEP_ANGLE`, to rounding error."""
    y = x * x
    c = 1.0 - y * (0.5 - y * (1.0 / 24 - y * (1.0 / 720)))
    s = x * (1.0 - y * (1.0 / 6 - y * (1.0 / 120 - y * (1.0 / 5040))))
    return c, s


@kernel
def _series(k, h, order, d_0, q_0, w_0, u_d0, u_q0):
    """Coefficients of i_d, i_q (A) and w_m (rad/s) over one step of length h (s).

    `k` are the constants of the equations, `order` is 3, 4 or 5, `u_d0` and `u_q0` the voltage (V)
    in the rotor frame at the start; it is constant in the stationary frame, so it turns with -w_m.
    """
    inv_L_d, inv_L_q, R, L_d, L_q, psi_f, k_psi, k_L, k_B, k_tau = k
    h_d, h_q = h * inv_L_d, h * inv_L_q
    h_2, h_3, h_4, h_5 = 0.5, 1.0 / 3.0, 0.25, 0.2

    d_1 = h_d * (u_d0 - R * d_0 + L_q * (w_0 * q_0))
    q_1 = h_q * (u_q0 - R * q_0 - w_0 * (L_d * d_0 + psi_f))
    w_1 = h * ((k_psi + k_L * d_0) * q_0 - k_B * w_0 - k_tau)
    u_d1 = h * (w_0 * u_q0)
    u_q1 = -h * (w_0 * u_d0)

    d_2 = h_2 * h_d * (u_d1 - R * d_1 + L_q * (w_0 * q_1 + w_1 * q_0))
    q_2 = h_2 * h_q * (u_q1 - R * q_1 - L_d * (w_0 * d_1 + w_1 * d_0) - psi_f * w_1)
    w_2 = h_2 * h * (k_psi * q_1 + k_L * (d_0 * q_1 + d_1 * q_0) - k_B * w_1)
    u_d2 = h_2 * h * (w_0 * u_q1 + w_1 * u_q0)
    u_q2 = -h_2 * h * (w_0 * u_d1 + w_1 * u_d0)

    d_3 = h_3 * h_d * (u_d2 - R * d_2 + L_q * (w_0 * q_2 + w_1 * q_1 + w_2 * q_0))
    q_3 = h_3 * h_q * (u_q2 - R * q_2 - L_d * (w_0 * d_2 + w_1 * d_1 + w_2 * d_0) - psi_f * w_2)
    w_3 = h_3 * h * (k_psi * q_2 + k_L * (d_0 * q_2 + d_1 * q_1 + d_2 * q_0) - k_B * w_2)
    if order == 3:
        return (
            (d_0, d_1, d_2, d_3, 0.0, 0.0),
            (q_0, q_1, q_2, q_3, 0.0, 0.0),
            (w_0, w_1, w_2, w_3, 0.0, 0.0),
        )
    u_d3 = h_3 * h * (w_0 * u_q2 + w_1 * u_q1 + w_2 * u_q0)
    u_q3 = -h_3 * h * (w_0 * u_d2 + w_1 * u_d1 + w_2 * u_d0)

    d_4 = h_4 * h_d * (u_d3 - R * d_3 + L_q * (w_0 * q_3 + w_1 * q_2 + w_2 * q_1 + w_3 * q_0))
    q_4 = (
        h_4
        * h_q
        * (u_q3 - R * q_3 - L_d * (w_0 * d_3 + w_1 * d_2 + w_2 * d_1 + w_3 * d_0) - psi_f * w_3)
    )
    w_4 = (
        h_4 * h * (k_psi * q_3 + k_L * (d_0 * q_3 + d_1 * q_2 + d_2 * q_1 + d_3 * q_0) - k_B * w_3)
    )
    if order == 4:
        return (
            (d_0, d_1, d_2, d_3, d_4, 0.0),
            (q_0, q_1, q_2, q_3, q_4, 0.0),
            (w_0, w_1, w_2, w_3, w_4, 0.0),
        )
    u_d4 = h_4 * h * (w_0 * u_q3 + w_1 * u_q2 + w_2 * u_q1 + w_3 * u_q0)
    u_q4 = -h_4 * h * (w_0 * u_d3 + w_1 * u_d2 + w_2 * u_d1 + w_3 * u_d0)

    d_5 = (
        h_5
        * h_d
        * (u_d4 - R * d_4 + L_q * (w_0 * q_4 + w_1 * q_3 + w_2 * q_2 + w_3 * q_1 + w_4 * q_0))
    )
    w_d = w_0 * d_4 + w_1 * d_3 + w_2 * d_2 + w_3 * d_1 + w_4 * d_0
    q_5 = h_5 * h_q * (u_q4 - R * q_4 - L_d * w_d - psi_f * w_4)
    d_q = d_0 * q_4 + d_1 * q_3 + d_2 * q_2 + d_3 * q_1 + d_4 * q_0
    w_5 = h_5 * h * (k_psi * q_4 + k_L * d_q - k_B * w_4)
    return (
        (d_0, d_1, d_2, d_3, d_4, d_5),
        (q_0, q_1, q_2, q_3, q_4, q_5),
        (w_0, w_1, w_2, w_3, w_4, w_5),
    )


@kernel
def _at(a, x):
    """Value of a series."""
    return a[0] + x * (a[1] + x * (a[2] + x * (a[3] + x * (a[4] + x * a[5]))))


@kernel
def _angle(w, h, x):
    """Electrical angle turned (rad) from the start of the step to x."""
    sixth = 1.0 / 6.0
    third = 1.0 / 3.0
    rest = third * w[2] + x * (0.25 * w[3] + x * (0.2 * w[4] + x * (sixth * w[5])))
    return h * x * (w[0] + x * (0.5 * w[1] + x * rest))


@kernel
def _oversample(T_s, t_0, h, c, s, d, q, w, legs, k, i_abc, legs_out):
    """Waveform at the points j T_s / n in [t_0, t_0 + h); returns the index of the next point.

    c and s are the cosine and sine of the electrical angle at t_0; d, q and w the series.
    """
    n = legs_out.shape[0]
    dt = T_s / n
    while k < n and k * dt < t_0 + h:
        x = max(k * dt - t_0, 0.0) / h
        i_d, i_q = _at(d, x), _at(q, x)
        c_t, s_t = small_rotation(_angle(w, h, x))
        c_k, s_k = c * c_t - s * s_t, s * c_t + c * s_t
        i_alpha, i_beta = stationary(i_d, i_q, c_k, s_k)
        i_abc[3 * k], i_abc[3 * k + 1], i_abc[3 * k + 2] = phases(i_alpha, i_beta)
        legs_out[k] = legs
        k += 1
    return k


@kernel
def integrate_ideal(par, st, c, s, i_abc, legs_out):
    """Advance the state by one period.

    c and s are the cosine and sine of the electrical angle at its start. Returns the mechanical
    angle turned (rad) and the energy taken from the DC link (J).
    """
    T_s, n_p, u_dc = par.T_s, par.n_p, par.u_dc
    R, L_d, L_q, psi_f = par.R_s, par.L_d, par.L_q, par.psi_f
    per_J = n_p / par.J
    constants = (
        1.0 / L_d,
        1.0 / L_q,
        R,
        L_d,
        L_q,
        psi_f,
        per_J * 1.5 * n_p * psi_f,
        per_J * 1.5 * n_p * (L_d - L_q),
        par.B / par.J,
        per_J * par.tau_L,
    )
    h_max = par.h_max
    n_over = legs_out.shape[0]
    set_pattern(st, T_s)
    i_d, i_q, w_m = st.i_d, st.i_q, n_p * st.w_M
    turned = 0.0
    energy = 0.0
    k = 0
    for j in range(7):
        t = st.t_switch[j]
        h = st.t_switch[j + 1] - t
        if h <= 0.0:
            continue
        legs = st.legs[j]
        u_alpha, u_beta = leg_voltage(legs, u_dc)
        steps = 1
        if h > h_max or h * abs(w_m) > MAX_STEP_ANGLE:
            steps = math.ceil(max(h / h_max, h * abs(w_m) / MAX_STEP_ANGLE))
            steps = min(max(steps, 1), MOST_STEPS)
            h /= steps
        order = 3 if h < _ORDER_3 * T_s else 4 if h < _ORDER_4 * T_s else 5
        for _ in range(steps):
            u_d, u_q = c * u_alpha + s * u_beta, c * u_beta - s * u_alpha
            d, q, w = _series(constants, h, order, i_d, i_q, w_m, u_d, u_q)
            if n_over > 0:
                k = _oversample(T_s, t, h, c, s, d, q, w, legs, k, i_abc, legs_out)
            # what the flux linkage does not take of the voltage drops at the resistance, which
            # gives the charge, and so the energy
            c_0, s_0 = c, s
            angle = _angle(w, h, 1.0)
            c_t, s_t = small_rotation(angle)
            c, s = c * c_t - s * s_t, s * c_t + c * s_t
            i_d1, i_q1, w_m = _at(d, 1.0), _at(q, 1.0), _at(w, 1.0)
            if legs != 0 and legs != 7:
                psi_d0, psi_d1 = L_d * i_d + psi_f, L_d * i_d1 + psi_f
                psi_q0, psi_q1 = L_q * i_q, L_q * i_q1
                drop_alpha = u_alpha * h - (c * psi_d1 - s * psi_q1) + (c_0 * psi_d0 - s_0 * psi_q0)
                drop_beta = u_beta * h - (s * psi_d1 + c * psi_q1) + (s_0 * psi_d0 + c_0 * psi_q0)
                energy += u_alpha * drop_alpha + u_beta * drop_beta
            i_d, i_q = i_d1, i_q1
            turned += angle
            t += h
    st.i_d, st.i_q, st.w_M = i_d, i_q, w_m / n_p
    return turned / n_p, 1.5 / R * energy

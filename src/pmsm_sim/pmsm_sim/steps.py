"""One step of the general model while current flows in every leg.

The flux linkage in the stationary frame is what is integrated,

    dpsi/dt = e,    e = M (rail u_dc + drop - R i)    (see `bridge.join_legs`)

and the current follows from it and from the angle, by division or by the inverse flux map. So all
that is difficult acts on the derivative through the small R i only, and a step can be as long as
the interval between two switching instants: classical Runge-Kutta, of third order (Kutta) where it
is short, of fourth otherwise. Energies are summed up with the weights of the same step. What an
instant needs anew, the current and the torque, does not depend on the legs, so the end of a step
serves as the start of the next one, whatever is switched in between.

There are two steps, compiled from one source: the plain one has linear machine, stiff DC link and
one mass; the full one has everything.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pmsm_sim import columns as col
from pmsm_sim.bridge import induced
from pmsm_sim.frames import stationary
from pmsm_sim.ideal import small_rotation
from pmsm_sim.parts.dc_link import charge
from pmsm_sim.parts.machine import cogging, current, harmonics
from pmsm_sim.parts.mechanics import accelerate, move
from pmsm_sim.parts.sensors import low_pass
from pwm_node.compiled import inlined, kernel

# Where Newton's method on a flux map ends (cells of the map): its error within a step matters by
# the small R i only, but at its end it is that of the current.
_ROUGH, _EXACT = 1e-4, 1e-7


def _stepper(full: bool) -> Callable[..., Any]:
    """One of the two steps; `full` is known to the compiler."""

    @inlined
    def node(par, per_L, theta_M, c_0, s_0, turn_0, y, near, last_move):
        """What follows from the state y at one instant.

        `near` is the same at a neighbouring instant, in the rotor frame: i_d, i_q, psi_d, psi_q,
        L_dd, L_dq, L_qd, L_qq. c_0 and s_0 belong to the angle at `turn_0`. `per_L` are 1 / L_d,
        1 / L_q.

        Returns i_alpha, i_beta, tau_M; c, s; what is near for the next.
        """
        c_t, s_t = small_rotation(par.n_p * (y[3] - turn_0))
        c, s = c_0 * c_t - s_0 * s_t, s_0 * c_t + c_0 * s_t
        psi_d, psi_q = c * y[0] + s * y[1], c * y[1] - s * y[0]
        if full:
            turn_d = turn_q = 0.0
            if par.harmonics:
                more_d, more_q, turn_d, turn_q = harmonics(par, c, s)
                psi_d -= more_d
                psi_q -= more_q
            now = current(par, per_L, psi_d, psi_q, near, last_move)
            i_alpha, i_beta = stationary(now[0], now[1], c, s)
            tau = y[0] * i_beta - y[1] * i_alpha + turn_d * now[0] + turn_q * now[1]
            tau_M = 1.5 * par.n_p * tau + cogging(par, theta_M + y[3])
        else:
            i_d, i_q = (psi_d - par.psi_f) * per_L[0], psi_q * per_L[1]
            now = (i_d, i_q, psi_d, psi_q, near[4], near[5], near[6], near[7])
            i_alpha, i_beta = stationary(i_d, i_q, c, s)
            tau_M = 1.5 * par.n_p * (y[0] * i_beta - y[1] * i_alpha)
        return (i_alpha, i_beta, tau_M), (c, s), now

    @inlined
    def slope(par, br, per_J, chopping, period, t, y, at):
        """Derivatives of the state y, and that of which the energies are made.

        The latter: i_alpha, i_beta, their products, e^2; power of friction; and in the full step
        those of load, supply, inverter input and chopper (W).
        """
        e_alpha, e_beta, i_alpha, i_beta = induced(par, br, y[4], at[0], at[1])
        w_M, e_2 = y[2], 0.0
        if par.iron_conductance > 0.0:
            e_2 = e_alpha * e_alpha + e_beta * e_beta
        products = i_alpha * i_alpha, i_alpha * i_beta, i_beta * i_beta
        if full:
            i_dc = 1.5 * (br.rail[0] * i_alpha + br.rail[1] * i_beta)
            du, supply, chopper = charge(par, period, t, chopping, y[4], i_dc)
            dw, dw_L, dtwist, dtau, friction, load = move(
                par, period, t, w_M, y[5], y[6], y[7], at[2]
            )
            return (
                (e_alpha, e_beta, dw, w_M, du, dw_L, dtwist, dtau),
                (i_alpha, i_beta, *products, e_2, friction, load, supply, y[4] * i_dc, chopper),
            )
        dw, friction = accelerate(par, per_J, w_M, at[2])
        return (
            (e_alpha, e_beta, dw, w_M, 0.0, 0.0, 0.0, 0.0),
            (i_alpha, i_beta, *products, e_2, friction, 0.0, 0.0, 0.0, 0.0),
        )

    @inlined
    def moved(y, h, k):
        """The state y + h k."""
        psi_alpha, psi_beta = y[0] + h * k[0], y[1] + h * k[1]
        w_M, turn_M = y[2] + h * k[2], y[3] + h * k[3]
        if full:
            return (
                psi_alpha,
                psi_beta,
                w_M,
                turn_M,
                y[4] + h * k[4],
                y[5] + h * k[5],
                y[6] + h * k[6],
                y[7] + h * k[7],
            )
        return psi_alpha, psi_beta, w_M, turn_M, y[4], y[5], y[6], y[7]

    @inlined
    def weighted(k_1, k_2, m, k_3):
        """Derivatives k_1 + m k_2 + k_3."""
        psi_alpha, psi_beta = k_1[0] + m * k_2[0] + k_3[0], k_1[1] + m * k_2[1] + k_3[1]
        w_M, turn_M = k_1[2] + m * k_2[2] + k_3[2], k_1[3] + m * k_2[3] + k_3[3]
        if full:
            return (
                psi_alpha,
                psi_beta,
                w_M,
                turn_M,
                k_1[4] + m * k_2[4] + k_3[4],
                k_1[5] + m * k_2[5] + k_3[5],
                k_1[6] + m * k_2[6] + k_3[6],
                k_1[7] + m * k_2[7] + k_3[7],
            )
        return psi_alpha, psi_beta, w_M, turn_M, 0.0, 0.0, 0.0, 0.0

    @inlined
    def summed(p_1, p_2, m, p_3):
        """That of which the energies are made: p_1 + m p_2 + p_3."""
        i_alpha, i_beta = p_1[0] + m * p_2[0] + p_3[0], p_1[1] + m * p_2[1] + p_3[1]
        aa, ab = p_1[2] + m * p_2[2] + p_3[2], p_1[3] + m * p_2[3] + p_3[3]
        bb, ee = p_1[4] + m * p_2[4] + p_3[4], p_1[5] + m * p_2[5] + p_3[5]
        friction = p_1[6] + m * p_2[6] + p_3[6]
        if full:
            return (
                i_alpha,
                i_beta,
                aa,
                ab,
                bb,
                ee,
                friction,
                p_1[7] + m * p_2[7] + p_3[7],
                p_1[8] + m * p_2[8] + p_3[8],
                p_1[9] + m * p_2[9] + p_3[9],
                p_1[10] + m * p_2[10] + p_3[10],
            )
        return i_alpha, i_beta, aa, ab, bb, ee, friction, 0.0, 0.0, 0.0, 0.0

    @inlined
    def scaled(h, p):
        """The sums p times h."""
        return (
            h * p[0],
            h * p[1],
            h * p[2],
            h * p[3],
            h * p[4],
            h * p[5],
            h * p[6],
            h * p[7],
            h * p[8],
            h * p[9],
            h * p[10],
        )

    @inlined
    def book(par, br, a, b, p):
        """Energies of row b: those of row a, and what the sums p make."""
        if full:
            load, supply, dc = p[7], p[8], p[9]
            b[col.CHOPPER] = a[col.CHOPPER] + p[10]
        else:
            load = par.tau_L * (b[col.TURN_M] - a[col.TURN_M])
            dc = 1.5 * a[col.U_DC] * (br.rail[0] * p[0] + br.rail[1] * p[1])
            supply = dc
            b[col.CHOPPER] = a[col.CHOPPER]
        lost = br.r[0] * p[2] + 2.0 * br.r[1] * p[3] + br.r[2] * p[4]
        lost -= br.drop[0] * p[0] + br.drop[1] * p[1]
        b[col.SUPPLY] = a[col.SUPPLY] + supply
        b[col.DC] = a[col.DC] + dc
        b[col.INVERTER] = a[col.INVERTER] + 1.5 * lost
        b[col.COPPER] = a[col.COPPER] + 1.5 * par.R_s * (p[2] + p[4])
        b[col.IRON] = a[col.IRON] + 1.5 * par.iron_conductance * p[5]
        b[col.FRICTION] = a[col.FRICTION] + p[6]
        b[col.LOAD] = a[col.LOAD] + load

    @kernel
    def step(par, st, a, b, t, h, short):
        """Step of length h (s) from row a at t (s) to row b; of third order if it is `short`."""
        br, period, chopping, theta_M = st.bridge, st.period, st.chopping, st.theta_M
        y = (
            a[col.PSI_ALPHA],
            a[col.PSI_BETA],
            a[col.W_M],
            a[col.TURN_M],
            a[col.U_DC],
            a[col.W_L],
            a[col.TWIST],
            a[col.TAU_BRAKE],
        )
        near = (
            a[col.I_D],
            a[col.I_Q],
            a[col.PSI_D],
            a[col.PSI_Q],
            a[col.L_DD],
            a[col.L_DQ],
            a[col.L_QD],
            a[col.L_QQ],
        )
        c, s, turn = a[col.C], a[col.S], y[3]
        at_1 = (a[col.I_ALPHA], a[col.I_BETA], a[col.TAU_M])
        half, sixth = 0.5 * h, h / 6.0
        per_L, per_J = (1.0 / par.L_d, 1.0 / par.L_q), 1.0 / par.J
        k_1, p_1 = slope(par, br, per_J, chopping, period, t, y, at_1)
        y_2 = moved(y, half, k_1)
        at_2, _, near = node(par, per_L, theta_M, c, s, turn, y_2, near, _ROUGH)
        k_2, p_2 = slope(par, br, per_J, chopping, period, t + half, y_2, at_2)
        if short:
            y_3 = moved(moved(y, 2.0 * h, k_2), -h, k_1)
            at_3, _, near = node(par, per_L, theta_M, c, s, turn, y_3, near, _ROUGH)
            k_3, p_3 = slope(par, br, per_J, chopping, period, t + h, y_3, at_3)
            k, p = weighted(k_1, k_2, 4.0, k_3), summed(p_1, p_2, 4.0, p_3)
        else:
            y_3 = moved(y, half, k_2)
            at_3, _, near = node(par, per_L, theta_M, c, s, turn, y_3, near, _ROUGH)
            k_3, p_3 = slope(par, br, per_J, chopping, period, t + half, y_3, at_3)
            y_4 = moved(y, h, k_3)
            at_4, _, near = node(par, per_L, theta_M, c, s, turn, y_4, near, _ROUGH)
            k_4, p_4 = slope(par, br, per_J, chopping, period, t + h, y_4, at_4)
            k = weighted(weighted(k_1, k_2, 2.0, k_3), k_3, 1.0, k_4)
            p = summed(summed(p_1, p_2, 2.0, p_3), p_3, 1.0, p_4)
        y_end = moved(y, sixth, k)
        at, angle, near = node(par, per_L, theta_M, c, s, turn, y_end, near, _EXACT)

        b[col.PSI_ALPHA], b[col.PSI_BETA], b[col.W_M], b[col.TURN_M] = (
            y_end[0],
            y_end[1],
            y_end[2],
            y_end[3],
        )
        b[col.U_DC], b[col.W_L], b[col.TWIST], b[col.TAU_BRAKE] = (
            y_end[4],
            y_end[5],
            y_end[6],
            y_end[7],
        )
        b[col.I_D], b[col.I_Q], b[col.PSI_D], b[col.PSI_Q] = near[0], near[1], near[2], near[3]
        b[col.L_DD], b[col.L_DQ], b[col.L_QD], b[col.L_QQ] = near[4], near[5], near[6], near[7]
        b[col.I_ALPHA], b[col.I_BETA], b[col.TAU_M] = at
        b[col.C], b[col.S] = angle
        book(par, br, a, b, scaled(sixth, p))
        if par.filter_rate > 0.0:
            _, _, end_alpha, end_beta = induced(par, br, y_end[4], at[0], at[1])
            b[col.I_F_ALPHA], b[col.I_F_BETA] = low_pass(
                par,
                h,
                (a[col.I_F_ALPHA], a[col.I_F_BETA]),
                (p_1[0], p_1[1]),
                # the errors of the two stages cancel
                (0.5 * (p_2[0] + p_3[0]), 0.5 * (p_2[1] + p_3[1])),
                (end_alpha, end_beta),
            )

    return step  # type: ignore[no-any-return]


plain_step = _stepper(False)
full_step = _stepper(True)

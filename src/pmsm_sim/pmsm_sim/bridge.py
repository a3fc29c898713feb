"""The inverter's legs when diodes take part: which conduct, and what voltage the machine sees.

Each leg clamps its terminal to one of the rails while current flows. With v the voltage of the
terminal against the negative rail and i the current into the machine,

    i > 0:  v = rail_p u_dc - drop_p - r_p i       i < 0:  v = rail_n u_dc + drop_n - r_n i
    i = 0:  v floats between the two

(positive current flows through the upper switch or the lower diode, negative current through the
lower switch or the upper diode). This one law covers blocked gates (rail_p = 0, rail_n = 1: the
diodes), dead time, the on-state drops of switches and diodes, and currents clamped to zero.

A leg whose current has ended may stay without: then its terminal floats at the voltage at which
the current of that phase has no derivative, or with iron loss, stays zero. One floating leg leaves
the other two in series; two leave no path at all, so that the third carries nothing either.

Iron loss is a conductance G across the induced voltage e (seen from the stationary frame), so the
current at the terminals is i + G e, where i is what magnetises.
"""

from __future__ import annotations

import math

import numpy as np

from pmsm_sim.frames import stationary
from pmsm_sim.parts.machine import flux
from pwm_node.compiled import inlined, kernel

_SQRT3 = math.sqrt(3.0)
#: Alpha and beta components of the phase axes a, b, c
AXIS_ALPHA = (1.0, -0.5, -0.5)
AXIS_BETA = (0.0, 0.5 * _SQRT3, -0.5 * _SQRT3)

# How the three bridge legs are connected
BRIDGE = np.dtype(
    [
        # what clamps a leg that carries positive, and negative current: v = rail u_dc - drop - r i
        ("rail_p", np.float64, (3,)),
        ("drop_p", np.float64, (3,)),
        ("r_p", np.float64, (3,)),
        ("rail_n", np.float64, (3,)),
        ("drop_n", np.float64, (3,)),
        ("r_n", np.float64, (3,)),
        ("watched", np.int64, (3,)),  # 1: the two differ, so the sign of the current matters
        ("can_float", np.int64, (3,)),  # 1: there are voltages at which neither conducts
        ("mode", np.int64, (3,)),  # sign of the current; 0: none flows
        # all legs together, at the terminals and as induced voltage (see `join_legs`)
        ("rail", np.float64, (2,)),  # alpha and beta voltage per DC-link voltage
        ("drop", np.float64, (2,)),  # and what does not depend on it (V)
        ("r", np.float64, (3,)),  # resistance (ohm): alpha-alpha, alpha-beta, beta-beta
        ("e_rail", np.float64, (2,)),
        ("e_drop", np.float64, (2,)),
        ("fall", np.float64, (3,)),
        ("P", np.float64, (3,)),
    ],
    align=True,
)

# What `solve` and `solve_joined` find for one instant
ELECTRIC = np.dtype(
    [
        ("i_alpha", np.float64),  # stator current in the stationary frame (A)
        ("i_beta", np.float64),
        ("e_alpha", np.float64),  # induced voltage (V)
        ("e_beta", np.float64),
        ("v", np.float64, (3,)),  # terminal voltages; against the star point if no leg conducts
        # without iron loss only
        ("di_d", np.float64),  # derivative of the machine current (A/s)
        ("di_q", np.float64),
        ("torque", np.float64),  # electromagnetic (N m)
        ("c", np.float64),  # cosine and sine of the electrical angle
        ("s", np.float64),
        ("w_m", np.float64),  # electrical speed (rad/s)
    ],
    align=True,
)

NONE_FLOATS = 3
ALL_FLOAT = -1


@kernel
def connect_legs(par, br, gates):
    """Connect the legs as their gates say (bits a, b, c: upper switch on; from bit 3 on: lower)."""
    for x in range(3):
        upper, lower = gates >> x & 1 == 1, gates >> (x + 3) & 1 == 1
        br.rail_p[x] = 1.0 if upper else 0.0
        br.rail_n[x] = 0.0 if lower else 1.0
        br.drop_p[x] = par.switch_voltage if upper else par.diode_voltage
        br.r_p[x] = par.switch_resistance if upper else par.diode_resistance
        br.drop_n[x] = par.switch_voltage if lower else par.diode_voltage
        br.r_n[x] = par.switch_resistance if lower else par.diode_resistance
        can_float = not (upper or lower) or par.switch_voltage + par.diode_voltage > 0.0
        br.can_float[x] = 1 if can_float else 0
        br.watched[x] = 1 if can_float or br.r_p[x] != br.r_n[x] else 0
        br.mode[x] = 1


@kernel
def floating_leg(br):
    """The only leg without current (0, 1, 2), or `NONE_FLOATS`, or `ALL_FLOAT`."""
    found = NONE_FLOATS
    for x in range(3):
        if br.mode[x] == 0:
            if found != NONE_FLOATS:
                return ALL_FLOAT
            found = x
    return found


@kernel
def _clamp(br, x, u_dc):
    """Voltage and resistance (V, ohm) of leg x in the direction its current has."""
    if br.mode[x] >= 0:
        return br.rail_p[x] * u_dc - br.drop_p[x], br.r_p[x]
    return br.rail_n[x] * u_dc + br.drop_n[x], br.r_n[x]


@kernel
def join_legs(par, br, G_floating):
    """All legs as one source behind a resistance, wherever that gives the induced voltage.

    That is while current flows in each of them, and with iron loss always. With i the stator
    current, the voltage at the terminals is u = rail u_dc + drop - r i, as far as currents can
    flow: P takes out what belongs to a leg without current, or everything if none conducts.
    Behind the winding's resistance, where i = P (i_m + G e), the induced voltage is

        e = e_rail u_dc + e_drop - fall i_m

    Iron loss alone lets the field of a leg without current die away, e = -i_m / G there, within
    L G. Steps cannot be as short as they like: for this a conductance too small for them acts as
    the smallest they can follow, `G_floating`.
    """
    rail_a = rail_b = drop_a = drop_b = r_aa = r_ab = r_bb = 0.0
    for x in range(3):
        if br.mode[x] == 0:
            continue
        n_a, n_b = 2.0 / 3.0 * AXIS_ALPHA[x], 2.0 / 3.0 * AXIS_BETA[x]
        if br.mode[x] > 0:
            rail, drop, r = br.rail_p[x], -br.drop_p[x], br.r_p[x]
        else:
            rail, drop, r = br.rail_n[x], br.drop_n[x], br.r_n[x]
        rail_a += rail * n_a
        rail_b += rail * n_b
        drop_a += drop * n_a
        drop_b += drop * n_b
        r_aa += r * n_a * AXIS_ALPHA[x]
        r_ab += r * n_a * AXIS_BETA[x]
        r_bb += r * n_b * AXIS_BETA[x]
    P_aa, P_ab, P_bb = 1.0, 0.0, 1.0
    z = floating_leg(br)
    if z == ALL_FLOAT:
        P_aa = P_bb = rail_a = rail_b = drop_a = drop_b = r_aa = r_ab = r_bb = 0.0
    elif z != NONE_FLOATS:
        n_a, n_b = AXIS_ALPHA[z], AXIS_BETA[z]
        P_aa, P_ab, P_bb = 1.0 - n_a * n_a, -n_a * n_b, 1.0 - n_b * n_b
        rail_a, rail_b = P_aa * rail_a + P_ab * rail_b, P_ab * rail_a + P_bb * rail_b
        drop_a, drop_b = P_aa * drop_a + P_ab * drop_b, P_ab * drop_a + P_bb * drop_b
        # P is t t^T with the unit vector t of the current that can flow, so P r P = (t r t) P
        r = P_aa * r_aa + 2.0 * P_ab * r_ab + P_bb * r_bb
        r_aa, r_ab, r_bb = r * P_aa, r * P_ab, r * P_bb
    br.rail[0], br.rail[1] = rail_a, rail_b
    br.drop[0], br.drop[1] = drop_a, drop_b
    br.r[0], br.r[1], br.r[2] = r_aa, r_ab, r_bb
    R, G = par.R_s, par.iron_conductance
    R_aa, R_ab, R_bb = R * P_aa + r_aa, R * P_ab + r_ab, R * P_bb + r_bb
    if G > 0.0:
        a, b, d = 1.0 + G * R_aa, G * R_ab, 1.0 + G * R_bb
        per = 1.0 / (a * d - b * b)
        rail_a, rail_b = per * (d * rail_a - b * rail_b), per * (a * rail_b - b * rail_a)
        drop_a, drop_b = per * (d * drop_a - b * drop_b), per * (a * drop_b - b * drop_a)
        dies = 1.0 / G_floating
        R_aa, R_ab, R_bb = (
            per * (d * R_aa - b * R_ab) + dies * (1.0 - P_aa),
            per * (d * R_ab - b * R_bb) - dies * P_ab,
            per * (a * R_bb - b * R_ab) + dies * (1.0 - P_bb),
        )
        br.P[0], br.P[1], br.P[2] = P_aa, P_ab, P_bb
    br.e_rail[0], br.e_rail[1] = rail_a, rail_b
    br.e_drop[0], br.e_drop[1] = drop_a, drop_b
    br.fall[0], br.fall[1], br.fall[2] = R_aa, R_ab, R_bb


@inlined
def induced(par, br, u_dc, i_alpha, i_beta):
    """Induced voltage (V) and stator current (A), alpha and beta, of a machine current (A).

    For legs that have been joined.
    """
    e_alpha = br.e_rail[0] * u_dc + br.e_drop[0] - br.fall[0] * i_alpha - br.fall[1] * i_beta
    e_beta = br.e_rail[1] * u_dc + br.e_drop[1] - br.fall[1] * i_alpha - br.fall[2] * i_beta
    G = par.iron_conductance
    if G > 0.0:
        i_alpha += G * e_alpha
        i_beta += G * e_beta
        i_alpha, i_beta = (
            br.P[0] * i_alpha + br.P[1] * i_beta,
            br.P[1] * i_alpha + br.P[2] * i_beta,
        )
    return e_alpha, e_beta, i_alpha, i_beta


@kernel
def _terminals(br, el, u_dc):
    """Fill in the terminal voltages, where currents and induced voltage are known."""
    z = floating_leg(br)
    for x in range(3):
        i_x = AXIS_ALPHA[x] * el.i_alpha + AXIS_BETA[x] * el.i_beta
        e_x = AXIS_ALPHA[x] * el.e_alpha + AXIS_BETA[x] * el.e_beta
        v, r = _clamp(br, x, u_dc)
        el.v[x] = e_x if z in (ALL_FLOAT, x) else v - r * i_x
    if z not in (ALL_FLOAT, NONE_FLOATS):
        # against the star point, e_x + e_y + e_z = 0
        el.v[z] = 0.5 * (el.v[(z + 1) % 3] + el.v[(z + 2) % 3]) + 1.5 * el.v[z]


@kernel
def solve_joined(par, br, el, i_alpha, i_beta, u_dc):
    """Voltages and stator current, for legs that have been joined.

    Parameters
    ----------
    i_alpha, i_beta : float
        Machine current (A).
    u_dc : float
        DC-link voltage (V).
    el : record of `ELECTRIC`
        Filled here.
    """
    el.e_alpha, el.e_beta, el.i_alpha, el.i_beta = induced(par, br, u_dc, i_alpha, i_beta)
    _terminals(br, el, u_dc)


@kernel
def solve(par, br, el, i_d, i_q, w_m, c, s, u_dc):
    """Voltages and current derivatives without iron loss, for the legs as they conduct now.

    Parameters
    ----------
    i_d, i_q : float
        Machine current (A).
    w_m, c, s : float
        Electrical speed (rad/s), cosine and sine of the electrical angle.
    u_dc : float
        DC-link voltage (V).
    el : record of `ELECTRIC`
        Filled here.
    """
    psi_d, psi_q, turn_d, turn_q, L_dd, L_dq, L_qd, L_qq = flux(par, i_d, i_q, c, s)
    inverse = 1.0 / (L_dd * L_qq - L_dq * L_qd)
    # induced voltage at constant i_dq
    emf_d, emf_q = w_m * (turn_d - psi_q), w_m * (turn_q + psi_d)
    i_alpha, i_beta = stationary(i_d, i_q, c, s)

    z = floating_leg(br)
    if z == NONE_FLOATS:
        join_legs(par, br, 0.0)
        e_alpha, e_beta, i_alpha, i_beta = induced(par, br, u_dc, i_alpha, i_beta)
    elif z == ALL_FLOAT:
        # the derivative of i_alpha_beta is zero
        u_d = emf_d + w_m * (L_dd * i_q - L_dq * i_d)
        u_q = emf_q + w_m * (L_qd * i_q - L_qq * i_d)
        e_alpha, e_beta = stationary(u_d, u_q, c, s)
    else:
        x, y = (z + 1) % 3, (z + 2) % 3
        n_a, n_b = AXIS_ALPHA[z], AXIS_BETA[z]
        # unit vector in which the current through x and y points
        t_a = (AXIS_ALPHA[x] - AXIS_ALPHA[y]) / _SQRT3
        t_b = (AXIS_BETA[x] - AXIS_BETA[y]) / _SQRT3
        v_x, r_x = _clamp(br, x, u_dc)
        v_y, r_y = _clamp(br, y, u_dc)
        R_t = par.R_s + 0.5 * (r_x + r_y)
        e_t = (v_x - v_y) / _SQRT3 - R_t * (t_a * i_alpha + t_b * i_beta)
        # e_n such that the current along n has no derivative:
        # n . (L^-1 (e - emf) + w J i) = 0 in the rotor frame
        n_d, n_q = c * n_a + s * n_b, c * n_b - s * n_a
        t_d, t_q = c * t_a + s * t_b, c * t_b - s * t_a
        m_d = (L_qq * n_d - L_qd * n_q) * inverse
        m_q = (L_dd * n_q - L_dq * n_d) * inverse
        along_t = m_d * (e_t * t_d - emf_d) + m_q * (e_t * t_q - emf_q)
        turning = w_m * (n_q * i_d - n_d * i_q)
        e_n = -(along_t + turning) / (m_d * n_d + m_q * n_q)
        e_alpha = e_t * t_a + e_n * n_a
        e_beta = e_t * t_b + e_n * n_b

    if z == ALL_FLOAT:
        el.di_d, el.di_q = w_m * i_q, -w_m * i_d  # zero stays zero
    else:
        d_d, d_q = c * e_alpha + s * e_beta - emf_d, c * e_beta - s * e_alpha - emf_q
        el.di_d = (L_qq * d_d - L_dq * d_q) * inverse
        el.di_q = (L_dd * d_q - L_qd * d_d) * inverse
    el.i_alpha, el.i_beta = i_alpha, i_beta
    el.e_alpha, el.e_beta = e_alpha, e_beta
    el.torque = 1.5 * par.n_p * (psi_d * i_q - psi_q * i_d + turn_d * i_d + turn_q * i_q)
    el.c, el.s, el.w_m = c, s, w_m
    _terminals(br, el, u_dc)


@kernel
def conducting_rails(br):
    """Bits a, b, c: which legs are connected to the positive rail by what conducts now."""
    bits = 0
    for x in range(3):
        rail = br.rail_p[x] if br.mode[x] > 0 else br.rail_n[x]
        if br.mode[x] != 0 and rail > 0.5:
            bits |= 1 << x
    return bits


@kernel
def rail_current(br, el):
    """Current out of the positive rail (A), and the power lost in switches and diodes (W)."""
    total, loss = 0.0, 0.0
    for x in range(3):
        i_x = AXIS_ALPHA[x] * el.i_alpha + AXIS_BETA[x] * el.i_beta
        if br.mode[x] > 0:
            total += br.rail_p[x] * i_x
            loss += (br.drop_p[x] + br.r_p[x] * i_x) * i_x
        elif br.mode[x] < 0:
            total += br.rail_n[x] * i_x
            loss += (br.r_n[x] * i_x - br.drop_n[x]) * i_x
    return total, loss

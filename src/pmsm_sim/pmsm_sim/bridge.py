"""The inverter's legs when diodes take part: which conduct, and what voltage the machine sees.

Each leg clamps its terminal to one of the rails while current flows. With v the voltage of the
terminal against the negative rail and i the current into the machine,

    i > 0:  v = rail_p u_dc - drop_p - r_p i       i < 0:  v = rail_n u_dc + drop_n - r_n i
    i = 0:  v floats between the two

(positive current flows through the upper switch or the lower diode, negative current through the
lower switch or the upper diode). This one law covers blocked gates (rail_p = 0, rail_n = 1: the
diodes), dead time, the on-state drops of switches and diodes, and currents clamped to zero.

A leg whose current has ended may stay without: then its terminal floats at the voltage at which
the current of that phase has no derivative. One floating leg leaves the other two in series; two
leave no path at all, so that the third carries nothing either.

Iron loss is a conductance G across the induced voltage e (seen from the stationary frame), so the
current at the terminals is i + G e, where i is what magnetises.
"""

from __future__ import annotations

import math

import numpy as np

from pmsm_sim.parts.machine import flux
from pwm_node.compiled import inlined, kernel

_SQRT3 = math.sqrt(3.0)
# alpha and beta components of the phase axes a, b, c
_AXIS_ALPHA = (1.0, -0.5, -0.5)
_AXIS_BETA = (0.0, 0.5 * _SQRT3, -0.5 * _SQRT3)

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
        # all legs together, while current flows in each (see `join_legs`)
        ("rail", np.float64, (2,)),  # alpha and beta voltage per DC-link voltage
        ("drop", np.float64, (2,)),  # and what does not depend on it (V)
        ("r", np.float64, (3,)),  # resistance (ohm): alpha-alpha, alpha-beta, beta-beta
        ("inner", np.float64, (3,)),  # what iron loss leaves of the voltage, the same way
    ],
    align=True,
)

# What `solve` finds for one instant
ELECTRIC = np.dtype(
    [
        ("di_d", np.float64),  # derivative of the machine current (A/s)
        ("di_q", np.float64),
        ("i_alpha", np.float64),  # stator current in the stationary frame (A)
        ("i_beta", np.float64),
        ("e_alpha", np.float64),  # induced voltage (V)
        ("e_beta", np.float64),
        ("torque", np.float64),  # electromagnetic (N m)
        ("v", np.float64, (3,)),  # terminal voltages; against the star point if no leg conducts
        ("c", np.float64),  # cosine and sine of the electrical angle
        ("s", np.float64),
        ("w_m", np.float64),  # electrical speed (rad/s)
    ],
    align=True,
)

NONE_FLOATS = 3
ALL_FLOAT = -1

# Below this a current has no sign (A).
ZERO_CURRENT = 1e-9
# Rounding of a voltage that is compared with a limit (V).
VOLTAGE_ROUNDING = 1e-9


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
def _limits(br, x, u_dc):
    """Between which terminal voltages leg x carries no current (V)."""
    return (
        br.rail_p[x] * u_dc - br.drop_p[x],
        br.rail_n[x] * u_dc + br.drop_n[x],
    )


@kernel
def _clamp(br, x, u_dc):
    """Voltage and resistance (V, ohm) of leg x in the direction its current has."""
    if br.mode[x] >= 0:
        return br.rail_p[x] * u_dc - br.drop_p[x], br.r_p[x]
    return br.rail_n[x] * u_dc + br.drop_n[x], br.r_n[x]


@kernel
def join_legs(par, br):
    """All legs as one source behind a resistance, while current flows in each of them.

    With i the stator current, the voltage at the terminals is u = rail u_dc + drop - r i. Behind
    the winding's resistance, and with iron loss, i = i_m + G e, the induced voltage is

        e = inner (rail u_dc + drop - (R_s + r) i_m),    inner = (1 + G (R_s + r))^-1
    """
    rail_a = rail_b = drop_a = drop_b = r_aa = r_ab = r_bb = 0.0
    for x in range(3):
        n_a, n_b = 2.0 / 3.0 * _AXIS_ALPHA[x], 2.0 / 3.0 * _AXIS_BETA[x]
        if br.mode[x] >= 0:
            rail, drop, r = br.rail_p[x], -br.drop_p[x], br.r_p[x]
        else:
            rail, drop, r = br.rail_n[x], br.drop_n[x], br.r_n[x]
        rail_a += rail * n_a
        rail_b += rail * n_b
        drop_a += drop * n_a
        drop_b += drop * n_b
        r_aa += r * n_a * _AXIS_ALPHA[x]
        r_ab += r * n_a * _AXIS_BETA[x]
        r_bb += r * n_b * _AXIS_BETA[x]
    br.rail[0], br.rail[1] = rail_a, rail_b
    br.drop[0], br.drop[1] = drop_a, drop_b
    br.r[0], br.r[1], br.r[2] = r_aa, r_ab, r_bb
    G = par.iron_conductance
    if G > 0.0:
        a, b, d = 1.0 + G * (par.R_s + r_aa), G * r_ab, 1.0 + G * (par.R_s + r_bb)
        determinant = a * d - b * b
        br.inner[0], br.inner[1], br.inner[2] = d / determinant, -b / determinant, a / determinant


@inlined
def induced(par, br, u_dc, i_alpha, i_beta):
    """Induced voltage (V) and stator current (A), alpha and beta, of a machine current (A)."""
    R, G = par.R_s, par.iron_conductance
    e_alpha = br.rail[0] * u_dc + br.drop[0] - (R + br.r[0]) * i_alpha - br.r[1] * i_beta
    e_beta = br.rail[1] * u_dc + br.drop[1] - br.r[1] * i_alpha - (R + br.r[2]) * i_beta
    if G > 0.0:
        e_alpha, e_beta = (
            br.inner[0] * e_alpha + br.inner[1] * e_beta,
            br.inner[1] * e_alpha + br.inner[2] * e_beta,
        )
        return e_alpha, e_beta, i_alpha + G * e_alpha, i_beta + G * e_beta
    return e_alpha, e_beta, i_alpha, i_beta


@kernel
def conducting_margin(br, i_alpha, i_beta):
    """As `margin` (A), for the stator current where all legs carry some."""
    smallest = math.inf
    for x in range(3):
        if br.watched[x] == 1:
            i_x = _AXIS_ALPHA[x] * i_alpha + _AXIS_BETA[x] * i_beta
            smallest = min(smallest, br.mode[x] * i_x)
    return smallest


@kernel
def solve(par, br, el, i_d, i_q, w_m, c, s, u_dc):
    """Voltages and current derivatives for the legs as they conduct now.

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
    psi_d, psi_q, turn_d, turn_q, L_dd, L_dq, L_qq = flux(par, i_d, i_q, c, s)
    inverse = 1.0 / (L_dd * L_qq - L_dq * L_dq)
    # induced voltage at constant i_dq
    emf_d, emf_q = w_m * (turn_d - psi_q), w_m * (turn_q + psi_d)
    i_alpha, i_beta = c * i_d - s * i_q, s * i_d + c * i_q  # what magnetises; G e adds to it
    # The field of a leg without current dies away within L G, and steps cannot be as short as they
    # like: a conductance too small for them acts as the smallest they can follow.
    R, G, G_floating = par.R_s, par.iron_conductance, par.iron_floating

    z = floating_leg(br)
    if z == NONE_FLOATS:
        # u = u_0 - R_clamps i_s and u = R i_s + e, with i_s = i + G e
        u_alpha, u_beta = 0.0, 0.0
        R_aa, R_ab, R_bb = R, 0.0, R
        for x in range(3):
            v, r = _clamp(br, x, u_dc)
            n_a, n_b = _AXIS_ALPHA[x], _AXIS_BETA[x]
            u_alpha += 2.0 / 3.0 * v * n_a
            u_beta += 2.0 / 3.0 * v * n_b
            R_aa += 2.0 / 3.0 * r * n_a * n_a
            R_ab += 2.0 / 3.0 * r * n_a * n_b
            R_bb += 2.0 / 3.0 * r * n_b * n_b
        e_alpha = u_alpha - R_aa * i_alpha - R_ab * i_beta
        e_beta = u_beta - R_ab * i_alpha - R_bb * i_beta
        if G > 0.0:
            a, b, d = 1.0 + G * R_aa, G * R_ab, 1.0 + G * R_bb
            determinant = a * d - b * b
            e_alpha, e_beta = (
                (d * e_alpha - b * e_beta) / determinant,
                (a * e_beta - b * e_alpha) / determinant,
            )
            i_alpha += G * e_alpha
            i_beta += G * e_beta
        for x in range(3):
            v, r = _clamp(br, x, u_dc)
            el.v[x] = v - r * (_AXIS_ALPHA[x] * i_alpha + _AXIS_BETA[x] * i_beta)
    elif z == ALL_FLOAT:
        if G > 0.0:
            # the field dies away in the iron
            e_alpha, e_beta = -i_alpha / G_floating, -i_beta / G_floating
            i_alpha = i_beta = 0.0
        else:
            # the derivative of i_alpha_beta is zero
            u_d = emf_d + w_m * (L_dd * i_q - L_dq * i_d)
            u_q = emf_q + w_m * (L_dq * i_q - L_qq * i_d)
            e_alpha, e_beta = c * u_d - s * u_q, s * u_d + c * u_q
        for x in range(3):
            el.v[x] = _AXIS_ALPHA[x] * e_alpha + _AXIS_BETA[x] * e_beta
    else:
        x, y = (z + 1) % 3, (z + 2) % 3
        n_a, n_b = _AXIS_ALPHA[z], _AXIS_BETA[z]
        # unit vector in which the current through x and y points
        t_a = (_AXIS_ALPHA[x] - _AXIS_ALPHA[y]) / _SQRT3
        t_b = (_AXIS_BETA[x] - _AXIS_BETA[y]) / _SQRT3
        v_x, r_x = _clamp(br, x, u_dc)
        v_y, r_y = _clamp(br, y, u_dc)
        R_t = R + 0.5 * (r_x + r_y)
        i_t, i_n = t_a * i_alpha + t_b * i_beta, n_a * i_alpha + n_b * i_beta
        e_t = ((v_x - v_y) / _SQRT3 - R_t * i_t) / (1.0 + G * R_t)
        if G > 0.0:
            e_n = -i_n / G_floating
            i_t += G * e_t
            i_alpha, i_beta = i_t * t_a, i_t * t_b
        else:
            # e_n such that the current along n has no derivative:
            # n . (L^-1 (e - emf) + w J i) = 0 in the rotor frame
            n_d, n_q = c * n_a + s * n_b, c * n_b - s * n_a
            t_d, t_q = c * t_a + s * t_b, c * t_b - s * t_a
            m_d = (L_qq * n_d - L_dq * n_q) * inverse
            m_q = (L_dd * n_q - L_dq * n_d) * inverse
            along_t = m_d * (e_t * t_d - emf_d) + m_q * (e_t * t_q - emf_q)
            turning = w_m * (n_q * i_d - n_d * i_q)
            e_n = -(along_t + turning) / (m_d * n_d + m_q * n_q)
        e_alpha = e_t * t_a + e_n * n_a
        e_beta = e_t * t_b + e_n * n_b
        i_x = 0.5 * _SQRT3 * i_t
        el.v[x] = v_x - r_x * i_x
        el.v[y] = v_y + r_y * i_x
        el.v[z] = 0.5 * (el.v[x] + el.v[y]) + 1.5 * e_n

    if z == ALL_FLOAT and G == 0.0:
        el.di_d, el.di_q = w_m * i_q, -w_m * i_d
    else:
        d_d = c * e_alpha + s * e_beta - emf_d
        d_q = c * e_beta - s * e_alpha - emf_q
        el.di_d = (L_qq * d_d - L_dq * d_q) * inverse
        el.di_q = (L_dd * d_q - L_dq * d_d) * inverse
    el.i_alpha = i_alpha
    el.i_beta = i_beta
    el.e_alpha = e_alpha
    el.e_beta = e_beta
    el.torque = 1.5 * par.n_p * (psi_d * i_q - psi_q * i_d + turn_d * i_d + turn_q * i_q)
    el.c = c
    el.s = s
    el.w_m = w_m


@kernel
def positive_legs(br, i_alpha, i_beta):
    """Bits a, b, c: which legs carry a positive current (A), or are about to."""
    bits = 0
    for x in range(3):
        i_x = _AXIS_ALPHA[x] * i_alpha + _AXIS_BETA[x] * i_beta
        if (br.mode[x] > 0) if br.watched[x] == 1 else (i_x > 0.0):
            bits |= 1 << x
    return bits


@kernel
def _pair_margin(br, el, u_dc):
    """Voltage (V) missing until some pair of legs starts to conduct, while none does."""
    margin = math.inf
    for x in range(3):
        _, high = _limits(br, x, u_dc)
        for y in range(3):
            if y != x:
                low, _ = _limits(br, y, u_dc)
                margin = min(margin, (high - el.v[x]) - (low - el.v[y]))
    return margin


@kernel
def margin(br, el, u_dc):
    """How far the conduction is from changing (A or V); below zero it has changed."""
    if floating_leg(br) == ALL_FLOAT:
        return _pair_margin(br, el, u_dc) + VOLTAGE_ROUNDING
    smallest = math.inf
    for x in range(3):
        if br.watched[x] == 0:
            continue
        if br.mode[x] == 0:
            low, high = _limits(br, x, u_dc)
            smallest = min(smallest, min(el.v[x] - low, high - el.v[x]) + VOLTAGE_ROUNDING)
        else:
            i_x = _AXIS_ALPHA[x] * el.i_alpha + _AXIS_BETA[x] * el.i_beta
            smallest = min(smallest, br.mode[x] * i_x)
    return smallest


@kernel
def _disagreement(par, br, el, u_dc):
    """By how much (V) the voltages contradict the modes; 0 if they agree.

    A leg without current that is to conduct must have a derivative of the right sign.
    """
    z = floating_leg(br)
    if z == ALL_FLOAT:
        return max(0.0, -_pair_margin(br, el, u_dc) - VOLTAGE_ROUNDING)
    # derivative of the current in the stationary frame
    d_d = el.di_d - el.w_m * (el.c * el.i_beta - el.s * el.i_alpha)
    d_q = el.di_q + el.w_m * (el.c * el.i_alpha + el.s * el.i_beta)
    d_alpha, d_beta = el.c * d_d - el.s * d_q, el.s * d_d + el.c * d_q
    worst = 0.0
    for x in range(3):
        if br.watched[x] == 0:
            continue
        if br.mode[x] == 0:
            low, high = _limits(br, x, u_dc)
            excess = max(low - el.v[x], el.v[x] - high)
            worst = max(worst, excess - VOLTAGE_ROUNDING)
        else:
            i_x = _AXIS_ALPHA[x] * el.i_alpha + _AXIS_BETA[x] * el.i_beta
            if par.iron_conductance > 0.0:
                # the current follows the voltage at once
                worst = max(worst, -br.mode[x] * i_x)
            elif abs(i_x) <= ZERO_CURRENT:
                rate = _AXIS_ALPHA[x] * d_alpha + _AXIS_BETA[x] * d_beta
                worst = max(worst, -br.mode[x] * rate * par.L_d)
    return worst


@kernel
def modes_code(br):
    """How the legs conduct now, as a number that `find_modes` takes."""
    code, weight = 0, 1
    for x in range(3):
        code += weight * (br.mode[x] if br.mode[x] >= 0 else 2)
        weight *= 3
    return code


@kernel
def _choose(par, br, el, i_d, i_q, w_m, c, s, u_dc, fixed, flowing, ended):
    """Set the modes of the legs that are not fixed to those that agree best."""
    modes = (0, 1, -1)
    best, best_code = math.inf, 0
    known = (br.mode[0], br.mode[1], br.mode[2])
    for code in range(28):
        if code == 27:
            code = best_code  # the last round sets what was found
        possible = True
        digits = code
        for x in range(3):
            mode = modes[digits % 3]
            digits //= 3
            if fixed >> x & 1:
                possible = possible and mode == known[x]
            else:
                possible = possible and (mode != 0 or br.can_float[x] == 1)
            br.mode[x] = mode
        if not possible or (flowing and floating_leg(br) == ALL_FLOAT):
            continue
        solve(par, br, el, i_d, i_q, w_m, c, s, u_dc)
        wrong = _disagreement(par, br, el, u_dc)
        if code == ended:
            wrong = max(wrong, 2.0 * VOLTAGE_ROUNDING)  # so near its end only if nothing else is
        if wrong < best:
            best, best_code = wrong, code
        if wrong <= VOLTAGE_ROUNDING:
            return


@kernel
def without_floating(par, br, i_d, i_q, c, s):
    """The current (i_d, i_q) (A) with that of floating legs removed to the last digit.

    With iron loss it dies away by itself, and is not touched.
    """
    z = floating_leg(br)
    if z == NONE_FLOATS or par.iron_conductance > 0.0:
        return i_d, i_q
    if z == ALL_FLOAT:
        return 0.0, 0.0
    n_d = c * _AXIS_ALPHA[z] + s * _AXIS_BETA[z]
    n_q = c * _AXIS_BETA[z] - s * _AXIS_ALPHA[z]
    i_n = n_d * i_d + n_q * i_q
    return i_d - i_n * n_d, i_q - i_n * n_q


@kernel
def _all_conduct(par, br, i_alpha, i_beta, u_dc):
    """Whether all legs carry current in the directions of their modes."""
    join_legs(par, br)
    _, _, i_alpha, i_beta = induced(par, br, u_dc, i_alpha, i_beta)
    return conducting_margin(br, i_alpha, i_beta) > ZERO_CURRENT


@kernel
def find_modes(par, br, el, i_d, i_q, w_m, c, s, u_dc, ended):
    """Find how the legs conduct, after a switching instant or the end of a current.

    A leg with current has the mode of its sign. For the others the combination is taken whose
    voltages agree with it; the law of the legs is monotone, so there is one. With iron loss the
    current depends on the voltage itself, so that no mode is known beforehand. `ended` are the
    modes that have just come to their end (`modes_code`), or -1.

    Returns
    -------
    (i_d, i_q) : the current, with that of floating legs removed to the last digit
    """
    i_alpha, i_beta = c * i_d - s * i_q, s * i_d + c * i_q
    fixed = 0  # bit x: the mode of leg x is known
    flowing = False
    for x in range(3):
        i_x = _AXIS_ALPHA[x] * i_alpha + _AXIS_BETA[x] * i_beta
        has_current = abs(i_x) > ZERO_CURRENT and par.iron_conductance == 0.0
        flowing = flowing or has_current
        if br.watched[x] == 0:
            br.mode[x] = 1
            fixed |= 1 << x
        elif has_current:
            br.mode[x] = 1 if i_x > 0.0 else -1
            fixed |= 1 << x
        else:
            br.mode[x] = 1 if i_x > 0.0 else -1  # most likely
    if fixed != 7 and not (
        par.iron_conductance > 0.0 and _all_conduct(par, br, i_alpha, i_beta, u_dc)
    ):
        _choose(par, br, el, i_d, i_q, w_m, c, s, u_dc, fixed, flowing, ended)
    return without_floating(par, br, i_d, i_q, c, s)


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
        i_x = _AXIS_ALPHA[x] * el.i_alpha + _AXIS_BETA[x] * el.i_beta
        if br.mode[x] > 0:
            total += br.rail_p[x] * i_x
            loss += (br.drop_p[x] + br.r_p[x] * i_x) * i_x
        elif br.mode[x] < 0:
            total += br.rail_n[x] * i_x
            loss += (br.r_n[x] * i_x - br.drop_n[x]) * i_x
    return total, loss

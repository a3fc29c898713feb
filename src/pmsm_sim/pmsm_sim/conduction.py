"""Which of the inverter's legs conduct: how long yet, and which do afterwards (see `bridge`)."""

from __future__ import annotations

import math

from pmsm_sim.bridge import (
    ALL_FLOAT,
    AXIS_ALPHA,
    AXIS_BETA,
    floating_leg,
    induced,
    join_legs,
    solve,
    solve_joined,
)
from pmsm_sim.frames import stationary
from pwm_node.compiled import kernel

# Below this a current has no sign (A).
ZERO_CURRENT = 1e-9
# Rounding of a voltage that is compared with a limit (V).
VOLTAGE_ROUNDING = 1e-9
# What agrees better than this is taken rather than what has just ended (V, A): a current that is
# zero but for rounding is some microvolts across the largest iron-loss resistance.
_AT_ITS_END = 1e-4


@kernel
def limits(br, x, u_dc):
    """Between which terminal voltages leg x carries no current (V)."""
    return (
        br.rail_p[x] * u_dc - br.drop_p[x],
        br.rail_n[x] * u_dc + br.drop_n[x],
    )


@kernel
def conducting_margin(br, i_alpha, i_beta):
    """As `margin` (A), for the stator current where all legs carry some."""
    smallest = math.inf
    for x in range(3):
        if br.watched[x] == 1:
            i_x = AXIS_ALPHA[x] * i_alpha + AXIS_BETA[x] * i_beta
            smallest = min(smallest, br.mode[x] * i_x)
    return smallest


@kernel
def positive_legs(br, i_alpha, i_beta):
    """Bits a, b, c: which legs carry a positive current (A), or are about to."""
    bits = 0
    for x in range(3):
        i_x = AXIS_ALPHA[x] * i_alpha + AXIS_BETA[x] * i_beta
        if (br.mode[x] > 0) if br.watched[x] == 1 else (i_x > 0.0):
            bits |= 1 << x
    return bits


@kernel
def _pair_margin(br, el, u_dc):
    """Voltage (V) missing until some pair of legs starts to conduct, while none does."""
    margin = math.inf
    for x in range(3):
        _, high = limits(br, x, u_dc)
        for y in range(3):
            if y != x:
                low, _ = limits(br, y, u_dc)
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
            low, high = limits(br, x, u_dc)
            smallest = min(smallest, min(el.v[x] - low, high - el.v[x]) + VOLTAGE_ROUNDING)
        else:
            i_x = AXIS_ALPHA[x] * el.i_alpha + AXIS_BETA[x] * el.i_beta
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
    d_alpha = d_beta = 0.0
    if par.iron_conductance == 0.0:
        # derivative of the current in the stationary frame
        d_d = el.di_d - el.w_m * (el.c * el.i_beta - el.s * el.i_alpha)
        d_q = el.di_q + el.w_m * (el.c * el.i_alpha + el.s * el.i_beta)
        d_alpha, d_beta = stationary(d_d, d_q, el.c, el.s)
    worst = 0.0
    for x in range(3):
        if br.watched[x] == 0:
            continue
        if br.mode[x] == 0:
            low, high = limits(br, x, u_dc)
            excess = max(low - el.v[x], el.v[x] - high)
            worst = max(worst, excess - VOLTAGE_ROUNDING)
        else:
            i_x = AXIS_ALPHA[x] * el.i_alpha + AXIS_BETA[x] * el.i_beta
            if par.iron_conductance > 0.0:
                # the current follows the voltage at once
                worst = max(worst, -br.mode[x] * i_x)
            elif abs(i_x) <= ZERO_CURRENT:
                rate = AXIS_ALPHA[x] * d_alpha + AXIS_BETA[x] * d_beta
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
    i_alpha, i_beta = stationary(i_d, i_q, c, s)
    best, best_code = math.inf, 0
    known = (br.mode[0], br.mode[1], br.mode[2])
    for code in range(28):
        if code == 27:
            code = best_code  # the last round sets what was found
        possible, chosen = True, False
        digits = code
        for x in range(3):
            mode = modes[digits % 3]
            digits //= 3
            if fixed >> x & 1:
                possible = possible and mode == known[x]
            else:
                possible = possible and (mode != 0 or br.can_float[x] == 1)
                chosen = chosen or mode != 0
            br.mode[x] = mode
        # one leg alone carries no current: that has one name only, so that its end is known again
        if not possible or ((flowing or chosen) and floating_leg(br) == ALL_FLOAT):
            continue
        if par.iron_conductance > 0.0:
            join_legs(par, br, par.iron_conductance)
            solve_joined(par, br, el, i_alpha, i_beta, u_dc)
        else:
            solve(par, br, el, i_d, i_q, w_m, c, s, u_dc)
        wrong = _disagreement(par, br, el, u_dc)
        if code == ended:
            wrong = max(wrong, _AT_ITS_END)  # only if nothing else agrees
        if wrong < best:
            best, best_code = wrong, code
        if wrong <= VOLTAGE_ROUNDING:
            return


@kernel
def without_floating(br, i_d, i_q, c, s):
    """The current (i_d, i_q) (A) with that of floating legs removed to the last digit.

    Without iron loss; with it, it dies away by itself.
    """
    z = floating_leg(br)
    if z == ALL_FLOAT:
        return 0.0, 0.0
    n_d = c * AXIS_ALPHA[z] + s * AXIS_BETA[z]
    n_q = c * AXIS_BETA[z] - s * AXIS_ALPHA[z]
    i_n = n_d * i_d + n_q * i_q
    return i_d - i_n * n_d, i_q - i_n * n_q


@kernel
def _all_conduct(par, br, i_alpha, i_beta, u_dc):
    """Whether all legs carry current in the directions of their modes."""
    join_legs(par, br, par.iron_conductance)
    _, _, i_alpha, i_beta = induced(par, br, u_dc, i_alpha, i_beta)
    return conducting_margin(br, i_alpha, i_beta) > ZERO_CURRENT


@kernel
def find_modes(par, br, el, i_d, i_q, w_m, c, s, u_dc, ended):
    """Find how the legs conduct, after a switching instant or the end of a current.

    A leg with current has the mode of its sign. For the others the combination is taken whose
    voltages agree with it; the law of the legs is monotone, so there is one. With iron loss the
    current depends on the voltage itself, so that no mode is known beforehand. `ended` are the
    modes that have just come to their end (`modes_code`), or -1.
    """
    i_alpha, i_beta = stationary(i_d, i_q, c, s)
    fixed = 0  # bit x: the mode of leg x is known
    flowing = False
    for x in range(3):
        i_x = AXIS_ALPHA[x] * i_alpha + AXIS_BETA[x] * i_beta
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

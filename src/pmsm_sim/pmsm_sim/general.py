"""One PWM period of the complete model, with every effect there is.

The period is cut where a gate is switched; inside such an interval the classical fourth-order
Runge-Kutta method runs with equal steps. Where the conduction of a leg changes by itself (a
current ends, a diode starts) the step is shortened until it ends at that very instant.

Every power flow is integrated along with the state, so that the balance of energy can be drawn up
at any time (`Plant.energies`).
"""

from __future__ import annotations

import math

import numpy as np

from pmsm_sim.bridge import (
    NONE_FLOATS,
    conducting_rails,
    connect_leg,
    find_modes,
    floating_leg,
    margin,
    rail_current,
    solve,
    without_floating,
)
from pmsm_sim.columns import FIRST_ENERGY, N_INTEGRATED, column
from pmsm_sim.dc_link import begin_dc_link, charge, end_dc_link
from pmsm_sim.frames import phases
from pmsm_sim.inverter import begin_gates, leg_gate, remember_gates, switching_instants
from pmsm_sim.machine import cogging
from pmsm_sim.mechanics import begin_mechanics, end_mechanics, move
from pmsm_sim.part import MOST_STEPS
from pmsm_sim.sensors import begin_low_pass, end_low_pass, low_pass, shown
from pwm_node.compiled import kernel

_I_D, _I_Q = column("i_d"), column("i_q")
_W_M, _TURN_M = column("w_M"), column("turn_M")
_U_DC, _DC = column("u_dc"), column("dc")
_INVERTER, _COPPER, _IRON = column("inverter"), column("copper"), column("iron")

# Rows of the work space: state, state after the step, four derivatives.
_ROWS = 6
# Changes of conduction in one period: more than any drive has, so that rounding cannot hold it up.
_MAX_EVENTS = 200
# Largest electrical angle (rad) of one step; harmonics and saturation turn faster.
_STEP_ANGLE = 0.06
_STEP_ANGLE_FINE = 0.02


@kernel
def _solve_at(par, st, y):
    """Fill `st.electric` for the state y."""
    theta_m = par.n_p * (st.theta_M + y[_TURN_M])
    c, s = math.cos(theta_m), math.sin(theta_m)
    w_m = par.n_p * y[_W_M]
    solve(par, st.bridge, st.electric, y[_I_D], y[_I_Q], w_m, c, s, y[_U_DC])


@kernel
def _derivative(par, st, t, y, dy):
    """Time derivative of all integrated quantities, t (s) after the period began."""
    _solve_at(par, st, y)
    el = st.electric
    dy[_I_D] = el.di_d
    dy[_I_Q] = el.di_q
    low_pass(par, y, dy, el.i_alpha, el.i_beta)
    dy[_COPPER] = 1.5 * par.R_s * (el.i_alpha**2 + el.i_beta**2)
    dy[_IRON] = 1.5 * par.iron_conductance * (el.e_alpha**2 + el.e_beta**2)

    i_dc, dy[_INVERTER] = rail_current(st.bridge, el)
    charge(par, st.period, t, st.chopping, y, dy, i_dc)
    tau_M = el.torque + cogging(par, st.theta_M + y[_TURN_M])
    move(par, st.period, t, y, dy, tau_M)


@kernel
def _step(par, st, work, t, h):
    """One Runge-Kutta step of length h (s) from `work[0]` at t, where y' is `work[2]`, to
    `work[1]`."""
    y, y_end, k_1, k_2, k_3, k_4 = work[0], work[1], work[2], work[3], work[4], work[5]
    half = 0.5 * h
    for n in range(N_INTEGRATED):
        y_end[n] = y[n] + half * k_1[n]
    _derivative(par, st, t + half, y_end, k_2)
    for n in range(N_INTEGRATED):
        y_end[n] = y[n] + half * k_2[n]
    _derivative(par, st, t + half, y_end, k_3)
    for n in range(N_INTEGRATED):
        y_end[n] = y[n] + h * k_3[n]
    _derivative(par, st, t + h, y_end, k_4)
    sixth = h / 6.0
    for n in range(N_INTEGRATED):
        y_end[n] = y[n] + sixth * (k_1[n] + 2.0 * (k_2[n] + k_3[n]) + k_4[n])


@kernel
def _margin_after(par, st, work, t, h):
    """Step by h and tell how far the conduction is from changing then."""
    _step(par, st, work, t, h)
    _solve_at(par, st, work[1])
    return margin(st.bridge, st.electric, work[1][_U_DC])


@kernel
def _step_to_event(par, st, work, t, h, start, end):
    """Shorten the step from h to where the margin, `start` at 0 and `end` < 0 at h, is zero.

    Bisection until there is a bracket, then regula falsi (Illinois variant). Returns the length.
    """
    low, high = 0.0, h
    at_low, at_high = max(start, 0.0), end
    length = h
    side = 0
    for _ in range(80):
        if at_low > 0.0:
            length = (low * at_high - high * at_low) / (at_high - at_low)
        else:
            length = 0.5 * (low + high)
        if high - low < 1e-16:
            break
        here = _margin_after(par, st, work, t, length)
        if abs(here) < 1e-13:
            break
        if here > 0.0:
            low, at_low = length, here
            if side == 1:
                at_high *= 0.5
            side = 1
        else:
            high, at_high = length, here
            if side == -1:
                at_low *= 0.5
            side = -1
    _step(par, st, work, t, length)
    return length


@kernel
def _settle(par, st, work, t):
    """After a change of the gates or of the conduction: find the modes anew."""
    y = work[0]
    theta_m = par.n_p * (st.theta_M + y[_TURN_M])
    c, s = math.cos(theta_m), math.sin(theta_m)
    w_m = par.n_p * y[_W_M]
    y[_I_D], y[_I_Q] = find_modes(
        par, st.bridge, st.electric, y[_I_D], y[_I_Q], w_m, c, s, y[_U_DC]
    )
    _derivative(par, st, t, y, work[2])


@kernel
def _clean(par, st, y):
    """Keep the current of floating legs at zero against the error of the integration."""
    theta_m = par.n_p * (st.theta_M + y[_TURN_M])
    c, s = math.cos(theta_m), math.sin(theta_m)
    y[_I_D], y[_I_Q] = without_floating(par, st.bridge, y[_I_D], y[_I_Q], c, s)


@kernel
def _longest_step(par, st, y):
    """Longest step (s) that keeps the error small now."""
    angle = _STEP_ANGLE_FINE if par.harmonics or par.saturates else _STEP_ANGLE
    w_m = abs(par.n_p * y[_W_M])
    h = par.h_general
    if w_m * h > angle:
        h = angle / w_m
    if par.iron_conductance > 0.0 and floating_leg(st.bridge) != NONE_FLOATS:
        # the field of a floating leg dies away within L G
        h = min(h, 0.5 * min(par.L_d, par.L_q) * par.iron_floating)
    # beyond that no drive makes sense, and a run must end
    return max(h, par.T_s / MOST_STEPS)


@kernel
def _look(par, st, work, t, target):
    """State of the currents at `target` >= t by a step that leads nowhere else."""
    if target > t:
        _step(par, st, work, t, target - t)
        _solve_at(par, st, work[1])
    else:
        _solve_at(par, st, work[0])


@kernel
def _oversample(par, st, work, t_0, t_1, k, i_abc, legs_out):
    """Waveform at the points j T_s / n in [t_0, t_1), by steps that lead nowhere else.

    The trajectory itself is not touched, so a run is the same with and without oversampling.
    Returns the index of the next point.
    """
    n = legs_out.shape[0]
    dt = par.T_s / n
    while k < n and k * dt < t_1:
        _look(par, st, work, t_0, k * dt)
        el = st.electric
        i_abc[3 * k], i_abc[3 * k + 1], i_abc[3 * k + 2] = phases(el.i_alpha, el.i_beta)
        legs_out[k] = conducting_rails(st.bridge)
        k += 1
    return k


@kernel
def _take_samples(par, st, work, t_0, t_1):
    """Keep what the sensors will report at the start of the next period, if it is their time."""
    t = par.T_s - par.lead
    if t_0 <= t < t_1 or (t_1 == par.T_s and t == t_1):
        _look(par, st, work, t_0, t)
        y, el = work[1] if t > t_0 else work[0], st.electric
        st.i_sampled[0], st.i_sampled[1] = shown(par, y, el.i_alpha, el.i_beta)
    t = par.T_s - par.encoder_latency
    if t_0 <= t < t_1 or (t_1 == par.T_s and t == t_1):
        _look(par, st, work, t_0, t)
        y = work[1] if t > t_0 else work[0]
        st.theta_sampled = st.theta_M + y[_TURN_M]


@kernel
def _begin(par, st, y):
    """State at the start of the period."""
    fresh = not st.general_before
    st.general_before = True
    y[_I_D], y[_I_Q] = st.i_d, st.i_q
    theta_m = par.n_p * st.theta_M
    begin_mechanics(par, st, y, fresh)
    begin_dc_link(par, st, y, fresh)
    begin_low_pass(par, st, y, math.cos(theta_m), math.sin(theta_m), fresh)
    if fresh:
        begin_gates(st)


@kernel
def _end(par, st, y):
    """State after the period, but for angle and period number."""
    st.i_d, st.i_q = y[_I_D], y[_I_Q]
    end_mechanics(st, y)
    end_dc_link(st, y)
    end_low_pass(par, st, y)
    for n in range(N_INTEGRATED - FIRST_ENERGY):
        st.energy[n] += y[FIRST_ENERGY + n]
    remember_gates(par, st)


@kernel
def integrate(par, st, i_abc, legs_out):
    """Advance the state by one period.

    Returns the mechanical angle turned (rad) and the energy taken from the DC link (J).
    """
    work = np.zeros((_ROWS, N_INTEGRATED))
    y, y_end = work[0], work[1]
    _begin(par, st, y)
    instants = np.empty(40)
    n_instants = switching_instants(par, st, instants)
    events = 0
    n_over, k = legs_out.shape[0], 0
    for j in range(n_instants - 1):
        t, t_end = instants[j], instants[j + 1]
        middle = 0.5 * (t + t_end)
        watched = False
        for x in range(3):
            connect_leg(par, st.bridge, x, leg_gate(par, st, x, middle))
            watched = watched or st.bridge.watched[x] == 1
        _settle(par, st, work, t)
        before = margin(st.bridge, st.electric, y[_U_DC]) if watched else 0.0
        while t < t_end:
            steps = max(1, math.ceil((t_end - t) / _longest_step(par, st, y)))
            h = (t_end - t) / steps
            _step(par, st, work, t, h)
            t_next = t_end if steps == 1 else t + h
            event = False
            if watched and events < _MAX_EVENTS:
                _solve_at(par, st, y_end)
                after = margin(st.bridge, st.electric, y_end[_U_DC])
                if after < 0.0:
                    event = True
                    events += 1
                    h = _step_to_event(par, st, work, t, h, before, after)
                    t_next = t + h
                before = after
            looked = False
            if n_over > 0 and k < n_over and k * par.T_s / n_over < t_next:
                k = _oversample(par, st, work, t, t_next, k, i_abc, legs_out)
                looked = True
            if par.T_s - max(par.lead, par.encoder_latency) < t_next or t_next == par.T_s:
                _take_samples(par, st, work, t, t_next)
                looked = True
            if looked:
                _step(par, st, work, t, h)  # the looks used its work space
            y[:] = y_end
            t = t_next
            if event:
                _settle(par, st, work, t)
                before = margin(st.bridge, st.electric, y[_U_DC])
            else:
                if watched:
                    _clean(par, st, y)
                _derivative(par, st, t, y, work[2])
    _end(par, st, y)
    return y[_TURN_M], y[_DC]

"""One PWM period of the complete model, with every effect there is.

The period is cut where a gate is switched; inside such an interval the classical fourth-order
Runge-Kutta method runs with equal steps. Where the conduction of a leg changes by itself (a
current ends, a diode starts) the step is shortened until it ends at that very instant.
"""

from __future__ import annotations

import math

import numpy as np

from pmsm_sim.bridge import (
    conducting_rails,
    connect_leg,
    find_modes,
    margin,
    solve,
    without_floating,
)
from pmsm_sim.ideal import MAX_STEP_ANGLE
from pmsm_sim.inverter import leg_gate, switching_instants
from pmsm_sim.machine import torque
from pwm_node.compiled import kernel

# The integrated quantities
I_D, I_Q, W_M, TURN, ENERGY = range(5)
SIZE = 5

# Changes of conduction in one period: more than any drive has, so that rounding cannot hold it up.
_MAX_EVENTS = 200
_SQRT3_2 = 0.5 * math.sqrt(3.0)


@kernel
def _solve_at(par, st, y):
    theta_m = par.n_p * (st.theta_M + y[TURN])
    w_m = par.n_p * y[W_M]
    c, s = math.cos(theta_m), math.sin(theta_m)
    solve(par, st.bridge, st.electric, y[I_D], y[I_Q], w_m, c, s, par.u_dc)


@kernel
def _rail_current(st):
    """Current out of the positive rail (A)."""
    el = st.electric
    bits = conducting_rails(st.bridge)
    total = 0.0
    if bits & 1:
        total += el.i_alpha
    if bits & 2:
        total += -0.5 * el.i_alpha + _SQRT3_2 * el.i_beta
    if bits & 4:
        total += -0.5 * el.i_alpha - _SQRT3_2 * el.i_beta
    return total


@kernel
def derivative(par, st, y, dy):
    """Time derivative of all integrated quantities."""
    _solve_at(par, st, y)
    el = st.electric
    dy[I_D] = el.di_d
    dy[I_Q] = el.di_q
    tau_M = torque(par, y[I_D], y[I_Q])
    dy[W_M] = (tau_M - par.tau_L - par.B * y[W_M]) / par.J
    dy[TURN] = y[W_M]
    dy[ENERGY] = par.u_dc * _rail_current(st)


@kernel
def _step(par, st, work, h):
    """One Runge-Kutta step of length h (s) from `work[0]` to `work[1]`; `work[2]` holds y'."""
    y, y_end, k_1, k_2, k_3, k_4 = work[0], work[1], work[2], work[3], work[4], work[5]
    half = 0.5 * h
    for n in range(SIZE):
        y_end[n] = y[n] + half * k_1[n]
    derivative(par, st, y_end, k_2)
    for n in range(SIZE):
        y_end[n] = y[n] + half * k_2[n]
    derivative(par, st, y_end, k_3)
    for n in range(SIZE):
        y_end[n] = y[n] + h * k_3[n]
    derivative(par, st, y_end, k_4)
    sixth = h / 6.0
    for n in range(SIZE):
        y_end[n] = y[n] + sixth * (k_1[n] + 2.0 * (k_2[n] + k_3[n]) + k_4[n])


@kernel
def _margin_after(par, st, work, h):
    """Step by h and tell how far the conduction is from changing then."""
    _step(par, st, work, h)
    _solve_at(par, st, work[1])
    return margin(st.bridge, st.electric, par.u_dc)


@kernel
def _step_to_event(par, st, work, h, start, end):
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
        here = _margin_after(par, st, work, length)
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
    _step(par, st, work, length)
    return length


@kernel
def _settle(par, st, work):
    """After a change of the gates or of the conduction: find the modes anew."""
    y = work[0]
    theta_m = par.n_p * (st.theta_M + y[TURN])
    w_m = par.n_p * y[W_M]
    c, s = math.cos(theta_m), math.sin(theta_m)
    y[I_D], y[I_Q] = find_modes(par, st.bridge, st.electric, y[I_D], y[I_Q], w_m, c, s, par.u_dc)
    derivative(par, st, y, work[2])


@kernel
def _clean(par, st, y):
    """Keep the current of floating legs at zero against the error of the integration."""
    theta_m = par.n_p * (st.theta_M + y[TURN])
    c, s = math.cos(theta_m), math.sin(theta_m)
    y[I_D], y[I_Q] = without_floating(st.bridge, y[I_D], y[I_Q], c, s)


@kernel
def _oversample(par, st, work, t_0, t_1, k, i_abc, legs_out):
    """Waveform at the points j T_s / n in [t_0, t_1), by steps that lead nowhere else.

    The trajectory itself is not touched, so a run is the same with and without oversampling.
    Returns the index of the next point.
    """
    n = legs_out.shape[0]
    dt = par.T_s / n
    while k < n and k * dt < t_1:
        _step(par, st, work, max(k * dt - t_0, 0.0))
        _solve_at(par, st, work[1])
        el = st.electric
        i_abc[3 * k] = el.i_alpha
        i_abc[3 * k + 1] = -0.5 * el.i_alpha + _SQRT3_2 * el.i_beta
        i_abc[3 * k + 2] = -0.5 * el.i_alpha - _SQRT3_2 * el.i_beta
        legs_out[k] = conducting_rails(st.bridge)
        k += 1
    return k


@kernel
def integrate(par, st, i_abc, legs_out):
    """Advance the state by one period; returns the mechanical angle turned (rad) and the energy
    taken from the DC link (J)."""
    work = np.zeros((6, SIZE))
    y, y_end = work[0], work[1]
    y[I_D], y[I_Q], y[W_M] = st.i_d, st.i_q, st.w_M
    instants = np.empty(32)
    n_instants = switching_instants(par, st, instants)
    events = 0
    n_over, k = legs_out.shape[0], 0
    for j in range(n_instants - 1):
        t, t_end = instants[j], instants[j + 1]
        middle = 0.5 * (t + t_end)
        watched = False
        for x in range(3):
            connect_leg(st.bridge, x, leg_gate(par, st, x, middle))
            watched = watched or st.bridge.watched[x] == 1
        _settle(par, st, work)
        before = margin(st.bridge, st.electric, par.u_dc) if watched else 0.0
        while t < t_end:
            rate = max(1.0 / par.h_max, abs(par.n_p * y[W_M]) / MAX_STEP_ANGLE)
            steps = math.ceil((t_end - t) * rate)
            h = (t_end - t) / steps
            _step(par, st, work, h)
            t_next = t_end if steps == 1 else t + h
            event = False
            if watched and events < _MAX_EVENTS:
                _solve_at(par, st, y_end)
                after = margin(st.bridge, st.electric, par.u_dc)
                if after < 0.0:
                    event = True
                    events += 1
                    h = _step_to_event(par, st, work, h, before, after)
                    t_next = t + h
                before = after
            if n_over > 0:
                # it uses the same work space, so the step is done again after it
                k_next = _oversample(par, st, work, t, t_next, k, i_abc, legs_out)
                if k_next != k:
                    k = k_next
                    _step(par, st, work, h)
            y[:] = y_end
            t = t_next
            if event:
                _settle(par, st, work)
                before = margin(st.bridge, st.electric, par.u_dc)
            else:
                if watched:
                    _clean(par, st, y)
                derivative(par, st, y, work[2])
    st.i_d, st.i_q, st.w_M = y[I_D], y[I_Q], y[W_M]
    return y[TURN], y[ENERGY]

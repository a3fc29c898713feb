"""One PWM period of the complete model, with every effect there is.

The period is cut where a gate is switched. Inside such an interval, one or few steps lead from
instant to instant: those of `steps` while current flows in every leg, those of `floating`
otherwise. Where the conduction of a leg changes by itself (a current ends, a diode starts), or that
of the rectifier's diodes, the step is shortened until it ends at that very instant.

Every power flow is summed up along with the state, so that the balance of energy can be drawn up
at any time (`Plant.energies`).
"""

from __future__ import annotations

import math

from pmsm_sim import columns as col
from pmsm_sim.bridge import (
    NONE_FLOATS,
    conducting_rails,
    connect_legs,
    floating_leg,
    induced,
    join_legs,
    solve_joined,
)
from pmsm_sim.conduction import (
    VOLTAGE_ROUNDING,
    conducting_margin,
    find_modes,
    margin,
    modes_code,
    positive_legs,
    without_floating,
)
from pmsm_sim.floating import complete, floating_step, solve_at
from pmsm_sim.frames import phases
from pmsm_sim.ideal import MAX_STEP_ANGLE
from pmsm_sim.parts.dc_link import begin_dc_link, end_dc_link, pulse_end, surplus
from pmsm_sim.parts.inverter import begin_gates, rails, remember_gates, set_gates
from pmsm_sim.parts.mechanics import begin_mechanics, end_mechanics
from pmsm_sim.parts.part import MOST_STEPS
from pmsm_sim.parts.sensors import begin_low_pass, end_low_pass, shown
from pmsm_sim.steps import full_step, plain_step
from pwm_node.compiled import kernel

# Changes of conduction in one period: more than any drive has, so that rounding cannot hold it up.
_MAX_EVENTS = 50
# Largest electrical angle (rad) of one step where the flux has harmonics, which turn faster.
_STEP_ANGLE_FINE = 0.02
# Up to this part of the longest step the third order is enough.
_SHORT = 0.05
# Longest step while a leg floats, over that while all conduct: there it is the current that is
# integrated, and the derivatives of a flux map's spline jump from cell to cell.
_FLOATING, _FLOATING_SATURATED = 0.25, 0.04
# With iron loss, over the time within which the field of a floating leg dies away.
_DECAY = 0.05


@kernel
def _floats(st):
    """Whether some leg carries no current."""
    return floating_leg(st.bridge) != NONE_FLOATS


@kernel
def _is_blind(par, st):
    """Whether the flux linkage does not tell all: a leg floats, and no iron loss says how."""
    return par.iron_conductance == 0.0 and _floats(st)


@kernel
def _step(par, st, y, y_end, t, h):
    """One step of length h (s) from the instant y at t to y_end."""
    if _is_blind(par, st):
        floating_step(par, st, y, y_end, t, h)
        complete(par, st, y_end)
        return
    short = h < _SHORT * par.h_general and par.filter_rate == 0.0 and not _floats(st)
    if par.full:
        full_step(par, st, y, y_end, t, h, short)
    else:
        plain_step(par, st, y, y_end, t, h, short)


@kernel
def _stator_current(par, st, y):
    """Current at the terminals (A, alpha and beta) at the instant y."""
    _, _, i_alpha, i_beta = induced(par, st.bridge, y[col.U_DC], y[col.I_ALPHA], y[col.I_BETA])
    return i_alpha, i_beta


@kernel
def _margin(par, st, y):
    """How far the conduction is from changing at the instant y; below zero it has changed."""
    br = st.bridge
    if not _floats(st):
        i_alpha, i_beta = _stator_current(par, st, y)
        return conducting_margin(br, i_alpha, i_beta)
    if par.iron_conductance > 0.0:
        solve_joined(par, br, st.electric, y[col.I_ALPHA], y[col.I_BETA], y[col.U_DC])
    else:
        solve_at(par, st, y)
    return margin(br, st.electric, y[col.U_DC])


@kernel
def _distance(par, st, t, y, grid):
    """What an event makes negative, at t: the margin of the legs or the sign of the grid's surplus.

    `grid` is that sign before the event; 0 is for the legs.
    """
    if grid == 0.0:
        return _margin(par, st, y)
    return grid * surplus(par, st.period, t, y[col.U_DC])


@kernel
def _step_to_event(par, st, y, y_end, t, h, grid):
    """Shorten the step from h to where the distance from an event, negative at h, is zero.

    Bisection until there is a bracket, then regula falsi (Illinois variant). Where the distance
    jumps (at the border of a flux map), the step ends behind the jump. Returns the length.
    """
    low, high = 0.0, h
    at_low = max(_distance(par, st, t, y, grid), 0.0)
    at_high = _distance(par, st, t + h, y_end, grid)
    length = h
    side = 0
    for _ in range(80):
        if at_low > 0.0:
            length = (low * at_high - high * at_low) / (at_high - at_low)
        else:
            length = 0.5 * (low + high)
        if high - low < 1e-16:
            break
        _step(par, st, y, y_end, t, length)
        here = _distance(par, st, t + length, y_end, grid)
        if abs(here) < 2e-12:
            return length
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
    _step(par, st, y, y_end, t, high)
    return high


@kernel
def _clean(par, st, y):
    """Keep the current of floating legs at zero against the error of the integration."""
    i_d, i_q = y[col.I_D], y[col.I_Q]
    y[col.I_D], y[col.I_Q] = without_floating(st.bridge, i_d, i_q, y[col.C], y[col.S])
    complete(par, st, y)


@kernel
def _turned(par, st, t, t_next, y, y_end):
    """Sign of the grid's surplus before a step in which it changes: the rectifier's diodes do."""
    if not par.rectifier:
        return 0.0
    before = surplus(par, st.period, t, y[col.U_DC])
    after = surplus(par, st.period, t_next, y_end[col.U_DC])
    if abs(before) < VOLTAGE_ROUNDING or before * after >= 0.0:
        return 0.0
    return math.copysign(1.0, before)


@kernel
def _enlarge(par, st, y, factor):
    """Enlarge the current of floating legs by this factor, that of the larger iron loss they have.

    So their voltage goes on as it was, e = -i / G, where they begin to float and where they end.
    """
    P = st.bridge.P
    a, b = y[col.I_ALPHA], y[col.I_BETA]
    flows_a, flows_b = P[0] * a + P[1] * b, P[1] * a + P[2] * b
    a, b = flows_a + factor * (a - flows_a), flows_b + factor * (b - flows_b)
    y[col.I_D] = y[col.C] * a + y[col.S] * b
    y[col.I_Q] = y[col.C] * b - y[col.S] * a
    complete(par, st, y)


@kernel
def _settle(par, st, y, ended):
    """After a change of the gates (ended = -1) or of the conduction: find the modes anew."""
    if par.iron_floating > par.iron_conductance > 0.0:
        _enlarge(par, st, y, par.iron_conductance / par.iron_floating)
    c, s, w_m = y[col.C], y[col.S], par.n_p * y[col.W_M]
    i_d, i_q, u_dc = y[col.I_D], y[col.I_Q], y[col.U_DC]
    find_modes(par, st.bridge, st.electric, i_d, i_q, w_m, c, s, u_dc, ended)
    if _is_blind(par, st):
        _clean(par, st, y)
    else:
        join_legs(par, st.bridge, par.iron_floating)
        if par.iron_floating > par.iron_conductance > 0.0:
            _enlarge(par, st, y, par.iron_floating / par.iron_conductance)


@kernel
def _longest_step(par, st, y):
    """Longest step (s) that keeps the error small now."""
    h = par.h_general
    if _is_blind(par, st):
        h *= _FLOATING_SATURATED if par.saturates else _FLOATING
    elif _floats(st):
        # the field of a floating leg dies away within L G
        h = min(h, _DECAY * min(par.L_d, par.L_q) * par.iron_floating)
    angle = _STEP_ANGLE_FINE if par.harmonics else MAX_STEP_ANGLE
    w_m = abs(par.n_p * y[col.W_M])
    if w_m * h > angle:
        h = angle / w_m
    # beyond that no drive makes sense, and a run must end
    return max(h, par.T_s / MOST_STEPS)


@kernel
def _look(par, st, t_0, t_1, t):
    """The instant t in the step from t_0 to t_1: by a step that leads nowhere, or its own ends."""
    if t <= t_0:
        return st.work[0]
    if t == t_1:
        return st.work[1]
    _step(par, st, st.work[0], st.work[2], t_0, t - t_0)
    return st.work[2]


@kernel
def _oversample(par, st, t_0, t_1, k, i_abc, legs_out):
    """Waveform at the points j T_s / n in [t_0, t_1), by steps that lead nowhere else.

    The trajectory itself is not touched, so a run is the same with and without oversampling.
    Returns the index of the next point.
    """
    n = legs_out.shape[0]
    dt = par.T_s / n
    while k < n and k * dt < t_1:
        i_alpha, i_beta = _stator_current(par, st, _look(par, st, t_0, t_1, k * dt))
        i_abc[3 * k], i_abc[3 * k + 1], i_abc[3 * k + 2] = phases(i_alpha, i_beta)
        legs_out[k] = conducting_rails(st.bridge)
        k += 1
    return k


@kernel
def _take_samples(par, st, t_0, t_1):
    """Keep what the sensors will report at the start of the next period, if it is their time."""
    t = par.T_s - par.lead
    if t_0 <= t < t_1 or (t_1 == par.T_s and t == t_1):
        y = _look(par, st, t_0, t_1, t)
        i_alpha, i_beta = _stator_current(par, st, y)
        st.i_sampled[0], st.i_sampled[1] = shown(par, y, i_alpha, i_beta)
    t = par.T_s - par.encoder_latency
    if t_0 <= t < t_1 or (t_1 == par.T_s and t == t_1):
        st.theta_sampled = st.theta_M + _look(par, st, t_0, t_1, t)[col.TURN_M]


@kernel
def _begin(par, st, y):
    """The instant at the start of the period."""
    fresh = not st.general_before
    st.general_before = True
    for n in range(col.N_INTEGRATED):
        y[n] = 0.0
    y[col.I_D], y[col.I_Q] = st.i_d, st.i_q
    begin_mechanics(par, st, y, fresh)
    begin_dc_link(par, st, y, fresh)
    complete(par, st, y)
    begin_low_pass(par, st, y, y[col.C], y[col.S], fresh)
    if fresh:
        begin_gates(st)
        st.bridge.P[0], st.bridge.P[1], st.bridge.P[2] = 1.0, 0.0, 1.0


@kernel
def _end(par, st, y):
    """State after the period, but for angle and period number."""
    st.i_d, st.i_q = y[col.I_D], y[col.I_Q]
    end_mechanics(st, y)
    end_dc_link(st, y)
    i_alpha, i_beta = _stator_current(par, st, y)
    end_low_pass(par, st, y, i_alpha, i_beta)
    for n in range(len(col.ENERGIES)):
        st.energy[n] += y[col.SUPPLY + n]
    remember_gates(par, st)


@kernel
def _reach(par, st, y, j, n):
    """Number of the instant, after interval j of n, at which a switch changes what conducts.

    A current that keeps its sign does not see the end of a dead time: it goes on through the same
    diode. So such instants are no reason to end a step, unless the current changes its sign before
    (which then is seen: from here on all legs are watched).
    """
    br = st.bridge
    if par.dead_time == 0.0 or _floats(st):
        return j + 1
    i_alpha, i_beta = _stator_current(par, st, y)
    positive = positive_legs(br, i_alpha, i_beta)
    now = rails(st.gates[j], positive)
    k = j + 1
    while k < n and rails(st.gates[k], positive) == now:
        k += 1
    if k > j + 1:
        for x in range(3):
            br.mode[x] = 1 if positive >> x & 1 else -1
            br.watched[x] = 1
    return k


@kernel
def _is_watched(st):
    """Whether the sign of some current matters."""
    return st.bridge.watched[0] + st.bridge.watched[1] + st.bridge.watched[2] > 0


@kernel
def integrate(par, st, i_abc, legs_out):
    """Advance the state by one period.

    Returns the mechanical angle turned (rad) and the energy taken from the DC link (J).
    """
    y, y_end = st.work[0], st.work[1]
    _begin(par, st, y)
    instants = st.instants
    n = set_gates(par, st)
    events = 0
    n_over, k = legs_out.shape[0], 0
    first_sample = par.T_s - max(par.lead, par.encoder_latency)
    t, j, far = 0.0, 0, True
    while j < n:
        if t >= instants[j + 1]:
            j += 1
            continue
        connect_legs(par, st.bridge, st.gates[j])
        _settle(par, st, y, -1)
        reach = _reach(par, st, y, j, n) if far else j + 1
        far = True
        t_end = instants[reach]
        watched = _is_watched(st)
        while t < t_end:
            t_next = min(t_end, pulse_end(par, st.period, t)) if par.rectifier else t_end
            h = t_next - t
            longest = _longest_step(par, st, y)
            if h > longest:
                h /= math.ceil(h / longest)
                t_next = t + h
            _step(par, st, y, y_end, t, h)
            event = False
            if watched and events < _MAX_EVENTS and _margin(par, st, y_end) < 0.0:
                if reach > j + 1:
                    far = False  # some current ends: interval by interval from here on
                    break
                event = True
                events += 1
                h = _step_to_event(par, st, y, y_end, t, h, 0.0)
                t_next = t + h
            grid = _turned(par, st, t, t_next, y, y_end)
            if grid != 0.0:
                event = False
                t_next = t + _step_to_event(par, st, y, y_end, t, h, grid)
            if n_over > 0 and k < n_over and k * par.T_s / n_over < t_next:
                k = _oversample(par, st, t, t_next, k, i_abc, legs_out)
            if first_sample < t_next or t_next == par.T_s:
                _take_samples(par, st, t, t_next)
            y[:] = y_end
            t = t_next
            if event:
                _settle(par, st, y, modes_code(st.bridge))
            elif _is_blind(par, st):
                _clean(par, st, y)
    _end(par, st, y)
    st.events = events
    turn_M, dc = y[col.TURN_M], y[col.DC]
    st.work[:] = 0.0  # what is looked at besides the trajectory leaves no trace in the state
    return turn_M, dc

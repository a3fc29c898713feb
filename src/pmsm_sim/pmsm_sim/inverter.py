"""Two-level inverter with centre-aligned PWM: from duties to switching instants and voltages."""

from __future__ import annotations

import math

import numpy as np

from pmsm_sim.protection import COMMAND_LOST, trip
from pwm_node.compiled import kernel

_INV_SQRT3 = 1.0 / math.sqrt(3.0)


@kernel
def _modulate(par, st):
    """What the PWM hardware makes of the duties.

    The up-down counter compares with whole numbers: d = round(d N) / N with N counts from zero to
    its peak. A pulse of either level shorter than `min_pulse` is left out.
    """
    for x in range(3):
        d = st.duty[x]
        if par.timer_counts > 0.0:
            d = math.floor(d * par.timer_counts + 0.5) / par.timer_counts
        if d * par.T_s < par.min_pulse:
            d = 0.0
        elif (1.0 - d) * par.T_s < par.min_pulse:
            d = 1.0
        st.duty[x] = d


@kernel
def take_command(par, st):
    """Decide what the inverter applies in the period that begins now: `st.duty`, `st.gates_on`.

    That is the command latched for this period. When there is none, the first missing one is
    replaced by the one before (`par.hold`) or by the zero vector, the next ones by the zero
    vector; as many in a row as `COMMAND_LOST` allows block the gates until they are cleared. Before
    the first command of all nothing counts as missing: period 0 has the zero vector, later
    periods have blocked gates.
    """
    if st.latched:
        st.armed = True
        st.missing_in_row = 0
        if not st.enable:
            st.awaits_off = False
    elif st.armed:
        st.missed += np.uint64(1)
        st.missing_in_row += 1
        if st.missing_in_row >= par.limit[COMMAND_LOST]:
            trip(par, st, COMMAND_LOST, st.missing_in_row)
        if not (par.hold and st.missing_in_row == 1):
            for x in range(3):
                st.duty[x] = 0.5
    elif st.period > 0:
        st.enable = False
    st.latched = False
    if par.modulator:
        _modulate(par, st)
    st.gates_on = st.enable and not (st.latch.tripped or st.blocked or st.awaits_off)


@kernel
def leg_voltage(legs, u_dc):
    """Stator voltage (u_alpha, u_beta) (V) of the leg states `legs` (bits a, b, c).

    `u_j = 2/3 u_dc exp(1j (j - 1) pi / 3)`, method section 1, written by legs.
    """
    s_a = legs & 1
    s_b = (legs >> 1) & 1
    s_c = (legs >> 2) & 1
    return u_dc * (2 * s_a - s_b - s_c) / 3.0, u_dc * (s_b - s_c) * _INV_SQRT3


@kernel
def set_pattern(st, T_s):
    """Switching pattern of one period from `st.duty`.

    Leg x is high in `T_s/2 (1 - d_x) .. T_s/2 (1 + d_x)`. The three rising edges in time order,
    then the three falling ones mirrored, bound seven intervals; some may have no length.
    """
    d_0, d_1, d_2 = st.duty[0], st.duty[1], st.duty[2]
    b_0, b_1, b_2 = 1, 2, 4
    if d_0 < d_1:
        d_0, d_1, b_0, b_1 = d_1, d_0, b_1, b_0
    if d_1 < d_2:
        d_1, d_2, b_1, b_2 = d_2, d_1, b_2, b_1
    if d_0 < d_1:
        d_0, d_1, b_0, b_1 = d_1, d_0, b_1, b_0
    half = 0.5 * T_s
    st.t_switch[0] = 0.0
    st.t_switch[1] = half * (1.0 - d_0)
    st.t_switch[2] = half * (1.0 - d_1)
    st.t_switch[3] = half * (1.0 - d_2)
    st.t_switch[4] = half * (1.0 + d_2)
    st.t_switch[5] = half * (1.0 + d_1)
    st.t_switch[6] = half * (1.0 + d_0)
    st.t_switch[7] = T_s
    st.legs[0] = 0
    st.legs[1] = b_0
    st.legs[2] = b_0 | b_1
    st.legs[3] = 7
    st.legs[4] = b_0 | b_1
    st.legs[5] = b_0
    st.legs[6] = 0


@kernel
def _told(par, st, x, t):
    """What leg x is told at time t (s) of the period: 1 high, 0 low; and when that began (s)."""
    d = st.duty[x]
    half = 0.5 * par.T_s
    high = d == 1.0 or abs(t - half) < half * d
    if d > 0.0 and d < 1.0:
        if high:
            return 1, half * (1.0 - d)
        if t > half:
            return 0, half * (1.0 + d)
    # as since the start of the period, or longer
    level = 1 if high else 0
    return level, 0.0 if level != st.level[x] else -st.since[x]


@kernel
def leg_gate(par, st, x, t):
    """Gates of leg x at time t (s) in the period: 1 upper on, -1 lower on, 0 both off.

    After every change of what a leg is told, both its switches are off for the dead time.
    """
    if not st.gates_on or st.injector.leg_off[x] == 1:
        return 0
    level, began = _told(par, st, x, t)
    if t - began < par.dead_time:
        return 0
    return 1 if level == 1 else -1


@kernel
def remember_gates(par, st):
    """Keep for the next period what each leg is told, and since when."""
    for x in range(3):
        if st.gates_on:
            level, began = _told(par, st, x, par.T_s)
            st.level[x] = level
            st.since[x] = min(par.T_s - began, 1.0)
        else:
            st.level[x] = 0
            st.since[x] = 1.0


@kernel
def _insert(instants, n, t):
    """Put t into the first n sorted instants, unless it is there; returns the new number."""
    k = n
    while k > 0 and instants[k - 1] > t:
        k -= 1
    if k > 0 and instants[k - 1] == t:
        return n
    for j in range(n, k, -1):
        instants[j] = instants[j - 1]
    instants[k] = t
    return n + 1


@kernel
def switching_instants(par, st, instants):
    """Fill `instants` with the sorted limits of the intervals between which no gate changes.

    Returns how many there are; the first is 0, the last T_s.
    """
    instants[0] = 0.0
    n = 1
    n = _insert(instants, n, par.T_s)
    if not st.gates_on:
        return n
    half = 0.5 * par.T_s
    for x in range(3):
        for edge in (-st.since[x], 0.0, half * (1.0 - st.duty[x]), half * (1.0 + st.duty[x])):
            for t in (edge, edge + par.dead_time):
                if t > 0.0 and t < par.T_s:
                    n = _insert(instants, n, t)
    return n

"""Two-level inverter with centre-aligned PWM: from duties to switching instants and voltages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pmsm_sim.motor import MotorPars
from pmsm_sim.parts.part import Part
from pmsm_sim.parts.protection import COMMAND_LOST, trip
from pwm_node.compiled import kernel
from pwm_node.parameters import Parameter

_INV_SQRT3 = 1.0 / math.sqrt(3.0)

# Start and end of a period; four edges of each leg, and the ends of their dead times.
_MOST_INSTANTS = 26

PARAMETERS = (
    Parameter(
        "inverter.missing_command",
        "zero",
        "What the inverter applies in the first period without a command: the zero vector, or "
        "the command before (hold)",
        choices=("zero", "hold"),
    ),
    Parameter(
        "inverter.dead_time",
        0.0,
        "Time between switching one transistor of a leg off and the other on",
        unit="s",
        minimum=0.0,
        maximum=1e-4,
    ),
    Parameter(
        "inverter.switch_voltage",
        0.0,
        "On-state voltage of a transistor, its constant part",
        unit="V",
        minimum=0.0,
        maximum=10.0,
    ),
    Parameter(
        "inverter.switch_resistance",
        0.0,
        "On-state resistance of a transistor",
        unit="ohm",
        minimum=0.0,
        maximum=10.0,
    ),
    Parameter(
        "inverter.diode_voltage",
        0.0,
        "Forward voltage of a diode, its constant part",
        unit="V",
        minimum=0.0,
        maximum=10.0,
    ),
    Parameter(
        "inverter.diode_resistance",
        0.0,
        "Forward resistance of a diode",
        unit="ohm",
        minimum=0.0,
        maximum=10.0,
    ),
    Parameter(
        "inverter.min_pulse",
        0.0,
        "Pulses shorter than this are left out",
        unit="s",
        minimum=0.0,
        maximum=1e-4,
    ),
    Parameter(
        "inverter.timer_clock",
        0.0,
        "Clock of the PWM timer, which rounds duties to its counts; 0: no rounding",
        unit="Hz",
        minimum=0.0,
        maximum=1e10,
    ),
)

PAR = (
    ("hold", np.bool_),  # whether the first missing command is replaced by the one before
    ("modulator", np.bool_),  # duties are not applied as they come
    ("timer_counts", np.float64),  # of the PWM timer from 0 to its peak; 0: no quantisation
    ("min_pulse", np.float64),  # shorter pulses are left out (s)
    ("dead_time", np.float64),  # (s)
    ("switch_voltage", np.float64),  # on-state: constant part (V), resistance (ohm)
    ("switch_resistance", np.float64),
    ("diode_voltage", np.float64),
    ("diode_resistance", np.float64),
)

STATE = (
    # what it applies in the period that begins now
    ("duty", np.float64, (3,)),
    ("enable", np.bool_),
    ("latched", np.bool_),  # a command for this period is there
    # commands that were not there in time, and those refused
    ("armed", np.bool_),  # a command has been accepted: from now on one has to be there
    ("missing_in_row", np.int64),
    ("missed", np.uint64),  # since the start
    ("refused", np.uint64),  # since the start
    ("gates_on", np.bool_),  # whether the gates are driven in this period
    # the period's switching pattern: seven intervals of constant leg states
    ("t_switch", np.float64, (8,)),  # their limits (s from the start of the period)
    ("legs", np.int64, (7,)),  # bit 0, 1, 2: upper switch of leg a, b, c
    # the same with dead time, blocked gates and failed legs, for the general model
    ("instants", np.float64, (_MOST_INSTANTS,)),  # limits of intervals (s)
    ("gates", np.int64, (_MOST_INSTANTS,)),  # bits 0, 1, 2: upper switch on; 3, 4, 5: lower
    ("level", np.int64, (3,)),  # what leg x was told last: 1 high, 0 low
    ("since", np.float64, (3,)),  # how long ago that changed (s)
)


def _check(values: Mapping[str, Any]) -> str | None:
    T_s = 1.0 / values["pwm_frequency"]
    for name in ("inverter.dead_time", "inverter.min_pulse"):
        if values[name] >= 0.5 * T_s:
            return (
                f"'{name}' = {values[name]:g} is out of range: it must be shorter than half a "
                f"PWM period, 0 to {0.5 * T_s:g} s"
            )
    clock = values["inverter.timer_clock"]
    if 0.0 < clock < 8.0 / T_s:
        return (
            f"'inverter.timer_clock' = {clock:g} is out of range: 0 (no rounding), or at least "
            f"{8.0 / T_s:g} Hz, for 4 counts up and 4 down in a PWM period"
        )
    return None


def _start(par: np.void, st: np.void, values: Mapping[str, Any], motor: MotorPars) -> None:
    # until the first command comes: the zero vector
    st["duty"] = 0.5
    st["enable"] = True


def _configure(par: np.void, st: np.void, values: Mapping[str, Any], motor: MotorPars) -> None:
    par["hold"] = values["inverter.missing_command"] == "hold"
    # the timer counts up and down once in a period
    counts = 0.5 * values["inverter.timer_clock"] * par["T_s"]
    par["timer_counts"] = max(1.0, round(counts)) if counts > 0.0 else 0.0
    par["modulator"] = counts > 0.0 or values["inverter.min_pulse"] > 0.0


def _general(par: np.void) -> bool:
    drops = ("switch_voltage", "switch_resistance", "diode_voltage", "diode_resistance")
    return bool(par["dead_time"] > 0.0 or any(par[name] for name in drops))


PART = Part(
    parameters=PARAMETERS,
    par=PAR,
    state=STATE,
    check=_check,
    start=_start,
    configure=_configure,
    general=_general,
)


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
def begin_gates(st):
    """Each leg has been told what it is told now for long."""
    for x in range(3):
        st.level[x] = 1 if st.duty[x] == 1.0 else 0
        st.since[x] = 1.0


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
def set_gates(par, st):
    """Fill `st.instants` and `st.gates` for the period; returns the number of intervals.

    After every change of what a leg is told, both its switches are off for the dead time.
    """
    T_s, half, dead = par.T_s, 0.5 * par.T_s, par.dead_time
    instants, gates = st.instants, st.gates
    instants[0], instants[1] = 0.0, T_s
    if not st.gates_on:
        gates[0] = 0
        return 1
    n = 2
    for x in range(3):
        d = st.duty[x]
        rises, falls = half * (1.0 - d), half * (1.0 + d)
        if d > 0.0 and d < 1.0:
            n = _insert(instants, _insert(instants, n, rises), falls)
        if dead > 0.0:
            _, began = _told(par, st, x, 0.0)
            for edge in (began, rises, falls):
                if edge + dead > 0.0 and edge + dead < T_s:
                    n = _insert(instants, n, edge + dead)
    for j in range(n - 1):
        gates[j] = 0
    for x in range(3):
        if st.injector.leg_off[x] == 1:
            continue
        d = st.duty[x]
        high = half * d
        first, began = _told(par, st, x, 0.0)
        switched = d > 0.0 and d < 1.0
        for j in range(n - 1):
            t = 0.5 * (instants[j] + instants[j + 1])
            level, since = first, began
            if switched and abs(t - half) < high:
                level, since = 1, half - high
            elif switched and t > half:
                level, since = 0, half + high
            if t - since >= dead:
                gates[j] |= 1 << x if level == 1 else 8 << x
    return n - 1


@kernel
def rails(gates, positive):
    """Bits of the legs that are on the positive rail, for the signs of their currents.

    Where both switches of a leg are off, a negative current flows through its upper diode.
    """
    upper, lower = gates & 7, gates >> 3
    return upper | (7 & ~(upper | lower | positive))

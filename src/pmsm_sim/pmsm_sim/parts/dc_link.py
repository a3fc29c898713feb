"""The DC link: a stiff voltage, or a three-phase rectifier with a capacitor and a brake chopper."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pmsm_sim import columns as col
from pmsm_sim.motor import MotorPars
from pmsm_sim.parts.part import Part
from pwm_node.compiled import inlined, kernel
from pwm_node.parameters import Parameter

# Angle of the grid during which one pair of diodes carries the current (rad).
_PULSE = math.pi / 3.0

# Shorter than any step (s).
_INSTANT = 1e-12

PARAMETERS = (
    Parameter(
        "dc_voltage",
        311.0,
        "DC-link voltage; where it is not given, that of the motor file",
        unit="V",
        minimum=1.0,
        maximum=2_000.0,
        also=(
            "u_dc",
            "v_dc",
        ),
    ),
    Parameter(
        "dc_link.kind",
        "stiff",
        "What feeds the inverter: dc_voltage without any resistance, or a three-phase "
        "rectifier with a capacitor, which begins at dc_voltage",
        choices=("stiff", "rectifier"),
        read_only=True,
    ),
    Parameter(
        "dc_link.capacitance",
        1e-3,
        "Capacitor behind the rectifier",
        unit="F",
        minimum=1e-6,
        maximum=10.0,
    ),
    Parameter(
        "dc_link.grid_voltage",
        220.0,
        "Line-to-line voltage of the grid, rms",
        unit="V",
        minimum=0.0,
        maximum=2_000.0,
    ),
    Parameter(
        "dc_link.grid_frequency",
        50.0,
        "Frequency of the grid; the rectified voltage has six pulses per period",
        unit="Hz",
        minimum=1.0,
        maximum=1_000.0,
        read_only=True,
    ),
    Parameter(
        "dc_link.grid_resistance",
        0.5,
        "Resistance in series with the rectifier",
        unit="ohm",
        minimum=1e-3,
        maximum=1e3,
    ),
    Parameter(
        "dc_link.chopper_resistance",
        0.0,
        "Resistor of the brake chopper; 0: no chopper",
        unit="ohm",
        minimum=0.0,
        maximum=1e4,
    ),
    Parameter(
        "dc_link.chopper_on",
        380.0,
        "DC-link voltage at which the chopper goes on, checked once per period",
        unit="V",
        minimum=1.0,
        maximum=5_000.0,
    ),
    Parameter(
        "dc_link.chopper_off",
        370.0,
        "DC-link voltage at which the chopper goes off",
        unit="V",
        minimum=1.0,
        maximum=5_000.0,
    ),
)

PAR = (
    ("dc_voltage", np.float64),  # what the parameter says (V)
    ("u_dc", np.float64),  # the same with injected faults (V): the DC link, where it is stiff
    ("rectifier", np.bool_),  # a rectifier and a capacitor instead of a stiff voltage
    ("capacitance", np.float64),  # (F)
    ("grid_peak", np.float64),  # line-to-line (V)
    ("grid_w", np.float64),  # (rad/s)
    ("grid_conductance", np.float64),  # of what lies in series with the rectifier (S)
    ("chopper_conductance", np.float64),  # (S); 0: no chopper
    ("chopper_on", np.float64),  # voltages at which it switches (V)
    ("chopper_off", np.float64),
)

STATE = (
    ("u_dc", np.float64),  # (V)
    ("chopping", np.bool_),
)


def _check(values: Mapping[str, Any]) -> str | None:
    on, off = values["dc_link.chopper_on"], values["dc_link.chopper_off"]
    if off >= on:
        return (
            f"'dc_link.chopper_off' = {off:g} is out of range: it must be below "
            f"'dc_link.chopper_on' ({on:g} V)"
        )
    return None


def _configure(par: np.void, st: np.void, values: Mapping[str, Any], motor: MotorPars) -> None:
    par["u_dc"] = par["dc_voltage"]
    par["rectifier"] = values["dc_link.kind"] == "rectifier"
    par["grid_peak"] = math.sqrt(2.0) * values["dc_link.grid_voltage"]
    par["grid_w"] = 2.0 * math.pi * values["dc_link.grid_frequency"]
    par["grid_conductance"] = 1.0 / values["dc_link.grid_resistance"]
    R = values["dc_link.chopper_resistance"]
    par["chopper_conductance"] = 1.0 / R if R > 0.0 else 0.0


def _general(par: np.void) -> bool:
    return bool(par["rectifier"])


def _rates(par: np.void) -> list[float]:
    if not par["rectifier"]:
        return []
    return [(par["grid_conductance"] + par["chopper_conductance"]) / par["capacitance"]]


PART = Part(
    parameters=PARAMETERS,
    par=PAR,
    state=STATE,
    check=_check,
    configure=_configure,
    general=_general,
    full=_general,
    rates=_rates,
)


@kernel
def begin_dc_link(par, st, y, fresh):
    """State at the start of a period, in which the chopper looks once at the voltage.

    `fresh`: the general model did not run in the period before.
    """
    if fresh or not par.rectifier:
        st.u_dc = par.u_dc
    if par.rectifier:
        if st.u_dc >= par.chopper_on:
            st.chopping = True
        elif st.u_dc <= par.chopper_off:
            st.chopping = False
    y[col.U_DC] = st.u_dc


@kernel
def end_dc_link(st, y):
    """State after a period."""
    st.u_dc = y[col.U_DC]


@kernel
def _rectified(par, t):
    """Voltage behind a three-phase diode bridge (V), six pulses per grid period."""
    pulses = par.grid_w * t / _PULSE
    return par.grid_peak * math.cos((pulses - math.floor(pulses) - 0.5) * _PULSE)


@kernel
def pulse_end(par, period, t):
    """When the next pair of diodes takes over, after t (both s after the period began)."""
    begin = period * par.T_s
    n = math.floor(par.grid_w * (begin + t) / _PULSE) + 1.0
    end = n * _PULSE / par.grid_w - begin
    # one that ends within rounding has ended
    return end if end > t + _INSTANT else end + _PULSE / par.grid_w


@kernel
def surplus(par, period, t, u_dc):
    """Rectified voltage above that of the DC link (V): the diodes carry current while positive."""
    return _rectified(par, period * par.T_s + t) - u_dc


@inlined
def charge(par, period, t, chopping, u_dc, i_dc):
    """Derivative of the voltage (V/s), t (s) after the period began, and powers (W).

    `i_dc` is what the inverter takes (A).

    Returns du_dc, the power into the DC link, and that lost in the chopper.
    """
    if not par.rectifier:
        return 0.0, u_dc * i_dc, 0.0
    now = period * par.T_s + t
    i_grid = max(0.0, (_rectified(par, now) - u_dc) * par.grid_conductance)
    i_chopper = u_dc * par.chopper_conductance if chopping else 0.0
    return (i_grid - i_dc - i_chopper) / par.capacitance, u_dc * i_grid, u_dc * i_chopper

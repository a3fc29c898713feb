"""Temperature of winding and magnets, and what it changes.

dT/dt = (T_ambient + R_th P_copper - T) / tau
R_s = R_20 (1 + alpha_Cu (T - 20)),   psi_f = psi_20 (1 + alpha_magnet (T - 20))
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pmsm_sim.motor import MotorPars
from pmsm_sim.parts.part import Part
from pwm_node.compiled import kernel
from pwm_node.parameters import Parameter

#: The temperature at which the values of a motor file hold (degC).
REFERENCE_TEMPERATURE = 20.0

PARAMETERS = (
    Parameter(
        "drift.temperature",
        20.0,
        "Temperature of winding and magnets without copper loss; the values of the motor file "
        "hold at 20",
        unit="degC",
        minimum=-60.0,
        maximum=250.0,
    ),
    Parameter(
        "drift.time_constant",
        0.0,
        "Time constant of the temperature; 0: it follows at once",
        unit="s",
        minimum=0.0,
        maximum=1e5,
    ),
    Parameter(
        "drift.thermal_resistance",
        0.0,
        "Rise of the temperature divided by the copper loss",
        unit="K/W",
        minimum=0.0,
        maximum=100.0,
    ),
    Parameter(
        "drift.copper_coefficient",
        0.00393,
        "Relative change of the resistance with temperature (copper)",
        unit="1/K",
        minimum=0.0,
        maximum=0.01,
    ),
    Parameter(
        "drift.magnet_coefficient",
        -0.0012,
        "Relative change of the magnet flux with temperature (NdFeB)",
        unit="1/K",
        minimum=-0.01,
        maximum=0.01,
    ),
)

PAR = (
    ("drifts", np.bool_),  # the temperature moves
    ("temperature", np.float64),  # without copper loss (degC)
    ("thermal_rate", np.float64),  # 1 / time constant (1/s); 0: at once
    ("thermal_resistance", np.float64),  # rise per copper loss (K/W)
    ("copper_coefficient", np.float64),  # (1/K)
    ("magnet_coefficient", np.float64),
)

STATE = (
    ("temperature", np.float64),  # of winding and magnets (degC)
)


def _start(par: np.void, st: np.void, values: Mapping[str, Any], motor: MotorPars) -> None:
    st["temperature"] = REFERENCE_TEMPERATURE


def _configure(par: np.void, st: np.void, values: Mapping[str, Any], motor: MotorPars) -> None:
    tau = values["drift.time_constant"]
    par["thermal_rate"] = 1.0 / tau if tau > 0.0 else 0.0
    par["drifts"] = tau > 0.0 or par["thermal_resistance"] > 0.0
    if not par["drifts"]:
        st["temperature"] = par["temperature"]
    _act(par, st["temperature"])


@kernel
def _act(par, temperature):
    rise = temperature - REFERENCE_TEMPERATURE
    par.R_s = par.R_20 * (1.0 + par.copper_coefficient * rise)
    par.psi_f = par.psi_20 * (1.0 + par.magnet_coefficient * rise)
    par.psi_shift = par.psi_f - par.psi_map


@kernel
def warm(par, st):
    """Let one period pass."""
    copper = 1.5 * par.R_s * (st.i_d * st.i_d + st.i_q * st.i_q)
    end = par.temperature + par.thermal_resistance * copper
    if par.thermal_rate > 0.0:
        st.temperature = end + (st.temperature - end) * math.exp(-par.thermal_rate * par.T_s)
    else:
        st.temperature = end
    _act(par, st.temperature)


PART = Part(parameters=PARAMETERS, par=PAR, state=STATE, start=_start, configure=_configure)

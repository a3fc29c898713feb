"""The inverter's own protection: it blocks the gates whatever the controller says.

It has sensors of its own (shunts at the switches, the DC link, the heat sink), so a fault of the
sensors that the controller reads does not blind it. What it finds blocks the gates in the same
period and stays until it is cleared, which is refused while the cause lasts; the gates come back
only after a command that had them off, so that power never returns into a running set-point. Heat
comes slowly: before it trips, the inverter allows less current, and tells the controller so.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pmsm_sim.motor import MotorPars
from pmsm_sim.parts.part import Part
from pwm_node import faults
from pwm_node.compiled import kernel
from pwm_node.faults import REACT, Fault, Faults
from pwm_node.parameters import Parameter

_OFF = "gates off in the same period"

#: What the inverter sees; `text` is what it says.
FAULTS = Faults(
    Fault(
        code="COMMAND_LOST",
        text="{value:.0f} periods in a row without a valid command",
        reaction="gates off; until then the zero vector, at first perhaps the command before",
        threshold=Parameter(
            "inverter.command_loss_limit",
            10,
            "Number of periods in a row without a command that blocks the gates until the trip "
            "is cleared",
            minimum=1,
            maximum=1_000_000,
        ),
    ),
    Fault(
        code="OVERCURRENT",
        text="current amplitude {value:.1f} A, limit {limit:.1f} A",
        reaction=_OFF,
        threshold=Parameter(
            "fault.overcurrent",
            1.5,
            "Current amplitude that trips, divided by the motor's current limit",
            minimum=0.1,
            maximum=100.0,
        ),
    ),
    Fault(
        code="DC_OVERVOLTAGE",
        text="DC link at {value:.0f} V, limit {limit:.0f} V",
        reaction=_OFF,
        threshold=Parameter(
            "fault.dc_overvoltage",
            1.318,
            "DC-link voltage that trips, divided by the motor's nominal voltage (seed_750: 410 V)",
            minimum=1.0,
            maximum=100.0,
        ),
    ),
    Fault(
        code="DC_UNDERVOLTAGE",
        text="DC link at {value:.0f} V, at least {limit:.0f} V",
        reaction=_OFF,
        threshold=Parameter(
            "fault.dc_undervoltage",
            0.643,
            "DC-link voltage below which it trips, divided by the motor's nominal voltage "
            "(seed_750: 200 V)",
            minimum=0.0,
            maximum=1.0,
        ),
    ),
    Fault(
        code="OVERTEMPERATURE",
        text="winding at {value:.0f} degC, limit {limit:.0f} degC",
        reaction=_OFF + "; from 'fault.derating_temperature' on less current",
        threshold=Parameter(
            "fault.overtemperature",
            125.0,
            "Winding temperature that trips",
            unit="degC",
            minimum=0.0,
            maximum=500.0,
        ),
    ),
)

PARAMETERS = (
    REACT,
    *FAULTS.parameters,
    Parameter(
        "fault.derating_temperature",
        100.0,
        "Winding temperature from which the inverter allows less current, in proportion down to "
        "none at 'fault.overtemperature'; if both have the same value, it only trips",
        unit="degC",
        minimum=0.0,
        maximum=500.0,
    ),
)

COMMAND_LOST = FAULTS.number("COMMAND_LOST")
OVERCURRENT = FAULTS.number("OVERCURRENT")
DC_OVERVOLTAGE = FAULTS.number("DC_OVERVOLTAGE")
DC_UNDERVOLTAGE = FAULTS.number("DC_UNDERVOLTAGE")
OVERTEMPERATURE = FAULTS.number("OVERTEMPERATURE")

PAR = (
    ("react", np.bool_),  # whether a fault blocks the gates
    ("limit", np.float64, (len(FAULTS.rows),)),  # of the quantity that each fault looks at
    ("hot", np.float64),  # temperature from which less current is allowed (degC)
)

STATE = (
    ("latch", FAULTS.latch),
    ("blocked", np.bool_),  # gates off because nobody wants them to be driven
    ("awaits_off", np.bool_),  # and until a command has had them off after that or a trip
    ("derating", np.float64),  # share of the current limit that the temperature allows
)


def _check(values: Mapping[str, Any]) -> str | None:
    hot, limit = values["fault.derating_temperature"], values["fault.overtemperature"]
    if hot > limit:
        return (
            f"'fault.derating_temperature' = {hot:g} is out of range: at most "
            f"'fault.overtemperature' ({limit:g} degC)"
        )
    return None


def _configure(par: np.void, st: np.void, values: Mapping[str, Any], motor: MotorPars) -> None:
    limit = par["limit"]
    limit[COMMAND_LOST] = values["inverter.command_loss_limit"]
    limit[OVERCURRENT] = values["fault.overcurrent"] * motor.i_max
    limit[DC_OVERVOLTAGE] = values["fault.dc_overvoltage"] * motor.u_dc
    limit[DC_UNDERVOLTAGE] = values["fault.dc_undervoltage"] * motor.u_dc
    limit[OVERTEMPERATURE] = values["fault.overtemperature"]
    par["hot"] = values["fault.derating_temperature"]


PART = Part(parameters=PARAMETERS, par=PAR, state=STATE, check=_check, configure=_configure)


@kernel
def trip(par, st, fault, value):
    """Latch a fault with the value that was seen, and block the gates."""
    faults.trip(st.latch, fault, st.period, value, par.react)


@kernel
def protect(par, st):
    """Look at current, voltage and temperature; comparisons are written so that NaN trips."""
    st.latch.present = np.uint32(0)
    i_sq = st.i_d * st.i_d + st.i_q * st.i_q
    if not i_sq <= par.limit[OVERCURRENT] * par.limit[OVERCURRENT]:
        trip(par, st, OVERCURRENT, np.sqrt(i_sq))
    u_dc = st.u_dc if par.rectifier and st.general_before else par.u_dc
    if not u_dc <= par.limit[DC_OVERVOLTAGE]:
        trip(par, st, DC_OVERVOLTAGE, u_dc)
    # before the first command the DC link may still be charging
    if (st.armed or st.latched) and not u_dc >= par.limit[DC_UNDERVOLTAGE]:
        trip(par, st, DC_UNDERVOLTAGE, u_dc)
    temperature = st.temperature + st.injector.warmth
    st.derating = 1.0
    if not temperature <= par.hot:
        limit = par.limit[OVERTEMPERATURE]
        if temperature <= limit:
            st.derating = (limit - temperature) / (limit - par.hot)
        else:
            st.derating = 0.0
            trip(par, st, OVERTEMPERATURE, temperature)


@kernel
def allowed_current(st):
    """Share of the current limit that the drive may use: it is told with each sample."""
    return 0.0 if st.latch.tripped or st.blocked or st.awaits_off else st.derating

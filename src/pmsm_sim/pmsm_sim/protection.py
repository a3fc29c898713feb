"""The inverter's own protection: it blocks the gates whatever the controller says.

It has sensors of its own (shunts at the switches, the DC link, the heat sink), so a fault of the
sensors that the controller reads does not blind it. What it finds blocks the gates in the same
period and stays until it is cleared, which is refused while the cause lasts; the gates come back
only after a command that had them off, so that power never returns into a running set-point. Heat
comes slowly: before it trips, the inverter allows less current, and tells the controller so.
"""

from __future__ import annotations

import numpy as np

from pwm_node.compiled import kernel

#: The inverter's faults; the position is the bit in `PLANT_STATE.faults`.
FAULTS: dict[str, str] = {
    "COMMAND_LOST": "{value:.0f} periods in a row without a valid command",
    "OVERCURRENT": "current amplitude {value:.1f} A, limit {limit:.1f} A",
    "DC_OVERVOLTAGE": "DC link at {value:.0f} V, limit {limit:.0f} V",
    "DC_UNDERVOLTAGE": "DC link at {value:.0f} V, at least {limit:.0f} V",
    "OVERTEMPERATURE": "winding at {value:.0f} degC, limit {limit:.0f} degC",
}
CODES = tuple(FAULTS)
N_FAULTS = len(CODES)

COMMAND_LOST = CODES.index("COMMAND_LOST")
OVERCURRENT = CODES.index("OVERCURRENT")
DC_OVERVOLTAGE = CODES.index("DC_OVERVOLTAGE")
DC_UNDERVOLTAGE = CODES.index("DC_UNDERVOLTAGE")
OVERTEMPERATURE = CODES.index("OVERTEMPERATURE")


@kernel
def trip(par, st, fault, value):
    """Latch a fault with the value that was seen, and block the gates."""
    bit = np.uint32(1) << np.uint32(fault)
    st.present |= bit
    if st.faults & bit == np.uint32(0):
        st.faults |= bit
        st.fault_at[fault] = st.period
        st.fault_value[fault] = value
    if par.react:
        st.tripped = True


@kernel
def protect(par, st):
    """Look at current, voltage and temperature; comparisons are written so that NaN trips."""
    st.present = np.uint32(0)
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
    return 0.0 if st.tripped or st.blocked or st.awaits_off else st.derating


def named(faults: int) -> list[str]:
    """Codes of the bits that are set."""
    return [code for bit, code in enumerate(CODES) if faults >> bit & 1]

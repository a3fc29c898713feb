"""The parts of the plant; each module says what it has."""

from __future__ import annotations

from pmsm_sim.parts import (
    dc_link,
    injection,
    inverter,
    machine,
    mechanics,
    protection,
    sensors,
    thermal,
)

#: The order is that of the parameters, and that in which they are configured.
PARTS = (
    mechanics.PART,
    dc_link.PART,
    inverter.PART,
    protection.PART,
    injection.PART,
    machine.PART,
    sensors.PART,
    thermal.PART,
)

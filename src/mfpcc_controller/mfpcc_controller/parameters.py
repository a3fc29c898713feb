"""The controller's parameters: one table for the node, the engine and the scenario files."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping
from typing import Any

from mfpcc_controller import firmware, protection, schemes
from pwm_node.parameters import (
    PWM_FREQUENCY,
    RECORDERS,
    SCHEDULE,
    Parameter,
    ParameterError,
    Table,
    Value,
    file_parameter,
)

#: Names of the built-in schemes
SCHEMES = schemes.NAMES

#: Entry points of schemes that other packages offer, by name; a built-in name stays built in.
PLUG_INS = {
    point.name: point
    for point in importlib.metadata.entry_points(group="mfpcc_controller.schemes")
    if point.name not in SCHEMES
}

SECTOR_SEARCHES = ("dwell", "ranking")
OVERMODULATIONS = ("scale", "project")
CONTROL_MODES = ("speed", "current")


class _Scheme(Parameter):
    """A scheme by its name, or a firmware by its folder."""

    def validate(self, value: Any) -> Value:
        if not isinstance(value, str) or not value.startswith(firmware.PREFIX):
            return super().validate(value)
        try:
            firmware.Firmware(value)  # compiles it, while no motor waits
        except firmware.FirmwareError as error:
            raise ParameterError(str(error)) from None
        return value


def _check(values: Mapping[str, Value]) -> str | None:
    """Rules across several parameters."""
    reasons = (scheme.check(values) for scheme in schemes.BUILT_IN)
    return next((reason for reason in reasons if reason), None)


TABLE = Table(
    [
        file_parameter("motor", "seed_750", "motors", "Motor"),
        PWM_FREQUENCY,
        _Scheme(
            "scheme",
            "mls_mfpcc",
            "Current-control scheme; 'firmware:FOLDER': the one in C of that folder",
            choices=(*SCHEMES, *PLUG_INS),
        ),
        Parameter(
            "fallback_scheme",
            "pi_foc",
            "Scheme that takes over in the same period when the chosen one fails",
            choices=SCHEMES,
        ),
        Parameter(
            "mismatch.inductance",
            1.0,
            "Inductance of the controller's model over the motor file's",
            minimum=0.01,
            maximum=100.0,
            also=(
                "mismatch.L",
                "mismatch.L_s",
                "mismatch.L_d",
                "mismatch.L_q",
            ),
        ),
        Parameter(
            "mismatch.resistance",
            1.0,
            "Resistance of the controller's model over the motor file's",
            minimum=0.0,
            maximum=100.0,
            also=(
                "mismatch.R",
                "mismatch.R_s",
            ),
        ),
        Parameter(
            "mismatch.flux",
            1.0,
            "Magnet flux of the controller's model over the motor file's",
            minimum=0.0,
            maximum=100.0,
            also=(
                "mismatch.psi",
                "mismatch.psi_f",
            ),
        ),
        Parameter(
            "control_mode",
            "speed",
            "What is regulated: the speed, or the current to i_d_ref and i_q_ref",
            choices=CONTROL_MODES,
        ),
        Parameter("speed_ref_rpm", 0.0, "Speed reference", unit="r/min", minimum=-1e5, maximum=1e5),
        Parameter(
            "i_d_ref",
            0.0,
            "d-axis current reference (both control modes)",
            unit="A",
            minimum=-1e4,
            maximum=1e4,
        ),
        Parameter(
            "i_q_ref",
            0.0,
            "q-axis current reference (control_mode current)",
            unit="A",
            minimum=-1e4,
            maximum=1e4,
        ),
        Parameter(
            "torque_limit",
            0.0,
            "Largest torque the speed loop asks for; 0: what the motor's current limit allows",
            unit="N m",
            minimum=0.0,
            maximum=1e5,
        ),
        Parameter(
            "mtpa",
            False,
            "Maximum torque per ampere: the speed loop gives its torque with the smallest "
            "current, to which i_d_ref is added (salient machines)",
        ),
        Parameter(
            "field_weakening",
            False,
            "Negative i_d where the inverter's voltage is at its limit",
        ),
        Parameter(
            "speed.bandwidth",
            50.0,
            "Bandwidth of the speed loop",
            unit="rad/s",
            minimum=0.1,
            maximum=5_000.0,
        ),
        Parameter(
            "load.inertia",
            0.0,
            "Inertia of the load, for the gains of the speed loop; experiments tell that of the "
            "plant",
            unit="kg m^2",
            minimum=0.0,
            maximum=1e3,
            read_only=True,
            also=("load.J",),
        ),
        Parameter(
            "observer.bandwidth",
            600.0,
            "Bandwidth of the rotor observer (phase-locked loop on the encoder angle)",
            unit="rad/s",
            minimum=1.0,
            maximum=20_000.0,
        ),
        Parameter(
            "sector_search",
            "dwell",
            "How the two active vectors are found: the pair with non-negative dwell times, or the "
            "paper's ranking of three costs (equal inductances only)",
            choices=SECTOR_SEARCHES,
        ),
        Parameter(
            "overmodulation",
            "scale",
            "What happens to dwell times that do not fit into the period: they are scaled (the "
            "paper), or become those of the point of the voltage hexagon nearest to the wanted "
            "voltage (project)",
            choices=OVERMODULATIONS,
        ),
        Parameter(
            "deadbeat.gain",
            0.0,
            "Share of the predicted error of the current that a predictive scheme takes off in one "
            "period: 1 is deadbeat, less is slower and quieter, and stands a wrong model better; "
            "0: the scheme's own",
            minimum=0.0,
            maximum=1.0,
        ),
        *schemes.PARAMETERS,
        *protection.PARAMETERS,
        Parameter(
            "diagnostics_decimation",
            1,
            "lut_diagnostics is published once in this number of periods; 0: never",
            minimum=0,
            maximum=1_000_000,
            read_only=True,
        ),
        RECORDERS,
        SCHEDULE,
    ],
    check=_check,
)

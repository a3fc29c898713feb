"""The controller's parameters: one table for the node, the engine and the scenario files."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping

from mfpcc_controller import schemes
from pwm_node.parameters import Parameter, Table, Value

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


def _check(values: Mapping[str, Value]) -> str | None:
    """Rules across several parameters."""
    reasons = (scheme.check(values) for scheme in schemes.BUILT_IN)
    return next((reason for reason in reasons if reason), None)


TABLE = Table(
    [
        Parameter(
            "motor",
            "seed_750",
            "Motor: a name of config/motors or the path of a file",
            read_only=True,
        ),
        Parameter(
            "pwm_frequency",
            10_000.0,
            "PWM and control frequency",
            unit="Hz",
            minimum=1_000.0,
            maximum=100_000.0,
            read_only=True,
            also=(
                "f_pwm",
                "f_s",
                "T_s",
            ),
        ),
        Parameter("scheme", "mls_mfpcc", "Current-control scheme", choices=(*SCHEMES, *PLUG_INS)),
        Parameter(
            "fallback_scheme",
            "pi_foc",
            "Who takes over in the same period when the scheme fails",
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
            "Maximum torque per ampere: the speed loop's torque with the smallest current, i_d_ref "
            "added to it (salient machines)",
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
            "Dwell times that do not fit into the period: scaled (the paper), or the point of the "
            "voltage hexagon nearest to the wish",
            choices=OVERMODULATIONS,
        ),
        *schemes.PARAMETERS,
        Parameter(
            "stop.ramp_time",
            0.5,
            "Safe stop 1: time from top speed to zero; the gates go off after twice as long at the "
            "latest",
            unit="s",
            minimum=1e-3,
            maximum=1e3,
        ),
        Parameter(
            "fault.react",
            True,
            "Whether a fault disables the inverter; false only to see what happens then",
        ),
        Parameter(
            "fault.overcurrent",
            1.5,
            "Current amplitude that trips, over the motor's current limit",
            minimum=0.1,
            maximum=100.0,
        ),
        Parameter(
            "fault.current_sum",
            0.083,
            "Sum of the phase currents (filtered, 1 ms) that trips, over the current limit",
            minimum=1e-3,
            maximum=100.0,
        ),
        Parameter(
            "fault.encoder_jump",
            0.05,
            "Step of the angle from sample to sample that trips, beyond 1.5 times top speed; a "
            "coarse encoder has steps of its own",
            unit="rad",
            minimum=0.0,
            maximum=3.2,
        ),
        Parameter(
            "fault.overspeed",
            1.2,
            "Speed that trips, over the motor's top speed",
            minimum=0.1,
            maximum=100.0,
        ),
        Parameter(
            "fault.prediction_error",
            0.25,
            "Prediction error at which another scheme takes over, over the current limit",
            minimum=1e-3,
            maximum=100.0,
        ),
        Parameter(
            "fault.prediction_time",
            5e-3,
            "How long every prediction has to be that wrong",
            unit="s",
            minimum=1e-4,
            maximum=10.0,
        ),
        Parameter(
            "fault.feedback_timeout",
            1.0,
            "Wall-clock time without a sample after which an enabled controller disables the "
            "inverter, counted in tenths of a second; 0: it waits for ever. It has to be longer "
            "than samples are apart; gaps of more than 5 samples trip in any case",
            unit="s",
            minimum=0.0,
            maximum=1e3,
        ),
        Parameter(
            "fault.step_budget",
            0.0,
            "Wall-clock time that a step of the scheme may take: ten in a row beyond it bring the "
            "fallback scheme; 0: any time, so that a run does not depend on how fast the machine "
            "is",
            unit="us",
            minimum=0.0,
            maximum=1e6,
        ),
        Parameter(
            "diagnostics_decimation",
            1,
            "lut_diagnostics is published every so many periods; 0: never",
            minimum=0,
            maximum=1_000_000,
            read_only=True,
        ),
        Parameter(
            "recorders",
            0,
            "So many recorders are awaited before the first period, so that they miss nothing",
            minimum=0,
            maximum=100,
            read_only=True,
        ),
        Parameter(
            "schedule",
            [],
            "Parameter changes at given simulated times, each 'SECONDS NAME VALUE'",
            read_only=True,
        ),
    ],
    check=_check,
)

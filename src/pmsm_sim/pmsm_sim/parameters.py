"""The simulator's parameters: one table for the node, the engine and the scenario files."""

from __future__ import annotations

from collections.abc import Mapping

from pmsm_sim import motor
from pmsm_sim.parts import PARTS
from pwm_node.parameters import (
    PWM_FREQUENCY,
    RECORDERS,
    SCHEDULE,
    Parameter,
    Table,
    Value,
    file_parameter,
)
from pwm_node.yaml_files import FileError


def _check(values: Mapping[str, Value]) -> str | None:
    """What single limits cannot say."""
    return next(filter(None, (part.check(values) for part in PARTS)), None)


def _of_the_motor(values: Mapping[str, Value]) -> Mapping[str, Value]:
    """The DC link a motor is meant for: 311 V would be the end of one for 12 V."""
    try:
        return {"dc_voltage": motor.load(str(values["motor"])).u_dc}
    except FileError:
        return {}  # whoever needs the motor says what is wrong with it


TABLE = Table(
    [
        file_parameter("motor", "seed_750", "motors", "Motor"),
        PWM_FREQUENCY,
        Parameter(
            "real_time_factor",
            0.0,
            "0: lock-step, each period waits for its command; above 0: periods follow the wall "
            "clock at this speed",
            minimum=0.0,
            maximum=100.0,
        ),
        *(row for part in PARTS for row in part.parameters),
        Parameter(
            "oversampling",
            0,
            "Points per period of the waveform in drive_state; 0: none. Does not change the run",
            minimum=0,
            maximum=1_000,
            read_only=True,
        ),
        Parameter(
            "state_decimation",
            1,
            "drive_state is published once in this number of periods; 0: never",
            minimum=0,
            maximum=1_000_000,
            read_only=True,
        ),
        Parameter(
            "periods",
            0,
            "Number of periods after which the node ends; 0: it runs until it is stopped",
            minimum=0,
            maximum=2**53,
            read_only=True,
        ),
        RECORDERS,
        SCHEDULE,
    ],
    check=_check,
    follow=_of_the_motor,
)

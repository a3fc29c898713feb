"""Test vectors of a firmware: recorded samples, and what the simulated controller answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mfpcc_msgs.msg import DutyCommand, LutDiagnostics
from numpy.typing import NDArray

from mfpcc_controller.controller import Controller
from mfpcc_controller.firmware import PREFIX, FirmwareError
from mfpcc_experiments.bags import recording
from mfpcc_experiments.running import closed_loop
from pwm_node.wire import fixed_dtype

# Samples that go into the test, at most.
_MOST = 1_000

# The references of a recorded drive: of the parameters, and of the configuration they become.
_REFERENCES = ("control_mode", "speed_ref_rpm", "i_d_ref", "i_q_ref")

_SAMPLE = ("i_a", "i_b", "i_c", "encoder_angle", "dc_voltage", "derating")


@dataclass(frozen=True)
class Samples:
    """
    Recorded samples, and the commands that a controller gave for them.

    Attributes
    ----------
    feedback, command : structured arrays, shape (n,)
    cfg : record of CONTROL_CFG
        Of that controller, with the recording's references.
    changes : dict
        The references, as parameters.
    origin : str
        What the samples are of.
    """

    feedback: NDArray[np.void]
    command: NDArray[np.void]
    cfg: np.void
    changes: dict[str, Any]
    origin: str


def samples(values: Mapping[str, Any], path: Path | None) -> Samples:
    """
    Ask the simulated controller with these parameters for its answers to recorded samples.

    Parameters
    ----------
    values : mapping
        A value for every parameter.
    path : Path or None
        The recording; None: the drive is simulated for it, while it gets faster.

    Raises
    ------
    mfpcc_experiments.bags.BagError
        If it cannot be read.
    FirmwareError
        If there is nothing in it.
    """
    if path is None:
        feedback, changes = _simulated(values)
        origin = "a simulated run-up of the drive"
    else:
        read = recording.read(path)
        feedback, origin = read.feedback, f"the recording '{path.name}'"
        stored = read.config.get("parameters", {}).get("mfpcc_controller", {})
        changes = {name: stored[name] for name in _REFERENCES if name in stored}
    if not len(feedback):
        raise FirmwareError(f"{path}: there are no samples in it, for the test of the firmware")
    feedback = feedback[:_MOST]
    drive = Controller({**values, **changes})
    cfg = drive.cfg[0].copy()
    return Samples(feedback, answers(drive, feedback), cfg, changes, origin)


def answered(found: Samples, values: Mapping[str, Any], folder: Path) -> Samples:
    """The same samples with the answers of the firmware in a folder, compiled for this machine."""
    drive = Controller({**values, **found.changes, "scheme": f"{PREFIX}{folder}"})
    return replace(found, command=answers(drive, found.feedback))


def _simulated(values: Mapping[str, Any]) -> tuple[NDArray[np.void], dict[str, Any]]:
    """Samples of a drive at a quarter of its top speed, on its way to three tenths of it."""
    top = Controller(values).motor.speed_max_rpm
    changes = {"control_mode": "speed", "speed_ref_rpm": 0.3 * top}
    own = {name: value for name, value in values.items() if name not in ("motor", "scheme")}
    done = closed_loop.run(
        str(values["scheme"]),
        _MOST / float(values["pwm_frequency"]),
        motor=str(values["motor"]),
        rpm=0.25 * top,
        load=0.0,
        plant={"pwm_frequency": values["pwm_frequency"]},
        controller={**own, **changes},
    )
    return done.feedback, changes


def answers(drive: Controller, feedback: NDArray[np.void]) -> NDArray[np.void]:
    """The commands of a controller for samples, one after the other."""
    command = np.zeros(len(feedback), fixed_dtype(DutyCommand))
    row, lut = np.zeros(1, fixed_dtype(DutyCommand)), np.zeros(1, fixed_dtype(LutDiagnostics))
    for k in range(len(feedback)):
        drive.step(feedback[k : k + 1], row, lut, False)
        command[k] = row[0]
    return command


def references(found: Samples, real: str) -> str:
    """C that sets the references of the recorded drive."""
    f = "f" if real == "float" else ""
    cfg = found.cfg
    rows = (
        ("SPEED_CONTROL", float(cfg["speed_control"])),
        ("W_M_REF", float(cfg["w_M_ref"])),
        ("I_DQ_REF_D", float(cfg["i_dq_ref"].real)),
        ("I_DQ_REF_Q", float(cfg["i_dq_ref"].imag)),
    )
    lines = [
        f"    if (mfpcc_set_parameter(&drive, MFPCC_{name}, {_hex(value)}{f}) != MFPCC_OK) {{\n"
        "        return 2;\n"
        "    }"
        for name, value in rows
    ]
    return "\n".join(lines)


def source(found: Samples, real: str) -> str:
    """The samples and commands as constants in C."""
    f = "f" if real == "float" else ""

    def number(value: float) -> str:
        return f"{_hex(float(value))}{f}"

    rows = []
    for each in found.feedback:
        parts = ", ".join(f".{name} = {number(each[name])}" for name in _SAMPLE)
        rows.append(f"    {{.period = {int(each['period'])}U, {parts}}},")
    answered = []
    for each in found.command:
        duty = ", ".join(number(d) for d in each["duty"])
        a, b = (int(v) for v in each["vectors"])
        on = "true" if each["enable"] else "false"
        answered.append(f"    {{{{{duty}}}, {{{a}, {b}}}, {on}}},")
    return "\n".join(
        [
            f"/* Samples of {found.origin}, and the simulation's answers. */",
            "#ifndef VECTORS_H",
            "#define VECTORS_H",
            "",
            '#include "mfpcc.h"',
            "",
            "typedef struct {",
            "    mfpcc_real duty[3];",
            "    uint8_t vectors[2];",
            "    bool enable;",
            "} expected_command;",
            "",
            f"#define SAMPLES {len(rows)}",
            "",
            "static const mfpcc_sample SAMPLE[SAMPLES] = {",
            *rows,
            "};",
            "",
            "static const expected_command EXPECTED[SAMPLES] = {",
            *answered,
            "};",
            "",
            "#endif",
            "",
        ]
    )


def _hex(value: float) -> str:
    """A number that C reads as exactly this one."""
    return value.hex()

"""Whether firmware gives what the compiled kernels give, bit for bit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mfpcc_msgs.msg import DutyCommand, LutDiagnostics
from numpy.typing import NDArray

from mfpcc_controller import schemes
from mfpcc_controller.controller import Controller
from mfpcc_controller.parameters import TABLE
from mfpcc_experiments.measuring.replay import Samples
from pwm_node import bits
from pwm_node.wire import fixed_dtype


@dataclass(frozen=True)
class Agreement:
    """
    How two controllers agree on recorded samples.

    Attributes
    ----------
    periods : int
    commands, diagnostics : int
        Periods in which every bit of the command, or of the diagnostics, is the same.
    memory : tuple of str
        Fields of the memory that differ at the end.
    """

    periods: int
    commands: int
    diagnostics: int
    memory: tuple[str, ...]

    @property
    def whole(self) -> bool:
        """Whether every bit is the same."""
        return self.commands == self.diagnostics == self.periods and not self.memory


def agreement(samples: Samples, scheme: str, firmware: str) -> Agreement:
    """
    Feed recorded samples, and recorded changes of parameters, to a scheme and to its firmware.

    Parameters
    ----------
    samples : Samples
    scheme : str
        A built-in one.
    firmware : str
        `firmware:FOLDER`, which has this scheme.
    """
    commands, luts, memories = [], [], []
    for name in (scheme, firmware):
        drive = Controller(TABLE.complete({**samples.values, "scheme": name}))
        drive.cfg["scheme"] = schemes.NAMES.index(scheme)
        command, lut = _fed(drive, samples)
        commands.append(command)
        luts.append(lut)
        memories.append(drive.mem)
    return Agreement(
        len(samples.feedback),
        _equal_rows(*commands),
        _equal_rows(*luts),
        tuple(_different(memories[0], memories[1])),
    )


def _fed(drive: Controller, samples: Samples) -> tuple[NDArray[np.void], NDArray[np.void]]:
    feedback = samples.feedback
    command = np.zeros(len(feedback), fixed_dtype(DutyCommand))
    lut = np.zeros(len(feedback), fixed_dtype(LutDiagnostics))
    due = samples.changes(drive.values)
    row = np.zeros(1, command.dtype)
    for k in range(len(feedback)):
        while due and due[0][0] <= feedback["period"][k]:
            _, changes = due.pop(0)
            drive.apply({name: value for name, value in changes.items() if name != "scheme"})
        drive.enabled = bool(samples.enable[k])
        drive.step(feedback[k : k + 1], row, lut[k : k + 1], True)
        command[k] = row[0]
    return command, lut


def _equal_rows(one: NDArray[np.void], other: NDArray[np.void]) -> int:
    """Rows of two arrays of records of which every bit is the same."""
    equal = np.ones(len(one), bool)
    for name in one.dtype.names or ():
        sides = (np.ascontiguousarray(each[name]) for each in (one, other))
        left, right = (side.view(np.uint8).reshape(len(one), -1) for side in sides)
        equal &= (left == right).all(axis=1)
    return int(equal.sum())


def _different(one: Any, other: Any, path: str = "") -> list[str]:
    """Fields of two records of which not every bit is the same."""
    found = []
    for name in one.dtype.names or ():
        if one.dtype[name].names is not None:
            found += _different(one[name], other[name], f"{path}{name}.")
        elif bits.of(one[name]) != bits.of(other[name]):
            found.append(f"{path}{name}")
    return found

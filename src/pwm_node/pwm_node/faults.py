"""Faults of a node: what they are, and the latch that keeps them until they are cleared.

A node's protection says in one row all there is to a fault (`Fault`), and its kernels latch it in a
record (`Faults.latch`): with the period and the value of its first occurrence, so that what came of
it does not hide what began it. It is cleared by request only, and not while its cause lasts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwm_node.compiled import kernel
from pwm_node.parameters import Parameter

#: The parameter that keeps faults from switching off.
REACT = Parameter(
    "fault.react",
    True,
    "Whether a fault blocks the gates; false is only meant to show what happens without protection",
)


def _report(latch: Any, fault: int, period: Any, value: float) -> None:
    # by item, which both the compiler and NumPy's records know
    bit = np.uint32(1) << np.uint32(fault)
    latch["present"] |= bit
    if latch["faults"] & bit == np.uint32(0):
        latch["faults"] |= bit
        latch["at"][fault] = period
        latch["value"][fault] = value


#: `report(latch, fault, period, value)`: the kernel that latches a fault with the value seen.
report = kernel(_report)


@kernel
def trip(latch: Any, fault: int, period: Any, value: float, react: bool) -> None:
    """Latch a fault, and take the gates off if it is to react."""
    report(latch, fault, period, value)
    if react:
        latch.tripped = True


@dataclass(frozen=True, kw_only=True)
class Fault:
    """
    One fault of a node.

    Attributes
    ----------
    code : str
        Its name in `drive_status`, `/diagnostics` and the log.
    text : str
        What was seen, for people; `{value}` and `{limit}` stand for the value that tripped and the
        threshold it passed.
    reaction : str
        What follows.
    threshold : Parameter, optional
        The parameter that says from where on it is one.
    text_of_value : str
        What was seen where the value is above 0, if the same code has such a cause too.
    """

    code: str
    text: str
    reaction: str
    threshold: Parameter | None = None
    text_of_value: str = ""

    def described(self, value: float, limit: float) -> str:
        """Say what was seen."""
        text = self.text_of_value if self.text_of_value and value > 0.0 else self.text
        return text.format(value=value, limit=limit)


class Faults:
    """
    All faults of a node; their order is that of the bits in the latch.

    Parameters
    ----------
    *rows : Fault

    Attributes
    ----------
    rows : tuple of Fault
    codes : tuple of str
    latch : dtype
        The record of the latch, to be a field of a node's state. `tripped`: the gates are off until
        cleared; `present`: the faults whose cause is there in this period, bit by bit; `faults`:
        those latched; `at`, `value`: period and value of the first occurrence of each.
    """

    def __init__(self, *rows: Fault) -> None:
        self.rows = rows
        self.codes = tuple(row.code for row in rows)
        self.latch = np.dtype(
            [
                ("tripped", np.bool_),
                ("present", np.uint32),
                ("faults", np.uint32),
                ("at", np.uint64, (len(rows),)),
                ("value", np.float64, (len(rows),)),
            ],
            align=True,
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The thresholds."""
        return tuple(row.threshold for row in self.rows if row.threshold is not None)

    def number(self, code: str) -> int:
        """Return the number by which kernels know a fault."""
        return self.codes.index(code)

    def trip(self, latch: np.void, fault: int, period: int, value: float, *, react: bool) -> None:
        """As the kernel `trip`, for what is seen outside of kernels."""
        _report(latch, fault, period, value)
        if react:
            latch["tripped"] = True

    def latched(
        self, latch: np.void, limits: Sequence[float] | NDArray[np.float64] | None = None
    ) -> list[tuple[str, int, str]]:
        """Latched faults, oldest first: code, period of the first occurrence, what was seen.

        `limits` are the thresholds by the order of the faults, for the texts that name them.
        """
        found = []
        for bit, row in enumerate(self.rows):
            if int(latch["faults"]) >> bit & 1:
                limit = float(limits[bit]) if limits is not None else 0.0
                detail = row.described(float(latch["value"][bit]), limit)
                found.append((row.code, int(latch["at"][bit]), detail))
        return sorted(found, key=lambda fault: fault[1])

    def clear(self, latch: np.void) -> list[str]:
        """Forget the latched faults; returns those whose cause lasts, and then clears none."""
        lasting = int(latch["present"] & latch["faults"])
        if not lasting:
            latch["tripped"] = False
            latch["faults"] = 0
        return [code for bit, code in enumerate(self.codes) if lasting >> bit & 1]

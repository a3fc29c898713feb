"""What can happen to a recorded drive: changes, faults, who controls, gates that are off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Change:
    """
    A parameter that changed while the drive ran.

    Attributes
    ----------
    period : int
        First period with the new value.
    node : str
        Whose parameter it is.
    name : str
        Its name.
    value : Any
        The new value.
    """

    period: int
    node: str
    name: str
    value: Any


@dataclass(frozen=True)
class Fault:
    """
    A fault that a node latched.

    Attributes
    ----------
    period : int
        Of its first occurrence.
    node : str
        Who latched it.
    code, detail : str
        Such as ``OVERSPEED``, and what was seen.
    """

    period: int
    node: str
    code: str
    detail: str

    def __str__(self) -> str:
        return f"{self.code}, {self.detail}" if self.detail else self.code


@dataclass(frozen=True)
class Reign:
    """
    Consecutive periods in which one scheme controlled the current.

    Attributes
    ----------
    begin, end : int
        First period, and the one after the last.
    scheme : str
        Who answered their samples.
    chosen : str or None
        Who had been chosen to; None where nothing tells. If another, `scheme` is the fallback.
    """

    begin: int
    end: int
    scheme: str
    chosen: str | None

    @property
    def fell_back(self) -> bool:
        """Whether the fallback controlled in place of the chosen scheme."""
        return self.chosen is not None and self.chosen != self.scheme

    @property
    def title(self) -> str:
        """As it stands above a column: of a fallback, also in whose place it controlled."""
        return f"{self.chosen} -> {self.scheme}" if self.fell_back else self.scheme


@dataclass(frozen=True)
class Off:
    """
    Consecutive periods with all gates off.

    Attributes
    ----------
    begin, end : int
        First period, and the one after the last.
    commanded : bool
        Whether the controller had them off; else the inverter blocked them by itself.
    """

    begin: int
    end: int
    commanded: bool

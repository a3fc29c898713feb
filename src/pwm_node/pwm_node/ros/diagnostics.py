"""What a node tells about itself on ``/diagnostics``, and how step times are kept for it."""

from __future__ import annotations

import array
import enum
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pwm_node.lags import PERCENTILES, Lags


class Level(enum.IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True)
class Part:
    """One line of a node's diagnostics.

    Parameters
    ----------
    name : str
        Name of the part, such as ``loop``; it appears as ``<node>: <name>``.
    message : str
        The state in a few words.
    level : Level
        How serious it is.
    values : mapping
        Details by name, unit in the name.
    """

    name: str
    message: str
    level: Level = Level.OK
    values: Mapping[str, object] = field(default_factory=dict)


def lag_values(name: str, lags: Lags) -> dict[str, object]:
    """Return what a part tells of a histogram: percentiles (us), the longest, and all bins."""
    told = {f"{name} {p:g} % (us)": v for p, v in zip(PERCENTILES, lags.percentiles(), strict=True)}
    return {
        **told,
        f"{name} maximum (us)": lags.longest * 1e-3,
        f"{name} histogram (ns:periods)": lags.to_text(),
    }


class StepTimes:
    """The durations of the latest steps, for percentiles.

    Parameters
    ----------
    size : int
        Number of steps kept, a power of two.
    """

    def __init__(self, size: int = 4096) -> None:
        if size & (size - 1):
            raise ValueError(f"size must be a power of two, not {size}")
        self._ring = array.array("q", bytes(8 * size))
        self._mask = size - 1
        self._count = 0

    def add(self, nanoseconds: int) -> None:
        """Keep the duration of one step (ns)."""
        self._ring[self._count & self._mask] = nanoseconds
        self._count += 1

    def percentiles(self, *which: float) -> list[float]:
        """Return percentiles (us) of the steps kept; NaN if there are none."""
        kept = np.frombuffer(self._ring, np.int64)[: min(self._count, len(self._ring))]
        if not kept.size:
            return [float("nan")] * len(which)
        return [float(value) for value in np.percentile(kept, which) * 1e-3]

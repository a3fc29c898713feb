"""What a part of the plant is made of: one object per module of physics.

The module of a part owns its parameters, its fields of both records, how they are filled, and the
kernels that use them. `parts` lists all of them; the parameter table, the records and the choice of
the model are put together from that list.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pmsm_sim.motor import MotorPars
from pwm_node.parameters import Parameter

# Fields of a record, as NumPy takes them.
Fields = tuple[Any, ...]

# Of one interval: more is needed only far beyond any drive, and a run must end.
MOST_STEPS = 2_000


def _nothing(*_: Any) -> None:
    """For a part that has nothing to say here."""


def _never(par: np.void) -> bool:
    """For a part that the simpler model has too."""
    return False


def _no_rates(par: np.void) -> list[float]:
    """For a part that has no dynamics of its own."""
    return []


@dataclass(frozen=True, kw_only=True)
class Part:
    """
    A part of the plant.

    Attributes
    ----------
    parameters : tuple of Parameter
        What of it can be set. Where the last part of a parameter's name is a field of `par`, the
        value is copied there.
    par, state : tuple
        Its fields of `PLANT_PAR` and of `PLANT_STATE`.
    check : callable
        `check(values)`: reason for refusing values together, or None.
    start : callable
        `start(par, st, values, motor)`: fills what stays as it is, and the state at period 0.
    configure : callable
        `configure(par, st, values, motor)`: fills the rest of `par`; called at start, and after
        each change of a parameter.
    general : callable
        `general(par)`: whether it needs the general model as it is set now.
    full : callable
        `full(par)`: whether there it needs the full step (see `steps`).
    rates : callable
        `rates(par)`: inverses of its time constants (1/s), which the general model's step follows.
    """

    parameters: tuple[Parameter, ...] = ()
    par: Fields = ()
    state: Fields = ()
    check: Callable[[Mapping[str, Any]], str | None] = _nothing
    start: Callable[[np.void, np.void, Mapping[str, Any], MotorPars], None] = _nothing
    configure: Callable[[np.void, np.void, Mapping[str, Any], MotorPars], None] = _nothing
    general: Callable[[np.void], bool] = _never
    full: Callable[[np.void], bool] = _never
    rates: Callable[[np.void], list[float]] = _no_rates

    @cached_property
    def copied(self) -> list[tuple[str, str]]:
        """Parameters that are copied as they are, each with the field that it is copied to."""
        fields = {field[0] for field in self.par}
        pairs = ((row.name, row.name.rpartition(".")[2]) for row in self.parameters)
        return [(name, field) for name, field in pairs if field in fields]

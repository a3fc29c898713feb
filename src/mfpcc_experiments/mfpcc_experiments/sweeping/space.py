"""Where the values of a parameter come from: a grid, or a distribution."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwm_node.names import unknown

Array = NDArray[np.float64]

#: The largest number of values of a grid.
MOST_VALUES = 1_000_000

#: Shape and number of the values that each kind of space takes.
_TAKES = {
    "uniform": "[lowest, highest]",
    "log_uniform": "[lowest, highest], both above 0",
    "normal": "[mean, standard deviation], the latter above 0",
    "choice": "a list of values",
    "grid": "a list of values",
    "linspace": "[first, last, how many]",
    "logspace": "[first, last, how many], both ends above 0",
}

_GRIDS = ("grid", "linspace", "logspace")

#: Of uniform numbers, so that a normal one is finite.
_SMALLEST = 2.0**-53


@dataclass(frozen=True)
class Space:
    """
    The values that a parameter takes.

    Attributes
    ----------
    kind : str
        `grid` for every one of `values`, else the distribution they are drawn from.
    values : tuple
        The values of a grid or a choice; else the distribution's numbers.
    sign_of : str
        Name of a parameter whose sign the values get; empty: none.
    """

    kind: str
    values: tuple[Any, ...]
    sign_of: str = ""

    @property
    def is_grid(self) -> bool:
        """Whether every value is taken, rather than drawn."""
        return self.kind == "grid"

    def drawn(self, u: Array, *, whole: bool) -> NDArray[Any]:
        """
        Values of uniform numbers.

        Parameters
        ----------
        u : ndarray, shape (n,)
            In [0, 1).
        whole : bool
            Whether the values are whole numbers.
        """
        if self.kind == "choice":
            return np.array(self.values)[np.minimum(u * len(self.values), len(self.values) - 1)
                                         .astype(np.int64)]  # fmt: skip
        a, b = self.values
        if self.kind == "normal":
            from scipy.special import ndtri

            x = a + b * ndtri(np.maximum(u, _SMALLEST))
        elif self.kind == "log_uniform":
            x = np.exp(math.log(a) + u * (math.log(b) - math.log(a)))
            x = np.clip(x, a, b)
        elif whole:
            return np.floor(a + u * (b + 1 - a)).astype(np.int64)
        else:
            x = a + u * (b - a)
        return np.rint(x).astype(np.int64) if whole else x


def parse(name: str, given: Any) -> Space:
    """
    Read what a file says of a parameter.

    Parameters
    ----------
    name : str
        The parameter.
    given : Any
        `{KIND: VALUES}`, with `sign_of: NAME` beside it if wanted; a plain list is a grid.

    Raises
    ------
    ValueError
        With a sentence.
    """
    if isinstance(given, list):
        given = {"grid": given}
    if not isinstance(given, dict):
        raise ValueError(f"'{name}' needs a list of values, or one of {', '.join(_TAKES)}")
    rest = dict(given)
    sign_of = rest.pop("sign_of", "")
    if len(rest) != 1:
        raise ValueError(f"'{name}' needs one of {', '.join(_TAKES)}, and has {_listed(rest)}")
    kind, values = next(iter(rest.items()))
    if kind not in _TAKES:
        raise ValueError(f"'{name}': {unknown('distribution', str(kind), _TAKES)}")
    if not isinstance(values, list) or not values:
        raise ValueError(f"'{name}': '{kind}' needs {_TAKES[kind]}, and has {values!r}")
    if not isinstance(sign_of, str):
        raise ValueError(f"'{name}': 'sign_of' needs the name of a parameter, not {sign_of!r}")
    if kind not in ("grid", "choice"):
        _check_numbers(name, kind, values)
    elif any(isinstance(value, (list, dict)) or value is None for value in values):
        raise ValueError(f"'{name}': '{kind}' needs {_TAKES[kind]}, each a number or a text")
    elif len(set(map(repr, values))) < len(values):
        raise ValueError(f"'{name}': a value stands twice in its {kind}")
    if kind in ("linspace", "logspace"):
        make: Callable[..., Array] = np.linspace if kind == "linspace" else np.geomspace
        first, last, n = values
        return Space("grid", tuple(make(first, last, n).tolist()), sign_of)
    return Space(kind, tuple(values), sign_of)


def _listed(rest: dict[str, Any]) -> str:
    return ", ".join(map(str, rest)) or "none"


def _check_numbers(name: str, kind: str, values: list[Any]) -> None:
    """Numbers that a distribution can be made of."""
    wrong = f"'{name}': '{kind}' needs {_TAKES[kind]}"
    count = 3 if kind in _GRIDS else 2
    numbers = all(
        isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x) for x in values
    )
    if len(values) != count or not numbers:
        raise ValueError(f"{wrong}, and has {values!r}")
    a, b = values[:2]
    if kind == "normal":
        if not b > 0:
            raise ValueError(f"{wrong}, and has {b:g} for it")
        return
    if kind in ("log_uniform", "logspace") and not (a > 0 and b > 0):
        raise ValueError(f"{wrong}, and has {a:g} and {b:g}")
    if kind in ("uniform", "log_uniform") and not a < b:
        raise ValueError(f"'{name}': the range from {a:g} to {b:g} is empty")
    if count == 3:
        n = values[2]
        if not isinstance(n, int) or n < 2:
            raise ValueError(f"'{name}': '{kind}' needs at least 2 values, a whole number, not {n}")
        if n > MOST_VALUES:
            raise ValueError(f"'{name}': '{kind}' has {n:,} values, more than {MOST_VALUES:,}")
        if a == b:
            raise ValueError(f"'{name}': the range from {a:g} to {b:g} is empty")

"""Numbered fuzz cases: each is made of its number alone, so that a failure can be run again.

`FUZZ=100` in the environment makes a hundred times as many cases, `FUZZ_CASE=123` that one alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from pwm_node.parameters import Parameter, ParameterError, Table

#: Numbers that programs stumble over.
ODD_FLOATS = (
    float("nan"),
    float("inf"),
    float("-inf"),
    0.0,
    -0.0,
    5e-324,
    -2.2e-308,
    1e-9,
    1.0,
    -1.0,
    1e9,
    -1e30,
    1.7e308,
)
ODD_INTEGERS = (0, 1, 2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63 - 1, 2**63, 2**64 - 2, 2**64 - 1)


def cases(count: int) -> Iterator[np.random.Generator]:
    """Yield the random numbers of each case; of one that fails, the output tells its number."""
    chosen = os.environ.get("FUZZ_CASE")
    numbers = range(round(count * float(os.environ.get("FUZZ", "1"))))
    for number in numbers if chosen is None else [int(chosen)]:
        print(f"FUZZ_CASE={number}")
        yield np.random.default_rng(number)


def any_float(rng: np.random.Generator) -> float:
    """Any number: an odd one, or one of any size."""
    if rng.random() < 0.5:
        return ODD_FLOATS[rng.integers(len(ODD_FLOATS))]
    return float(rng.normal() * 10.0 ** rng.uniform(-6, 6))


def any_integer(rng: np.random.Generator) -> int:
    """Any number that an unsigned 64-bit field can hold."""
    if rng.random() < 0.5:
        return ODD_INTEGERS[rng.integers(len(ODD_INTEGERS))]
    return int(2.0 ** rng.uniform(0, 63.9))


def legal_values(table: Table, rng: np.random.Generator, share: float) -> dict[str, Any]:
    """Values that the table accepts at start: a share of them random, the others the defaults."""
    values: dict[str, Any] = {}
    for name, parameter in table.items():
        if rng.random() < share:
            try:
                values |= table.validate({**values, name: _legal(parameter, rng)})
            except ParameterError:
                continue  # against a rule across parameters
    return values


def _legal(parameter: Parameter, rng: np.random.Generator) -> Any:
    default = parameter.default
    if parameter.choices:
        return parameter.choices[rng.integers(len(parameter.choices))]
    if isinstance(default, bool):
        return bool(rng.integers(2))
    if isinstance(default, (str, list)):
        return default
    low, high = parameter.minimum, parameter.maximum
    assert low is not None and high is not None, parameter.name
    kind = rng.integers(4)
    if kind == 0:
        value = (low, high)[rng.integers(2)]
    elif kind == 1 and default != 0:
        value = min(max(default * 10.0 ** rng.uniform(-1, 1), low), high)
    else:
        # of any size between the limits
        size = 10.0 ** rng.uniform(-6, 0) * max(abs(low), abs(high))
        value = min(max(size if rng.random() < 0.5 or low >= 0 else -size, low), high)
    return round(value) if isinstance(default, int) else float(value)


def outcome(refusal: type[Exception], call: Callable[..., Any], *arguments: Any) -> tuple[Any, str]:
    """Return what a call returns and "", or None and what it says where it refuses."""
    try:
        return call(*arguments), ""
    except refusal as error:
        return None, str(error) or "?"

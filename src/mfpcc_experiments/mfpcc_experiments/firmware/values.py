"""Values of C: their code, and what kind of number they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import types
from numba.core.registry import cpu_target

from mfpcc_controller.firmware import FirmwareError
from mfpcc_experiments.firmware.layout import Array, Kind, Record

#: How tightly something binds that is one word, or in brackets.
PRIMARY = 11

# Where a constant of a C type needs more than its digits
_CONSTANTS = {
    types.uint32: "UINT32_C({})",
    types.uint64: "UINT64_C({})",
    types.uint8: "(uint8_t){}",
    types.int32: "(int32_t){}",
}
_LARGEST_INT = 2**31 - 1
_SMALL_INT = 2**15


@dataclass(frozen=True)
class Value:
    """
    An expression in C.

    Attributes
    ----------
    code : str
    kind : type, Record, Array
    binds : int
        How tightly its last operator binds.
    number : int, float or complex, optional
        Of a constant that stands in the source as it is.
    pointer : bool
        Of a record: whether the code is a pointer to it.
    root : str
        Of a record, an array, or a part of it: the local name by which it is reached.
    place : tuple, optional
        The field it lies in.
    small : bool
        Whether it is a whole number of 32 bits in C, where the kernel's have 64.
    """

    code: str
    kind: Kind
    binds: int = PRIMARY
    number: Any = None
    pointer: bool = False
    root: str = ""
    place: tuple[Any, str] | None = None
    small: bool = False


def is_small(number: Any, kind: Kind) -> bool:
    """Whether 32 bits hold a whole number, and products of it with another such."""
    return bool(kind == types.int64 and abs(int(number)) < _SMALL_INT)


def resolved(function: Any, arguments: Sequence[types.Type]) -> tuple[types.Type, tuple[Any, ...]]:
    """The types of result and arguments that numba chooses for a function of these."""
    context = cpu_target.typing_context
    context.refresh()
    signature = context.resolve_function_type(function, tuple(arguments), {})
    if signature is None:
        raise FirmwareError(f"numba knows no {function} of {', '.join(map(str, arguments))}")
    return types.unliteral(signature.return_type), tuple(map(types.unliteral, signature.args))


def unified(kinds: Sequence[Kind]) -> Kind:
    """The kind that a variable has which is given values of all of these."""
    first = kinds[0]
    if all(kind == first for kind in kinds):
        return first
    if any(isinstance(kind, (Record, Array)) for kind in kinds):
        raise FirmwareError("a name stands for several kinds of things")
    kind = cpu_target.typing_context.unify_types(*kinds)
    if kind is None:
        raise FirmwareError(f"a variable is {' and '.join(map(str, kinds))}")
    return kind


def spelt(number: Any, kind: types.Type, real: str) -> str:
    """A constant in C."""
    if kind == types.boolean:
        return "true" if number else "false"
    if kind == types.complex128:
        parts = ", ".join(spelt(part, types.float64, real) for part in (number.real, number.imag))
        return f"{{{parts}}}"
    if kind != types.float64:
        if abs(int(number)) > _LARGEST_INT and kind == types.int64:
            return f"INT64_C({int(number)})"
        return _CONSTANTS.get(kind, "{}").format(int(number))
    value = float(number)
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0.0 else "-INFINITY"
    if real == "float":
        with np.errstate(all="ignore"):
            text = repr(float(str(np.float32(value))))
        return f"{text}f"
    return repr(value)

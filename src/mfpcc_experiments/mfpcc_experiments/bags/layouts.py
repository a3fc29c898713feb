"""
How the messages of a recording are laid out, as their own definition says.

A recording brings the definitions of its messages with it. Where these are not those of this
version, as in a bag that was recorded before a field was added, the fields are found by their
names; what the recording does not have takes the default of its field.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg

from mfpcc_experiments.bags.definitions import message_definition

# What rosbag2 writes before each definition in IDL.
_IDL_HEAD = re.compile(r"^={80}\nIDL: .*\n", re.MULTILINE)
_IDL_INCLUDE = re.compile(r"^\s*#include .*$", re.MULTILINE)
_LARGEST_DEFINITION = 1 << 20  # characters

_ELEMENTS = {
    "bool": np.dtype(np.bool_),
    "byte": np.dtype(np.uint8),
    "char": np.dtype(np.uint8),
    "octet": np.dtype(np.uint8),
    "float32": np.dtype(np.float32),
    "float64": np.dtype(np.float64),
} | {
    f"{kind}{bits}": np.dtype(f"{kind}{bits}")
    for kind in ("int", "uint")
    for bits in (8, 16, 32, 64)
}

# Without these a message says nothing.
_NEEDED = {
    "mfpcc_msgs/msg/PhaseFeedback": ("i_a", "i_b", "i_c", "encoder_angle", "dc_voltage"),
    "mfpcc_msgs/msg/DutyCommand": ("duty",),
    "mfpcc_msgs/msg/LutDiagnostics": (),
    "mfpcc_msgs/msg/DriveState": (),
}
#: A drive of which it was not recorded whether its gates are on is read as one whose gates are.
TAKEN_AS_ON = ("enable", "gates_on")


class LayoutError(ValueError):
    """Messages that cannot be read by their definition; the text says why."""


@dataclass(frozen=True)
class Layout:
    """
    The leading fields of fixed size of a message on the wire, and what follows them.

    Attributes
    ----------
    dtype : np.dtype
        Record of the fixed fields behind the header of four bytes, without padding at its end.
    tail : tuple of (str, str)
        Names and kinds of the fields that follow: ``string``, or the element of a list.
    missing, unknown : tuple of str
        Fields of this version that the recording has not, and the other way round.
    """

    dtype: np.dtype[np.void]
    tail: tuple[tuple[str, str], ...]
    missing: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Bytes of the fixed fields, without header."""
        return self.dtype.itemsize


@lru_cache
def own_layout(type_name: str) -> Layout:
    """Layout of a message type of this version."""
    return _layout(_fields(message_definition(type_name), "ros2msg", type_name))


@lru_cache
def recorded_layout(type_name: str, definition: str, encoding: str) -> Layout:
    """
    Layout of the recorded messages of a type.

    Parameters
    ----------
    type_name : str
        E.g. ``mfpcc_msgs/msg/PhaseFeedback``.
    definition : str
        Its definition as recorded; where there is none, that of this version is supposed.
    encoding : str
        Of the definition: ``ros2msg`` or ``ros2idl``.

    Raises
    ------
    LayoutError
        If it cannot be understood, or the messages lack what they are there for.
    """
    own = _fields(message_definition(type_name), "ros2msg", type_name)
    if not definition.strip():
        return _layout(own)
    there = _fields(definition, encoding, type_name)
    if there == own:
        return _layout(own)
    kinds, own_kinds = dict(there), dict(own)
    for name, kind in own:
        if name in kinds and _shape(kinds[name]) != _shape(kind):
            raise LayoutError(f"its field {name} is another one there")
    needed = ("stamp", "period", *_NEEDED.get(type_name, ()))
    lacking = [name for name in needed if name not in kinds]
    if lacking:
        raise LayoutError(f"it has no field {lacking[0]} there")
    layout = _layout(there)
    expected = _layout(own)
    fixed = set(expected.dtype.names or ()) & set(kinds)
    if not fixed <= set(layout.dtype.names or ()) or layout.tail not in (expected.tail, ()):
        raise LayoutError("its fields stand in another order there")
    return Layout(
        layout.dtype,
        layout.tail,
        missing=tuple(name for name, _ in own if name not in kinds),
        unknown=tuple(name for name, _ in there if name not in own_kinds),
    )


def convert(
    block: NDArray[np.uint8], layout: Layout, dtype: np.dtype[np.void], msg_class: Any
) -> NDArray[np.void]:
    """
    Records of this version out of recorded bytes.

    Parameters
    ----------
    block : ndarray of uint8, shape (n, layout.size)
        The fixed fields of the messages.
    layout : Layout
        As recorded.
    dtype : np.dtype
        Record of this version.
    msg_class : type
        Generated class of the message: it knows the defaults.
    """
    rows = np.zeros(len(block), dtype)
    recorded = np.ascontiguousarray(block).view(layout.dtype)[:, 0]
    defaults = msg_class()
    for name in dtype.names or ():
        if name in (layout.dtype.names or ()):
            rows[name] = recorded[name]
        elif name in TAKEN_AS_ON:
            rows[name] = True
        elif dtype[name].base.kind == "f" and not np.any(getattr(defaults, name)):
            rows[name] = np.nan  # no default was declared: it is not known
        else:
            rows[name] = getattr(defaults, name)
    return rows


# --- From a definition to fields ---------------------------------------------------------------

# A field's kind: ("float64", None), ("float64", 3) for an array, ("float64", "list"),
# ("string", None), or the kinds of a nested message's fields.
_Kind = tuple[Any, Any]


@lru_cache
def _fields(text: str, encoding: str, type_name: str) -> tuple[tuple[str, _Kind], ...]:
    if encoding not in ("ros2msg", "ros2idl"):
        raise LayoutError(f"its definition is in '{encoding}'; only ros2msg and ros2idl are known")
    if len(text) > _LARGEST_DEFINITION:
        raise LayoutError("its definition is too long")
    try:
        types: dict[str, Any] = {}
        if encoding == "ros2msg":
            types |= get_types_from_msg(text, type_name)
        else:
            for part in _IDL_HEAD.split(_IDL_INCLUDE.sub("", text)):
                types |= get_types_from_idl(part) if part.strip() else {}
        return _of_type(type_name, types, depth=0)
    except (TypesysError, KeyError, RecursionError, TypeError, ValueError) as error:
        if isinstance(error, LayoutError):
            raise
        raise LayoutError("its definition cannot be understood") from None


def _of_type(name: str, types: dict[str, Any], depth: int) -> tuple[tuple[str, _Kind], ...]:
    if depth > 8:
        raise LayoutError("its definition is nested too deep")
    return tuple((field, _kind(node, types, depth)) for field, node in types[name][1])


def _kind(node: Any, types: dict[str, Any], depth: int) -> _Kind:
    kind, inner = node
    if kind == Nodetype.BASE:
        return (str(inner[0]), None)
    if kind == Nodetype.NAME:
        return (_of_type(inner, types, depth + 1), None)
    element = _kind(inner[0], types, depth)
    return (element[0], int(inner[1]) if kind == Nodetype.ARRAY else "list")


def _shape(kind: _Kind) -> tuple[Any, Any]:
    """What of a kind must be the same: numbers may be of another size."""
    name, count = kind
    number = isinstance(name, str) and name in _ELEMENTS and count != "list"
    return ("number" if number else name, count)


def _layout(fields: tuple[tuple[str, _Kind], ...]) -> Layout:
    """Lay fields out as CDR does: each element on a multiple of its size."""
    leading: list[tuple[str, Any, int]] = []
    end = 0
    for at, (name, kind) in enumerate(fields):
        parts = list(_leaves(kind))
        if any(part is None for part in parts):
            return Layout(_record(leading, end), tuple(_tail(fields[at:])))
        offset = begin = -(-end // parts[0].base.itemsize) * parts[0].base.itemsize  # type: ignore[union-attr]
        inner: list[int] = []
        for part in parts:
            size = part.base.itemsize  # type: ignore[union-attr]
            offset = -(-offset // size) * size
            inner.append(offset - begin)
            offset += part.itemsize  # type: ignore[union-attr]
        leading.append((name, _field_type(kind, parts, inner, offset - begin), begin))
        end = offset
    return Layout(_record(leading, end), ())


def _leaves(kind: _Kind) -> Iterator[np.dtype[Any] | None]:
    """Elements of a field in their order; None for one without a fixed size."""
    name, count = kind
    if count == "list" or name in ("string", "wstring") or (count and not isinstance(name, str)):
        yield None
    elif isinstance(name, str):
        if name not in _ELEMENTS or count == 0 or (count or 1) > 1 << 16:
            raise LayoutError(f"'{name}' is no type of a field")
        yield np.dtype((_ELEMENTS[name], (count,))) if count else _ELEMENTS[name]
    else:
        for _, inner in name:
            yield from _leaves(inner)


def _field_type(kind: _Kind, parts: list[Any], offsets: list[int], size: int) -> Any:
    name, _ = kind
    if isinstance(name, str):
        return parts[0]
    names = [n for n, _ in name]
    if len(names) != len(parts):
        raise LayoutError("a field is nested more than once")
    return np.dtype({"names": names, "formats": parts, "offsets": offsets, "itemsize": size})


def _record(fields: list[tuple[str, Any, int]], size: int) -> np.dtype[np.void]:
    names, formats, offsets = zip(*fields, strict=True) if fields else ((), (), ())
    return np.dtype(
        {"names": list(names), "formats": list(formats), "offsets": list(offsets), "itemsize": size}  # type: ignore[arg-type]
    )


def _tail(fields: tuple[tuple[str, _Kind], ...]) -> Iterator[tuple[str, str]]:
    """What follows the fixed fields; numbers behind a text or list lie nowhere fixed."""
    for name, (kind, count) in fields:
        if count is None and kind == "string":
            yield name, "string"
        else:
            yield name, f"{kind}[]" if count == "list" else "other"

"""Messages as text (YAML, CSV), and filled from YAML."""

from __future__ import annotations

import array
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import yaml
from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractString,
    AbstractWString,
    Array,
    BasicType,
    BoundedSequence,
    NamedType,
    NamespacedType,
)

from ros2_standin.types import interface_class

_SEQUENCES = (list, tuple, array.array, np.ndarray)


def _fields(message: Any) -> Iterator[tuple[str, Any, Any]]:
    """Name, value and type of each field."""
    for name, kind in zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True):
        yield name, getattr(message, name), kind


# --- To text -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Style:
    """
    How much of a message is printed.

    Parameters
    ----------
    length : int or None
        Longest sequence, text or bytes that is printed in full; None: any.
    no_arr, no_str : bool
        Print what arrays and texts are instead of what is in them.
    """

    length: int | None = None
    no_arr: bool = False
    no_str: bool = False

    def plain(self, message: Any) -> dict[str, Any]:
        """Return a message as nested dicts, lists and numbers."""
        return {name: self._plain(value, kind) for name, value, kind in _fields(message)}

    def _plain(self, value: Any, kind: Any = None) -> Any:
        if isinstance(value, np.generic):  # first of all: some are Python floats, too
            return value.item()
        if isinstance(value, (bool, int, float)):
            return value
        if isinstance(value, bytes):
            return self._cut(value.decode("latin-1"))
        if isinstance(value, str):
            return f"<string length: <{len(value)}>>" if self.no_str else self._cut(value)
        if isinstance(value, _SEQUENCES):
            if self.no_arr and kind is not None:
                return _outline(value, kind)
            items = [self._plain(v) for v in value[: self.length]]
            return [*items, "..."] if self._too_long(value) else items
        return self.plain(value)

    def csv(self, message: Any) -> str:
        """Return all fields of a message, separated by commas."""
        return ",".join(self._csv(value, kind) for _, value, kind in _fields(message))

    def _csv(self, value: Any, kind: Any = None) -> str:
        if isinstance(value, _SEQUENCES):
            if self.no_arr and kind is not None:
                return _outline(value, kind)
            items = [self._csv(v) for v in value[: self.length]]
            return ",".join([*items, "..."] if self._too_long(value) else items)
        if isinstance(value, str):
            return f"<string length: <{len(value)}>>" if self.no_str else self._cut(value)
        if isinstance(value, bytes):
            return str(value[: self.length] + b"..." if self._too_long(value) else value)
        if isinstance(value, (bool, int, float, np.number)):
            return str(value)
        return self.csv(value)

    def _too_long(self, value: Any) -> bool:
        return self.length is not None and len(value) > self.length

    def _cut(self, text: str) -> str:
        return text[: self.length] + "..." if self._too_long(text) else text

    def yaml(self, message: Any, *, flow: bool = False) -> str:
        """Return a message as YAML; `flow` puts each list on one line."""
        return yaml.dump(
            self.plain(message),
            Dumper=_Dumper,
            allow_unicode=True,
            width=sys.maxsize,
            default_flow_style=flow,
            sort_keys=False,
        )


class _Dumper(yaml.SafeDumper):
    """YAML as ROS 2 prints messages: nothing shortened, mappings never on one line by choice."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_mapping(self, *args: Any, **options: Any) -> yaml.MappingNode:
        node = super().represent_mapping(*args, **options)
        node.flow_style = False
        return node


def _outline(value: Any, kind: Any) -> str:
    """Say what an array or sequence is, rather than what is in it."""
    item = kind.value_type
    if isinstance(item, BasicType):
        name = item.typename
    elif isinstance(item, AbstractString):
        name = "string"
    elif isinstance(item, AbstractWString):
        name = "wstring"
    elif isinstance(item, NamedType):
        name = item.name
    elif isinstance(item, NamespacedType):
        name = "/".join(item.namespaced_name())
    else:
        name = "unknown"
    if isinstance(kind, Array):
        return f"<array type: {name}[{kind.size}]>"
    if isinstance(kind, BoundedSequence):
        return f"<sequence type: {name}[{kind.maximum_size}], length: {len(value)}>"
    return f"<sequence type: {name}, length: {len(value)}>"


# --- From YAML ---------------------------------------------------------------------------------

#: Sets a time field to the time it gets.
Setter = Callable[[Any], None]


def read_values(text: str | bytes) -> dict[str, Any]:
    """
    Read the values of a message from YAML.

    Raises
    ------
    RuntimeError
        If it is not YAML, or not a mapping.
    """
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise RuntimeError(f"The passed value is not YAML: {error}") from None
    if not isinstance(values, dict):
        raise RuntimeError("The passed value needs to be a dictionary in YAML format")
    return values


def fill(message: Any, values: dict[str, Any], *, times: bool = False) -> list[Setter]:
    """
    Set fields of a message.

    Parameters
    ----------
    message : message
        Changed in place.
    values : dict
        Value by name of the field; messages in it are dicts again.
    times : bool
        Let ``now`` stand for the time of publishing, and ``auto`` for a header with that time.

    Returns
    -------
    list of callable
        What sets those fields to a time.

    Raises
    ------
    AttributeError, TypeError, ValueError
        If a field is not there, or a value does not fit.
    """
    if not isinstance(values, dict):
        raise TypeError(
            f"Value '{values}' is expected to be a dictionary but is a {type(values).__name__}"
        )
    kinds = dict(zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True))
    setters: list[Setter] = []
    for name, value in values.items():
        field = getattr(message, name)
        kind = kinds[name]
        type_name = "/".join(kind.namespaced_name()) if isinstance(kind, NamespacedType) else ""
        if times and type_name == "std_msgs/msg/Header" and value == "auto":
            setters.append(partial(setattr, field, "stamp"))
        elif times and type_name == "builtin_interfaces/msg/Time" and value == "now":
            setters.append(partial(setattr, message, name))
        elif type_name:
            setters += fill(field, value, times=times)
        else:
            setattr(message, name, _converted(field, value, kind, setters, times))
    return setters


def _converted(field: Any, value: Any, kind: Any, setters: list[Setter], times: bool) -> Any:
    """Return a value in the type that the field has now."""
    if isinstance(field, array.array):
        return array.array(field.typecode, value)
    if isinstance(field, np.ndarray):
        return np.array(value, dtype=field.dtype)
    if isinstance(kind, AbstractNestedType) and isinstance(kind.value_type, NamespacedType):
        make = interface_class("/".join(kind.value_type.namespaced_name()))
        items = [make() for _ in value]
        for item, item_values in zip(items, value, strict=True):
            setters += fill(item, item_values, times=times)
        return items
    return value if type(value) is type(field) else type(field)(value)

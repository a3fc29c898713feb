"""Definitions of message types, as they are stored in bags."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from rosidl_parser.definition import AbstractNestedType, NamespacedType

from ros2_standin.index import interface_file
from ros2_standin.types import interface_class


@lru_cache
def definition(name: str) -> str:
    """
    Return the definition of a message type, followed by those of the types in it.

    Parameters
    ----------
    name : str
        E.g. ``std_msgs/msg/Header``.
    """
    parts = [interface_file(name).read_text(encoding="utf-8")]
    for used in dict.fromkeys(_types_in(interface_class(name))):
        package, _, base = used.split("/")
        text = interface_file(used).read_text(encoding="utf-8")
        parts.append(f"{'=' * 80}\nMSG: {package}/{base}\n{text}")
    return "\n".join(parts)


def _types_in(kind: Any) -> Iterator[str]:
    """Names of all message types within a message type, with repetitions."""
    for slot in kind.SLOT_TYPES:
        item = slot.value_type if isinstance(slot, AbstractNestedType) else slot
        if isinstance(item, NamespacedType):
            name = "/".join(item.namespaced_name())
            yield name
            yield from _types_in(interface_class(name))

"""Interface classes by name."""

from __future__ import annotations

import importlib
from typing import Any


def interface_class(name: str, kind: str = "msg") -> Any:
    """
    Return the class of an interface type.

    Parameters
    ----------
    name : str
        E.g. ``std_msgs/msg/String``, or shorter ``std_msgs/String``.
    kind : str
        ``msg``, ``srv`` or ``action``: what the short form means.

    Raises
    ------
    LookupError
        If there is no such type.
    """
    package, *middle, base = name.split("/") if "/" in name else ("", name)
    if not package or len(middle) > 1:
        raise LookupError(name)
    try:
        module = importlib.import_module(".".join([package, *(middle or [kind])]))
        return getattr(module, base)
    except (AttributeError, ModuleNotFoundError, ValueError):
        raise LookupError(name) from None


def message_class(name: str, error: str) -> Any:
    """Return the class of a message type; raise a RuntimeError of text `error` if it is none."""
    try:
        found = interface_class(name, "msg")
    except LookupError:
        raise RuntimeError(error) from None
    if not hasattr(found, "SLOT_TYPES"):
        raise RuntimeError(error)
    return found

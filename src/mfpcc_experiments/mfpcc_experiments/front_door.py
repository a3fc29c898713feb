"""What a package offers, imported only when somebody asks for it."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any


def front_door(package: str, offered: Mapping[str, Sequence[str]]) -> Callable[[str], Any]:
    """
    Return the `__getattr__` of a package.

    A node that only records needs nothing that draws, and the command line is there at once. So a
    package does not import all that it offers when one of its modules is wanted.

    Parameters
    ----------
    package : str
        Its `__name__`.
    offered : mapping of str to sequence of str
        By module of the package, the names that others may use.
    """
    where = {name: module for module, names in offered.items() for name in names}

    def find(name: str) -> Any:
        if name not in where:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(importlib.import_module(f"{package}.{where[name]}"), name)

    return find

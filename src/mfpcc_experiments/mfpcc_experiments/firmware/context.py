"""What the translation of one kernel needs of the whole program."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from numba import types

from mfpcc_experiments.firmware.layout import Kind, Structs


@dataclass(frozen=True)
class Function:
    """
    A translated kernel.

    Attributes
    ----------
    name : str
    parameters : tuple of str
    written : frozenset of str
        Those of the parameters that it changes something in.
    result : type
    """

    name: str
    parameters: tuple[str, ...]
    written: frozenset[str]
    result: Kind


class Context(Protocol):
    """The program that a kernel becomes a part of (`program.Program`)."""

    structs: Structs
    stand_ins: dict[Any, Any]

    def function(self, kernel: Any, kinds: Sequence[Kind]) -> Function:
        """A kernel that is called, for arguments of these kinds."""

    def pruned(self, body: Sequence[ast.stmt]) -> list[ast.stmt]:
        """The statements that the program has."""

    def local(self, name: str) -> str:
        """A variable's name in C."""

    def constant(self, kernel: Any, node: ast.expr, value: Any, kind: Any, real: str) -> str:
        """The name of a constant from outside the kernels."""

    def helper(self, name: str, real: str) -> str:
        """The name of a function of the prelude."""

    def tuple_name(self, kind: types.BaseTuple, real: str) -> str:
        """The struct for several values at once."""

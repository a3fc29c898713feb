"""All kernels that one kernel needs, as one file of C."""

from __future__ import annotations

import ast
import copy
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numba import types

from mfpcc_controller.firmware import FirmwareError
from mfpcc_experiments.firmware import prelude
from mfpcc_experiments.firmware.context import Function
from mfpcc_experiments.firmware.functions import Translator, comment
from mfpcc_experiments.firmware.layout import Kind, Structs, c_name, kind_of
from mfpcc_experiments.firmware.values import is_small, spelt

# Words of C, and of its headers, that are no names of variables
_RESERVED = {
    "auto", "case", "char", "const", "default", "do", "double", "enum", "extern", "float", "goto",
    "inline", "int", "long", "register", "restrict", "short", "signed", "sizeof", "static",
    "struct", "switch", "typedef", "union", "unsigned", "void", "volatile", "bool", "true", "false",
    "NAN", "INFINITY",
}  # fmt: skip

# Names of the interface, as a kernel of the scheme `mfpcc` would have one
_INTERFACE = {f"mfpcc_{name}" for name in ("init", "step", "set_parameter", "stop", "clear_faults")}

_SHORT = {types.float64: "real", types.boolean: "bool"}

#: Kernels of these modules count periods and nanoseconds: single precision would lose them.
_ALWAYS_DOUBLE = {"pwm_node.stamps"}


class Program:
    """
    A program in C, made of kernels.

    Parameters
    ----------
    structs : Structs
        Of its records.
    real : str
        `double` or `float`.
    included : callable
        Says whether the program has what begins with this: the test of an `if`, or what is given
        a value (see `pruned`).
    stand_ins : mapping, optional
        Kernels that are called in the place of other functions.
    """

    def __init__(
        self,
        structs: Structs,
        real: str = "double",
        included: Callable[[str], bool] = lambda text: True,
        stand_ins: Mapping[Any, Any] | None = None,
    ) -> None:
        self.structs = structs
        self.real = real
        self.stand_ins = dict(stand_ins or {})
        self._included = included
        self._functions: dict[tuple[Any, tuple[Kind, ...]], Function | None] = {}
        self._texts: list[tuple[str, str]] = []
        self._constants: dict[str, str] = {}
        self._values: dict[str, tuple[Any, str]] = {}
        self._tuples: dict[str, str] = {}
        self._helpers: dict[str, str] = {}

    def function(self, kernel: Any, kinds: Sequence[Kind]) -> Function:
        """A kernel for arguments of these kinds; translated when it is first asked for."""
        kinds = tuple(types.unliteral(k) if isinstance(k, types.Type) else k for k in kinds)
        key = kernel, kinds
        if key in self._functions:
            known = self._functions[key]
            if known is None:
                raise FirmwareError(f"kernel '{kernel.__name__}' calls itself")
            return known
        self._functions[key] = None
        module = kernel.__module__
        name = f"{module.rpartition('.')[2]}_{kernel.__name__.lstrip('_')}"
        if name in _INTERFACE:
            name = f"scheme_{name}"
        taken = {each.name for each in self._functions.values() if each is not None}
        number = 2
        unique = name
        while unique in taken:
            unique, number = f"{name}_{number}", number + 1
        real = "double" if module in _ALWAYS_DOUBLE else self.real
        function, text = Translator(self, kernel, unique, kinds, real).translate()
        self._functions[key] = function
        self._texts.append((module, text))
        return function

    def pruned(self, body: Sequence[ast.stmt]) -> list[ast.stmt]:
        """
        A kernel's statements without those of schemes that the program does not have.

        They are the branches `mem.active == N` of the generated dispatch, and what concerns a
        field of the records that is left out.
        """
        kept: list[ast.stmt] = []
        for statement in body:
            if not self._included(_begin(statement)):
                if isinstance(statement, ast.If):
                    kept += self.pruned(statement.orelse)
                continue
            if isinstance(statement, ast.If) and statement.orelse:
                statement = copy.copy(statement)
                statement.orelse = self.pruned(statement.orelse)
            kept.append(statement)
        return kept

    def local(self, name: str) -> str:
        """A variable's name in C."""
        if name == "_":
            return "pass"
        return f"{name}_" if name in _RESERVED else name

    def constant(self, kernel: Any, node: ast.expr, value: Any, kind: Any, real: str) -> str:
        """The name of a constant from outside the kernels."""
        home, name = _where(kernel, node)
        text = name.lstrip("_").upper()
        digest = f"{value!r}"
        if self._values.get(text, (digest, home))[0] != digest:
            text = f"{home.rpartition('.')[2].upper()}_{text}"
        if real != self.real:
            text = f"{text}_{real.upper()}"
        if text not in self._values:
            self._values[text] = (digest, home)
            self._constants[text] = _definition(text, value, kind, real)
        return text

    def helper(self, name: str, real: str) -> str:
        """A function of the prelude, which the program has from now on."""
        text = name if real == self.real else name.replace("real_", f"{real}_")
        if text not in self._helpers:
            if name == "complex_abs" and math.hypot in self.stand_ins:
                kernel = self.stand_ins[math.hypot].py_func
                hypot = self.function(kernel, [types.float64, types.float64]).name
            else:
                hypot = "hypotf" if real == "float" else "hypot"
            source = prelude.helper(name, text, real, hypot)
            if name == "complex_abs" and math.hypot in self.stand_ins:
                source = f"static {real} {hypot}({real} x, {real} y);\n\n{source}"
            self._helpers[text] = source
        return text

    def tuple_name(self, kind: types.BaseTuple, real: str) -> str:
        """The struct for several values at once."""
        names = [_SHORT.get(each, str(each)) for each in kind.types]
        counted = (f"{name}_{len(list(group))}" for name, group in itertools.groupby(names))
        name = f"tuple_{'_'.join(counted)}"
        if real != self.real and types.float64 in kind.types:
            name = f"{name}_{real}"
        if name not in self._tuples:
            lines = [
                f"    {c_name(each, real)} v{position};" for position, each in enumerate(kind.types)
            ]
            self._tuples[name] = "\n".join(["typedef struct {", *lines, f"}} {name};"])
        return name

    def source(self, describe: Callable[[str], str]) -> str:
        """Constants, tuples and functions, each after what it uses; `describe` tells of modules."""
        text = "\n".join(self._constants.values())
        text += "\n\n" + "\n\n".join([*self._tuples.values(), *self._helpers.values()])
        before = None
        for module, function in self._texts:
            if module != before:
                text += f"\n\n{comment(f'--- {module}: {describe(module)}')}"
                before = module
            text += f"\n\n{function}"
        return text + "\n"

    @property
    def kernels(self) -> list[Any]:
        """The Python functions that were translated."""
        return [kernel for kernel, _ in self._functions]


def _begin(statement: ast.stmt) -> str:
    if isinstance(statement, ast.If):
        return ast.unparse(statement.test)
    return ast.unparse(statement.targets[0]) if isinstance(statement, ast.Assign) else ""


def _where(kernel: Any, node: ast.expr) -> tuple[str, str]:
    """Module and name under which a constant is defined."""
    if isinstance(node, ast.Attribute):
        module = kernel.__globals__.get(getattr(node.value, "id", ""), None)
        return getattr(module, "__name__", kernel.__module__), node.attr
    assert isinstance(node, ast.Name)
    return kernel.__module__, node.id


def _definition(name: str, value: Any, kind: Any, real: str) -> str:
    if not isinstance(value, (np.ndarray, tuple)):
        text = "int32_t" if is_small(value, kind) else c_name(kind, real)
        return f"static const {text} {name} = {spelt(value, kind, real)};"
    array = np.asarray(value)
    number = kind_of(array.dtype)
    bounds = "".join(f"[{n}]" for n in array.shape)

    def inner(part: Any) -> str:
        if isinstance(part, np.ndarray) and part.ndim:
            return f"{{{', '.join(inner(each) for each in part)}}}"
        return spelt(part.item(), number, real)

    return f"static const {c_name(number, real)} {name}{bounds} = {inner(array)};"

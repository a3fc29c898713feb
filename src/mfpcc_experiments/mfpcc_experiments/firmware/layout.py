"""Records as C structs: their names, their fields' units, and how they lie in memory."""

from __future__ import annotations

import ast
import importlib
import io
import pkgutil
import tokenize
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numba import types

import mfpcc_controller
from mfpcc_controller.firmware import FirmwareError

#: Numbers as NumPy stores them, and as numba calls them.
NUMBERS: dict[np.dtype[Any], types.Type] = {
    np.dtype(np.float64): types.float64,
    np.dtype(np.complex128): types.complex128,
    np.dtype(np.bool_): types.boolean,
    np.dtype(np.int32): types.int32,
    np.dtype(np.int64): types.int64,
    np.dtype(np.uint8): types.uint8,
    np.dtype(np.uint32): types.uint32,
    np.dtype(np.uint64): types.uint64,
}

_C_NAMES = {
    types.complex128: "mfpcc_complex",
    types.boolean: "bool",
    types.int32: "int32_t",
    types.int64: "int64_t",
    types.uint8: "uint8_t",
    types.uint32: "uint32_t",
    types.uint64: "uint64_t",
    types.none: "void",
}


@dataclass(frozen=True)
class Record:
    """A record, by its dtype."""

    dtype: np.dtype[np.void]


@dataclass(frozen=True)
class Array:
    """An array of a fixed shape, in a record or a constant."""

    element: types.Type
    shape: tuple[int, ...]


#: What an expression may be: a number, a tuple of such, a record, an array.
Kind = Any


#: Of each struct in C, what is said above a field and beside it.
Notes = Mapping[str, Mapping[str, tuple[str, str]]]


def c_name(number: types.Type, real: str) -> str:
    """The C type of a number, `real` being `double` or `float`."""
    return real if number == types.float64 else _C_NAMES[number]


def kind_of(dtype: np.dtype[Any]) -> Kind:
    """What a field of this dtype is."""
    if dtype.subdtype is not None:
        element, shape = dtype.subdtype
        return Array(NUMBERS[element], shape)
    return Record(dtype) if dtype.names is not None else NUMBERS[dtype]


def fields(dtype: np.dtype[np.void]) -> Iterator[tuple[str, np.dtype[Any]]]:
    """Fields of a record with their dtypes, in their order."""
    for name in dtype.names or ():
        yield name, dtype.fields[name][0]  # type: ignore[index]


@dataclass
class Structs:
    """
    The structs that a program needs, each after those that it holds.

    Parameters
    ----------
    keep : callable
        Says of a field's name whether the firmware has it.
    names : dict
        C names of records known before.
    """

    keep: Callable[[str], bool]
    names: dict[np.dtype[np.void], str]
    comments: Notes
    _listed: dict[np.dtype[np.void], str] = field(default_factory=dict)

    def name(self, dtype: np.dtype[np.void], fallback: str = "") -> str:
        """C name of a record's struct, which is listed from now on."""
        if dtype not in self.names:
            if not fallback:
                raise FirmwareError(f"a record with the fields {dtype.names} has no name in C")
            self.names[dtype] = fallback
        if dtype not in self._listed:
            self._listed[dtype] = self._body(dtype)
        return self.names[dtype]

    def has(self, dtype: np.dtype[np.void], name: str) -> bool:
        """Whether a record has this field, here and in the firmware."""
        return name in (dtype.names or ()) and self.keep(name)

    def _body(self, dtype: np.dtype[np.void]) -> str:
        own = self.names[dtype]
        notes = self.comments.get(own, {})
        lines = ["typedef struct {"]
        for name, each in fields(dtype):
            if not self.keep(name):
                continue
            base, shape = each.subdtype or (each, ())
            if base.names is not None:
                text = self.name(base, f"{own}_{name}")
            else:
                text = c_name(NUMBERS[base], "mfpcc_real")
            bounds = "".join(f"[{n}]" for n in shape)
            above, beside = notes.get(name, ("", ""))
            if above:
                lines.append(f"    /* {above} */")
            lines.append(f"    {text} {name}{bounds};" + (f" /* {beside} */" if beside else ""))
        lines.append(f"}} {own};")
        return "\n".join(lines)

    def source(self) -> str:
        """All structs, in C."""
        return "\n\n".join(self._listed.values())


def known_records() -> tuple[dict[np.dtype[np.void], str], Notes]:
    """Names in C of the controller's records, and the comments of their fields in the source."""
    names: dict[np.dtype[np.void], str] = {}
    notes: dict[str, dict[str, tuple[str, str]]] = {}
    for module in _modules():
        path = Path(module.__file__ or "")
        if not path.is_file():
            continue
        short = module.__name__.rpartition(".")[2]
        source = path.read_text(encoding="utf-8")
        comments = _comments(source)
        for node in ast.parse(source).body:
            if not isinstance(node, ast.Assign) or not isinstance(node.targets[0], ast.Name):
                continue
            variable = node.targets[0].id
            value = getattr(module, variable, None)
            if isinstance(value, np.dtype) and value.names and value not in names:
                names[value] = _struct_name(short, variable)
            if variable == "CFG_FIELDS":
                notes.setdefault("mfpcc_cfg", {}).update(_field_notes(node.value, comments))
            elif isinstance(value, np.dtype) and value.names:
                notes.setdefault(names[value], {}).update(_field_notes(node.value, comments))
    return names, notes


def _modules() -> Iterator[Any]:
    """The controller's modules that hold no node, and those of the schemes that are plugged in."""
    from mfpcc_controller import schemes

    for info in pkgutil.walk_packages(mfpcc_controller.__path__, "mfpcc_controller."):
        if not info.name.endswith(".node"):
            yield importlib.import_module(info.name)
    for scheme in schemes.BUILT_IN:
        name = scheme.step.__module__
        if not name.startswith("mfpcc_controller."):
            yield importlib.import_module(name)


def _struct_name(module: str, variable: str) -> str:
    if module == "records":
        return "mfpcc_" + variable.lower().removeprefix("control_")
    return f"mfpcc_{module}_{variable.lower()}"


def _comments(source: str) -> dict[int, tuple[str, bool]]:
    """Comments by line, and whether they have it for themselves."""
    return {
        token.start[0]: (
            token.string.lstrip("#: ").strip().replace("*/", "* /"),
            not token.line[: token.start[1]].strip(),
        )
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }


def _field_notes(
    node: ast.expr, comments: Mapping[int, tuple[str, bool]]
) -> dict[str, tuple[str, str]]:
    """What is said of the fields of a dtype: above their lines, and on them."""
    found = {}
    for item in ast.walk(node):
        if not isinstance(item, ast.Tuple) or not item.elts:
            continue
        name = item.elts[0]
        if not isinstance(name, ast.Constant) or not isinstance(name.value, str):
            continue
        beside, alone = comments.get(item.lineno, ("", False))
        above: list[str] = []
        line = item.lineno - 1
        while comments.get(line, ("", False))[1]:
            above.insert(0, comments[line][0])
            line -= 1
        found[name.value] = (" ".join(above), "" if alone else beside)
    return found

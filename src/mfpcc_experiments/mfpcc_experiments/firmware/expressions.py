"""Expressions of kernels in C, with the types that numba gives them."""

from __future__ import annotations

import ast
import builtins
import math
import operator
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numba import types
from numba.core.dispatcher import Dispatcher

from mfpcc_controller.firmware import FirmwareError
from mfpcc_experiments.firmware.context import Context
from mfpcc_experiments.firmware.layout import Array, Kind, Record, c_name, kind_of
from mfpcc_experiments.firmware.values import PRIMARY, Value, is_small, resolved, spelt, unified

# How tightly operators of C bind
_UNARY, _TIMES, _PLUS, _SHIFT, _RELATION, _EQUAL, _BITS, _AND, _OR, _CONDITION = range(
    PRIMARY - 1, 0, -1
)

_BINARY: dict[type[ast.operator], tuple[Callable[..., Any], str, int]] = {
    ast.Add: (operator.add, "+", _PLUS),
    ast.Sub: (operator.sub, "-", _PLUS),
    ast.Mult: (operator.mul, "*", _TIMES),
    ast.Div: (operator.truediv, "/", _TIMES),
    ast.FloorDiv: (operator.floordiv, "//", PRIMARY),
    ast.Mod: (operator.mod, "%", PRIMARY),
    ast.Pow: (operator.pow, "**", PRIMARY),
    ast.LShift: (operator.lshift, "<<", _SHIFT),
    ast.RShift: (operator.rshift, ">>", _SHIFT),
    ast.BitAnd: (operator.and_, "&", _BITS),
    ast.BitOr: (operator.or_, "|", _BITS),
    ast.BitXor: (operator.xor, "^", _BITS),
}

_COMPARE: dict[type[ast.cmpop], tuple[Callable[..., Any], str, int]] = {
    ast.Lt: (operator.lt, "<", _RELATION),
    ast.LtE: (operator.le, "<=", _RELATION),
    ast.Gt: (operator.gt, ">", _RELATION),
    ast.GtE: (operator.ge, ">=", _RELATION),
    ast.Eq: (operator.eq, "==", _EQUAL),
    ast.NotEq: (operator.ne, "!=", _EQUAL),
}

_COMPLEX = {"+": "add", "-": "sub", "*": "mul"}

# Functions of `math` that C's library has by the same name
_MATH = {"sqrt", "sin", "cos", "exp", "floor", "copysign", "hypot", "ldexp"}

_CASTS = {
    np.uint8: types.uint8,
    np.uint32: types.uint32,
    np.uint64: types.uint64,
    np.int32: types.int32,
    np.int64: types.int64,
    np.float64: types.float64,
    float: types.float64,
    int: types.int64,
    bool: types.boolean,
    np.bool_: types.boolean,
}


class Expressions:
    """
    Translates the expressions of one kernel.

    Parameters
    ----------
    program : Context
        Takes the kernels that it calls, and the constants.
    kernel : function
        The kernel's Python function: where names are looked up.
    real : str
        `double` or `float`.
    """

    def __init__(self, program: Context, kernel: Any, real: str) -> None:
        self.program = program
        self.kernel = kernel
        self.real = real
        self.kinds: dict[str, Kind] = {}
        self.roots: dict[str, str] = {}
        self.places: dict[str, tuple[Any, str] | None] = {}
        self.written: set[str] = set()

    # --- What things are ----------------------------------------------------------------------

    def outside(self, node: ast.expr) -> Any:
        """The Python object that a name from outside the kernel stands for."""
        if isinstance(node, ast.Attribute):
            return getattr(self.outside(node.value), node.attr)
        if not isinstance(node, ast.Name):
            raise self.wrong(node)
        code = self.kernel.__code__
        for name, cell in zip(code.co_freevars, self.kernel.__closure__ or (), strict=True):
            if name == node.id:
                return cell.cell_contents
        if node.id in self.kernel.__globals__:
            return self.kernel.__globals__[node.id]
        return getattr(builtins, node.id)

    def is_local(self, node: ast.expr) -> bool:
        """Whether an expression begins with a name of the kernel."""
        while isinstance(node, (ast.Attribute, ast.Subscript)):
            node = node.value
        return not isinstance(node, ast.Name) or node.id in self.kinds

    def wrong(self, node: ast.AST, why: str = "") -> FirmwareError:
        """The error that this part of the kernel cannot be translated."""
        path = self.kernel.__code__.co_filename
        line = self.kernel.__code__.co_firstlineno + getattr(node, "lineno", 1) - 1
        text = ast.unparse(node).partition("\n")[0]
        return FirmwareError(
            f"kernel '{self.kernel.__name__}' cannot be translated to C: "
            f"'{text}' ({path}, line {line}){': ' + why if why else ''}"
        )

    # --- Expressions --------------------------------------------------------------------------

    def value(self, node: ast.expr) -> Value:
        """Translate an expression."""
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise self.wrong(node)
        value: Value = method(node)
        return value

    def number(self, node: ast.expr) -> Value:
        """Translate an expression that must be a number."""
        value = self.value(node)
        if isinstance(value.kind, (Record, Array)):
            raise self.wrong(node, "a number is expected")
        return value

    def condition(self, node: ast.expr) -> Value:
        """Translate what is true or false; a number is true unless it is 0."""
        value = self.number(node)
        if value.kind == types.boolean:
            return value
        return self._joined(value, "!=", self.constant(0, value.kind), _EQUAL, types.boolean)

    def cast(self, value: Value, kind: Kind) -> Value:
        """The value as another kind of number, as numba converts it."""
        if value.kind == kind or isinstance(kind, (Record, Array)):
            return value
        if isinstance(kind, types.BaseTuple):
            raise FirmwareError(f"{value.code}: a tuple of other numbers is expected")
        if value.number is not None and kind != types.complex128:
            return self.constant(value.number, kind)
        if kind == types.complex128:
            parts = f"{self.cast(value, types.float64).code}, {self.spelt(0.0, types.float64)}"
            return Value(f"{self.helper('complex_of')}({parts})", kind)
        if value.kind == types.complex128:
            raise FirmwareError(f"{value.code}: a real number is expected")
        return Value(f"({self.c(kind)}){self.within(value, _UNARY)}", kind, _UNARY)

    def constant(self, number: Any, kind: Kind) -> Value:
        """A constant of a kind."""
        if kind == types.complex128:
            text = self.spelt(number, kind)
            return Value(f"{self.helper('complex_of')}({text[1:-1]})", kind)
        text = self.spelt(number, kind)
        binds = _UNARY if text[0] in "-(" else PRIMARY
        return Value(text, kind, binds, number, small=is_small(number, kind))

    def spelt(self, number: Any, kind: types.Type) -> str:
        """A constant in this kernel's precision."""
        return spelt(number, kind, self.real)

    def c(self, kind: Kind) -> str:
        """C type of a number or a tuple."""
        if isinstance(kind, types.BaseTuple):
            return self.program.tuple_name(kind, self.real)
        return c_name(kind, self.real)

    def helper(self, name: str) -> str:
        """A function of the prelude, in this kernel's precision."""
        return self.program.helper(name, self.real)

    def within(self, value: Value, binds: int) -> str:
        """The code of a value as an operand, in brackets where it needs them."""
        return value.code if value.binds >= binds else f"({value.code})"

    def _joined(self, left: Value, sign: str, right: Value, binds: int, kind: Kind) -> Value:
        lower = binds
        if sign in ("<<", ">>", "&", "|", "^", "==", "!=", "<", ">", "<=", ">="):
            lower = _PLUS if binds in (_RELATION, _EQUAL) else _UNARY  # nobody knows these by heart
        code = f"{self.within(left, lower)} {sign} {self.within(right, lower + 1)}"
        return Value(code, kind, binds)

    def _name(self, node: ast.Name) -> Value:
        if node.id in self.kinds:
            kind = self.kinds[node.id]
            return Value(
                self.program.local(node.id),
                kind,
                pointer=isinstance(kind, Record),
                root=node.id,
                place=self.places.get(node.id),
            )
        return self._from_outside(node, self.outside(node))

    def _from_outside(self, node: ast.expr, found: Any) -> Value:
        if isinstance(found, (bool, np.bool_)):
            return self.constant(bool(found), types.boolean)
        if isinstance(found, (int, float, np.generic)):
            number = found.item() if isinstance(found, np.generic) else found
            kind = kind_of(np.dtype(type(found)))
            if isinstance(number, float) and not math.isfinite(number):
                return self.constant(number, kind)
            name = self.program.constant(self.kernel, node, number, kind, self.real)
            return Value(name, kind, small=is_small(number, kind))
        if isinstance(found, (np.ndarray, tuple)):
            array = np.asarray(found)
            name = self.program.constant(self.kernel, node, found, array.dtype, self.real)
            return Value(name, Array(kind_of(array.dtype), array.shape))
        raise self.wrong(node, "no number, and nothing that is made of numbers")

    def _constant(self, node: ast.Constant) -> Value:
        number = node.value
        if isinstance(number, bool):
            return self.constant(number, types.boolean)
        for python, kind in (
            (int, types.int64), (float, types.float64), (complex, types.complex128)
        ):  # fmt: skip
            if isinstance(number, python):
                return self.constant(number, kind)
        raise self.wrong(node)

    def _attribute(self, node: ast.Attribute) -> Value:
        if not self.is_local(node):
            return self._from_outside(node, self.outside(node))
        if node.attr == "shape":
            raise self.wrong(node, "only one of its numbers can be used")
        owner = self.value(node.value)
        if isinstance(owner.kind, Record):
            return self._field(node, owner, node.attr)
        if owner.kind == types.complex128 and node.attr in ("real", "imag"):
            part = {"real": "re", "imag": "im"}[node.attr]
            code = f"{self.within(owner, PRIMARY)}.{part}"
            return replace(owner, code=code, kind=types.float64, binds=PRIMARY)
        raise self.wrong(node)

    def _field(self, node: ast.expr, owner: Value, name: str) -> Value:
        if not self.program.structs.has(owner.kind.dtype, name):
            raise self.wrong(node, f"there is no field '{name}'")
        kind = kind_of(owner.kind.dtype[name])
        code = f"{owner.code}{'->' if owner.pointer else '.'}{name}"
        return Value(code, kind, root=owner.root, place=(owner.kind.dtype, name))

    def _subscript(self, node: ast.Subscript) -> Value:
        shaped = node.value
        if isinstance(shaped, ast.Attribute) and shaped.attr == "shape":
            array, axis = self.value(shaped.value), ast.literal_eval(node.slice)
            return self.constant(array.kind.shape[axis], types.int64)
        owner = self.value(shaped)
        if isinstance(owner.kind, Record) and isinstance(node.slice, ast.Constant):
            return self._field(node, owner, str(node.slice.value))
        if isinstance(owner.kind, types.BaseTuple):
            position = ast.literal_eval(node.slice)
            return Value(f"{owner.code}.v{position}", owner.kind.types[position])
        if not isinstance(owner.kind, Array):
            raise self.wrong(node)
        indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if len(indices) != len(owner.kind.shape):
            raise self.wrong(node, "a part of an array")
        texts = []
        for index in indices:
            value = self.number(index)
            if not isinstance(value.kind, types.Integer):
                raise self.wrong(node, "an index that is no whole number")
            texts.append(f"[{value.code}]")
        return replace(owner, code=owner.code + "".join(texts), kind=owner.kind.element)

    def _tuple(self, node: ast.Tuple) -> Value:
        values = [self.number(item) for item in node.elts]
        kind = types.Tuple([value.kind for value in values])
        name = self.c(kind)
        return Value(f"({name}){{{', '.join(value.code for value in values)}}}", kind)

    def _unaryop(self, node: ast.UnaryOp) -> Value:
        if isinstance(node.op, ast.Not):
            inner = self.condition(node.operand)
            return Value(f"!{self.within(inner, _UNARY)}", types.boolean, _UNARY)
        if not isinstance(node.op, ast.USub):
            raise self.wrong(node)
        inner = self.number(node.operand)
        if inner.number is not None:
            return self.constant(-inner.number, inner.kind)
        if inner.kind == types.complex128:
            return Value(f"{self.helper('complex_neg')}({inner.code})", inner.kind)
        kind, (wanted,) = resolved(operator.neg, [inner.kind])
        code = self.within(self.cast(inner, wanted), _UNARY)
        return Value(f"-({code})" if code.startswith("-") else f"-{code}", kind, _UNARY)

    def _binop(self, node: ast.BinOp) -> Value:
        return self.binary(node, self.number(node.left), node.op, self.number(node.right))

    def binary(self, node: ast.AST, left: Value, op: ast.operator, right: Value) -> Value:
        """One value, an operator, and another."""
        function, sign, binds = _BINARY[type(op)]
        if sign == "**":
            return self._power(node, left, right)
        kind, wanted = resolved(function, [left.kind, right.kind])
        left, right = (self.cast(v, k) for v, k in zip((left, right), wanted, strict=True))
        if kind == types.complex128:
            if sign not in _COMPLEX:
                raise self.wrong(node)
            name = self.helper(f"complex_{_COMPLEX[sign]}")
            return Value(f"{name}({left.code}, {right.code})", kind)
        if sign in ("//", "%"):
            whole = "int" if isinstance(kind, types.Integer) else "real"
            if (sign == "//" and whole == "real") or kind not in (types.int64, types.float64):
                raise self.wrong(node)
            name = self.helper(f"{whole}_{'quotient' if sign == '//' else 'remainder'}")
            return Value(f"{name}({left.code}, {right.code})", kind)
        if sign in ("<<", ">>") and left.number is not None:
            left = Value(f"({self.c(left.kind)}){left.code}", left.kind, _UNARY)
        return self._joined(left, sign, right, binds, kind)

    def _power(self, node: ast.AST, base: Value, exponent: Value) -> Value:
        if exponent.number != 2 or base.kind != types.float64:
            raise self.wrong(node, "only squares")
        return Value(f"{self.helper('real_square')}({base.code})", types.float64)

    def _compare(self, node: ast.Compare) -> Value:
        if len(node.ops) != 1:
            parts, before = [], node.left
            for op, after in zip(node.ops, node.comparators, strict=True):
                parts.append(ast.Compare(left=before, ops=[op], comparators=[after]))
                before = after
            return self._boolop(ast.BoolOp(op=ast.And(), values=list(parts)))
        op = node.ops[0]
        if isinstance(op, ast.In):
            return self._member(node)
        if type(op) not in _COMPARE:
            raise self.wrong(node)
        function, sign, binds = _COMPARE[type(op)]
        left, right = self.number(node.left), self.number(node.comparators[0])
        _, wanted = resolved(function, [left.kind, right.kind])
        if len(set(wanted)) > 1:
            # of two integers, one without a sign: a constant takes the other's type
            if left.number is None and right.number is None:
                raise self.wrong(node, "integers with and without a sign are compared")
            kind = right.kind if left.number is not None else left.kind
            wanted = (kind, kind)
        left, right = (self.cast(v, k) for v, k in zip((left, right), wanted, strict=True))
        if wanted[0] == types.complex128:
            raise self.wrong(node, "complex numbers are compared")
        return self._joined(left, sign, right, binds, types.boolean)

    def _member(self, node: ast.Compare) -> Value:
        among = node.comparators[0]
        written_out = isinstance(among, ast.Tuple)
        options = ast.literal_eval(among) if written_out else self.outside(among)
        value = self.number(node.left)
        parts = [
            self._joined(value, "==", self.constant(o, value.kind), _EQUAL, types.boolean).code
            for o in options
        ]
        return Value(" || ".join(parts), types.boolean, _OR)

    def _boolop(self, node: ast.BoolOp) -> Value:
        sign, binds = ("&&", _AND) if isinstance(node.op, ast.And) else ("||", _OR)
        parts = []
        for item in node.values:
            value = self.number(item)
            if value.kind != types.boolean:
                raise self.wrong(node, "numbers where true or false is expected")
            parts.append(self.within(value, _BITS))
        return Value(f" {sign} ".join(parts), types.boolean, binds)

    def _ifexp(self, node: ast.IfExp) -> Value:
        test, one, other = (
            self.condition(node.test),
            self.number(node.body),
            self.number(node.orelse),
        )
        kind = unified([one.kind, other.kind])
        texts = [self.within(self.cast(each, kind), _OR) for each in (one, other)]
        return Value(f"{self.within(test, _OR)} ? {texts[0]} : {texts[1]}", kind, _CONDITION)

    # --- Calls --------------------------------------------------------------------------------

    def _call(self, node: ast.Call) -> Value:
        if node.keywords:
            raise self.wrong(node, "arguments by name")
        function = node.func
        if isinstance(function, ast.Attribute) and self.is_local(function):
            owner = self.number(function.value)
            if function.attr == "conjugate" and owner.kind == types.complex128:
                name = self.helper("complex_conj")
                return Value(f"{name}({owner.code})", types.complex128)
            raise self.wrong(node)
        called = self.outside(function)
        called = self.program.stand_ins.get(called, called)
        if isinstance(called, Dispatcher):
            return self._kernel(node, called.py_func)
        arguments = [self.number(argument) for argument in node.args]
        if called in _CASTS:
            return self._converted(node, arguments[0], _CASTS[called])
        return self._library(node, called, arguments)

    def _converted(self, node: ast.Call, value: Value, kind: types.Type) -> Value:
        if kind == types.boolean:
            return self.condition(node.args[0])
        if value.kind == types.complex128:
            raise self.wrong(node)
        return self.cast(value, kind)

    def _library(self, node: ast.Call, called: Any, arguments: list[Value]) -> Value:
        suffix = "f" if self.real == "float" else ""
        reals = [
            self.cast(a, types.float64) if a.kind != types.complex128 else a for a in arguments
        ]
        codes = ", ".join(value.code for value in reals)
        first = arguments[0].kind if arguments else None
        name = getattr(called, "__name__", "")
        if called is complex:
            return Value(f"{self.helper('complex_of')}({codes})", types.complex128)
        if called in (min, max) and len(arguments) == 2:
            kind = unified([value.kind for value in arguments])
            if kind != types.float64:
                raise self.wrong(node, "of whole numbers")
            return Value(f"{self.helper(f'real_{name}')}({codes})", kind)
        if called is abs and first == types.complex128:
            return Value(f"{self.helper('complex_abs')}({codes})", types.float64)
        if called is abs and first == types.float64:
            return Value(f"fabs{suffix}({codes})", types.float64)
        if called is round and len(arguments) == 1:
            return Value(f"(int64_t)rint{suffix}({codes})", types.int64, _UNARY)
        if called is math.ldexp:
            exponent = self.cast(arguments[1], types.int32).code
            return Value(f"ldexp{suffix}({reals[0].code}, {exponent})", types.float64)
        if called is math.frexp:
            kind = types.Tuple([types.float64, types.int32])
            self.c(kind)
            return Value(f"{self.helper('real_frexp')}({codes})", kind)
        if getattr(math, name, None) is called and name in _MATH:
            kind, _ = resolved(called, [types.float64] * len(reals))
            text = f"{name}{suffix}({codes})"
            if kind == types.int64:
                return Value(f"(int64_t){text}", kind, _UNARY)
            return Value(text, types.float64)
        raise self.wrong(node)

    def _kernel(self, node: ast.Call, function: Any) -> Value:
        values = [self.value(argument) for argument in node.args]
        translated = self.program.function(function, [value.kind for value in values])
        texts = []
        for value, parameter in zip(values, translated.parameters, strict=True):
            if parameter in translated.written:
                self.wrote(value.root)
            address = isinstance(value.kind, Record) and not value.pointer
            texts.append(f"&{value.code}" if address else value.code)
        return Value(f"{translated.name}({', '.join(texts)})", translated.result)

    def wrote(self, root: str) -> None:
        """Note that what a name stands for is changed, and what that is a part of."""
        while root not in self.written:
            self.written.add(root)
            if root not in self.roots:
                return
            root = self.roots[root]

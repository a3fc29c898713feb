"""Kernels as functions in C: their statements, variables and comments."""

from __future__ import annotations

import ast
import inspect
import io
import textwrap
import tokenize
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from numba import types

from mfpcc_controller.firmware import FirmwareError
from mfpcc_experiments.firmware.context import Context, Function
from mfpcc_experiments.firmware.expressions import Expressions
from mfpcc_experiments.firmware.layout import Array, Kind, Record
from mfpcc_experiments.firmware.values import PRIMARY, Value, unified

_WIDTH = 100
_INDENT = "    "

#: A block of statements, by the way to it: the numbers of the blocks it stands in.
_Way = tuple[int, ...]


def source_of(kernel: Any) -> tuple[ast.FunctionDef, dict[int, str]]:
    """A kernel's source as a tree, and its comments by line; those of empty lines are empty."""
    text = getattr(kernel, "__source__", None)
    if text is None:
        try:
            text = textwrap.dedent(inspect.getsource(kernel))
        except OSError:
            raise FirmwareError(
                f"kernel '{kernel.__name__}' has no source that could be read "
                f"({kernel.__code__.co_filename})"
            ) from None
    tree = ast.parse(text).body[0]
    if not isinstance(tree, ast.FunctionDef):
        raise FirmwareError(f"kernel '{kernel.__name__}' is no plain function")
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type == tokenize.COMMENT
    }
    empty = {n: "" for n, line in enumerate(text.splitlines(), 1) if not line.strip()}
    return tree, comments | empty


def comment(text: str, indent: str = "") -> str:
    """A text as a comment of C."""
    lines = inspect.cleandoc(text).replace("*/", "* /").replace("/*", "/ *").splitlines()
    if len(lines) == 1 and len(indent) + len(lines[0]) + 6 <= _WIDTH:
        return f"{indent}/* {lines[0]} */"
    inner = [f"{indent} * {line}".rstrip() for line in lines]
    return "\n".join([f"{indent}/*", *inner, f"{indent} */"])


def wrapped(line: str) -> Iterator[str]:
    """A line of C, broken where it is too long."""
    indent = line[: len(line) - len(line.lstrip())]
    while len(line) > _WIDTH:
        at = line.rfind(" ", len(indent) + len(_INDENT) + 1, _WIDTH)
        if at < 0:
            break
        yield line[:at]
        line = f"{indent}{_INDENT}{line[at + 1 :]}"
    yield line


class Translator(Expressions):
    """
    Translates one kernel for arguments of given kinds.

    Parameters
    ----------
    program : Context
    kernel : function
        Its Python function.
    name : str
        In C.
    kinds : sequence
        Of its arguments.
    real : str
        `double` or `float`.
    """

    def __init__(
        self, program: Context, kernel: Any, name: str, kinds: Sequence[Kind], real: str
    ) -> None:
        super().__init__(program, kernel, real)
        self.name = name
        self.tree, self.comments = source_of(kernel)
        self.body = program.pruned(self.tree.body)
        self.doc = ast.get_docstring(self.tree) or ""
        if self.doc:
            self.body = self.body[1:]
        self.parameters = tuple(argument.arg for argument in self.tree.args.args)
        self.kinds.update(zip(self.parameters, kinds, strict=True))
        self.returned: list[Kind] = []
        self._temporaries = 0

    def translate(self) -> tuple[Function, str]:
        """The function, and its text in C."""
        for _ in range(4):
            before = dict(self.kinds)
            self.returned = []
            self._infer(self.body)
            if self.kinds == before:
                break
        result = unified(self.returned) if self.returned else types.none
        if isinstance(result, (Record, Array)):
            raise self.wrong(self.tree, "it gives a record or an array")
        function = Function(
            self.name,
            self.parameters,
            frozenset(self.written & set(self.parameters)),
            result,
        )
        self.result = result
        self._find_homes()
        lines: list[str] = []
        first = self.tree.body[0]
        self._told = (first.end_lineno or 0) if self.doc else first.lineno - 1
        for parameter in self.parameters:
            if parameter not in self._loaded:
                lines.append(f"{_INDENT}(void){self.program.local(parameter)};")
        self._block(self.body, (), _INDENT, lines)
        text = "\n".join(
            [
                *([comment(self.doc)] if self.doc else []),
                *wrapped(f"static {self.c(result)} {self.name}({self._signature()})"),
                "{",
                *lines,
                "}",
            ]
        )
        return function, text

    # --- Kinds --------------------------------------------------------------------------------

    def _infer(self, body: Sequence[ast.stmt]) -> None:
        for node in body:
            if isinstance(node, ast.Assign):
                self._infer_assign(node)
            elif isinstance(node, ast.AugAssign):
                self._store(node.target, self.augmented(node))
            elif isinstance(node, ast.If):
                self.condition(node.test)
                self._infer(node.body)
                self._infer(node.orelse)
            elif isinstance(node, ast.For):
                assert isinstance(node.target, ast.Name)
                self.kinds[node.target.id] = types.int64
                self._infer(node.body)
            elif isinstance(node, ast.While):
                self.condition(node.test)
                self._infer(node.body)
            elif isinstance(node, ast.Return):
                self.returned.append(
                    types.none if node.value is None else self.value(node.value).kind
                )
            elif isinstance(node, ast.Expr):
                self.value(node.value)
            elif not isinstance(node, (ast.Pass, ast.Break, ast.Continue)):
                raise self.wrong(node)

    def _infer_assign(self, node: ast.Assign) -> None:
        if len(node.targets) != 1:
            raise self.wrong(node)
        target = node.targets[0]
        if not isinstance(target, ast.Tuple):
            self._store(target, self.value(node.value))
        elif isinstance(node.value, ast.Tuple):
            values = [self.value(item) for item in node.value.elts]
            for item, value in zip(target.elts, values, strict=True):
                self._store(item, value)
        else:
            kind = self.value(node.value).kind
            if not isinstance(kind, types.BaseTuple) or len(kind.types) != len(target.elts):
                raise self.wrong(node)
            for item, each in zip(target.elts, kind.types, strict=True):
                self._store(item, Value("", each))

    def _store(self, target: ast.expr, value: Value) -> None:
        """Note what a target is given."""
        if isinstance(target, ast.Name):
            known = self.kinds.get(target.id)
            try:
                self.kinds[target.id] = unified(
                    [value.kind] if known is None else [known, value.kind]
                )
            except FirmwareError as error:
                raise self.wrong(target, str(error)) from None
            if isinstance(value.kind, (Record, Array)):
                self.roots[target.id] = value.root
                self.places[target.id] = value.place
                if target.id in self.written:
                    self.wrote(value.root)
            elif target.id in self.parameters:
                pass  # a copy of the caller's
            return
        self.wrote(self.value(target).root)

    def augmented(self, node: ast.AugAssign) -> Value:
        """The new value of what is changed by an operator."""
        return self.binary(node, self.number(node.target), node.op, self.number(node.value))

    # --- Where variables live -----------------------------------------------------------------

    def _find_homes(self) -> None:
        """Find the innermost block that holds all there is of each variable."""
        self._homes: dict[str, _Way] = {}
        self._stores: Counter[str] = Counter()
        self._loaded: set[str] = set()
        self._numbers: dict[int, int] = {}
        self._walk(self.body, (), frozenset())
        self._declared: set[str] = set(self.parameters)

    def _walk(self, body: Sequence[ast.stmt], way: _Way, loops: frozenset[str]) -> None:
        for node in body:
            inner = loops
            if isinstance(node, ast.For):
                assert isinstance(node.target, ast.Name)
                inner = loops | {node.target.id}
                self._see(node.iter, way, loops)
            for part in (getattr(node, name, None) for name in ("test", "value", "target")):
                if part is not None and not isinstance(node, ast.For):
                    self._see(part, way, loops)
            for part in getattr(node, "targets", ()):
                self._see(part, way, loops)
            for block in _blocks(node):
                number = self._numbers.setdefault(id(block), len(self._numbers))
                self._walk(block, (*way, number), inner)

    def _see(self, node: ast.expr, way: _Way, loops: frozenset[str]) -> None:
        for name in ast.walk(node):
            if not isinstance(name, ast.Name) or name.id not in self.kinds:
                continue
            if name.id not in loops:
                home = self._homes.get(name.id, way)
                common = 0
                while common < min(len(home), len(way)) and home[common] == way[common]:
                    common += 1
                self._homes[name.id] = home[:common]
            if isinstance(name.ctx, ast.Store):
                self._stores[name.id] += 1
            else:
                self._loaded.add(name.id)

    # --- Statements ---------------------------------------------------------------------------

    def _block(self, body: Sequence[ast.stmt], way: _Way, indent: str, lines: list[str]) -> None:
        for node in body:
            self._notes(node, indent, lines)
            self._declare(node, way, indent, lines)
            for line in self._statement(node, way, indent):
                lines.extend(wrapped(line) if "/*" not in line else [line])

    def _notes(self, node: ast.stmt, indent: str, lines: list[str]) -> None:
        """The comments above a statement, and on its lines."""
        last = node.lineno if _blocks(node) else node.end_lineno or node.lineno
        for line in range(self._told + 1, last + 1):
            if line in self.comments:
                text = self.comments[line]
                lines.append(comment(text, indent) if text else "")
        self._told = max(self._told, last)

    def _declare(self, node: ast.stmt, way: _Way, indent: str, lines: list[str]) -> None:
        """Declare what lives in this block, appears here first, and is not simply given a value."""
        given = set()
        if isinstance(node, ast.Assign):
            target = node.targets[0]
            items = target.elts if isinstance(target, ast.Tuple) else [target]
            read = {n.id for n in ast.walk(node.value) if isinstance(n, ast.Name)}
            given = {item.id for item in items if isinstance(item, ast.Name)} - read
        for name in dict.fromkeys(n.id for n in ast.walk(node) if isinstance(n, ast.Name)):
            here = self._homes.get(name) == way and name not in self._declared
            if here and name not in given:
                self._declared.add(name)
                lines.append(f"{indent}{self._variable(name, fixed=False)};")

    def _variable(self, name: str, *, fixed: bool) -> str:
        """The declaration of a variable or a parameter."""
        kind, text = self.kinds[name], self.program.local(name)
        const = "" if name in self.written else "const "
        if isinstance(kind, Record):
            return f"{const}{self.program.structs.name(kind.dtype)} *{text}"
        if isinstance(kind, Array):
            if len(kind.shape) == 1:
                return f"{const}{self.c(kind.element)} *{text}"
            bounds = "".join(f"[{n}]" for n in kind.shape[1:])
            return f"{self.c(kind.element)} (*{text}){bounds}"
        return f"{'const ' if fixed else ''}{self.c(kind)} {text}"

    def _signature(self) -> str:
        return ", ".join(self._variable(name, fixed=False) for name in self.parameters) or "void"

    def _statement(self, node: ast.stmt, way: _Way, indent: str) -> Iterator[str]:
        if isinstance(node, ast.Assign):
            yield from self._assign(node, indent)
        elif isinstance(node, ast.AugAssign):
            yield self._augmented(node, indent)
        elif isinstance(node, ast.If):
            yield from self._if(node, way, indent)
        elif isinstance(node, ast.For):
            yield from self._for(node, way, indent)
        elif isinstance(node, ast.While):
            yield f"{indent}while ({self.condition(node.test).code}) {{"
            yield from self._inner(node.body, way, indent)
            yield f"{indent}}}"
        elif isinstance(node, ast.Return):
            yield from self._return(node, indent)
        elif isinstance(node, ast.Expr):
            yield f"{indent}{self.value(node.value).code};"
        elif isinstance(node, (ast.Break, ast.Continue)):
            yield f"{indent}{type(node).__name__.lower()};"

    def _inner(self, body: Sequence[ast.stmt], way: _Way, indent: str) -> list[str]:
        lines: list[str] = []
        self._block(body, (*way, self._numbers[id(body)]), indent + _INDENT, lines)
        return lines

    def _if(self, node: ast.If, way: _Way, indent: str, head: str = "if") -> Iterator[str]:
        yield f"{indent}{head} ({self.condition(node.test).code}) {{"
        yield from self._inner(node.body, way, indent)
        if not node.orelse:
            yield f"{indent}}}"
        elif self._chained(node):
            other = node.orelse[0]
            assert isinstance(other, ast.If)
            # its block is passed through, so that what lives in it is counted there
            way = (*way, self._numbers[id(node.orelse)])
            yield from self._if(other, way, indent, "} else if")
        else:
            yield f"{indent}}} else {{"
            yield from self._inner(node.orelse, way, indent)
            yield f"{indent}}}"

    def _chained(self, node: ast.If) -> bool:
        """Whether what follows `else` is one `if`, before which nothing has to be declared."""
        other = node.orelse[0]
        if len(node.orelse) != 1 or not isinstance(other, ast.If):
            return False
        number = self._numbers[id(node.orelse)]
        return not any(home[-1:] == (number,) for home in self._homes.values())

    def _for(self, node: ast.For, way: _Way, indent: str) -> Iterator[str]:
        call, target = node.iter, node.target
        assert isinstance(target, ast.Name)
        if not (
            isinstance(call, ast.Call) and self.outside(call.func) is range and not node.orelse
        ):
            raise self.wrong(node, "only loops over 'range'")
        bounds = [self.cast(self.number(item), types.int64) for item in call.args]
        if len(bounds) > 2:
            raise self.wrong(node, "a range with a step")
        changed = {
            n.id for s in node.body for n in ast.walk(s)
            if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
        }  # fmt: skip
        if changed & {n.id for n in ast.walk(call) if isinstance(n, ast.Name)}:
            raise self.wrong(node, "the loop changes its own range")
        begin = self._counter(bounds[0]) if len(bounds) == 2 else "0"
        name, end = self.program.local(target.id), self._counter(bounds[-1])
        # of 32 bits: twice as fast on a processor of 32 bits
        yield f"{indent}for (int32_t {name} = {begin}; {name} < {end}; ++{name}) {{"
        yield from self._inner(node.body, way, indent)
        yield f"{indent}}}"

    def _counter(self, bound: Value) -> str:
        """A bound of a loop, as its counter."""
        return bound.code if bound.small else f"(int32_t){self.within(bound, PRIMARY - 1)}"

    def _return(self, node: ast.Return, indent: str) -> Iterator[str]:
        if node.value is None:
            yield f"{indent}return;"
            return
        if isinstance(node.value, ast.Tuple):
            values = zip(node.value.elts, self.result.types, strict=True)
            texts = [self.cast(self.number(item), kind).code for item, kind in values]
            yield f"{indent}return ({self.c(self.result)}){{{', '.join(texts)}}};"
            return
        yield f"{indent}return {self.cast(self.value(node.value), self.result).code};"

    # --- Assignments --------------------------------------------------------------------------

    def _assign(self, node: ast.Assign, indent: str) -> Iterator[str]:
        target = node.targets[0]
        if not isinstance(target, ast.Tuple):
            yield self._give(target, self.value(node.value), indent)
        elif isinstance(node.value, ast.Tuple):
            yield from self._give_several(target.elts, node.value.elts, indent)
        else:
            value = self.value(node.value)
            name = self._temporary()
            yield f"{indent}const {self.c(value.kind)} {name} = {value.code};"
            for position, (item, kind) in enumerate(
                zip(target.elts, value.kind.types, strict=True)
            ):
                yield self._give(item, Value(f"{name}.v{position}", kind), indent)

    def _give_several(
        self, targets: Sequence[ast.expr], nodes: Sequence[ast.expr], indent: str
    ) -> Iterator[str]:
        """Give values to several targets at once: none may see another's new value."""
        values = [self.value(item) for item in nodes]
        pairs = list(zip(targets, nodes, strict=True))
        if any(
            self._touches(target, later)
            for position, (target, _) in enumerate(pairs)
            for _, later in pairs[position + 1 :]
        ):
            kept = []
            for value in values:
                name = self._temporary()
                yield f"{indent}const {self.c(value.kind)} {name} = {value.code};"
                kept.append(Value(name, value.kind))
            values = kept
        for target, value in zip(targets, values, strict=True):
            yield self._give(target, value, indent)

    def _touches(self, target: ast.expr, node: ast.expr) -> bool:
        """Whether an expression may read what a target is."""
        if isinstance(target, ast.Name):
            return any(isinstance(n, ast.Name) and n.id == target.id for n in ast.walk(node))
        into = self.value(target)
        for part in ast.walk(node):
            if isinstance(part, ast.Call):
                return True
            if isinstance(part, (ast.Attribute, ast.Subscript)) and self._in_memory(part):
                read = self.value(part)
                if isinstance(read.kind, (Record, Array)) or read.kind != into.kind:
                    continue
                if read.place is None or into.place is None or read.place == into.place:
                    return True
        return False

    def _in_memory(self, node: ast.expr) -> bool:
        """Whether an expression reads a record or an array, and no variable."""
        while isinstance(node, (ast.Attribute, ast.Subscript)):
            node = node.value
        return isinstance(node, ast.Name) and isinstance(self.kinds.get(node.id), (Record, Array))

    def _give(self, target: ast.expr, value: Value, indent: str) -> str:
        if isinstance(target, ast.Name):
            name = target.id
            kind = self.kinds[name]
            text = value.code
            if isinstance(kind, Record):
                text = text if value.pointer else f"&{text}"
            elif not isinstance(kind, Array):
                text = self.cast(value, kind).code
            if name in self._declared:
                return f"{indent}{self.program.local(name)} = {text};"
            self._declared.add(name)
            if isinstance(kind, types.BaseTuple):
                text = text.removeprefix(f"({self.c(kind)})")
            return f"{indent}{self._variable(name, fixed=self._stores[name] == 1)} = {text};"
        into = self.value(target)
        return f"{indent}{into.code} = {self.cast(value, into.kind).code};"

    def _augmented(self, node: ast.AugAssign, indent: str) -> str:
        into = self.number(node.target)
        new = self.augmented(node)
        head = f"{into.code} "
        same = new.kind == into.kind and new.code.startswith(head) and into.kind == types.float64
        if same:
            sign, _, rest = new.code.removeprefix(head).partition(" ")
            right = self.number(node.value)
            if rest in (right.code, f"({right.code})"):
                return f"{indent}{into.code} {sign}= {right.code};"
        return f"{indent}{into.code} = {self.cast(new, into.kind).code};"

    def _temporary(self) -> str:
        self._temporaries += 1
        return f"found_{self._temporaries}"


def _blocks(node: ast.stmt) -> list[list[ast.stmt]]:
    """The blocks that a statement holds."""
    return [block for name in ("body", "orelse") if (block := getattr(node, name, None))]

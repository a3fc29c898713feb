"""Which cases of the fault matrix need which check of the protection: with it removed, they fail.

The kernels of the protection are compiled from their source with every check made removable: it is
not done where a field of the records holds its number. So one compilation serves for all of them,
and the product itself has no such switch. A check that has nothing to say in a case cannot change
it, so each is removed only in the cases in which it has spoken.

This runs as a process of its own, since it compiles other kernels under the product's names:
`mfpcc faults --needed` starts it and shows what it finds.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import sys
import types
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pwm_node.errors import ForPeople

#: Where the checks are: modules, and the node that each belongs to.
MODULES = {
    "mfpcc_controller.protection": "controller",
    "pmsm_sim.parts.protection": "inverter",
    "pmsm_sim.parts.inverter": "inverter",
}

# Of each node the module whose records tell what is removed.
_WITH_RECORDS = {
    "controller": "mfpcc_controller.protection",
    "inverter": "pmsm_sim.parts.protection",
}

# Functions whose single conditions are checks. Where one holds it lets something pass, or keeps it.
_PASS = {"plausible"}
_KEEP = {"stale", "released"}
# What latches has no conditions of its own; how long a step may take is measured by the node.
_NO_CHECKS = {"trip", "report", "overran"}
# Conditions that keep the gates off, in the statement that decides on them.
_GATES = "st.gates_on"

_HELPERS = """
@kernel
def _check_passes(record, ok, number):
    if not ok:
        record.spoken |= np.uint64(1) << np.uint64(number)
    return ok or record.removed == number


@kernel
def _check_keeps(record, holds, number):
    if holds:
        record.spoken |= np.uint64(1) << np.uint64(number)
    return holds and record.removed != number
"""


@dataclass(frozen=True)
class Check:
    """One check: its number, the node that makes it, and what it is for people."""

    number: int
    node: str
    what: str


# --- Making checks removable ----------------------------------------------------------------------


class _Removable(ast.NodeTransformer):
    """Gives every check of a module its number, and a condition that it is not removed."""

    def __init__(self, node: str, checks: list[Check]) -> None:
        self.node, self.checks = node, checks
        self._function = ""
        self._record = ""

    def _new(self, what: str) -> int:
        for check in self.checks:
            if (check.node, check.what) == (self.node, what):
                return check.number
        self.checks.append(Check(len(self.checks), self.node, what))
        return self.checks[-1].number

    def visit_FunctionDef(self, function: ast.FunctionDef) -> ast.AST:
        if function.name in _NO_CHECKS or not function.args.args:
            return function
        self._function = function.name
        first = function.args.args[0].arg
        self._record = "mem.guard" if function.name == "stale" else first
        self.generic_visit(function)
        return function

    def visit_Expr(self, statement: ast.Expr) -> ast.AST | list[ast.stmt]:
        """A fault that is latched: what comes of it does not, where it is removed."""
        call = statement.value
        if not (isinstance(call, ast.Call) and ast.unparse(call.func) in ("trip", "report")):
            return statement
        code, value = map(ast.unparse, call.args[-2:])
        several = {"ENCODER": " (step)" if value == "turned" else " (frozen)"}
        number = self._new(code + several.get(code, ""))
        record = self._record
        removed = ast.unparse(call.func) == "report"
        lines = [f"{record}.spoken |= np.uint64(1) << np.uint64({number})"]
        if removed:
            lines += [f"if {record}.removed == {number}: return False", ast.unparse(statement)]
        else:
            lines += [f"if {record}.removed != {number}: {ast.unparse(statement)}"]
        return ast.parse("\n".join(lines)).body

    def visit_Compare(self, compare: ast.Compare) -> ast.AST:
        if self._function in _PASS:
            return self._asked("_check_passes", compare)
        return compare

    def visit_BoolOp(self, operation: ast.BoolOp) -> ast.AST:
        if self._function == "stale":
            return self._asked("_check_keeps", operation, "samples that are not newer")
        return self.generic_visit(operation)

    def visit_Attribute(self, attribute: ast.Attribute) -> ast.AST:
        name = ast.unparse(attribute)
        kept = {
            "guard.latch.tripped": "gates off after a trip",
            "guard.awaits_zero": "gates off until the reference was at zero",
        }
        if self._function == "released" and isinstance(attribute.ctx, ast.Load) and name in kept:
            return self._asked("_check_keeps", attribute, kept[name])
        return attribute

    def visit_Assign(self, assign: ast.Assign) -> ast.AST:
        if ast.unparse(assign.targets[0]) != _GATES:
            return self.generic_visit(assign)
        kept = {
            "st.latch.tripped": "gates off after a trip",
            "st.awaits_off": "gates off until a command had them off",
        }
        for operation in ast.walk(assign.value):
            if isinstance(operation, ast.BoolOp) and isinstance(operation.op, ast.Or):
                operation.values = [
                    self._asked("_check_keeps", value, kept[ast.unparse(value)])
                    if ast.unparse(value) in kept
                    else value
                    for value in operation.values
                ]
        return assign

    def _asked(self, helper: str, condition: ast.expr, what: str = "") -> ast.expr:
        number = self._new(what or f"sample: {ast.unparse(condition)}")
        call = ast.parse(f"{helper}({self._record}, 0, {number})", mode="eval").body
        assert isinstance(call, ast.Call)
        call.args[1] = condition
        return call


def removable(name: str, source: str, checks: list[Check]) -> ast.Module:
    """The module with all of its checks removable; they are added to `checks`."""
    tree, node = ast.parse(source), MODULES[name]
    new = ast.fix_missing_locations(_Removable(node, checks).visit(tree))
    # behind the imports, before the first function
    first = next(n for n, part in enumerate(new.body) if isinstance(part, ast.FunctionDef))
    new.body[first:first] = ast.parse(_HELPERS).body
    for part in new.body:
        target = getattr(part, "targets", [getattr(part, "target", None)])[0]
        if target is not None and _WITH_RECORDS[node] == name:
            _add_fields(part, ast.unparse(target))
    return ast.fix_missing_locations(new)


def _add_fields(assign: Any, name: str) -> None:
    """Room in the records for the number that is removed, and for those that have spoken."""
    fields = ast.parse('[("removed", np.int64), ("spoken", np.uint64)]', mode="eval").body.elts  # type: ignore[attr-defined]
    if name in ("CFG_FIELDS", "PAR"):
        assign.value.elts += fields
    elif name == "MEMORY":
        assign.value.args[0].elts += fields


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Has the modules of the protection imported with removable checks."""

    def __init__(self) -> None:
        self.checks: list[Check] = []

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: types.ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if name not in MODULES:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path)
        assert spec is not None and spec.origin is not None
        return importlib.util.spec_from_file_location(name, spec.origin, loader=_Loader(self))


class _Loader(importlib.abc.Loader):
    def __init__(self, finder: _Finder) -> None:
        self._finder = finder

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> None:
        return None

    def exec_module(self, module: types.ModuleType) -> None:
        assert module.__file__ is not None
        source = Path(module.__file__).read_text(encoding="utf-8")
        tree = removable(module.__name__, source, self._finder.checks)
        exec(compile(tree, module.__file__, "exec"), vars(module))


# --- Asking ---------------------------------------------------------------------------------------


def main() -> int:
    """Tell, one line of JSON each: how far it is, each check with the cases that need it."""
    finder = _Finder()
    sys.meta_path.insert(0, finder)
    # kernels are kept by a digest of their file, in which nothing of this can be seen
    from pwm_node.compiled import cache_folder

    own = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:16]
    os.environ["MFPCC_CACHE"] = str(cache_folder().parent / f"removable-{own}")

    from mfpcc_experiments.proofs import fault_cases, faults
    from mfpcc_experiments.running import Engine

    removed, spoken = -1, 0

    def run(plant: dict[str, Any], controller: dict[str, Any]) -> Any:
        nonlocal spoken
        engine = Engine(plant, controller)
        records = (engine.plant.par, engine.controller.cfg, engine.controller.mem["guard"])
        for record in records:
            record["removed"] = removed
        result = faults.run_engine(engine, plant["periods"])
        for record in records:
            spoken |= int(record["spoken"][0])
        return result

    def verdict(case: fault_cases.Case) -> faults.Verdict:
        nonlocal spoken
        spoken = 0
        return next(iter(faults.judged([case], run, True, lambda n: None)))

    cases = fault_cases.cases()
    needing: dict[int, list[str]] = {}
    for n, case in enumerate(cases, start=1):
        removed = -1
        if not verdict(case).survived:
            _tell({"fails": f"{case.unit} {case.kind_of_fault} {case.point}"})
            return 1
        heard = spoken
        for check in finder.checks:
            if not heard >> check.number & 1:
                continue
            removed = check.number
            if not verdict(case).survived:
                needing.setdefault(removed, []).append(
                    f"{case.unit} {case.kind_of_fault}, {case.point}"
                )
        _tell({"done": n, "of": len(cases)})
    for check in finder.checks:
        found = needing.get(check.number, [])
        _tell({"node": check.node, "check": check.what, "cases": found})
    return 0


def _tell(what: dict[str, Any]) -> None:
    print(json.dumps(what), flush=True)


class NeededError(ForPeople, RuntimeError):
    """The checks could not be gone through to the end."""


def ask() -> Iterator[dict[str, Any]]:
    """
    What `main` tells, from a process of its own.

    Raises
    ------
    NeededError
        If it ends without having told all.
    """
    import subprocess

    command = [sys.executable, "-m", __name__]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                told = json.loads(line)
                if "error" in told:
                    raise NeededError(told["error"])
                yield told
            if code := process.wait():
                raise NeededError(f"the process that takes checks out ended with exit code {code}")
        finally:
            process.terminate()


if __name__ == "__main__":
    try:
        sys.exit(main())
    except ForPeople as error:
        _tell({"error": str(error)})
        sys.exit(1)

"""Mutation testing of the numeric core: `make mutants`.

Each mutant is one small change of a source file (a comparison the other way round, a sign, a
number, a branch), made by the operators of cosmic-ray. It is killed if a test of those that belong
to the file fails. What survives is listed with its line: either a test is missing, or the change
has no effect.

    mutants.py [--jobs N] [--sample N] [--count] [FILE ...]

Kernels run in plain Python (NUMBA_DISABLE_JIT), since each mutant would have to be compiled. No
file is changed: the tests are collected once, and for each mutant a process forks, changes the code
of the functions where they stand, and runs the tests.
Needs the workspace to be sourced, and the packages of requirements/dev.txt.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import functools
import io
import multiprocessing
import os
import random
import signal
import sys
import time
import types
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

os.environ["NUMBA_DISABLE_JIT"] = "1"

ROOT = Path(__file__).resolve().parent.parent

#: Files and the tests that have to notice: the fast ones first, since the first failure ends it.
TARGETS: dict[str, tuple[str, ...]] = {
    "src/pwm_node/pwm_node/faults.py": (
        "src/pwm_node/test/test_faults.py",
        "src/pmsm_sim/test/test_protection.py",
        "src/mfpcc_controller/test/test_protection.py",
    ),
    "src/pmsm_sim/pmsm_sim/parts/protection.py": (
        "src/pmsm_sim/test/test_protection.py",
        "src/pmsm_sim/test/test_missing_commands.py",
    ),
    "src/mfpcc_controller/mfpcc_controller/protection.py": (
        "src/mfpcc_controller/test/test_protection.py",
    ),
    "src/mfpcc_controller/mfpcc_controller/search.py": (
        "src/mfpcc_controller/test/test_search.py",
    ),
}

#: A comparison at its border and turned round, a sign, a factor, a branch, a number: of all that
#: cosmic-ray can do, what a slip of the pen does.
OPERATORS = (
    *(
        f"ReplaceComparisonOperator_{a}_{b}"
        for a, b in (
            ("Lt", "LtE"),
            ("LtE", "Lt"),
            ("Gt", "GtE"),
            ("GtE", "Gt"),
            ("Lt", "Gt"),
            ("Gt", "Lt"),
            ("LtE", "GtE"),
            ("GtE", "LtE"),
            ("Eq", "NotEq"),
            ("NotEq", "Eq"),
        )
    ),
    *(
        f"ReplaceBinaryOperator_{a}_{b}"
        for a, b in (("Add", "Sub"), ("Sub", "Add"), ("Mul", "Div"), ("Div", "Mul"))
    ),
    "ReplaceUnaryOperator_USub_UAdd",
    "ReplaceUnaryOperator_Delete_Not",
    "ReplaceAndWithOr",
    "ReplaceOrWithAnd",
    "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue",
    "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak",
    "NumberReplacer",
    "ZeroIterationForLoop",
)

_PATIENCE = 10.0  # times what the tests take without a change, and
_AT_LEAST = 60.0  # s


@dataclass
class Mutant:
    """A change of one line of a file."""

    file: Path
    operator: str
    line: int
    was: str
    now: str
    source: str = field(repr=False)
    outcome: str = ""

    def __str__(self) -> str:
        return (
            f"{self.file.relative_to(ROOT)}:{self.line}: {self.operator}\n"
            f"    - {self.was}\n    + {self.now}"
        )


def mutants(file: Path) -> Iterator[Mutant]:
    """All changes of the code of a file: its functions, and the numbers they take from it."""
    from cosmic_ray.ast import get_ast
    from cosmic_ray.mutating import MutationVisitor
    from cosmic_ray.plugins import get_operator

    source = file.read_text()
    before = source.splitlines()
    lines = _lines_of_code(source)
    for name in OPERATORS:
        kind = get_operator(f"core/{name}")
        for occurrence in range(10_000):
            visitor = MutationVisitor(occurrence, kind())
            tree = visitor.walk(get_ast(source))
            if not visitor.mutation_applied:
                break
            changed = tree.get_code()
            after = changed.splitlines()
            line = next(
                (n for n, (a, b) in enumerate(zip(before, after, strict=False)) if a != b), None
            )
            if line is None or line + 1 not in lines:
                continue
            yield Mutant(file, name, line + 1, before[line].strip(), after[line].strip(), changed)


def _lines_of_code(source: str) -> set[int]:
    """Lines of functions without their signatures, and of constants that are numbers."""
    found: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.FunctionDef, ast.Lambda)):
            body = node.body if isinstance(node.body, list) else [node.body]
            found.update(range(body[0].lineno, (body[-1].end_lineno or 0) + 1))
    for node in ast.parse(source).body:
        # a table of parameters or fields is no code
        if isinstance(node, ast.Assign) and not any(
            isinstance(part, (ast.Call, ast.List)) and not _is_cast(part)
            for part in ast.walk(node.value)
        ):
            found.update(range(node.lineno, (node.end_lineno or 0) + 1))
    return found


def _is_cast(node: ast.AST) -> bool:
    """Whether it is a number of some type, such as np.uint64(5)."""
    return (
        isinstance(node, ast.Call)
        and ast.unparse(node.func).startswith("np.")
        and all(isinstance(arg, ast.Constant) for arg in node.args)
    )


# --- Applying one ---------------------------------------------------------------------------------


def apply(mutant: Mutant) -> None:
    """Change the module of a mutant where it stands: the code of its functions, its constants."""
    module = _modules()[mutant.file.resolve()]
    changed = compile(mutant.source, str(module.__file__), "exec")
    codes = dict(_codes(changed, ""))
    for function in list(_functions(module)):
        code = codes.get(function.__qualname__)
        if code is not None:
            function.__code__ = code
    for node in ast.parse(mutant.source).body:
        if isinstance(node, ast.Assign) and node.lineno <= mutant.line <= (node.end_lineno or 0):
            scratch = dict(vars(module))
            exec(compile(ast.Module([node], []), mutant.file.name, "exec"), scratch)
            names = [n.id for t in node.targets for n in ast.walk(t) if isinstance(n, ast.Name)]
            # whoever has imported it has it by the same name
            for other in list(sys.modules.values()):
                for name in names:
                    if getattr(other, name, None) is getattr(module, name):
                        setattr(other, name, scratch[name])


def _modules() -> dict[Path, types.ModuleType]:
    """What is imported, by its file."""
    return {
        Path(file).resolve(): module
        for module in list(sys.modules.values())
        if (file := getattr(module, "__file__", None))
    }


def _codes(code: types.CodeType, scope: str) -> Iterator[tuple[str, types.CodeType]]:
    """Code of all functions by qualified name, those within functions and classes too."""
    for part in code.co_consts:
        if isinstance(part, types.CodeType):
            name = f"{scope}{part.co_name}"
            yield name, part
            is_class = not part.co_flags & 0x2  # CO_NEWLOCALS
            yield from _codes(part, f"{name}." if is_class else f"{name}.<locals>.")


def _functions(module: types.ModuleType) -> Iterator[types.FunctionType]:
    """All functions of a module, however deep in classes, wrappers and closures."""
    seen: set[int] = set()
    left: list[object] = list(vars(module).values())
    while left:
        thing = left.pop()
        if id(thing) in seen:
            continue
        seen.add(id(thing))
        if isinstance(thing, types.FunctionType):
            left.append(getattr(thing, "__wrapped__", None))
            for cell in thing.__closure__ or ():
                with contextlib.suppress(ValueError):  # still empty
                    left.append(cell.cell_contents)
            if thing.__module__ == module.__name__ and not hasattr(thing, "__wrapped__"):
                yield thing
        elif isinstance(thing, type) and thing.__module__ == module.__name__:
            left += vars(thing).values()
        elif isinstance(thing, property):
            left += [thing.fget, thing.fset]
        elif isinstance(thing, (classmethod, staticmethod)):
            left.append(thing.__func__)
        elif isinstance(thing, functools.cached_property):
            left.append(thing.func)


# --- Running the tests ----------------------------------------------------------------------------


class Jury:
    """The plug-in of pytest that runs the collected tests once for each mutant.

    Parameters
    ----------
    made : list of Mutant
        Their outcome is filled in.
    """

    def __init__(self, made: Sequence[Mutant]) -> None:
        self.made = made
        self.fails = True  # until they have passed without a change
        self._took: dict[str, float] = {}

    def pytest_runtest_logreport(self, report: Any) -> None:
        self._took[report.nodeid] = self._took.get(report.nodeid, 0.0) + report.duration

    def pytest_runtestloop(self, session: Any) -> bool:
        began = time.monotonic()
        self.fails = session.testscollected == 0 or not _passed(session)
        if self.fails:
            return True
        patience = max(_PATIENCE * (time.monotonic() - began), _AT_LEAST)
        session.items.sort(key=lambda item: self._took.get(item.nodeid, 0.0))
        for n, mutant in enumerate(self.made):
            print(f"\r{n} of {len(self.made)} ", end="", file=sys.__stderr__, flush=True)
            mutant.outcome = _in_a_child(functools.partial(_judged, session, mutant), patience)
        return True


def _judged(session: Any, mutant: Mutant) -> bool:
    apply(mutant)
    return _passed(session)


def _passed(session: Any) -> bool:
    """Run the collected tests until one fails."""
    for n, item in enumerate(session.items):
        following = session.items[n + 1] if n + 1 < len(session.items) else None
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if session.testsfailed:
            return False
    return True


def _in_a_child(judge: Callable[[], bool], patience: float) -> str:
    child = os.fork()
    if child == 0:
        os.setsid()
        code = 1
        try:
            code = 0 if judge() else 1
        finally:  # whatever was raised: it was noticed
            os._exit(code)
    deadline = time.monotonic() + patience
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return "survived" if status == 0 else "killed"
        if time.monotonic() > deadline:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "killed"
        time.sleep(0.01)


def _without_shrinking() -> None:
    """Let hypothesis find a counterexample, and not look for the smallest one for minutes.

    The profiles of the tests inherit this one.
    """
    from hypothesis import Phase, settings

    settings.register_profile(
        "mutants", deadline=None, database=None, derandomize=True, phases=[Phase.generate]
    )
    settings.load_profile("mutants")


def judge(name: str, part: int, parts: int, most: int) -> tuple[int, list[Mutant]] | None:
    """All mutants of a file, or one of so many parts: their number, and the survivors."""
    import pytest

    with contextlib.redirect_stderr(io.StringIO()):
        made = list(mutants(ROOT / name))
    if most:
        made = random.Random(0).sample(made, min(most, len(made)))
    made = made[part - 1 :: parts]
    jury = Jury(made)
    _without_shrinking()
    with contextlib.redirect_stdout(io.StringIO()) as said:
        pytest.main(["-q", "-p", "no:cacheprovider", *TARGETS[name]], [jury])
    if jury.fails:
        print(f"{name}: its tests fail without any change\n{said.getvalue()}", file=sys.stderr)
        return None
    return len(made), [mutant for mutant in made if mutant.outcome == "survived"]


def main() -> int:
    """Make, run and report mutants; 1 if the tests fail without one."""
    parser = argparse.ArgumentParser(prog="mutants", description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", help="parts of the names of files; all of them")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time")
    parser.add_argument("--sample", type=int, default=0, help="so many of each file, by chance")
    parser.add_argument("--count", action="store_true", help="only say how many there are")
    arguments = parser.parse_args()
    os.chdir(ROOT)
    chosen = [n for n in TARGETS if not arguments.files or any(f in n for f in arguments.files)]
    total = survived = 0
    for name in chosen:
        if arguments.count:
            print(f"{name}: {len(list(mutants(ROOT / name)))} mutants", flush=True)
            continue
        jobs = arguments.jobs
        # each in a process of its own, in which nothing of the file before is imported
        with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
            parts = [pool.submit(judge, name, n + 1, jobs, arguments.sample) for n in range(jobs)]
            found = [part.result() for part in parts]
        number = 0
        left: list[Mutant] = []
        for one in found:
            if one is None:
                return 1
            number, left = number + one[0], left + one[1]
        left.sort(key=lambda mutant: mutant.line)
        total, survived = total + number, survived + len(left)
        print(f"{name}: {number - len(left)} of {number} killed", flush=True)
        for mutant in left:
            print(mutant, flush=True)
    if total:
        print(f"{total - survived} of {total} killed: {100.0 * (1.0 - survived / total):.1f} %")
    return 0


if __name__ == "__main__":
    sys.exit(main())

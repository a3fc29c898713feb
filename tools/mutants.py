"""Mutation testing of the numeric core: `make mutants`.

Each mutant is one small change of a source file (a comparison the other way round, a sign, a
number, a branch), made by the operators of cosmic-ray. It is killed if a test of those that belong
to the file fails. What survives is listed with its line: either a test is missing, or the change
has no effect.

    mutants.py [--jobs N] [--sample N] [--count] [FILE ...]

Kernels run in plain Python (NUMBA_DISABLE_JIT), since each mutant would have to be compiled. No
file is changed: the tests are collected and run once, which tells what lines each of them runs. For
each mutant a process forks, changes the code of the function where it stands, and runs the tests
that come by, the fastest first. A mutant ends by processor time, not by the clock, so that a score
does not depend on what else the machine does.
Needs the workspace to be sourced, and the packages of requirements/dev.txt and mutants.txt.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import gc
import io
import multiprocessing
import os
import random
import resource
import signal
import sys
import time
import types
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

os.environ["NUMBA_DISABLE_JIT"] = "1"

ROOT = Path(__file__).resolve().parent.parent

_TRAJECTORIES = "src/mfpcc_experiments/test/test_trajectories.py"
_CONTROLLER = "src/mfpcc_controller/mfpcc_controller"
_PLANT = "src/pmsm_sim/pmsm_sim"
_EXPERIMENTS = "src/mfpcc_experiments/mfpcc_experiments"

#: Files and the tests that have to notice, as pytest is told: the nearest ones, and fast ones.
TARGETS: dict[str, tuple[str, ...]] = {
    "src/pwm_node/pwm_node/faults.py": (
        "src/pwm_node/test/test_faults.py",
        "src/pmsm_sim/test/test_protection.py",
        "src/mfpcc_controller/test/test_protection.py",
    ),
    f"{_PLANT}/parts/protection.py": (
        "src/pmsm_sim/test/test_protection.py",
        "src/pmsm_sim/test/test_missing_commands.py",
    ),
    f"{_CONTROLLER}/protection.py": ("src/mfpcc_controller/test/test_protection.py",),
    f"{_CONTROLLER}/search.py": ("src/mfpcc_controller/test/test_search.py",),
    **{
        f"{_CONTROLLER}/schemes/{scheme}.py": (_TRAJECTORIES, "-k", scheme)
        for scheme in (
            *("mls_mfpcc", "mls_mfpcc_paper", "mfpcc", "mfpcc_two_vector"),
            *("mbpcc", "mbpcc_single_vector", "neso_mfpcc", "pi_foc"),
            *("ultra_local_eso", "ultra_local_smo"),
        )
    },
    f"{_PLANT}/ideal.py": (_TRAJECTORIES, "-k", "plant and not switches and not timer"),
    f"{_PLANT}/general.py": (_TRAJECTORIES, "-k", "plant"),
    f"{_EXPERIMENTS}/measuring/waveform.py": ("src/mfpcc_experiments/test/test_metrics.py",),
    f"{_EXPERIMENTS}/measuring/metrics.py": (
        "src/mfpcc_experiments/test/test_metrics.py",
        "src/mfpcc_experiments/test/test_what_is_reported.py",
    ),
    f"{_EXPERIMENTS}/bags/completeness.py": ("src/mfpcc_experiments/test/test_recording.py",),
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

#: So many of each file, unless more are asked for.
SAMPLE = 60

_PATIENCE = 10.0  # times the processor time that the tests take without a change, and
_AT_LEAST = 30.0  # s
_IDLE = 30.0  # times that by the clock: for what waits for ever, on a machine however busy
_NOT_APPLIED = 3


@dataclass
class Mutant:
    """A change of one line of a file."""

    file: Path
    operator: str
    line: int
    was: str
    now: str
    source: str = field(repr=False)
    lines: range  # of the statement, or of the head of one with a body
    is_constant: bool  # of the module
    outcome: str = ""

    def __str__(self) -> str:
        return (
            f"{self.file.relative_to(ROOT)}:{self.line}: {self.operator} ({self.outcome})\n"
            f"    - {self.was}\n    + {self.now}"
        )


@dataclass(frozen=True)
class Place:
    """Where an operator can change a file: its how many-th one, and the line."""

    operator: str
    occurrence: int
    line: int


def places(file: Path) -> list[Place]:
    """All places in the code of a file: its functions, and the numbers they take from it."""
    from cosmic_ray.ast import Visitor, get_ast
    from cosmic_ray.plugins import get_operator

    class Finder(Visitor):  # type: ignore[misc]
        def __init__(self, operator: Any) -> None:
            self.operator = operator
            self.lines: list[int] = []

        def visit(self, node: Any) -> Any:
            self.lines += [start[0] for start, _ in self.operator.mutation_positions(node)]
            return node

    source = file.read_text()
    in_functions, constants = _lines_of_code(source)
    tree, found = get_ast(source), []
    for name in OPERATORS:
        finder = Finder(get_operator(f"core/{name}")())
        finder.walk(tree)
        found += [
            Place(name, number, line)
            for number, line in enumerate(finder.lines)
            if line in in_functions or line in constants
        ]
    return found


def mutant(file: Path, place: Place) -> Mutant | None:
    """Make the change at a place; None where it leaves the text as it is, or no Python."""
    from cosmic_ray.ast import get_ast
    from cosmic_ray.mutating import MutationVisitor
    from cosmic_ray.plugins import get_operator

    source = file.read_text()
    visitor = MutationVisitor(place.occurrence, get_operator(f"core/{place.operator}")())
    with contextlib.redirect_stderr(io.StringIO()):
        changed = visitor.walk(get_ast(source)).get_code()
    lines = zip(source.splitlines(), changed.splitlines(), strict=False)
    differ = [(n, a, b) for n, (a, b) in enumerate(lines, start=1) if a != b]
    try:
        _compiled(changed)
    except SyntaxError:
        return None
    if not differ:
        return None
    line, was, now = differ[0]
    in_functions, constants = _lines_of_code(source)
    return Mutant(
        file=file,
        operator=place.operator,
        line=line,
        was=was.strip(),
        now=now.strip(),
        source=changed,
        lines=in_functions.get(line, range(0)),
        is_constant=line in constants,
    )


def _lines_of_code(source: str) -> tuple[dict[int, range], set[int]]:
    """Lines of functions, without signatures, with those of their statement; and of constants."""
    functions: dict[int, range] = {}
    constants: set[int] = set()
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.Lambda)):
            for statement in node.body if isinstance(node.body, list) else [node.body]:
                for part in ast.walk(statement):
                    if isinstance(part, ast.stmt) or part is statement:
                        functions |= dict.fromkeys(_own_lines(part), _own_lines(part))
    for node in tree.body:
        # a table of parameters or fields is no code
        if isinstance(node, ast.Assign) and not any(
            isinstance(part, (ast.Call, ast.List)) and not _is_cast(part)
            for part in ast.walk(node.value)
        ):
            constants.update(_own_lines(node))
    return functions, constants


def _own_lines(node: ast.AST) -> range:
    """Lines of a statement or expression, without those of its body."""
    begin, end = node.lineno, node.end_lineno  # type: ignore[attr-defined]
    body = getattr(node, "body", None)
    if isinstance(node, ast.stmt) and isinstance(body, list) and body:
        end = max(begin, body[0].lineno - 1)
    return range(begin, end + 1)


def _is_cast(node: ast.AST) -> bool:
    """Whether it is a number of some type, such as np.uint64(5)."""
    return (
        isinstance(node, ast.Call)
        and ast.unparse(node.func).startswith("np.")
        and all(isinstance(arg, ast.Constant) for arg in node.args)
    )


# --- Applying one ---------------------------------------------------------------------------------


class NotAppliedError(Exception):
    """A mutant whose code was found nowhere, so that the tests would say nothing of it."""


def apply(mutant: Mutant) -> None:
    """Change what was imported of a file where it stands: the code of functions, constants."""
    original = mutant.file.read_text()
    changed = dict(_changes(_compiled(original), _compiled(mutant.source)))
    applied = False
    for thing in gc.get_objects():
        # a kernel has another name than its code, and may stand in a closure
        if isinstance(thing, types.FunctionType) and thing.__code__ in changed:
            thing.__code__ = changed[thing.__code__]
            applied = True
    if not (_apply_to_constant(mutant) or applied):
        raise NotAppliedError(str(mutant))


def _apply_to_constant(mutant: Mutant) -> bool:
    """Compute the constant of a module anew that is mutated, if it is one."""
    (module,) = (
        module
        for module in list(sys.modules.values())
        if (file := getattr(module, "__file__", None)) and Path(file).resolve() == mutant.file
    )
    applied = False
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
                        applied = True
    return applied


def _compiled(source: str) -> types.CodeType:
    return compile(source, "", "exec", dont_inherit=True)


def _changes(
    was: types.CodeType, now: types.CodeType
) -> Iterator[tuple[types.CodeType, types.CodeType]]:
    """The code of each function that differs, as it was and as it is now; inner ones too."""
    # a branch that can never be taken is no part of the code: its functions have no counterpart
    inner = [
        [part for part in code.co_consts if isinstance(part, types.CodeType)] for code in (was, now)
    ]
    for one, other in zip(*inner, strict=False):
        if one != other:
            yield one, other
            yield from _changes(one, other)


# --- Running the tests ----------------------------------------------------------------------------


class Jury:
    """The plug-in of pytest that runs the collected tests once, and then those of each mutant.

    Parameters
    ----------
    file : Path
        What the mutants change.
    made : list of Mutant
        Their outcome is filled in.
    jobs : int
        At a time.
    """

    def __init__(self, file: Path, made: Sequence[Mutant], jobs: int) -> None:
        from coverage import Coverage

        self.made = made
        self.fails = True  # until they have passed without a change, and all is judged
        self._file, self._jobs = file, jobs
        self._coverage = Coverage(data_file=None, include=[str(file)])
        self._took: dict[str, float] = {}  # processor time of each test (s)
        self._running: dict[int, tuple[Mutant, float]] = {}  # and when it is given up

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Any:
        # what a fixture of many tests runs is run for each of them, not for the first alone
        if fixturedef.scope == "function":
            return (yield)
        self._coverage.switch_context(_shared(fixturedef))
        try:
            return (yield)
        finally:
            self._coverage.switch_context(self._item)

    def pytest_runtestloop(self, session: Any) -> bool:
        items = session.items
        self._coverage.start()
        for item, following in zip(items, [*items[1:], None], strict=True):
            self._item = item.nodeid
            self._coverage.switch_context(self._item)
            began = time.process_time()
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            self._took[self._item] = time.process_time() - began
        self._coverage.stop()
        if items and not session.testsfailed:
            self._judge(session)
            self.fails = False
        return True

    def _judge(self, session: Any) -> None:
        """Run a process for each mutant, some at a time."""
        at_line = self._tests_at_lines(session)
        for n, mutant in enumerate(self.made):
            print(f"\r{n} of {len(self.made)} ", end="", file=sys.__stderr__, flush=True)
            tests = [item for line in mutant.lines for item in at_line.get(line, ())]
            if mutant.is_constant:
                tests = session.items
            tests = sorted(dict.fromkeys(tests), key=lambda item: self._took[item.nodeid])
            if not tests:
                mutant.outcome = "not reached"
                continue
            patience = _PATIENCE * sum(self._took[item.nodeid] for item in tests) + _AT_LEAST
            self._wait(self._jobs - 1)
            child = _in_a_child(session, mutant, tests, patience)
            self._running[child] = mutant, time.monotonic() + _IDLE * patience
        self._wait(0)

    def _tests_at_lines(self, session: Any) -> dict[int, list[Any]]:
        """The tests that run each line."""
        by_context: dict[str, list[Any]] = {}
        for item in session.items:
            by_context.setdefault(item.nodeid, []).append(item)
            for definitions in item._fixtureinfo.name2fixturedefs.values():
                for definition in definitions:
                    by_context.setdefault(_shared(definition), []).append(item)
        lines = self._coverage.get_data().contexts_by_lineno(str(self._file))
        return {
            line: [item for context in contexts for item in by_context.get(context, ())]
            for line, contexts in lines.items()
        }

    def _wait(self, most: int) -> None:
        """Wait until at most so many are running."""
        while len(self._running) > most:
            for child, (mutant, deadline) in list(self._running.items()):
                if time.monotonic() > deadline:  # it waits for what never comes
                    os.killpg(child, signal.SIGKILL)
                done, status = os.waitpid(child, os.WNOHANG)
                if done:
                    del self._running[child]
                    code = os.waitstatus_to_exitcode(status)
                    if code == _NOT_APPLIED:
                        raise NotAppliedError(str(mutant))
                    mutant.outcome = "survived" if code == 0 else "killed"
            time.sleep(0.005)


def _shared(fixture: Any) -> str:
    return f"fixture {fixture.baseid}::{fixture.argname}"


def _in_a_child(session: Any, mutant: Mutant, tests: Sequence[Any], patience: float) -> int:
    """Apply a mutant in a process of its own, and run these tests until one fails."""
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        os.setsid()
        limit = int(patience) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
        try:
            apply(mutant)
        except NotAppliedError:
            code = _NOT_APPLIED
        else:
            code = 0 if _passed(session, tests) else 1
    finally:  # whatever was raised: it was noticed
        os._exit(code)


def _passed(session: Any, tests: Sequence[Any]) -> bool:
    """Run tests until one fails."""
    for item, following in zip(tests, [*tests[1:], None], strict=True):
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if session.testsfailed:
            return False
    return True


def _without_shrinking() -> None:
    """Let hypothesis find a counterexample, and not look for the smallest one for minutes.

    The profiles of the tests inherit this one.
    """
    from hypothesis import Phase, settings

    settings.register_profile(
        "mutants", deadline=None, database=None, derandomize=True, phases=[Phase.generate]
    )
    settings.load_profile("mutants")


def judge(name: str, jobs: int, most: int) -> tuple[int, list[Mutant]] | None:
    """The mutants of a file: how many there are, and those made, with their outcome."""
    everything = places(ROOT / name)
    chosen = everything
    if 0 < most < len(everything):
        chosen = random.Random(0).sample(everything, most)
    made = [one for one in (mutant(ROOT / name, place) for place in chosen) if one is not None]
    jury = Jury(ROOT / name, made, jobs)
    _without_shrinking()
    with contextlib.redirect_stdout(io.StringIO()) as said:
        pytest.main(["-q", "-p", "no:cacheprovider", *TARGETS[name]], [jury])
    if jury.fails:
        print(f"{name}: its tests fail without any change\n{said.getvalue()}", file=sys.stderr)
        return None
    return len(everything), made


def main() -> int:
    """Make, run and report mutants; 1 if the tests fail without one."""
    parser = argparse.ArgumentParser(prog="mutants", description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", help="parts of the names of files; all of them")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time")
    parser.add_argument(
        "--sample",
        type=int,
        default=SAMPLE,
        help=f"so many of each file, by chance, always the same ones; 0: all ({SAMPLE})",
    )
    parser.add_argument("--count", action="store_true", help="only say how many there are")
    arguments = parser.parse_args()
    os.chdir(ROOT)
    chosen = [n for n in TARGETS if not arguments.files or any(f in n for f in arguments.files)]
    total = killed = 0
    for name in chosen:
        if arguments.count:
            number = len(places(ROOT / name))
            total += number
            print(f"{name}: {number} mutants", flush=True)
            continue
        # each in a process of its own, in which nothing of the file before is imported
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            found = pool.submit(judge, name, arguments.jobs, arguments.sample).result()
        if found is None:
            return 1
        number, made = found
        left = sorted((m for m in made if m.outcome != "killed"), key=lambda m: m.line)
        total, killed = total + len(made), killed + len(made) - len(left)
        print(
            f"{name}: {len(made) - len(left)} of {len(made)} killed"
            + (f" (a sample of {number})" if number > len(made) else ""),
            flush=True,
        )
        for mutant in left:
            print(mutant, flush=True)
    if arguments.count:
        print(f"{total} mutants")
    elif total:
        print(f"{killed} of {total} killed: {100.0 * killed / total:.1f} %")
    return 0


if __name__ == "__main__":
    sys.exit(main())

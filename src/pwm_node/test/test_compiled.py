"""Kernels are compiled once, and again when anything they are made of changes."""

import dis
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from harness import PATIENCE

from pwm_node.compiled import direct, kernel

PACKAGE_PARENT = Path(__file__).parents[1]


@pytest.fixture
def run(tmp_path):
    """Write two modules where one's kernel calls the other's, and run them in a new process."""
    environment = {
        **os.environ,
        "MFPCC_CACHE": str(tmp_path / "cache"),
        "PYTHONPATH": f"{tmp_path}{os.pathsep}{PACKAGE_PARENT}",
    }

    def _run(factor: str = "2.0", offset: str = "1.0") -> tuple[float, bool]:
        (tmp_path / "inner.py").write_text(
            textwrap.dedent(f"""\
            from pwm_node.compiled import kernel
            OFFSET = {offset}
            @kernel
            def inner(x):
                return {factor} * x
            """)
        )
        (tmp_path / "outer.py").write_text(
            textwrap.dedent("""\
            import inner as module
            from inner import OFFSET
            from pwm_node.compiled import announce, kernel
            @kernel
            def outer(x):
                return module.inner(x) + OFFSET
            announce()
            print(outer(10.0))
            """)
        )
        result = subprocess.run(
            [sys.executable, "-B", str(tmp_path / "outer.py")],
            env=environment,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=True,
        )
        said = result.stderr.count("compiling kernels (first start only)")
        assert said <= 1
        return float(result.stdout), bool(said)

    return _run


def test_compiles_only_what_changed(run):
    assert run() == (21.0, True)
    assert run() == (21.0, False), "the second start must compile nothing"
    assert run(factor="3.0") == (31.0, True), "a kernel in another file changed"
    assert run(factor="3.0", offset="4.0") == (34.0, True), "a constant in another file changed"
    assert run() == (21.0, False), "the first source is still on disk"


def test_a_kernel_must_not_use_what_comes_later(tmp_path, monkeypatch):
    monkeypatch.setenv("MFPCC_CACHE", str(tmp_path))
    from pwm_node.compiled import KernelError, kernel

    with pytest.raises(KernelError, match="'missing'"):

        @kernel
        def early(x):
            return missing(x)  # noqa: F821


def test_goes_on_where_nothing_can_be_kept(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("MFPCC_CACHE", str(tmp_path / "file"))
    from pwm_node.compiled import kernel

    @kernel
    def double(x):
        return 2.0 * x

    @kernel
    def triple(x):
        return 3.0 * x

    assert double(2.0) == 4.0
    assert triple(2.0) == 6.0
    assert capsys.readouterr().err.count("cannot be kept") == 1


def test_a_kernel_called_directly_gives_the_same():
    @kernel
    def add(record, step):
        record[0].x += step
        return record[0].x

    dtype = np.dtype([("x", np.float64)])
    add_directly = direct(add, np.zeros(1, dtype), 1.0)
    record = np.zeros(1, dtype)
    assert add_directly(record, 2.0) == 2.0
    assert add(record, 3.0) == record["x"][0] == 5.0


def test_one_function_made_twice_has_two_names():
    """The linker must not take the one for the other, whichever processes compiled them."""

    def scaled_by(factor):
        @kernel
        def scaled(x):
            return factor * x

        return scaled

    one, two = scaled_by(2.0), scaled_by(3.0)
    assert (one(1.0), two(1.0)) == (2.0, 3.0)
    # what follows the name counts within a process
    symbols = [f.overloads[f.signatures[0]].fndesc.mangled_name.split("B")[0] for f in (one, two)]
    assert symbols[0] != symbols[1]


def test_a_constant_is_no_type_of_its_own():
    @kernel
    def twice(n):
        return 2 * n

    @kernel
    def both(n):
        return twice(0) + twice(-1) + twice(n)

    assert both(5) == 8
    assert len(twice.signatures) == 1


def test_finds_the_names_that_the_disassembler_finds():
    """Also beyond 256 names, where the arguments of the byte code are longer than a byte."""
    from pwm_node.compiled import _global_names

    names = [f"name_{n}" for n in range(700)]
    source = "def many(record):\n" + "".join(f"    record.{name} = {name}.x\n" for name in names)
    space = {}
    exec(source, space)
    found = {
        instruction.argval
        for instruction in dis.get_instructions(space["many"])
        if instruction.opname == "LOAD_GLOBAL"
    }
    assert found == set(names)
    assert _global_names(space["many"].__code__) == found
    assert _global_names(_nested.__code__) == {"np", "OUTER"}


OUTER = 1.0


def _nested(x):
    return [np.add(x, y + OUTER) for y in x]


def test_a_kernel_opens_its_folder_when_it_is_first_called(tmp_path, monkeypatch):
    """A start is not to pay for the many kernels that are only a part of others."""
    monkeypatch.setenv("MFPCC_CACHE", str(tmp_path))

    @kernel
    def double(x):
        return 2.0 * x

    assert not list(tmp_path.iterdir())
    assert double(2.0) == 4.0
    (folder,) = (tmp_path / "kernels").iterdir()
    assert list(folder.rglob("*.nbc")), "what was compiled is kept there"

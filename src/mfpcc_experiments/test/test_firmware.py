"""Kernels in C: the language that is translated, the project, and the loop with it."""

from __future__ import annotations

import ctypes
import json
import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numba import types

from mfpcc_controller import firmware, schemes
from mfpcc_controller.controller import Controller
from mfpcc_controller.firmware import FirmwareError, library
from mfpcc_controller.parameters import TABLE
from mfpcc_experiments import cli
from mfpcc_experiments.bags import recording
from mfpcc_experiments.firmware import proof, target
from mfpcc_experiments.firmware.layout import Record, Structs
from mfpcc_experiments.firmware.program import Program
from mfpcc_experiments.measuring import replay, scheme_title
from mfpcc_experiments.measuring.replay import Samples
from mfpcc_experiments.running import run, scenario
from mfpcc_experiments.verbs.run import _recording_names
from pwm_node.compiled import kernel
from pwm_node.names import unknown
from pwm_node.parameters import ParameterError

ROOT = Path(__file__).resolve().parents[3]
WARNINGS = ["-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Werror"]

needs_compiler = pytest.mark.skipif(
    not any(shutil.which(name) for name in ("cc", "gcc", "clang")), reason="no C compiler here"
)

ROW = np.dtype(
    [("x", np.float64), ("z", np.complex128), ("n", np.uint32), ("v", np.float64, (3,))],
    align=True,
)


@kernel
def _inner(row, k):
    """Two values; the second one is a whole number."""
    if k < 0:
        return -row.x, k // 3
    return row.x, k % 3


@kernel
def _trial(row, k, y):
    """One of everything that kernels use."""
    # a loop, a tuple, a swap
    total, last = 0.0, 0
    for j in range(-1, 2):
        total += y * j
        if j == k:
            last = j
    row.v[0], row.v[1] = row.v[1], row.v[0]
    a, b = _inner(row, k)
    row.z = row.z * complex(y, -1.0) + 0.5j - row.z.conjugate()
    row.n |= np.uint32(1) << np.uint32(4)
    row.v[2] = min(max(y, -1.0), abs(row.z)) if k in (1, 2) else (y % 0.7) ** 2
    row.x = math.copysign(math.sqrt(abs(y)), a) + b + last - math.floor(y)
    return total > 0.0 and row.n != np.uint32(3)


def translated(function, kinds, real="double") -> str:
    """A kernel in C, with the struct of `ROW`."""
    structs = Structs(lambda name: True, {ROW: "row_t"}, {})
    structs.name(ROW)
    program = Program(structs, real)
    program.function(function.py_func, kinds)
    head = "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n"
    head += f"typedef {real} mfpcc_real;\ntypedef struct {{ {real} re, im; }} mfpcc_complex;\n"
    return head + structs.source() + "\n" + program.source(lambda module: "")


@needs_compiler
def test_a_kernel_in_c_gives_the_same_bits(tmp_path):
    source = translated(_trial, [Record(ROW), types.int64, types.float64])
    source += (
        "\nbool trial(row_t *row, int64_t k, double y) { return test_firmware_trial(row, k, y); }\n"
    )
    (tmp_path / "trial.c").write_text(source)
    command = [*firmware.compiler(), *firmware.FLAGS, *WARNINGS, "-Wno-missing-prototypes"]
    command += ["-shared", "-fPIC", "-O1", "-o", str(tmp_path / "trial.so"), "trial.c", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=120)
    in_c = ctypes.CDLL(str(tmp_path / "trial.so")).trial
    in_c.restype, in_c.argtypes = ctypes.c_bool, [ctypes.c_void_p, ctypes.c_int64, ctypes.c_double]
    rng = np.random.default_rng(3)
    for k in range(-4, 5):
        row = np.zeros(1, ROW)
        row["x"], row["z"], row["v"] = (
            rng.normal(),
            complex(*rng.normal(size=2)),
            rng.normal(size=3),
        )
        row["n"] = 3 if k == 2 else 7
        other, y = row.copy(), float(rng.normal())
        assert in_c(other.ctypes.data, k, y) == _trial(row[0], k, y)
        assert other.tobytes() == row.tobytes()


def test_comments_and_docstrings_come_along():
    source = translated(_trial, [Record(ROW), types.int64, types.float64])
    assert "/* One of everything that kernels use. */" in source
    assert "    /* a loop, a tuple, a swap */\n" in source


@kernel
def _asks(row):
    return row.v[np.argmax(row.v)]


def test_what_cannot_be_translated_is_named_with_its_line():
    with pytest.raises(
        FirmwareError, match=r"kernel '_asks.*' cannot be .*test_firmware\.py, line \d+"
    ):
        translated(_asks, [Record(ROW)])


# --- The project ----------------------------------------------------------------------------------


def mfpcc(*arguments: object) -> tuple[int, str]:
    """Exit code of the command, and all it has said."""
    runner = CliRunner()
    with runner.isolation() as streams:
        code = cli.run([str(argument) for argument in arguments])
        said = "".join(stream.getvalue().decode() for stream in streams[:2])
    return code, said


@pytest.fixture(scope="module")
def project(tmp_path_factory) -> Path:
    """A firmware of two schemes."""
    folder = tmp_path_factory.mktemp("firmware") / "two"
    code, said = mfpcc("firmware", "--scheme", "mls_mfpcc", "--scheme", "mfpcc", "--out", folder)
    assert code == 0, said
    return folder


def compiled(folder: Path, *sources: str, to: str = "a.out") -> Path:
    """An executable made of a firmware, without a warning."""
    command = [*firmware.compiler(), *firmware.FLAGS, *WARNINGS, "-O1", "-Iinclude", "-o", to]
    done = subprocess.run(
        [*command, *sources, "-lm"], cwd=folder, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return folder / to


def said_by(program: Path) -> str:
    done = subprocess.run([program], capture_output=True, text=True, timeout=60, check=True)
    return done.stdout


@needs_compiler
def test_the_project_compiles_without_a_warning_and_agrees_with_its_vectors(project):
    check = compiled(project, "src/mfpcc.c", "test/check.c", to="check")
    assert said_by(check).startswith("1000 of 1000 commands equal")


@needs_compiler
def test_the_vectors_find_a_sign_that_is_wrong(project, tmp_path):
    shutil.copytree(project, tmp_path / "mutant")
    source = tmp_path / "mutant/src/mfpcc.c"
    text = source.read_text()
    found = re.sub(r"(u\.re \* v\.im) - (u\.im \* v\.re)", r"\1 + \2", text)
    assert found != text
    source.write_text(found)
    check = compiled(tmp_path / "mutant", "src/mfpcc.c", "test/check.c", to="check")
    assert subprocess.run([check], capture_output=True, timeout=60).returncode == 1


@needs_compiler
def test_the_example_runs(project):
    example = compiled(project, "src/mfpcc.c", "examples/pwm_interrupt.c", to="example")
    assert said_by(example) == "10 periods, gates on\n"


PARAMETERS = """
#include "mfpcc.h"
#include <math.h>
int main(void)
{
    static mfpcc_controller d;
    mfpcc_init(&d);
    if (mfpcc_set_parameter(&d, MFPCC_W_M_REF, NAN) != MFPCC_BAD_VALUE) { return 1; }
    if (mfpcc_set_parameter(&d, MFPCC_PARAMETERS, 1) != MFPCC_UNKNOWN_PARAMETER) { return 2; }
    if (mfpcc_set_parameter(&d, MFPCC_SCHEME, 3) != MFPCC_BAD_VALUE) { return 3; }
    if (mfpcc_set_parameter(&d, MFPCC_SCHEME, MFPCC_SCHEME_MFPCC) != MFPCC_OK) { return 4; }
    if (d.cfg.scheme != MFPCC_SCHEME_MFPCC) { return 5; }
    if (mfpcc_set_parameter(&d, MFPCC_PROJECT, 0.5) != MFPCC_BAD_VALUE) { return 6; }
    if (mfpcc_set_parameter(&d, MFPCC_I_DQ_REF_Q, 2.5) != MFPCC_OK) { return 7; }
    if (d.cfg.i_dq_ref.im < 2.4) { return 8; }
    mfpcc_stop(&d);
    if (!d.memory.guard.latch.tripped) { return 9; }
    d.memory.guard.latch.faults = 5U;
    d.memory.guard.latch.present = 4U;
    if (mfpcc_clear_faults(&d) != 4U || !d.memory.guard.latch.tripped) { return 10; }
    d.memory.guard.latch.present = 0U;
    if (mfpcc_clear_faults(&d) != 0U || d.memory.guard.latch.tripped) { return 11; }
    return d.memory.guard.awaits_zero ? 0 : 12;
}
"""


@needs_compiler
def test_parameters_are_set_or_refused_and_faults_cleared(project):
    (project / "parameters.c").write_text(PARAMETERS)
    program = compiled(project, "src/mfpcc.c", "parameters.c", to="parameters")
    assert subprocess.run([program], timeout=60).returncode == 0


@needs_compiler
@pytest.mark.parametrize("scheme", ["mls_mfpcc", "mfpcc", "pi_foc"])
def test_every_bit_of_recorded_drives_is_the_kernels(project, scheme, monkeypatch):
    monkeypatch.setattr(firmware, "library", lambda folder: library(folder, "-O1"))
    samples = Samples(recording.read(ROOT / "bags/reference" / scheme))
    found = proof.agreement(samples, scheme, f"firmware:{project}")
    assert found.whole, found


@needs_compiler
def test_single_precision_stays_near(tmp_path):
    code, said = mfpcc(
        "firmware", "--scheme", "mbpcc", "--precision", "single", "--out", tmp_path / "f"
    )
    assert code == 0, said
    check = compiled(tmp_path / "f", "src/mfpcc.c", "test/check.c", to="check")
    assert float(said_by(check).rpartition(" ")[2]) < 1e-4
    assert "double" not in (tmp_path / "f/include/mfpcc.h").read_text()


# --- In the loop ----------------------------------------------------------------------------------


@needs_compiler
def test_a_run_with_firmware_is_the_run_with_its_scheme(project, tmp_path):
    wanted = scenario.load(ROOT / "bags/reference.yaml")
    name = f"firmware:{project}"
    recorded = []
    for scheme, folder in ((name, "c"), ("mls_mfpcc", "kernels")):
        run.run(wanted, scheme, "inprocess", tmp_path, 0, lambda done: None, name=folder)
        recorded.append(recording.read(tmp_path / folder))
    ours, kernels = recorded
    assert ours.command.tobytes() == kernels.command.tobytes()
    assert ours.config["parameters"]["mfpcc_controller"]["scheme"] == name
    samples = Samples(ours)
    replay.require_same(samples, replay.verify(samples))


def test_recordings_of_firmware_are_named_after_its_folder():
    names = _recording_names(("mbpcc", "firmware:/a/f", "firmware:/b/f"))
    assert list(names.values()) == ["mbpcc", "firmware_f", "firmware_f_2"]
    assert scheme_title("firmware:/a/f -> pi_foc") == "f in C -> PI-FOC"


@needs_compiler
def test_a_switch_from_firmware_to_its_scheme_and_back_changes_nothing(project):
    drives = [
        Controller(TABLE.complete({"scheme": s})) for s in ("mls_mfpcc", f"firmware:{project}")
    ]
    samples = Samples(recording.read(ROOT / "bags/reference/mls_mfpcc")).feedback[:90]
    answered = []
    for drive in drives:
        commands = []
        row, lut = (np.zeros(1, dtype) for dtype in firmware.messages()[1:])
        for k in range(len(samples)):
            if k % 30 == 29:
                scheme = "mls_mfpcc" if k == 29 else drive.values["scheme"]
                drive.apply({"scheme": scheme if drive is drives[0] else _other(drive, project)})
            drive.step(samples[k : k + 1], row, lut, True)
            commands.append(row.tobytes())
        answered.append(commands)
    assert answered[0] == answered[1]


def _other(drive: Controller, project: Path) -> str:
    return "mls_mfpcc" if drive.values["scheme"] != "mls_mfpcc" else f"firmware:{project}"


# --- On a processor -------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.skipif(bool(target.missing()), reason=target.missing())
def test_an_emulated_processor_gives_the_same_bits_as_this_one(tmp_path):
    code, said = mfpcc(
        "firmware", "--scheme", "mbpcc", "--trigonometry", "own", "--out", tmp_path / "f"
    )
    assert code == 0, said
    found = target.run(tmp_path / "f", "Cortex-M7", tmp_path)
    assert found.equal == found.samples == 1000
    assert 500 < found.instructions < 4_000
    # and the test sees what is not equal
    vectors = tmp_path / "f/test/vectors.h"
    vectors.write_text(vectors.read_text().replace("{0x1.", "{0x1.00", 1))
    assert target.run(tmp_path / "f", "Cortex-M7", tmp_path).equal < 1000


def test_single_precision_has_no_trigonometry_of_our_own(tmp_path):
    code, said = mfpcc(
        "firmware", "--scheme", "mbpcc", "--precision", "single", "--trigonometry", "own",
        "--out", tmp_path / "f",
    )  # fmt: skip
    assert code == 1
    assert "'--precision single' takes '--trigonometry libm'" in said


# --- Bad input ------------------------------------------------------------------------------------


def test_an_unknown_scheme(tmp_path):
    code, said = mfpcc("firmware", "--scheme", "mls", "--out", tmp_path / "f")
    assert code == 1
    assert unknown("scheme", "mls", (*schemes.NAMES, "all")) in said
    assert not (tmp_path / "f").exists()


def test_a_folder_that_is_there(tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    code, said = mfpcc("firmware", "--scheme", "mbpcc", "--out", tmp_path, "--force")
    assert code == 1
    assert "it has no firmware.json" in said
    (tmp_path / "firmware.json").write_text("{}")
    code, said = mfpcc("firmware", "--scheme", "mbpcc", "--out", tmp_path)
    assert code == 1
    assert "exists: replace it with --force" in said
    assert (tmp_path / "letter.txt").read_text() == "dear"


def test_no_compiler(project, monkeypatch):
    monkeypatch.setenv("CC", "")
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(ParameterError, match="takes a C compiler, and none is on the PATH"):
        TABLE["scheme"].validate(f"firmware:{project}")
    monkeypatch.setenv("CC", "nocc -m32")
    with pytest.raises(ParameterError, match=r"'nocc' \(variable CC\) is not on the PATH"):
        TABLE["scheme"].validate(f"firmware:{project}")


def test_a_plug_in_in_python(tmp_path, monkeypatch):
    from mfpcc_experiments.firmware import project as projects

    monkeypatch.setitem(projects.PLUG_INS, "mine", None)
    code, said = mfpcc("firmware", "--scheme", "mine", "--out", tmp_path / "f")
    assert code == 1
    assert "'mine' is a plug-in in Python, which cannot be translated to C" in said


@pytest.mark.parametrize("manifest", [None, "", "[]", "{}", '{"precision": "half"}'])
def test_a_folder_that_holds_no_firmware(tmp_path, manifest):
    if manifest is not None:
        (tmp_path / "firmware.json").write_text(manifest)
    with pytest.raises(ParameterError, match=r"'mfpcc firmware --scheme NAME --out .*' makes it"):
        TABLE["scheme"].validate(f"firmware:{tmp_path}")


@needs_compiler
def test_firmware_of_another_version_and_source_that_is_broken(project, tmp_path):
    folder = tmp_path / "f"
    shutil.copytree(project, folder)
    (folder / "src/mfpcc.c").write_text("this is no C")
    with pytest.raises(ParameterError, match=r"does not compile: .*error"):
        TABLE["scheme"].validate(f"firmware:{folder}")
    told = json.loads((folder / "firmware.json").read_text())
    (folder / "firmware.json").write_text(json.dumps({**told, "layout": "0"}))
    with pytest.raises(ParameterError, match="was made by another version"):
        TABLE["scheme"].validate(f"firmware:{folder}")

"""A folder of firmware: the translated controller, its parameters, an example, and a test."""

from __future__ import annotations

import json
import re
import string
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import types

from mfpcc_controller import controller, schemes
from mfpcc_controller.controller import Controller
from mfpcc_controller.firmware import MANIFEST, FirmwareError, Layout, messages
from mfpcc_controller.parameters import PLUG_INS, TABLE
from mfpcc_controller.protection import FAULTS
from mfpcc_controller.records import CONTROL_CFG, CONTROL_MEMORY
from mfpcc_experiments.firmware import vectors
from mfpcc_experiments.firmware.functions import wrapped
from mfpcc_experiments.firmware.layout import NUMBERS, Record, Structs, fields, known_records
from mfpcc_experiments.firmware.program import Program
from mfpcc_experiments.firmware.values import spelt
from pwm_node.names import unknown
from pwm_node.parameters import Table

_TEMPLATES = Path(__file__).parent / "templates"

#: Fields of the configuration that cannot be set one by one: others follow from them, or they are
#: numbers by which arrays are indexed.
_FIXED = {
    "fallback", "pwm_frequency", "T_s", "R_s", "L_d", "L_q", "psi_f", "b_d", "b_q", "n_p", "mtpa",
    "ref_L_d", "ref_L_q", "ref_psi_f", "update", "window", "refresh",
}  # fmt: skip

# Without these lines a parameter means nothing to a controller that is no node.
_OF_THE_NODE = {"recorders", "schedule", "diagnostics_decimation", "fault.step_budget"}

_DISPATCH = re.compile(r"mem\.active == (\d+)")
_MESSAGES = ("mfpcc_sample", "mfpcc_command", "mfpcc_diagnostics")


@dataclass(frozen=True)
class Choice:
    """
    What a firmware is made of.

    Attributes
    ----------
    schemes : tuple of str
        The first is in control at the start.
    values : mapping
        All parameters of the controller.
    single : bool
        Whether its numbers are of single precision.
    trigonometry : str
        `libm`: the C library's; `own`: that of `pwm_node.trigonometry`.
    """

    schemes: tuple[str, ...]
    values: Mapping[str, Any]
    single: bool = False
    trigonometry: str = "libm"

    @property
    def real(self) -> str:
        """The C type of its numbers."""
        return "float" if self.single else "double"

    @property
    def all_schemes(self) -> list[str]:
        """Those that it has, in the order of their numbers: the fallback belongs to them."""
        wanted = {*self.schemes, self.values["fallback_scheme"]}
        return [name for name in schemes.NAMES if name in wanted]


def chosen(
    names: Sequence[str], changes: Mapping[str, Any], single: bool, trigonometry: str = "libm"
) -> Choice:
    """
    Check what somebody wants to have as firmware.

    Parameters
    ----------
    names : sequence of str
        Schemes, or `all`.
    changes : mapping
        Parameters of the controller that are not to have their defaults.
    single : bool
    trigonometry : str

    Raises
    ------
    FirmwareError
        If a scheme cannot be translated.
    pwm_node.parameters.ParameterError
        If a parameter has no such value.
    """
    names = tuple(dict.fromkeys(schemes.NAMES if "all" in names else names))
    for name in names:
        if name in PLUG_INS:
            raise FirmwareError(
                f"scheme '{name}' is a plug-in in Python, which cannot be translated to C; one "
                "that is written as kernels in mfpcc_controller/schemes can: see docs/own_scheme.md"
            )
        if name not in schemes.NAMES:
            raise FirmwareError(unknown("scheme", name, (*schemes.NAMES, "all")))
    if single and trigonometry == "own":
        raise FirmwareError(
            "the sine and cosine of our own are of double precision: '--precision single' takes "
            "'--trigonometry libm'"
        )
    values = TABLE.complete({**changes, "scheme": names[0]})
    return Choice(names, values, single, trigonometry)


def write(choice: Choice, folder: Path, out: Path, recording: Path | None) -> None:
    """
    Write the project.

    Parameters
    ----------
    choice : Choice
    folder : Path
        Where to write it; empty.
    out : Path
        Where it will be found.
    recording : Path or None
        Whose samples are the test's; None: a drive with this controller, simulated for it.

    Raises
    ------
    FirmwareError
        If a kernel cannot be translated.
    mfpcc_experiments.bags.BagError
        If the recording cannot be read.
    """
    layout = Layout(choice.all_schemes, choice.single)
    drive = Controller(choice.values)
    structs = _structs(layout)
    program = _program(choice, structs)
    title = f"Current control by {', '.join(choice.schemes)} in C"
    common = {"title": title, "real": choice.real}
    settable = list(_settable(layout.keep))
    cases = "\n".join(_case(choice, path, name, dtype) for path, name, dtype in settable)
    samples = vectors.samples(choice.values, recording)
    values = choice.values
    content = {
        "include/mfpcc.h": _filled(
            "mfpcc.h",
            common,
            structs=structs.source(),
            scheme_numbers=_numbers("MFPCC_SCHEME", choice.all_schemes, schemes.NAMES),
            fault_numbers=_numbers("MFPCC_FAULT", FAULTS.codes, FAULTS.codes),
            parameter_names="\n".join(f"    {name}," for _, name, _ in settable),
        ),
        "src/mfpcc.c": _filled(
            "mfpcc.c",
            common,
            program=program.source(_says),
            first_memory=_first_memory(drive.mem[0], layout.keep, choice.real),
            cases=cases,
        ),
        "src/parameters.h": _parameters(choice, drive.cfg[0], structs),
        "test/check.c": _filled(
            "check.c",
            common,
            where=" where both use the same sine and cosine"
            if choice.trigonometry == "libm"
            else "",
            references=vectors.references(samples, choice.real),
            verdict="largest < 1.0" if choice.single else "equal == SAMPLES",
        ),
        "test/target.c": _filled(
            "target.c", common, references=vectors.references(samples, choice.real)
        ),
        "test/target.ld": _filled("target.ld", common),
        "examples/pwm_interrupt.c": _filled(
            "pwm_interrupt.c", common, u_dc=f"{drive.motor.u_dc:g}"
        ),
        "CMakeLists.txt": _filled("CMakeLists.txt", common),
        "README.md": _filled(
            "README.md",
            common,
            schemes=", ".join(choice.all_schemes),
            motor=values["motor"],
            precision=f"{'single' if choice.single else 'double'}",
            trigonometry={"libm": "the C library's", "own": "part of `src/mfpcc.c`"}[
                choice.trigonometry
            ],
            pwm_frequency=f"{values['pwm_frequency']:g}",
            memory=str(layout.controller.itemsize),
            out=str(out),
        ),
    }
    told = {
        "scheme": choice.schemes[0],
        "schemes": choice.all_schemes,
        "precision": "single" if choice.single else "double",
        "trigonometry": choice.trigonometry,
        "layout": layout.digest,
        "parameters": {k: v for k, v in values.items() if k not in _OF_THE_NODE},
    }
    content[MANIFEST] = json.dumps(told, indent=2, ensure_ascii=False) + "\n"
    for path, text in content.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    if choice.trigonometry == "own":
        # what numba calls rounds otherwise: the answers are those of this source on this machine
        samples = vectors.answered(samples, choice.values, folder)
    text = vectors.source(samples, choice.real)
    (folder / "test/vectors.h").write_text(text, encoding="utf-8")


def _filled(template: str, common: Mapping[str, str], **words: str) -> str:
    text = (_TEMPLATES / template).read_text(encoding="utf-8")
    return string.Template(text).substitute(common, **words)


def _structs(layout: Layout) -> Structs:
    names, notes = known_records()
    for name, dtype in zip(_MESSAGES, messages(), strict=True):
        names[dtype] = name
        names[dtype["stamp"]] = "mfpcc_time"
    structs = Structs(layout.keep, names, {**notes, **_message_notes()})
    for dtype in (*messages(), CONTROL_CFG, CONTROL_MEMORY):
        structs.name(dtype)
    return structs


def _message_notes() -> dict[str, dict[str, tuple[str, str]]]:
    """What the definitions of the messages say of their fields."""
    from ament_index_python.packages import get_package_share_directory

    folder = Path(get_package_share_directory("mfpcc_msgs")) / "msg"
    kinds = ("PhaseFeedback", "DutyCommand", "LutDiagnostics")
    found = {}
    for name, kind in zip(_MESSAGES, kinds, strict=True):
        notes = {}
        for line in (folder / f"{kind}.msg").read_text(encoding="utf-8").splitlines():
            field, _, text = line.partition("#")
            words = field.split()
            if len(words) >= 2 and text:
                notes[words[1]] = ("", text.strip())
        found[name] = notes
    return found


def _program(choice: Choice, structs: Structs) -> Program:
    kept = {schemes.NAMES.index(name) for name in choice.all_schemes}
    dropped = [name for name in schemes.NAMES if name not in choice.all_schemes]

    def included(text: str) -> bool:
        branch = _DISPATCH.fullmatch(text)
        if branch:
            return int(branch[1]) in kept
        return not any(text == f"mem.{name}.ready" for name in dropped)

    stand_ins: Mapping[Any, Any] = {}
    if choice.trigonometry == "own":
        from pwm_node import trigonometry

        stand_ins = trigonometry.STAND_INS
    program = Program(structs, choice.real, included, stand_ins)
    records = [Record(dtype) for dtype in (CONTROL_CFG, CONTROL_MEMORY, *messages())]
    answer: Any = controller.answer
    program.function(answer.py_func, [*records, types.boolean])
    return program


def _says(module: str) -> str:
    """The first sentence of a module's docstring."""
    return (sys.modules[module].__doc__ or "").strip().partition("\n")[0]


def _numbers(prefix: str, shown: Sequence[str], known: Sequence[str]) -> str:
    return "\n".join(f"#define {prefix}_{name.upper()} {known.index(name)}" for name in shown)


def _settable(
    keep: Any, dtype: np.dtype[Any] = CONTROL_CFG, path: str = "", name: str = "MFPCC"
) -> Any:
    """Fields of the configuration that can be set: path, name, type."""
    for field, inner in fields(dtype):
        if field in _FIXED or not keep(field):
            continue
        here, called = f"{path}{field}", f"{name}_{field.upper()}"
        base, shape = inner.subdtype or (inner, ())
        if base.names is not None:
            yield from _settable(keep, base, f"{here}.", called)
        elif base == np.complex128:
            yield f"{here}.re", f"{called}_D", np.dtype(np.float64)
            yield f"{here}.im", f"{called}_Q", np.dtype(np.float64)
        elif shape:
            for n in range(shape[0]):
                if keep(schemes.NAMES[n]):
                    yield f"{here}[{n}]", f"{called}_{schemes.NAMES[n].upper()}", base
        else:
            yield here, called, base


def _case(choice: Choice, path: str, name: str, dtype: np.dtype[Any]) -> str:
    lines = [f"    case {name}:"]
    f = "f" if choice.single else ""
    if dtype == np.bool_:
        lines += [
            f"        if (value != 0.0{f} && value != 1.0{f}) {{",
            "            return MFPCC_BAD_VALUE;",
            "        }",
            f"        cfg->{path} = value != 0.0{f};",
        ]
    elif path == "scheme":
        numbers = [schemes.NAMES.index(each) for each in choice.all_schemes]
        test = " && ".join(f"value != {n}.0{f}" for n in numbers)
        lines += [
            *wrapped(f"        if ({test}) {{"),
            "            return MFPCC_BAD_VALUE;",
            "        }",
            "        cfg->scheme = (int64_t)value;",
            "        self->memory.chosen = -1; /* also one that failed gets another chance */",
        ]
    else:
        lines.append(f"        cfg->{path} = value;")
    return "\n".join([*lines, "        break;"])


def _first_memory(memory: np.void, keep: Any, real: str, path: str = "") -> str:
    """What is not zero in the memory of a drive that starts."""
    lines = []
    for name, dtype in fields(memory.dtype):
        if not keep(name):
            continue
        if dtype.names is not None:
            inner = _first_memory(memory[name], keep, real, f"{path}{name}.")
            lines += [inner] if inner else []
        elif np.any(memory[name]):
            if dtype.subdtype is not None:
                raise FirmwareError(f"an array of the memory does not begin with zeros: {name}")
            value = spelt(memory[name].item(), NUMBERS[dtype], real)
            lines.append(f"    self->memory.{path}{name} = {value};")
    return "\n".join(lines)


def _parameters(choice: Choice, cfg: np.void, structs: Structs) -> str:
    """The parameters with their units, and the configuration that follows from them."""
    rows = []
    for name, parameter in _shown(TABLE, choice).items():
        unit = f" {parameter.unit}" if parameter.unit else ""
        rows.append(f" *   {name} = {choice.values[name]}{unit}")
    lines = _initial(cfg, structs, choice.real, "    ")
    return "\n".join(
        [
            "/*",
            " * The configuration that a drive starts with. It follows from these parameters:",
            " *",
            *rows,
            " */",
            "#ifndef MFPCC_PARAMETERS_H",
            "#define MFPCC_PARAMETERS_H",
            "",
            "#include <math.h>",
            "",
            '#include "mfpcc.h"',
            "",
            "static const mfpcc_cfg PARAMETERS = {",
            *lines,
            "};",
            "",
            "#endif",
            "",
        ]
    )


def _shown(table: Table, choice: Choice) -> dict[str, Any]:
    """The parameters that the firmware depends on."""
    others = {
        parameter.name
        for scheme in schemes.BUILT_IN
        if scheme.name not in choice.all_schemes
        for parameter in scheme.parameters
    }
    return {n: p for n, p in table.items() if n not in others | _OF_THE_NODE}


def _initial(record: np.void, structs: Structs, real: str, indent: str) -> list[str]:
    """A record as an initialiser, with what is said of its fields."""
    notes = structs.comments.get(structs.name(record.dtype), {})
    lines = []
    for name, dtype in fields(record.dtype):
        if not structs.keep(name):
            continue
        above, beside = notes.get(name, ("", ""))
        if above:
            lines.append(f"{indent}/* {above} */")
        tail = f" /* {beside} */" if beside else ""
        if dtype.names is not None:
            lines += [
                f"{indent}.{name} = {{{tail}",
                *_initial(record[name], structs, real, indent + "    "),
                f"{indent}}},",
            ]
            continue
        base, shape = dtype.subdtype or (dtype, ())
        kind = NUMBERS[base]
        if shape:
            text = ", ".join(spelt(each.item(), kind, real) for each in record[name].ravel())
            text = f"{{{text}}}"
        else:
            text = spelt(record[name].item(), kind, real)
        lines.append(f"{indent}.{name} = {text},{tail}")
    return lines

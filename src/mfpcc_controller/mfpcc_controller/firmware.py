"""Software in the loop: a controller that was translated to C, in the place of the compiled one.

`firmware:FOLDER` is a value of the parameter `scheme`: the C project of that folder (`mfpcc
firmware` writes it) then answers each sample with all its stages, protection and speed loop
included, on the same records. Its structs hold the same fields, without those of schemes that it
does not have, and perhaps of single precision; so they are copied before and after each step.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwm_node.compiled import cache_folder
from pwm_node.errors import ForPeople

#: What a value of `scheme` begins with that names a folder of firmware.
PREFIX = "firmware:"

#: The file that every such folder has, and by which it is known as one.
MANIFEST = "firmware.json"

# What a message holds as the name of a scheme, less the prefix
_LONGEST = 240

#: With these, C computes what the kernels compute, bit for bit.
FLAGS = ("-std=c99", "-ffp-contract=off")

_SINGLE: dict[np.dtype[Any], Any] = {
    np.dtype(np.float64): np.float32,
    np.dtype(np.complex128): np.complex64,
}
_REALS = {np.dtype(np.float64), np.dtype(np.float32)}
_PAIRS = {np.dtype(np.complex128): np.float64, np.dtype(np.complex64): np.float32}

# Compiled beside the firmware: how large its structs are.
_SIZES = """#include <stddef.h>
#include "mfpcc.h"
extern const size_t mfpcc_sizes[4];
const size_t mfpcc_sizes[4] = {sizeof(mfpcc_controller), sizeof(mfpcc_sample),
    sizeof(mfpcc_command), sizeof(mfpcc_diagnostics)};
"""


class FirmwareError(ForPeople):
    """Something that cannot become, or is no, firmware; the text says what, and what to do."""


def folder_of(name: str) -> Path | None:
    """The folder that a value of `scheme` names, with its whole path; None: it names a scheme."""
    if not name.startswith(PREFIX):
        return None
    return Path(name.removeprefix(PREFIX)).expanduser().resolve()


def whole_name(name: str) -> str:
    """A value of `scheme`, which names a folder by its whole path if it names one."""
    folder = folder_of(name)
    return f"{PREFIX}{folder}" if folder else name


def manifest(name: str) -> dict[str, Any]:
    """
    What a firmware says of itself.

    Parameters
    ----------
    name : str
        A value of `scheme`: `firmware:FOLDER`.

    Raises
    ------
    FirmwareError
        If there is none.
    """
    folder = Path(name.removeprefix(PREFIX)).expanduser()
    if len(name.encode()) > _LONGEST:
        raise FirmwareError(f"{folder}: a path of more than {_LONGEST} bytes fits into no message")
    path = folder / MANIFEST
    make = f"'mfpcc firmware --scheme NAME --out {folder}' makes it"
    if not path.is_file():
        raise FirmwareError(f"{folder} holds no firmware (it has no {MANIFEST}): {make}")
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if content["precision"] not in ("double", "single"):
            raise ValueError
        content["schemes"] = [str(scheme) for scheme in content["schemes"]]
        content["scheme"] = str(content["scheme"])
        content["layout"] = str(content["layout"])
    except (OSError, ValueError, KeyError, TypeError):
        raise FirmwareError(f"{path} cannot be read as that of a firmware: {make}") from None
    return content


def projected(
    dtype: np.dtype[Any], keep: Callable[[str], bool], *, single: bool = False
) -> np.dtype[Any]:
    """
    The dtype of the C struct made of a record.

    Parameters
    ----------
    dtype : dtype
        The record's.
    keep : callable
        Says of a field's name whether the firmware has it.
    single : bool
        Whether its numbers are of single precision.
    """
    if dtype.subdtype is not None:
        element, shape = dtype.subdtype
        return np.dtype((projected(element, keep, single=single), shape))
    if dtype.names is None:
        return np.dtype(_SINGLE.get(dtype, dtype)) if single else dtype
    fields = [(n, dtype.fields[n][0]) for n in dtype.names if keep(n)]  # type: ignore[index]
    return np.dtype([(n, projected(d, keep, single=single)) for n, d in fields], align=True)


class Layout:
    """
    How the structs of a firmware lie in memory.

    Parameters
    ----------
    schemes : sequence of str
        Those that it has.
    single : bool
        Whether its numbers are of single precision.

    Attributes
    ----------
    self, sample, command, diagnostics : dtype
        Of its four structs.
    digest : str
        By which it is known.
    """

    def __init__(self, schemes: list[str], single: bool) -> None:
        from mfpcc_controller.records import CONTROL_CFG, CONTROL_MEMORY
        from mfpcc_controller.schemes import NAMES

        dropped = set(NAMES) - set(schemes)

        def keep(name: str) -> bool:
            return name not in dropped

        own = np.dtype([("cfg", CONTROL_CFG), ("memory", CONTROL_MEMORY)], align=True)
        self.keep = keep
        self.controller = projected(own, keep, single=single)
        self.sample, self.command, self.diagnostics = (
            projected(dtype, keep, single=single) for dtype in messages()
        )
        all_of_it = [
            str(leaf)
            for dtype in (self.controller, self.sample, self.command, self.diagnostics)
            for leaf in _leaves(dtype)
        ]
        self.digest = hashlib.sha256("\n".join(all_of_it).encode()).hexdigest()[:16]


def messages() -> tuple[np.dtype[np.void], ...]:
    """Records of a sample, a command and the diagnostics."""
    from mfpcc_msgs.msg import DutyCommand, LutDiagnostics, PhaseFeedback

    from pwm_node.wire import fixed_dtype

    return tuple(fixed_dtype(each) for each in (PhaseFeedback, DutyCommand, LutDiagnostics))


def _leaves(dtype: np.dtype[Any], at: int = 0, path: str = "") -> Iterator[tuple[Any, ...]]:
    """The numbers of a record: path, place, type and how many there are in a row."""
    if dtype.names is not None:
        for name in dtype.names:
            inner, offset = dtype.fields[name][:2]  # type: ignore[index]
            yield from _leaves(inner, at + offset, f"{path}.{name}")
        return
    base, shape = dtype.subdtype or (dtype, ())
    count = int(np.prod(shape, dtype=int))
    if base in _PAIRS:
        base, count = np.dtype(_PAIRS[base]), 2 * count
    yield path, at, base, count


class _Copy:
    """Copies what two records have in common."""

    def __init__(self, host: np.dtype[Any], firmware: np.dtype[Any]) -> None:
        known = {path: (at, base) for path, at, base, _ in _leaves(host)}
        reals: list[tuple[int, int]] = []
        octets: list[tuple[int, int]] = []
        for path, at, base, count in _leaves(firmware):
            there, whole = known[path]
            size = base.itemsize
            if base in _REALS:
                reals += [(there // whole.itemsize + n, at // size + n) for n in range(count)]
                self._real = base
            else:
                octets += [(there + n, at + n) for n in range(count * size)]
        self._reals = tuple(np.array(side, np.intp) for side in zip(*reals, strict=True))
        self._octets = tuple(np.array(side, np.intp) for side in zip(*octets, strict=True))

    def into(self, host: NDArray[np.void], firmware: NDArray[np.void]) -> None:
        """From the host's to the firmware's."""
        here, there = self._reals
        firmware.view(self._real)[there] = host.view(np.float64)[here]
        here, there = self._octets
        firmware.view(np.uint8)[there] = host.view(np.uint8)[here]

    def back(self, host: NDArray[np.void], firmware: NDArray[np.void]) -> None:
        """From the firmware's to the host's."""
        here, there = self._reals
        host.view(np.float64)[here] = firmware.view(self._real)[there]
        here, there = self._octets
        host.view(np.uint8)[here] = firmware.view(np.uint8)[there]


class Firmware:
    """
    A firmware, compiled for this machine.

    Parameters
    ----------
    name : str
        `firmware:FOLDER`.

    Attributes
    ----------
    scheme : int
        The number of the scheme that it was made for.

    Raises
    ------
    FirmwareError
        If there is none, it cannot be compiled, or it is of another version.
    """

    def __init__(self, name: str) -> None:
        from mfpcc_controller.records import CONTROL_CFG, CONTROL_MEMORY
        from mfpcc_controller.schemes import NAMES

        told = manifest(name)
        folder = Path(name.removeprefix(PREFIX)).expanduser()
        layout = Layout(told["schemes"], told["precision"] == "single")
        if told["layout"] != layout.digest or not set(told["schemes"]) <= set(NAMES):
            raise FirmwareError(
                f"the firmware in {folder} was made by another version, whose records are others: "
                "make it again with 'mfpcc firmware'"
            )
        self.scheme = NAMES.index(told["scheme"])
        loaded = ctypes.CDLL(str(library(folder)))
        structs = (layout.controller, layout.sample, layout.command, layout.diagnostics)
        sizes = tuple((ctypes.c_size_t * len(structs)).in_dll(loaded, "mfpcc_sizes"))
        if sizes != tuple(struct.itemsize for struct in structs):
            raise FirmwareError(
                f"the structs of the firmware in {folder} do not lie in memory as its {MANIFEST} "
                "says: make it again with 'mfpcc firmware'"
            )
        self._step = loaded.mfpcc_step
        self._step.restype = None
        self._structs = tuple(np.zeros(1, struct) for struct in structs)
        self._addresses = tuple(ctypes.c_void_p(s.ctypes.data) for s in self._structs)
        hosts = (CONTROL_CFG, CONTROL_MEMORY)
        parts = ("cfg", "memory")
        self._parts = tuple(self._structs[0][part] for part in parts)
        self._own = tuple(
            _Copy(host, layout.controller[part]) for host, part in zip(hosts, parts, strict=True)
        )
        self._messages = tuple(
            _Copy(host, struct) for host, struct in zip(messages(), structs[1:], strict=True)
        )

    @np.errstate(all="ignore")
    def step(
        self,
        cfg: NDArray[np.void],
        mem: NDArray[np.void],
        feedback: NDArray[np.void],
        command: NDArray[np.void],
        diagnostics: NDArray[np.void],
        want_diagnostics: bool,
    ) -> None:
        """One period; parameters as of `mfpcc_controller.controller.control`."""
        own_cfg, own_memory = self._parts
        of_cfg, of_memory = self._own
        of_sample, of_command, of_diagnostics = self._messages
        _, own_sample, own_command, own_diagnostics = self._structs
        of_cfg.into(cfg, own_cfg)
        of_memory.into(mem, own_memory)
        of_sample.into(feedback, own_sample)
        of_command.into(command, own_command)
        slowing = mem["guard"]["slowing"][0]
        me, sample, answer, told = self._addresses
        self._step(me, sample, answer, told if want_diagnostics else None)
        of_memory.back(mem, own_memory)
        of_command.back(command, own_command)
        if want_diagnostics:
            of_diagnostics.back(diagnostics, own_diagnostics)
        if slowing:
            # all of the configuration that a step changes: safe stop 1 moves the reference
            cfg["w_M_ref"] = own_cfg["w_M_ref"]


def compiler() -> list[str]:
    """
    The C compiler of this machine: that of the variable CC, else the first there is.

    Raises
    ------
    FirmwareError
        If there is none.
    """
    chosen = os.environ.get("CC", "").split()
    for words in [chosen] if chosen else [["cc"], ["gcc"], ["clang"]]:
        path = shutil.which(words[0])
        if path:
            return [path, *words[1:]]
    named = f"'{chosen[0]}' (variable CC) is not on the PATH" if chosen else "none is on the PATH"
    raise FirmwareError(
        f"firmware in the loop takes a C compiler, and {named}: install gcc or clang "
        "(Debian: 'apt install gcc'), or name one with CC"
    )


def library(folder: Path, *options: str) -> Path:
    """
    Compile a firmware as a shared library of this machine; kept until its source changes.

    Parameters
    ----------
    folder : Path
        Of the firmware.
    *options : str
        Of the compiler, in the place of `-O2`.

    Raises
    ------
    FirmwareError
        If it cannot be compiled.
    """
    command = [*compiler(), *FLAGS, *(options or ("-O2",)), "-shared", "-fPIC"]
    sources = sorted([*folder.glob("src/*"), *folder.glob("include/*")])
    parts = hashlib.sha256("\0".join([*command, _SIZES]).encode())
    for source in sources:
        parts.update(source.read_bytes())
    kept = cache_folder().parent / "firmware"
    path = kept / f"{parts.hexdigest()[:16]}.so"
    if path.is_file():
        return path
    kept.mkdir(parents=True, exist_ok=True)
    fresh = path.with_suffix(f".{os.getpid()}")
    files = [str(source) for source in sources if source.suffix == ".c"]
    whole = [*command, f"-I{folder / 'include'}", "-o", str(fresh), *files, "-x", "c", "-", "-lm"]
    done = subprocess.run(whole, input=_SIZES, capture_output=True, text=True, check=False)
    if done.returncode:
        said = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr)
        raise FirmwareError(f"the firmware in {folder} does not compile: {said.strip()}")
    fresh.replace(path)
    return path

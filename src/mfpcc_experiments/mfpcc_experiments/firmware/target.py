"""Processor in the loop: firmware on an emulated Cortex-M, against its test vectors."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from mfpcc_controller.firmware import FLAGS, FirmwareError

_COMPILER, _EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"

# SysTick of these boards counts at 25 MHz; with -icount shift=0 an instruction takes 1 ns.
_INSTRUCTIONS_PER_TICK = 40

#: Processors: the compiler's options, and the emulated board.
PROCESSORS = {
    "Cortex-M4F": (("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16"), "mps2-an386"),
    "Cortex-M7": (("-mcpu=cortex-m7", "-mfpu=fpv5-d16"), "mps2-an500"),
}


@dataclass(frozen=True)
class Loop:
    """
    What came of the test vectors on a processor.

    Attributes
    ----------
    samples, equal : int
        How many there are, and how many commands have the expected bits.
    instructions : float
        Of a period, in the mean.
    code : int
        Bytes of the step and all that it calls, constants included.
    """

    samples: int
    equal: int
    instructions: float
    code: int


def missing() -> str:
    """What this machine lacks for it, as a sentence; empty if nothing."""
    lacks = [tool for tool in (_COMPILER, _EMULATOR) if shutil.which(tool) is None]
    if not lacks:
        return ""
    return f"{' and '.join(lacks)} missing (Debian: gcc-arm-none-eabi, qemu-system-arm)"


def run(folder: Path, processor: str, build: Path) -> Loop:
    """
    Compile a firmware for a processor, and let it answer its test vectors.

    Parameters
    ----------
    folder : Path
        Of the firmware.
    processor : str
        One of `PROCESSORS`.
    build : Path
        A folder for what is compiled.

    Raises
    ------
    FirmwareError
        If a tool is missing, it does not compile, or the processor does not come to an end.
    """
    if missing():
        raise FirmwareError(missing())
    options, board = PROCESSORS[processor]
    target = ["-mthumb", *options, "-mfloat-abi=hard", *FLAGS, "-O2", "-ffunction-sections"]
    step, program = build / "mfpcc.o", build / "target.elf"
    include = f"-I{folder / 'include'}"
    source = str(folder / "src/mfpcc.c")
    warnings = ("-Wall", "-Wextra", "-Werror")
    _call([_COMPILER, *target, *warnings, include, "-c", "-o", str(step), source])
    test = [str(folder / "test/target.c"), "-T", str(folder / "test/target.ld")]
    link = ["-nostartfiles", "-Wl,--gc-sections", "-o", str(program)]
    _call([_COMPILER, *target, include, *link, str(step), *test, "-lm"])
    quiet = ["-nographic", "-monitor", "none", "-serial", "none", "-icount", "shift=0"]
    out = ["-semihosting-config", "enable=on,target=native"]
    said = _call([_EMULATOR, "-M", board, *quiet, *out, "-kernel", str(program)])
    numbers = [int(line) for line in said.split() if line.isdigit()]
    if len(numbers) != 2:
        raise FirmwareError(f"the firmware in {folder} said on the {processor}: {said[:200]!r}")
    vectors = (folder / "test/vectors.h").read_text(encoding="utf-8")
    samples = int(re.findall(r"#define SAMPLES (\d+)", vectors)[0])
    return Loop(samples, numbers[0], numbers[1] * _INSTRUCTIONS_PER_TICK / samples, _size(program))


def _size(program: Path) -> int:
    """Bytes of code and constants of a program, less those of the test."""
    listed = _call(["arm-none-eabi-nm", "-S", "--size-sort", str(program)])
    total = 0
    for line in listed.splitlines():
        words = line.split()
        if len(words) == 4 and words[2] in "tTrR" and words[3] not in _OF_THE_TEST:
            total += int(words[1], 16)
    return total


_OF_THE_TEST = {"SAMPLE", "EXPECTED", "main", "reset", "say", "host", "VECTORS"}


def _call(command: list[str]) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    except subprocess.TimeoutExpired:
        raise FirmwareError(f"{command[0]} does not come to an end") from None
    if done.returncode:
        raise FirmwareError(f"{command[0]} fails: {(done.stderr or done.stdout).strip()[:500]}")
    return done.stdout + done.stderr

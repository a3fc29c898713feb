"""The tables of docs/firmware.md: ``python -m mfpcc_experiments.firmware bits``."""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from mfpcc_controller import schemes
from mfpcc_controller.firmware import Layout
from mfpcc_experiments.bags import bags_in, recording
from mfpcc_experiments.firmware import project, proof
from mfpcc_experiments.firmware import target as loops
from mfpcc_experiments.measuring.replay import Samples
from mfpcc_experiments.running import closed_loop

_REFERENCE = Path("bags/reference")


def bits(folder: Path) -> Iterator[str]:
    """Every scheme over every reference recording, in C and compiled by numba."""
    firmware = folder / "all"
    firmware.mkdir()
    project.write(project.chosen(["all"], {}, False), firmware, firmware, None)
    recordings = [Samples(recording.read(bag)) for bag in sorted(bags_in(_REFERENCE))]
    yield "| scheme | periods | commands | diagnostics | fields of the memory that differ |"
    yield "|---|---|---|---|---|"
    for scheme in schemes.NAMES:
        found = [proof.agreement(each, scheme, f"firmware:{firmware}") for each in recordings]
        periods, commands, told = (
            sum(getattr(each, name) for each in found)
            for name in ("periods", "commands", "diagnostics")
        )
        differ = sorted({field for each in found for field in each.memory})
        yield f"| `{scheme}` | {periods} | {commands} | {told} | {', '.join(differ) or 'none'} |"


def target(folder: Path) -> Iterator[str]:
    """Every scheme on emulated processors, by its test vectors."""
    if reason := loops.missing():
        yield reason
        return
    kinds = (
        ("Cortex-M7", False, "own"),
        ("Cortex-M4F", False, "own"),
        ("Cortex-M7", True, "libm"),
        ("Cortex-M4F", True, "libm"),
    )
    yield "| scheme | " + " | ".join(_title(*kind) for kind in kinds) + " | memory |"
    yield "|---|" + "---|" * len(kinds) + "---|"
    for scheme in schemes.NAMES:
        row = [f"`{scheme}`"]
        memory = []
        for processor, single, trigonometry in kinds:
            firmware = folder / f"{scheme}_{single}"
            choice = project.chosen([scheme], {}, single, trigonometry)
            if not firmware.exists():
                firmware.mkdir()
                project.write(choice, firmware, firmware, None)
            found = loops.run(firmware, processor, folder)
            row.append(
                f"{found.instructions:.0f}, {found.code / 1024:.1f} kB"
                + ("" if single else f", {found.equal} of {found.samples}")
            )
            memory.append(Layout(choice.all_schemes, single).controller.itemsize)
        yield f"| {' | '.join(row)} | {memory[0]} / {memory[-1]} B |"


# Of the paper: speed (r/min) and load torque (N m); inductance, resistance and flux of the
# controller's model over the motor's
_POINTS = ((750.0, 2.0), (750.0, 5.0), (300.0, 2.0), (1000.0, 2.0))
_MISMATCHES = {"a": (0.5, 0.1, 2.0), "b": (2.0, 10.0, 0.7), "c": (2.0, 1.0, 2.0)}
_LONG = 20.0  # s


def single(folder: Path) -> Iterator[str]:
    """mls_mfpcc in single precision beside double: closed loops with the same noise."""
    firmware = folder / "single"
    firmware.mkdir()
    project.write(project.chosen(["mls_mfpcc"], {}, True), firmware, firmware, None)
    pair = ("mls_mfpcc", f"firmware:{firmware}")
    yield "| drive | figure | double | single |"
    yield "|---|---|---|---|"
    for rpm, load in _POINTS:
        runs = [closed_loop.run(s, 0.6, rpm=rpm, load=load, oversampling=20) for s in pair]
        values = [f"{100.0 * run.thd(0.3):.4f} %" for run in runs]
        yield f"| {rpm:g} r/min, {load:g} N m | THD | {' | '.join(values)} |"
    for name, (inductance, resistance, flux) in _MISMATCHES.items():
        wrong = {
            "mismatch.inductance": inductance,
            "mismatch.resistance": resistance,
            "mismatch.flux": flux,
        }
        runs = [
            closed_loop.run(s, 0.4, controller=wrong, schedule=["0.2 load_torque 5.0"])
            for s in pair
        ]
        values = [f"{run.lut_error(0.1):.4f} A" for run in runs]
        yield f"| mismatch {name}, load step | largest prediction error | {' | '.join(values)} |"
    runs = [closed_loop.run(s, _LONG) for s in pair]
    for title, begin in (("second", 1.0), ("last", _LONG - 1.0)):
        rows = [run.lut["prediction_error"][run.rows(begin, begin + 1.0)] for run in runs]
        values = [f"{math.sqrt(float((row**2).mean())):.5f} A" for row in rows]
        figure = f"prediction error in the {title} second of {_LONG:g} s, rms"
        yield f"| 750 r/min, 2 N m | {figure} | {' | '.join(values)} |"


def _title(processor: str, single: bool, _: str) -> str:
    return f"{processor}, {'single' if single else 'double'}"


_TABLES: dict[str, Callable[[Path], Iterator[str]]] = {
    "bits": bits,
    "target": target,
    "single": single,
}


def main() -> int:
    """Print the table that is named."""
    if len(sys.argv) != 2 or sys.argv[1] not in _TABLES:
        print(f"usage: python -m mfpcc_experiments.firmware {'|'.join(_TABLES)}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        for line in _TABLES[sys.argv[1]](Path(folder)):
            print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

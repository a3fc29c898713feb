"""`mfpcc identify`: motor, delay and inverter from a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from mfpcc_experiments.identifying.identified import Identified


@click.command(short_help="Identify motor, delay and inverter from a recording.")
@click.argument("bag", type=click.Path(path_type=Path))
@click.option("--pole-pairs", type=click.IntRange(1, 100), help="Of the motor, if not recorded.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Motor file to write (.yaml).")
@click.option("-J", "--inertia", metavar="VALUE", help="For the file: inertia, such as 92.5gcm2.")
@click.option(
    "--psi-f",
    type=click.FloatRange(0.0, min_open=True),
    help="For the file, if the rotor stood still: flux linkage of the magnets (V s).",
)
@click.option("--namespace", metavar="/AXIS", help="Which axis, of a recording of several.")
@click.option("--force", is_flag=True, help="Overwrite the file.")
def command(
    bag: Path,
    pole_pairs: int | None,
    out: Path | None,
    inertia: str | None,
    psi_f: float | None,
    namespace: str | None,
    force: bool,
) -> None:
    """Tell of BAG what R, L, flux, delay, dead time and sensors the drive has, and how surely.

    The rotor should turn, and the current and the speed should change: what a recording does not
    tell is said. A wrong sign, phases that are exchanged, a wrong zero of the encoder and a delay
    that is none are said too; the exit code is 3 where one of the last two was found.
    """
    from mfpcc_experiments import notes
    from mfpcc_experiments.bags import recording
    from mfpcc_experiments.identifying import identified
    from mfpcc_experiments.progress import progress_bar

    if out is not None and out.exists() and not force:
        raise click.ClickException(f"{out}: there is such a file already; --force overwrites it")
    with progress_bar() as begin:
        read = recording.read(bag, namespace=namespace, progress=begin("read", 1.0))
        tell = begin("identify", 1.0)
        found = identified.identify(read, pole_pairs)
        tell(1.0)
    _print(found, read.config.get("motor_file") or {}, read.T_s, read.feedback["dc_voltage"].mean())
    for note in found.notes:
        click.echo(f"{note.severity.value}: {note.text}")
    if out is not None:
        known = _known(read, pole_pairs, inertia, psi_f)
        text = identified.motor_text(found, known, out.stem, f"Identified from {bag}")
        from mfpcc_experiments.files import write_whole

        write_whole(out, text)
        click.echo(f"written: {out}")
    row = {"notes": [note.to_json() for note in found.notes]}
    click.get_current_context().exit(notes.exit_code([row]))


def _known(
    read: Any, pole_pairs: int | None, inertia: str | None, psi_f: float | None
) -> dict[str, Any]:
    """What a motor file needs and no recording tells."""
    from mfpcc_experiments import datasheet

    motor = read.config.get("motor_file") or {}
    known: dict[str, Any] = {
        "n_p": pole_pairs or read.n_p or 1,
        "u_dc": float(read.feedback["dc_voltage"].mean()),
    }
    if psi_f is not None:
        known["psi_f"] = psi_f
    if inertia is not None:
        try:
            known["J"] = datasheet.read("inertia", inertia).value
        except datasheet.SheetError as error:
            raise click.UsageError(f"--inertia: {error}", click.get_current_context()) from None
    elif "J" in motor:
        known["J"] = motor["J"]
    else:
        raise click.UsageError(
            "a motor file needs the inertia, which is not identified: give --inertia",
            click.get_current_context(),
        )
    return known


def _print(found: Identified, motor: dict[str, Any], T_s: float, u_dc: float) -> None:
    """The table: one line per value, with the motor file's where the recording has one."""
    import math

    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("", no_wrap=True)
    for title in ("identified", "95 % between", "", "motor file"):
        table.add_column(title, justify="right")
    scale = {"H": (1e3, "mH"), "s": (1e6, "us")}
    for value in found.values:
        factor, unit = scale.get(value.unit, (1.0, value.unit))
        there = [factor * v for v in (value.value, value.low, value.high)]
        shown = [f"{there[0]:.4g}", f"{there[1]:.4g}, {there[2]:.4g}"]
        if not value.told:
            shown = ["–", "none seen" if value.key == "sensor_lag" else "not told"]
        truth = motor.get(value.key)
        table.add_row(
            value.key.replace("_", " ") if "_" in value.key[3:] else value.key,
            *shown,
            unit,
            f"{factor * truth:.4g}" if isinstance(truth, float) else "",
        )
    Console(highlight=False).print(table)
    dead, lag = found.value("dead_time_voltage"), found.value("sensor_lag")
    if dead.low > 0.0 and u_dc > 0.0:
        click.echo(f"that voltage is a dead time of {1e6 * dead.value * T_s / u_dc:.2g} us")
    if lag.told:
        click.echo(f"that lag is a bandwidth of the sensors of {0.5 / math.pi / lag.value:.4g} Hz")
    share = "" if found.explained is None else f"{found.explained:.1%} of each step, and "
    click.echo(
        f"explained by a linear model: {share}{found.fit.explained:.2%} of the current over "
        f"{found.fit.steps} periods; left is {found.fit.rms:.3g} A rms"
    )

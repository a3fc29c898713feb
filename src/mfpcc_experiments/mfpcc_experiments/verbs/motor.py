"""`mfpcc motor`: from a data sheet to a motor file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from mfpcc_experiments.datasheet import Quantity


def _quantity(kind: str) -> Any:
    """Callback that reads a number with its unit."""

    def read(ctx: click.Context, parameter: click.Parameter, text: str | None) -> Quantity | None:
        from mfpcc_experiments import datasheet

        if text is None or ctx.resilient_parsing:
            return None
        try:
            return datasheet.read(kind, text)
        except datasheet.SheetError as error:
            raise click.BadParameter(str(error), ctx, parameter) from None

    return read


def _poles(ctx: click.Context, parameter: click.Parameter, text: str) -> int:
    """Number of poles, alone or as makers of outrunners write it: 12N14P has 14."""
    match = re.fullmatch(r"(?:[0-9]+[NS])?([0-9]{1,4})P?", text.strip(), re.IGNORECASE)
    if match is None:
        raise click.BadParameter(
            f"'{text}': a whole number is expected, or as in 12N14P", ctx, parameter
        )
    return int(match.group(1))


@click.command(short_help="Make a motor file from a data sheet.")
@click.option("--name", required=True, help="Name of the motor and of its file.")
@click.option(
    "--poles",
    required=True,
    callback=_poles,
    help="Number of poles (twice the pole pairs), or a code such as '12N14P'.",
)
@click.option(
    "-R",
    "--resistance",
    required=True,
    callback=_quantity("resistance"),
    help="Resistance, such as '1.2 ohm'.",
)
@click.option(
    "-L",
    "--inductance",
    required=True,
    callback=_quantity("inductance"),
    help="Inductance, such as '0.56 mH'.",
)
@click.option(
    "--inductance-q",
    callback=_quantity("inductance"),
    help="Inductance of the q axis, if the sheet gives both axes; -L is then that of the d axis.",
)
@click.option(
    "--per-phase",
    is_flag=True,
    help="R and L are those of one phase; without this option they are between two terminals.",
)
@click.option(
    "--winding",
    default="star",
    show_default=True,
    help="Connection of the phases, for values that are per phase: star, or delta (a phase is "
    "then between two terminals).",
)
@click.option("--kt", callback=_quantity("kt"), help="Torque constant, such as '25.5 mNm/A'.")
@click.option(
    "--kt-current",
    help="How the sheet counts current: rms, peak, or dc (block commutation: maxon, Faulhaber).  "
    "[default: as the unit says (Nm/Arms), else rms]",
)
@click.option("--ke", callback=_quantity("ke"), help="Voltage constant, such as '51 V/krpm'.")
@click.option(
    "--ke-voltage",
    help="How the sheet counts voltage: ll-rms, ll-peak, phase-rms, phase-peak.  [default: "
    "between two terminals, as the unit says (Vpk/krpm), else rms]",
)
@click.option("--kv", callback=_quantity("kv"), help="Speed constant, such as '374 rpm/V'.")
@click.option(
    "-J",
    "--inertia",
    required=True,
    callback=_quantity("inertia"),
    help="Inertia of the rotor, such as '92.5 gcm2'.",
)
@click.option("--torque", callback=_quantity("torque"), help="Rated torque, such as '55.5 mNm'.")
@click.option("--current", callback=_quantity("current"), help="Rated current, such as '2.03 A'.")
@click.option("--speed", callback=_quantity("speed"), help="Rated speed, such as '2940 rpm'.")
@click.option(
    "--no-load-speed",
    callback=_quantity("speed"),
    help="No-load speed at --voltage, such as '4380 rpm'.",
)
@click.option(
    "--voltage",
    required=True,
    callback=_quantity("voltage"),
    help="DC-link voltage, such as '12 V'.",
)
@click.option(
    "--description", default="", help="Description in one line, which `mfpcc list` shows."
)
@click.option("--source", default="", help="Where the values come from.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Motor file to write (.yaml).")
@click.option("--force", is_flag=True, help="Overwrite the file.")
def command(
    name: str,
    description: str,
    source: str,
    out: Path | None,
    force: bool,
    kt_current: str | None,
    ke_voltage: str | None,
    **sheet: Any,
) -> None:
    """Convert the values of a data sheet to the parameters used here, and show how.

    Type each number with its unit, as it stands on the sheet: -R '1.2 ohm' -L 0.56mH
    --ke '1,02 mV/min-1' --torque '180 oz-in'. If the sheet contradicts itself, the command
    says so and uses the first of kE, kT, kV; the exit code is then 1.

    \b
    mfpcc motor --name ec45_30w --poles 16 -R 1.2ohm -L 0.56mH --kt 25.5mNm/A --kt-current dc \\
        --kv 374rpm/V -J 92.5gcm2 --torque 55.5mNm --current 2.03A --speed 2940rpm --voltage 12V
    """
    from rich.console import Console
    from rich.table import Table

    from mfpcc_experiments import datasheet
    from mfpcc_experiments.files import write_whole

    try:
        counted = {
            "kt_current": _counted("--kt", kt_current, sheet["kt"]),
            "ke_voltage": _counted("--ke", ke_voltage, sheet["ke"], before="ll-"),
            "current_counted": sheet["current"] and sheet["current"].counted,
        }
        values: dict[str, Any] = {
            name: value.value if isinstance(value, datasheet.Quantity) else value
            for name, value in sheet.items()
        }
        motor = datasheet.convert(datasheet.Sheet(**values, **counted))
    except datasheet.SheetError as error:
        raise click.UsageError(str(error)) from None

    table = Table(title=name)
    for heading in ("parameter", "from the sheet", "value"):
        table.add_column(heading)
    for step in motor.steps:
        table.add_row(*step)
    Console().print(table)

    text = datasheet.yaml_text(
        motor,
        name,
        description or f"{name}, from its data sheet",
        source or "Data sheet, entered by hand",
    )
    if out is None:
        click.echo(text, nl=False)
    else:
        if out.exists() and not force:
            raise click.ClickException(
                f"{out}: there is such a file already; --force overwrites it"
            )
        write_whole(out, text)
        click.echo(f"written: {out}")
    if motor.contradictions:
        for sentence in motor.contradictions:
            click.echo(f"mfpcc: the sheet contradicts itself: {sentence}", err=True)
        click.get_current_context().exit(1)


def _counted(option: str, given: str | None, number: Quantity | None, *, before: str = "") -> str:
    """How a constant counts, from an option and from its unit; they must not contradict."""
    from mfpcc_experiments.datasheet import SheetError

    by_unit = number.counted if number is not None else None
    if given is None:
        return f"{before}{by_unit or 'rms'}"
    if by_unit is not None and not given.endswith(by_unit):
        raise SheetError(f"the unit of {option} says '{by_unit}', its option '{given}'")
    return given

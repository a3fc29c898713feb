"""`mfpcc export`: a recording for other tools."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(short_help="Write a recording as a CSV, Parquet or MATLAB file.")
@click.argument("bag", type=click.Path(path_type=Path))
@click.option(
    "--format",
    "form",
    required=True,
    metavar="csv|parquet|mat",
    help="csv, parquet (needs the package pyarrow), or mat (MATLAB, Octave).",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="File to write.  [default: the name of BAG, here]",
)
@click.option(
    "--namespace",
    metavar="/AXIS",
    help="Which axis, of a recording that holds several.",
)
@click.option("--force", is_flag=True, help="Replace a file that is there already.")
def command(bag: Path, form: str, out: Path | None, namespace: str | None, force: bool) -> None:
    """Write a recording as a table: a row per PWM period, columns named with their units.

    The waveform within the periods, where it was recorded, is a second table: in csv and parquet a
    file of its own, <name>_oversampled.
    """
    from mfpcc_experiments.bags import recording
    from mfpcc_experiments.progress import progress_bar
    from mfpcc_experiments.reporting import export
    from pwm_node.names import unknown

    if form not in export.FORMATS:
        raise click.UsageError(unknown("format", form, export.FORMATS), click.get_current_context())
    name = bag.resolve().name.removesuffix(".mcap")
    path = out if out is not None else Path(f"{name}.{form}")
    if not path.parent.is_dir():
        raise click.ClickException(f"{path.parent}: there is no such folder")
    for file in (path, path.with_name(f"{path.stem}_oversampled{path.suffix}")):
        if file.exists() and not force:
            raise click.ClickException(f"{file} is there already: --force replaces it")
    with progress_bar() as begin:
        found = recording.read(bag, namespace=namespace, progress=begin("read", 1.0))
    for note in found.notes:
        click.echo(f"{note.severity}: {note.text}", err=True)
    for file in export.export(found, path, form):
        click.echo(f"written: {file}")

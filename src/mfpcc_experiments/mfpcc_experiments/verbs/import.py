"""`mfpcc import`: a measured drive's file into a bag."""

from __future__ import annotations

from pathlib import Path

import click

from mfpcc_experiments import completion


@click.command(short_help="Import a measured drive's CSV, Parquet or MATLAB file.")
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--map",
    "chart",
    required=True,
    metavar="NAME|FILE",
    shell_complete=completion.maps,
    help="What the columns are: a map that `mfpcc list` shows, or a YAML file.",
)
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path),
    help="Folder of the bag.",
)
@click.option("--force", is_flag=True, help="Replace a bag that is there already.")
def command(file: Path, chart: str, out: Path, force: bool) -> None:
    """Write a bag of FILE, which compare, replay and identify read.

    A file is read in pieces, so that its size does not matter (but for .mat, which is read as a
    whole). What the file does not hold is said; what can be judged without it can be.
    """
    from mfpcc_experiments import importing
    from mfpcc_experiments.progress import progress_bar

    chosen = importing.load(chart)
    with progress_bar() as begin:
        result = importing.import_file(
            file, chosen, out, force=force, progress=begin("import", 1.0)
        )
    for note in result.notes:
        click.echo(f"note: {note}", err=True)
    click.echo(
        f"written: {out}, {result.samples} samples and {result.commands} commands at "
        f"{1.0 / result.T_s:.6g} Hz"
    )

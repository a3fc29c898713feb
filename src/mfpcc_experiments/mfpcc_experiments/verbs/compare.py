"""`mfpcc compare`: metrics, figures and a report from recordings."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click


@click.command(short_help="Compare recordings: table, figures and report.")
@click.argument("bags", metavar="BAG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/compare"),
    show_default=True,
    help="Folder for the results.",
)
@click.option(
    "--window",
    "window_s",
    type=float,
    nargs=2,
    metavar="BEGIN END",
    help="Time to evaluate (s), in all recordings.  [default: each recording's own]",
)
@click.option(
    "--namespace",
    metavar="/AXIS",
    help="Which axis, of a recording that holds several.",
)
@click.option("--force", is_flag=True, help="Replace results that are there already.")
@click.option(
    "--strict",
    is_flag=True,
    help="Exit with 3 also where a recording is not complete, or the figures leave something out.",
)
def command(
    bags: tuple[Path, ...],
    out: Path,
    window_s: tuple[float, float] | None,
    namespace: str | None,
    force: bool,
    strict: bool,
) -> None:
    """Compare recordings: a table, and metrics.json, report.html and figures in a folder.

    BAG is a recording (its folder or one of its files: MCAP or sqlite3, packed or not), or a folder
    with recordings in it, as `mfpcc run` leaves it.

    The exit code is 3 where a recording is of a drive that did not do what was asked for (a trip,
    a fallback, gates off or messages missing in the window): the notes below the table say what.
    """
    from mfpcc_experiments.bags import bags_in
    from mfpcc_experiments.files import result_folder
    from mfpcc_experiments.progress import progress_bar
    from mfpcc_experiments.reporting import compare

    if window_s is not None and not 0.0 <= window_s[0] < window_s[1] < math.inf:
        raise click.UsageError(
            f"--window {window_s[0]:g} {window_s[1]:g}: 0 <= BEGIN < END is expected (s)",
            click.get_current_context(),
        )
    recordings = [recording for bag in bags for recording in bags_in(bag)]
    with result_folder(out, force=force) as folder:
        with progress_bar() as begin:
            rows = compare.compare(
                recordings,
                folder,
                window_s=window_s,
                namespace=namespace,
                progress=begin("compare", 1.0),
            )
    conclude(rows, out, strict=strict)


def conclude(rows: list[dict[str, Any]], out: Path, *, strict: bool = False) -> None:
    """Print the table with its notes, and where the report is; end with the code of the notes."""
    from mfpcc_experiments import notes
    from mfpcc_experiments.reporting import table

    table.print_table(rows)
    click.echo(f"report: {out / 'report.html'}")
    click.get_current_context().exit(notes.exit_code(rows, strict=strict))

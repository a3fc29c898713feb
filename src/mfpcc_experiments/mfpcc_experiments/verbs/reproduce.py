"""`mfpcc reproduce`: every figure and number of the paper, ours beside the published ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mfpcc_experiments import completion
from mfpcc_experiments.running import ENGINES

if TYPE_CHECKING:
    from mfpcc_experiments.paper.reproduce import Results, Statement


@click.command(short_help="Make every figure and number of the paper, ours beside the published.")
@click.option(
    "--figure",
    "figures",
    multiple=True,
    metavar="6|7|8|9|10",
    help="Only this figure; may be given several times.  [default: all, and the computing times]",
)
@click.option(
    "--engine",
    default="inprocess",
    show_default=True,
    metavar="|".join(ENGINES),
    shell_complete=completion.names(*ENGINES),
    help="Real nodes on a real graph, or the same plant and schemes without ROS.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/reproduce"),
    show_default=True,
    help="Folder for recordings and results.",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of all noise."
)
@click.option("--force", is_flag=True, help="Replace results that are there already.")
def command(figures: tuple[str, ...], engine: str, out: Path, seed: int, force: bool) -> None:
    """Run the paper's experiments, and compare what the paper says with our results.

    The folder then holds report.html, the figures, statements.json, metrics.json and all
    recordings. It takes a minute; with --engine ros two or three. The exit code is 3 where a run
    failed to do what it was meant to do: the notes say what, and its figures are not judged.
    """
    from mfpcc_experiments import notes
    from mfpcc_experiments.files import result_folder
    from mfpcc_experiments.paper import reproduce
    from pwm_node.names import unknown

    context = click.get_current_context()
    for figure in figures:
        if figure not in reproduce.FIGURES:
            raise click.UsageError(unknown("figure", figure, reproduce.FIGURES), context)
    if engine not in ENGINES:
        raise click.UsageError(unknown("engine", engine, ENGINES), context)
    wanted = tuple(figure for figure in reproduce.FIGURES if figure in figures or not figures)
    with result_folder(out, force=force) as folder:
        said, results = _reproduce(wanted, engine, seed, folder, timed=not figures)
    _show(said, results)
    click.echo(f"report: {out / 'report.html'}")
    context.exit(notes.exit_code([run.row for run in results.runs], strict=True))


def _reproduce(
    figures: Sequence[str], engine: str, seed: int, folder: Path, *, timed: bool
) -> tuple[list[Statement], Results]:
    """Run, measure, draw and write, with a progress bar."""
    import json

    from mfpcc_experiments.paper import paper_figures, reproduce, reproduce_report
    from mfpcc_experiments.progress import progress_bar
    from mfpcc_experiments.reporting.compare import write_whole
    from mfpcc_experiments.running import run, scenario
    from pwm_node import compiled

    runs, pairs = [], reproduce.plan(figures)
    with progress_bar() as begin:
        compiled.announce()  # above the bar, which stands still meanwhile
        tell = begin("run", len(pairs))
        for n, (experiment, scheme) in enumerate(pairs):
            wanted = scenario.load(experiment)
            run.run(
                wanted,
                scheme,
                engine,
                folder / experiment,
                seed,
                lambda done, n=n, total=wanted.periods: tell(n + done / total),  # type: ignore[misc]
            )
            runs.append(reproduce.measure(experiment, scheme, folder / experiment / scheme))
        times = {}
        if timed:
            bag = folder / "steady_750_2" / "mls_mfpcc"
            times = reproduce.step_times(bag, begin("times", 1.0))
        results = reproduce.Results(runs, times)
        said = reproduce.statements(results, figures)
        tell = begin("figures", len(figures))
        (folder / "figures").mkdir()
        drawn = []
        for entry in paper_figures.draw(results, figures, folder / "figures"):
            drawn.append(entry)
            tell(figures.index(entry[0]) + 1)
        write_whole(
            folder / "report.html",
            reproduce_report.render(results, said, drawn, engine=engine, seed=seed),
        )
        write_whole(folder / "statements.json", reproduce.to_json(results, said) + "\n")
        rows = [measured.row for measured in runs]
        write_whole(folder / "metrics.json", json.dumps(rows, indent=2, ensure_ascii=False) + "\n")
    return said, results


def _show(said: Sequence[Statement], results: Results) -> None:
    """Print the statements, how many are confirmed, and what went wrong."""
    from rich.console import Console
    from rich.table import Table

    from mfpcc_experiments import notes
    from mfpcc_experiments.paper.reproduce import FITTED
    from mfpcc_experiments.paper.reproduce_report import counts, labels

    colours = {
        "confirmed": "green",
        "differs": "yellow",
        "not confirmed": "red",
        "not judged": "red",
    }
    table = Table(box=None, pad_edge=False, header_style="bold", expand=True)
    table.add_column("", justify="right", width=5)
    table.add_column("the paper", ratio=5)
    table.add_column("published", ratio=2)
    table.add_column("ours", ratio=3)
    table.add_column("", width=13)
    for s in said:
        verdict = f"[{colours.get(s.verdict, 'red')}]{s.verdict}[/]"
        table.add_row(s.figure, s.says, s.published, s.ours, verdict)
    console = Console(highlight=False)
    console.print(table)
    click.echo(", ".join(f"{verdict} {count}" for verdict, count in counts(said)))
    click.echo(FITTED)
    for line in notes.lines([run.row for run in results.runs], labels(results)):
        if not line.startswith(notes.Severity.INFO):
            click.echo(line)

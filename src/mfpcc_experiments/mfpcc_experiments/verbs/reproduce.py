"""`mfpcc reproduce`: every figure and number of the paper, ours beside the published ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mfpcc_experiments import completion
from mfpcc_experiments.running import ENGINES

if TYPE_CHECKING:
    from mfpcc_experiments.paper.judging import Statement
    from mfpcc_experiments.paper.runs import Results


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
    help="Of the recordings: real nodes on a real graph, or the same without ROS.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/reproduce"),
    show_default=True,
    help="Folder for recordings and results.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of the recordings' noise; the verdicts take those behind it, too.",
)
@click.option(
    "--seeds",
    type=click.IntRange(min=1),
    default=20,
    show_default=True,
    help="How many seeds the verdicts rest on.",
)
@click.option("--force", is_flag=True, help="Replace results that are there already.")
def command(
    figures: tuple[str, ...], engine: str, out: Path, seed: int, seeds: int, force: bool
) -> None:
    """Run the paper's experiments, and compare what the paper says with our results.

    Each statement is judged over many seeds of the noise. The runs of the first seed are recorded,
    with the engine asked for; the others run in process, where they give the same samples.

    The folder then holds report.html, the figures, statements.json, metrics.json (of all seeds) and
    the recordings. It takes a minute or two; with --engine ros two more. The exit code is 3 where a
    run failed to do what it was meant to do: the notes say what.
    """
    from mfpcc_experiments import notes
    from mfpcc_experiments.files import result_folder
    from mfpcc_experiments.paper.runs import FIGURES
    from pwm_node.names import unknown

    context = click.get_current_context()
    for figure in figures:
        if figure not in FIGURES:
            raise click.UsageError(unknown("figure", figure, FIGURES), context)
    if engine not in ENGINES:
        raise click.UsageError(unknown("engine", engine, ENGINES), context)
    wanted = tuple(figure for figure in FIGURES if figure in figures or not figures)
    with result_folder(out, force=force) as folder:
        judged, results = _reproduce(
            wanted, engine, range(seed, seed + seeds), folder, timed=not figures
        )
    _show(judged, results)
    click.echo(f"report: {out / 'report.html'}")
    context.exit(notes.exit_code([run.row for run in results.runs], strict=True))


def _reproduce(
    figures: Sequence[str], engine: str, seeds: Sequence[int], folder: Path, *, timed: bool
) -> tuple[list[Statement], Results]:
    """Run, measure, draw and write, with a progress bar."""

    from mfpcc_experiments.bags import recording
    from mfpcc_experiments.files import write_rows, write_whole
    from mfpcc_experiments.paper import figures as paper_figures
    from mfpcc_experiments.paper import report, runs, statements
    from mfpcc_experiments.progress import progress_bar
    from mfpcc_experiments.running import run, scenario
    from pwm_node import compiled

    measured, shown, pairs = [], {}, runs.plan(figures)
    with progress_bar() as begin:
        compiled.announce()  # above the bar, which stands still meanwhile
        tell = begin("record", len(pairs))
        for n, (experiment, scheme) in enumerate(pairs):
            wanted = scenario.load(experiment)
            run.run(
                wanted,
                scheme,
                engine,
                folder / experiment,
                seeds[0],
                lambda done, n=n, total=wanted.periods: tell(n + done / total),  # type: ignore[misc]
            )
            found = recording.read(folder / experiment / scheme)
            measured.append(runs.measure(found))
            shown[experiment, scheme] = runs.shown(found)
        if len(seeds) > 1:
            tell = begin("other seeds", len(pairs) * (len(seeds) - 1))
            measured += runs.measure_seeds(pairs, seeds[1:], tell)
        times = {}
        if timed:
            bag = folder / "steady_750_2" / "mls_mfpcc"
            times = runs.step_times(bag, begin("times", 1.0))
        results = runs.Results(measured, shown, times)
        judged = statements.statements(results, figures)
        tell = begin("figures", len(figures))
        (folder / "figures").mkdir()
        drawn = []
        for entry in paper_figures.draw(results, figures, folder / "figures"):
            drawn.append(entry)
            tell(figures.index(entry[0]) + 1)
        write_whole(folder / "report.html", report.render(results, judged, drawn, engine=engine))
        write_whole(folder / "statements.json", statements.to_json(results, judged) + "\n")
        rows = [{**each.row, "of_paper": each.more} for each in measured]
        write_rows(folder, rows)
    return judged, results


def _show(judged: Sequence[Statement], results: Results) -> None:
    """Print the statements, how many are confirmed, and what went wrong."""
    from rich.console import Console
    from rich.table import Table

    from mfpcc_experiments import notes
    from mfpcc_experiments.paper.judging import BY_CHANCE, BY_CONSTRUCTION, CONFIRMED, DIFFERS
    from mfpcc_experiments.paper.report import agreement, counts, labels
    from mfpcc_experiments.paper.statements import FITTED

    colours = {CONFIRMED: "green", BY_CONSTRUCTION: "dim", DIFFERS: "yellow", BY_CHANCE: "yellow"}
    table = Table(box=None, pad_edge=False, header_style="bold", expand=True)
    table.add_column("", justify="right", width=5)
    table.add_column("the paper", ratio=5)
    table.add_column("published", ratio=2)
    table.add_column("ours", ratio=3)
    table.add_column("", width=17)
    for s in judged:
        verdict = f"[{colours.get(s.verdict, 'red')}]{s.verdict}[/]"
        if agreement(s):
            verdict += f"\n[dim]{agreement(s)}[/]"
        table.add_row(s.figure, s.says, s.published, s.ours, verdict)
    console = Console(highlight=False)
    console.print(table)
    click.echo(", ".join(f"{verdict} {count}" for verdict, count in counts(judged)))
    click.echo(
        f"over {len(results.seeds)} seed{'s' if len(results.seeds) > 1 else ''} of the noise"
    )
    click.echo(FITTED)
    for line in notes.lines([run.row for run in results.runs], labels(results)):
        if not line.startswith(notes.Severity.INFO):
            click.echo(line)

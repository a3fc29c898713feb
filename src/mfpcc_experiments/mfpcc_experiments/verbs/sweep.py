"""`mfpcc sweep`: robustness maps, from many thousand runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mfpcc_experiments import completion

if TYPE_CHECKING:
    from mfpcc_experiments.sweeping.folder import Folder
    from mfpcc_experiments.sweeping.plan import Plan


@click.command(short_help="Run an experiment many thousand times, with what varies from a file.")
@click.argument("spec")
@click.option(
    "--scheme",
    "schemes",
    multiple=True,
    metavar="NAME",
    shell_complete=completion.schemes,
    help="Scheme to run; may be given several times.  [default: those of the file]",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder for rows and report.  [default: out/sweeps/NAME]",
)
@click.option("--resume", is_flag=True, help="Go on with what is in the folder.")
@click.option("--yes", is_flag=True, help="Do not ask, however long it takes.")
@click.option("--scheduler", metavar="ADDRESS", help="Workers of this Dask scheduler do it.")
@click.option(
    "--scheduler-file",
    type=click.Path(path_type=Path),
    help="The same; the file is the one that `dask scheduler --scheduler-file` wrote.",
)
def command(
    spec: str,
    schemes: tuple[str, ...],
    out: Path | None,
    resume: bool,
    yes: bool,
    scheduler: str | None,
    scheduler_file: Path | None,
) -> None:
    """Run the sweep SPEC (a file, or a name of config/sweeps) on all cores or on a cluster.

    The folder is all the state there is: what was done before Ctrl-C, or before the machine went
    down, is kept, and --resume goes on. A row is run again with a full recording by
    `mfpcc run --from FOLDER --row N`. docs/sweeps.md tells what SPEC may hold.
    """
    from mfpcc_experiments.sweeping import folder as folders
    from mfpcc_experiments.sweeping import spec as specs
    from mfpcc_experiments.sweeping import work
    from mfpcc_experiments.sweeping.errors import needs
    from mfpcc_experiments.sweeping.plan import Plan
    from pwm_node import compiled, yaml_files

    needs("pyarrow")
    if scheduler and scheduler_file:
        raise click.UsageError("--scheduler and --scheduler-file name a scheduler each")
    wanted = specs.load(yaml_files.find("sweeps", spec))
    for scheme in schemes:
        specs.known_scheme(scheme)
    plan = Plan(wanted, tuple(dict.fromkeys(schemes)))
    plan.check()
    compiled.announce()
    _ask(plan, yes)
    folder = folders.begin(
        out or Path("out/sweeps") / wanted.name, plan, work.fingerprint(), resume=resume
    )
    _run(folder, scheduler, scheduler_file)


def _ask(plan: Plan, yes: bool) -> None:
    """Refuse what takes very long, until somebody has said that it is meant."""
    from mfpcc_experiments.sweeping import estimate

    if yes or not (plan.points >= estimate.MANY_POINTS or estimate.may_be_long(plan)):
        return
    grids = f" ({plan.points:,} points of the grids)" if plan.points > 1 else ""
    raise click.UsageError(
        f"{plan.rows:,} runs{grids} take about {estimate.shown(plan)} here: --yes if that is meant"
    )


def _run(folder: Folder, scheduler: str | None, scheduler_file: Path | None) -> None:
    from mfpcc_experiments.sweeping import local, work
    from mfpcc_experiments.sweeping.progress import counted

    done = set(folder.done())
    left = [n for n in range(folder.plan.chunks) if n not in done]
    jobs = work.jobs(folder.plan, left)
    results: Iterator[tuple[int, bytes]]
    rows_before = sum(folder.rows_of(n) for n in done)
    with (
        counted("sweep", "runs", folder.plan.rows, rows_before) as progress,
        local.pool(min(local.cores(), len(left))) as pool,
    ):
        if scheduler or scheduler_file:
            from mfpcc_experiments.sweeping import cluster

            results = cluster.run(jobs, scheduler, scheduler_file, progress.say)
        else:
            results = pool.run(jobs)
        try:
            for number, data in results:
                folder.keep(number, data)
                progress.add(folder.rows_of(number))
        except KeyboardInterrupt:
            progress.say(
                f"{progress.done:,} of {folder.plan.rows:,} runs are in {folder.path}: --resume "
                "goes on"
            )
            raise
    # matplotlib takes its time to load
    from mfpcc_experiments.sweeping import report

    click.echo(f"report: {report.write(folder)}")

"""`mfpcc run`: one recording per scheme, then the comparison."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mfpcc_experiments import completion
from mfpcc_experiments.running import ENGINES
from mfpcc_experiments.verbs.compare import conclude

if TYPE_CHECKING:
    from mfpcc_experiments.running import Scenario


@click.command(short_help="Run an experiment with one or more schemes, and compare.")
@click.argument("experiment", required=False, shell_complete=completion.experiments)
@click.option(
    "--scheme",
    "schemes",
    multiple=True,
    metavar="NAME",
    shell_complete=completion.schemes,
    help="Scheme to run; may be given several times.  [default: all there are]",
)
@click.option(
    "--engine",
    default="ros",
    show_default=True,
    metavar="|".join(ENGINES),
    shell_complete=completion.names(*ENGINES),
    help="Real nodes on a real graph, or the same plant and schemes without ROS.",
)
@click.option("--separate", is_flag=True, help="Run plant and controller in two processes.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder for recordings and results.  [default: out/EXPERIMENT]",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of all noise."
)
@click.option(
    "--seeds",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    metavar="N",
    help="Run each scheme with N seeds, from --seed on: differences can then be told from chance.",
)
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="NAME=VALUE",
    shell_complete=completion.changes,
    help="Replace the experiment's value of one of its keys, or of a parameter of a node, "
    "such as duration=0.5 or mls.window=10; may be given several times.",
)
@click.option(
    "--from",
    "sweep",
    type=click.Path(path_type=Path),
    help="Run a row (--row) of the sweep in this folder, in place of EXPERIMENT; without --engine "
    "in process.",
)
@click.option("--row", type=click.IntRange(min=0), metavar="N", help="Which row of the sweep.")
@click.option("--force", is_flag=True, help="Replace results that are there already.")
def command(
    experiment: str | None,
    schemes: tuple[str, ...],
    engine: str,
    separate: bool,
    out: Path | None,
    seed: int,
    seeds: int,
    changes: tuple[str, ...],
    sweep: Path | None,
    row: int | None,
    force: bool,
) -> None:
    """Run EXPERIMENT (a name of `mfpcc list`, or a file) once per scheme, and compare.

    The folder then holds one recording per scheme and seed, metrics.json, report.html and figures.
    Which scheme is best is marked where several seeds (--seeds) tell it from chance. The exit
    code is 3 where the drive did not do what was asked for (a trip, a fallback, messages that are
    missing, a pace that was not kept): the notes below the table say what.
    """
    from mfpcc_controller.firmware import whole_name
    from mfpcc_controller.parameters import SCHEMES
    from mfpcc_experiments.files import result_folder
    from mfpcc_experiments.running import scenario
    from pwm_node import yaml_files
    from pwm_node.names import unknown
    from pwm_node.parameters import ParameterError

    context = click.get_current_context()
    if engine not in ENGINES:
        raise click.UsageError(unknown("engine", engine, ENGINES), context)
    if separate and engine != "ros":
        raise click.UsageError("--separate starts two ROS processes: --engine ros only", context)
    if sweep is not None:
        wanted, schemes, seed, engine = _of_sweep(context, sweep)
    elif row is not None:
        raise click.UsageError("--row is of a sweep: --from names its folder", context)
    elif experiment is None:
        raise click.UsageError("Missing argument 'EXPERIMENT'", context)
    else:
        try:
            path = yaml_files.find("experiments", experiment)
        except yaml_files.FileError as error:
            raise click.UsageError(str(error), context) from None
        wanted = scenario.load(path)
    schemes = tuple(dict.fromkeys(map(whole_name, schemes))) or SCHEMES
    try:
        wanted = scenario.changed(wanted, changes)
        for scheme in schemes:
            wanted.node_parameters(scheme, seed + seeds - 1)
    except ParameterError as error:
        raise click.UsageError(error.reason, context) from None

    out = out or Path("out") / wanted.name
    with result_folder(out, force=force) as folder:
        rows = _run_and_compare(
            wanted, schemes, engine, separate, folder, range(seed, seed + seeds)
        )
    # what we record ourselves has to be whole
    conclude(rows, out, strict=True)


def _of_sweep(context: click.Context, sweep: Path) -> tuple[Scenario, tuple[str, ...], int, str]:
    """Experiment, scheme, seed and engine of a row of a sweep."""
    from click.core import ParameterSource

    from mfpcc_experiments.sweeping import again

    given = context.params
    if given["experiment"] is not None:
        raise click.UsageError("--from says what is run: no EXPERIMENT beside it", context)
    if given["row"] is None:
        raise click.UsageError("--from needs --row: which row of the sweep", context)
    for name in ("seed", "seeds"):
        if context.get_parameter_source(name) != ParameterSource.DEFAULT:
            raise click.UsageError(f"--from brings the seed of the row: no --{name}", context)
    wanted, scheme, seed = again.experiment(sweep, given["row"])
    chosen = context.get_parameter_source("engine") != ParameterSource.DEFAULT
    engine = given["engine"] if chosen else "inprocess"
    return wanted, given["schemes"] or (scheme,), seed, engine


def _run_and_compare(
    scenario: Scenario,
    schemes: tuple[str, ...],
    engine: str,
    separate: bool,
    folder: Path,
    seeds: Sequence[int],
) -> list[dict[str, Any]]:
    """Record each scheme and seed and compare them, with a progress bar."""
    from mfpcc_experiments.progress import progress_bar
    from mfpcc_experiments.reporting import compare
    from mfpcc_experiments.running import run
    from pwm_node import compiled

    several = len(seeds) > 1
    names = _recording_names(schemes)
    bags: dict[str, list[Path]] = {scheme: [] for scheme in schemes}
    with progress_bar() as begin:
        compiled.announce()  # above the bar, which stands still meanwhile
        # Seed by seed, so that what changes with time on this machine is no scheme's doing.
        for seed in seeds:
            for scheme in schemes:
                name = f"{names[scheme]}_seed{seed}" if several else names[scheme]
                progress = begin(name, scenario.periods)
                run.run(
                    scenario, scheme, engine, folder, seed, progress, separate=separate, name=name
                )
                bags[scheme].append(folder / name)
        paths = [path for each in bags.values() for path in each]
        return compare.compare(paths, folder, progress=begin("compare", 1.0))


def _recording_names(schemes: Sequence[str]) -> dict[str, str]:
    """Names of the recordings of schemes; a firmware's is that of its folder."""
    from mfpcc_controller.firmware import folder_of

    names: dict[str, str] = {}
    for scheme in schemes:
        folder = folder_of(scheme)
        name = f"firmware_{folder.name}" if folder else scheme
        alike = sum(other.startswith(name) for other in names.values()) if folder else 0
        names[scheme] = f"{name}_{alike + 1}" if alike else name
    return names

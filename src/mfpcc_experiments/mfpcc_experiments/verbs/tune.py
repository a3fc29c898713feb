"""`mfpcc tune`: the best parameters of every scheme, and who is the best with them."""

from __future__ import annotations

from pathlib import Path

import click

from mfpcc_experiments import completion


@click.command(short_help="Tune schemes by the same optimiser and budget, and compare them.")
@click.argument("schemes", nargs=-1, metavar="[SCHEME]...", shell_complete=completion.schemes)
@click.option(
    "--budget",
    type=click.IntRange(2, 10_000),
    required=True,
    metavar="N",
    help="Choices of parameters to look at, for each scheme in each repeat; one are the defaults.",
)
@click.option(
    "--repeats",
    type=click.IntRange(min=2),
    default=5,
    show_default=True,
    metavar="N",
    help="How often, with other seeds of optimiser, draws and noise: the intervals come from it.",
)
@click.option(
    "--scenarios",
    default="leaderboard",
    show_default=True,
    metavar="FILE",
    help="Ranges and drives: a name of config/tuning, or a file.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/tuning"),
    show_default=True,
    help="Folder for trials and page.",
)
@click.option(
    "--resume", is_flag=True, help="Go on with what is in the folder, if there is something."
)
def command(
    schemes: tuple[str, ...], budget: int, repeats: int, scenarios: str, out: Path, resume: bool
) -> None:
    """Tune each SCHEME (all that can be, where none is named) with the same budget.

    The optimiser sees one set of drives, and its choice is judged by another. The folder then holds
    every choice that was looked at, with its figures, and leaderboard.md: ranks, criteria, and what
    tuning gave. What was done before Ctrl-C is kept, and --resume goes on.
    """
    import shlex

    from mfpcc_experiments.files import write_whole
    from mfpcc_experiments.sweeping import local, work
    from mfpcc_experiments.sweeping.errors import needs
    from mfpcc_experiments.sweeping.progress import counted
    from mfpcc_experiments.sweeping.spec import known_scheme
    from mfpcc_experiments.tuning import page, tune
    from mfpcc_experiments.tuning import scenarios as files
    from mfpcc_experiments.tuning.folder import Folder
    from pwm_node import compiled, yaml_files

    for package in ("optuna", "pyarrow"):
        needs(package)
    found = files.load(yaml_files.find("tuning", scenarios))
    wanted = tuple(dict.fromkeys(schemes)) or tuple(found.ranges)
    for scheme in wanted:
        known_scheme(scheme)
        found.spaces(scheme)
    tuning = tune.Tuning(found, wanted, budget, repeats)
    compiled.announce()
    fingerprint = work.fingerprint()
    folder = Folder(
        out,
        {
            "schemes": list(wanted),
            "budget": budget,
            "repeats": repeats,
            "scenarios": found.model_dump(mode="json"),
            **fingerprint,
        },
        resume=resume,
    )
    with (
        counted("tune", "choices", tuning.steps, 0) as progress,
        local.pool(local.cores()) as pool,
    ):
        try:
            rows = tune.run(tuning, folder, pool, progress)
        except KeyboardInterrupt:
            progress.say(f"what is done is in {out}: --resume goes on")
            raise
    again = ["mfpcc", "tune", *schemes, "--budget", str(budget), "--repeats", str(repeats)]
    target = out / "leaderboard.md"
    write_whole(target, page.render(tuning, rows, shlex.join(again), _made_with()))
    click.echo(f"leaderboard: {target}")


def _made_with() -> str:
    """Date and versions, as a sentence."""
    import platform
    from datetime import date
    from importlib.metadata import version

    return (
        f"Last on {date.today().isoformat()}, with Python {platform.python_version()}, NumPy "
        f"{version('numpy')} and Optuna {version('optuna')}."
    )

"""`mfpcc replay`: the samples of a recording, fed to a scheme again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mfpcc_experiments import completion

if TYPE_CHECKING:
    from mfpcc_experiments.measuring import Replay, Samples
    from pwm_node.parameters import Table


@click.command(short_help="Feed a recording's samples to a scheme, open loop.")
@click.argument("bag", type=click.Path(path_type=Path))
@click.option(
    "--scheme",
    "schemes",
    multiple=True,
    metavar="NAME",
    shell_complete=completion.schemes,
    help="Scheme to ask; may be given several times.  [default: all there are]",
)
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="NAME=VALUE",
    help="Another value for a parameter of the controller, such as mls.window=10.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/replay"),
    show_default=True,
    help="Folder for the results.",
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
    help="Exit with 3 also where the recording is not complete, or the figures leave something "
    "out.",
)
def command(
    bag: Path,
    schemes: tuple[str, ...],
    changes: tuple[str, ...],
    out: Path,
    namespace: str | None,
    force: bool,
    strict: bool,
) -> None:
    """Feed the recorded samples of BAG to schemes: what would they have predicted and commanded?

    The recording's own scheme must give its own commands again; that is checked first. A folder
    then holds metrics.json and the figure. The loop is open: what a scheme commands here does not
    act on the motor, so it has no ripple and no THD; for those, run the experiment. The exit code
    is 3 if the recorded drive did not do what was asked for, or if a scheme gave no valid output.
    """
    from mfpcc_controller.firmware import whole_name
    from mfpcc_controller.parameters import SCHEMES, TABLE
    from mfpcc_experiments import notes
    from mfpcc_experiments.bags import recording
    from mfpcc_experiments.files import result_folder, write_rows
    from mfpcc_experiments.measuring import replay, replay_summary
    from mfpcc_experiments.progress import progress_bar
    from mfpcc_experiments.reporting import replay_figure
    from pwm_node import compiled
    from pwm_node.parameters import ParameterError

    schemes = tuple(dict.fromkeys(map(whole_name, schemes))) or SCHEMES
    try:
        for scheme in schemes:
            TABLE["scheme"].validate(scheme)
        values = dict(_change(TABLE, text) for text in changes)
    except ParameterError as wrong:
        raise click.UsageError(wrong.reason, click.get_current_context()) from None

    with result_folder(out, force=force) as folder:
        with progress_bar() as begin:
            read = recording.read(bag, namespace=namespace, progress=begin("read", 1.0))
            compiled.announce()  # above the bar, which stands still meanwhile
            verdict, error = _verify(replay.Samples(read, _motor(values)), begin("verify", 1.0))
            samples = replay.Samples(read, values)
            results = [replay.replay(samples, s, begin(s, 1.0)) for s in schemes]
        rows = [replay_summary.summary(samples, result) for result in results]
        replay_figure.draw(samples, results, rows, folder / "replay.png")
        write_rows(folder, rows)
    _print(samples, results, rows)
    click.echo(verdict)
    click.echo(f"figure: {out / 'replay.png'}")
    if error is not None:
        raise error
    click.get_current_context().exit(notes.exit_code(rows, strict=strict))


def _change(table: Table, text: str) -> tuple[str, Any]:
    """NAME=VALUE as a name and a value in its parameter's type."""
    from pwm_node.parameters import ParameterError

    name, equals, value = text.partition("=")
    if not equals:
        raise ParameterError(f"'--set {text}': NAME=VALUE is expected")
    if name == "scheme":
        raise ParameterError("the scheme is chosen by --scheme")
    return name, table[name].parse(value)


def _motor(values: dict[str, Any]) -> dict[str, Any]:
    """Of the changes, what a recording without a configuration needs to be read at all."""
    return {name: value for name, value in values.items() if name == "motor"}


def _verify(samples: Samples, progress: Callable[[float], None]) -> tuple[str, Exception | None]:
    """Ask the recording's own scheme; returns what to say of it, and the error where it fails."""
    from mfpcc_experiments.measuring import replay

    reason = samples.why_not_verifiable
    if reason:
        progress(1.0)
        return f"not checked whether it is reproduced: {reason}", None
    own = replay.verify(samples, progress)
    try:
        replay.require_same(samples, own)
    except replay.ReplayError as error:
        return "it is not reproduced", error
    count = int(samples.answered.sum())
    return f"reproduced: {samples.scheme} gives its {count} recorded commands again, exactly", None


def _print(samples: Samples, results: list[Replay], rows: list[dict[str, Any]]) -> None:
    """The table: one line per scheme, and what was recorded above them."""
    from rich.console import Console
    from rich.table import Table as Grid

    from mfpcc_experiments import notes
    from mfpcc_experiments.measuring import replay_summary, scheme_title

    def number(value: float | None, digits: int = 3) -> str:
        return "–" if value is None else f"{value:.{digits}f}"

    table = Grid(box=None, pad_edge=False, header_style="bold")
    table.add_column("", no_wrap=True)
    for title in (
        "error (A)\nd max",
        "\nq max",
        "\nd rms",
        "\nq rms",
        "duties\nmax",
        "volt. (V)\nrms",
        "same\n(%)",
        "first\nother",
    ):
        table.add_column(title, justify="right")

    def errors(row: dict[str, Any]) -> list[str]:
        return [number(row[f"lut_error_{k}"][a]) for k in ("max", "rms") for a in "dq"]

    recorded = replay_summary.recorded(samples)
    if recorded is not None:
        name = replay_summary.recorded_scheme(samples)
        table.add_row(f"recorded ({name})", *errors(recorded))
    for row in rows:
        first = row["first_difference"]
        table.add_row(
            scheme_title(row["scheme"]) if row["scheme"].startswith("firmware:") else row["scheme"],
            *errors(row),
            number(row["duty_difference_max"]),
            number(row["voltage_difference_rms"], 2),
            number(row["same_commands_percent"], 1),
            "–" if first is None else str(first),
        )
    begin, end = rows[0]["window_s"]
    Console(highlight=False).print(table)
    click.echo(
        f"evaluated from {begin:g} to {end:g} s. Against the recorded commands: largest difference "
        "of the duties, of the mean voltage, equal commands, and the first period with another one "
        "(of the whole recording)."
    )
    of_all = {"notes": [note.to_json() for note in replay_summary.recorded_notes(samples)]}
    own = [
        {"notes": [note.to_json() for note in replay_summary.own_notes(samples, result)]}
        for result in results
    ]
    titles = [f"recorded ({scheme_title(replay_summary.recorded_scheme(samples))})"]
    titles += [scheme_title(row["scheme"]) for row in rows]
    for line in notes.lines([of_all, *own], titles):
        click.echo(line)

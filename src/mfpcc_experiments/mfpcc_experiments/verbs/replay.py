"""`mfpcc replay`: the samples of a recording, fed to a scheme again."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mfpcc_experiments import completion

if TYPE_CHECKING:
    from mfpcc_experiments.identifying.bound import Bound
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
@click.option(
    "--window",
    "window_s",
    type=(float, float),
    metavar="BEGIN END",
    help="Evaluated time (s).  [default: the one stored in the recording, else all of it]",
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
    window_s: tuple[float, float] | None,
    force: bool,
    strict: bool,
) -> None:
    """Feed the recorded samples of BAG to schemes: what would they have predicted and commanded?

    The recording's own scheme must give its own commands again; that is checked first. A folder
    then holds metrics.json, figures and report.html. Beside the prediction errors of the schemes
    stand those of a linear model that is fitted to the recording by least squares, and of a
    predictor that says that nothing changes. The loop is open: what a scheme commands here does not
    act on the motor, so it has no ripple and no THD; for those, run the experiment. The exit code
    is 3 if the recorded drive did not do what was asked for, or if a scheme gave no valid output.
    """
    from mfpcc_controller.firmware import whole_name
    from mfpcc_controller.parameters import SCHEMES, TABLE
    from mfpcc_experiments import notes
    from mfpcc_experiments.bags import recording
    from mfpcc_experiments.files import result_folder, write_rows, write_whole
    from mfpcc_experiments.identifying import bound
    from mfpcc_experiments.measuring import replay, replay_summary
    from mfpcc_experiments.progress import progress_bar
    from mfpcc_experiments.reporting import bound_figure, replay_figure, replay_report
    from pwm_node import compiled
    from pwm_node.parameters import ParameterError

    schemes = tuple(dict.fromkeys(map(whole_name, schemes))) or SCHEMES
    if window_s is not None and not 0.0 <= window_s[0] < window_s[1] < math.inf:
        raise click.UsageError(
            f"--window {window_s[0]:g} {window_s[1]:g}: 0 <= BEGIN < END is expected (s)",
            click.get_current_context(),
        )
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
        found = bound.bound(samples, window_s)
        rows = [
            {**replay_summary.summary(samples, result, window_s), **bound.figures(found, result)}
            for result in results
        ]
        figures = {"replay": folder / "replay.png"}
        replay_figure.draw(samples, results, rows, figures["replay"], window_s)
        if found is not None:
            figures["bound"] = folder / "bound.png"
            bound_figure.draw(found, results, figures["bound"])
        write_whole(folder / "report.html", replay_report.render(samples, rows, figures, verdict))
        write_rows(folder, rows)
    _print(samples, results, rows, found, window_s)
    click.echo(verdict)
    click.echo(f"report: {out / 'report.html'}")
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


def _print(
    samples: Samples,
    results: list[Replay],
    rows: list[dict[str, Any]],
    found: Bound | None,
    window_s: tuple[float, float] | None,
) -> None:
    """The table: one line per scheme, and what was recorded above them."""
    from rich.console import Console
    from rich.table import Table as Grid

    from mfpcc_experiments import notes
    from mfpcc_experiments.identifying import bound
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
        "over\nLS",
        "duties\nmax",
        "volt. (V)\nrms",
        "same\n(%)",
        "first\nother",
    ):
        table.add_column(title, justify="right")

    def errors(row: dict[str, Any]) -> list[str]:
        return [number(row[f"lut_error_{k}"][a]) for k in ("max", "rms") for a in "dq"]

    if found is not None:
        for title, error in (
            ("nothing changes", found.unchanged),
            ("least squares", found.least_squares),
        ):
            ratio = bound.size(error) / bound.size(found.least_squares)
            table.add_row(title, *errors(replay_summary.of_errors(error)), number(ratio, 2))
    recorded = replay_summary.recorded(samples, window_s)
    if recorded is not None:
        name = replay_summary.recorded_scheme(samples, window_s)
        table.add_row(f"recorded ({name})", *errors(recorded))
    for row in rows:
        first = row["first_difference"]
        table.add_row(
            scheme_title(row["scheme"]) if row["scheme"].startswith("firmware:") else row["scheme"],
            *errors(row),
            number(row["over_least_squares"], 2),
            number(row["duty_difference_max"]),
            number(row["voltage_difference_rms"], 2),
            number(row["same_commands_percent"], 1),
            "–" if first is None else str(first),
        )
    begin, end = rows[0]["window_s"]
    Console(highlight=False).print(table)
    click.echo(
        f"evaluated from {begin:g} to {end:g} s. Over LS: rms of the error over that of a linear "
        "model fitted to the whole recording by least squares, at the same samples. Against the "
        "recorded commands: largest difference of the duties, of the mean voltage, equal commands, "
        "and the first period with another one (of the whole recording)."
    )
    of_all = {
        "notes": [note.to_json() for note in replay_summary.recorded_notes(samples, window_s)]
    }
    own = [
        {"notes": [note.to_json() for note in replay_summary.own_notes(samples, result)]}
        for result in results
    ]
    titles = [f"recorded ({scheme_title(replay_summary.recorded_scheme(samples, window_s))})"]
    titles += [scheme_title(row["scheme"]) for row in rows]
    for line in notes.lines([of_all, *own], titles):
        click.echo(line)

"""`mfpcc firmware`: a scheme as a project in C."""

from __future__ import annotations

from pathlib import Path

import click

from mfpcc_experiments import completion


@click.command(short_help="Write a scheme as a C99 project, with test vectors.")
@click.option(
    "--scheme",
    "names",
    multiple=True,
    required=True,
    metavar="NAME",
    shell_complete=completion.schemes,
    help="Scheme to translate, or 'all'; of several, the first is in control at the start.",
)
@click.option("--motor", metavar="NAME", help="Motor it is for.  [default: seed_750]")
@click.option(
    "--precision",
    type=click.Choice(["double", "single"]),
    default="double",
    show_default=True,
    help="Of its numbers.",
)
@click.option(
    "--trigonometry",
    type=click.Choice(["libm", "own"]),
    default="libm",
    show_default=True,
    help="Sine, cosine and the like: those of the C library, or part of the project.",
)
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="NAME=VALUE",
    help="Another value for a parameter of the controller, such as pi.bandwidth=700.",
)
@click.option(
    "--vectors",
    type=click.Path(path_type=Path),
    metavar="BAG",
    help="Recording whose samples are the test's.  [default: a drive is simulated for them]",
)
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder for the project."
)
@click.option("--force", is_flag=True, help="Replace a firmware that is there already.")
def command(
    names: tuple[str, ...],
    motor: str | None,
    precision: str,
    trigonometry: str,
    changes: tuple[str, ...],
    vectors: Path | None,
    out: Path,
    force: bool,
) -> None:
    """Translate the controller with a scheme to C.

    The folder then holds the source, the parameters, an example and a test with recorded samples;
    its README says how to build it. `--scheme firmware:FOLDER` runs it in the simulation.
    """
    from mfpcc_controller.firmware import MANIFEST
    from mfpcc_controller.parameters import TABLE
    from mfpcc_experiments.files import result_folder
    from mfpcc_experiments.firmware import project
    from pwm_node import compiled
    from pwm_node.parameters import ParameterError

    try:
        values = dict(_change(text) for text in changes)
        if motor is not None:
            values["motor"] = motor
        TABLE.validate(values)
    except ParameterError as wrong:
        raise click.UsageError(wrong.reason, click.get_current_context()) from None
    choice = project.chosen(names, values, precision == "single", trigonometry)
    with result_folder(out, force=force, mark=MANIFEST) as folder:
        compiled.announce()
        project.write(choice, folder, out, vectors)
    click.echo(f"{', '.join(choice.all_schemes)} in C: {out}")
    click.echo(f"its README says how to build it; in the simulation: --scheme firmware:{out}")


def _change(text: str) -> tuple[str, object]:
    """NAME=VALUE as a name and a value in its parameter's type."""
    from mfpcc_controller.parameters import TABLE
    from pwm_node.parameters import ParameterError

    name, equals, value = text.partition("=")
    if not equals:
        raise ParameterError(f"'--set {text}': NAME=VALUE is expected")
    if name in ("scheme", "motor"):
        raise ParameterError(f"the {name} is chosen by --{name}")
    return name, TABLE[name].parse(value)

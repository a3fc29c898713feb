"""`mfpcc list`: what there is to run."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import click


@click.command()
def command() -> None:
    """Show the experiments, schemes, motors and maps of measured files there are."""
    from mfpcc_controller.parameters import TABLE
    from mfpcc_experiments.importing import mapping
    from mfpcc_experiments.running import scenario
    from pmsm_sim import motor
    from pwm_node import yaml_files

    _show("experiments", yaml_files.available("experiments"), scenario.load)
    _show("schemes", TABLE["scheme"].choices)
    _show("motors", yaml_files.available("motors"), motor.load)
    _show("maps", yaml_files.available("maps"), mapping.load)


def _show(title: str, names: Iterable[str], load: Callable[[str], Any] | None = None) -> None:
    """Print names, with the descriptions of the files they stand for."""
    from pwm_node.yaml_files import FileError

    click.echo(f"{title}:")
    for name in names:
        description = ""
        if load is not None:
            try:
                description = load(name).description
            except FileError as error:  # one bad file must not hide the good ones
                description = f"(cannot be used: {error})"
        click.echo(f"  {name:<16}  {description}".rstrip())

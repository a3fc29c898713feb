"""`mfpcc recover`: repair a recording whose writer was killed."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(short_help="Repair a recording whose writer was killed.")
@click.argument("bag", type=click.Path(path_type=Path))
def command(bag: Path) -> None:
    """Repair BAG, a recording whose writer was killed before it could finish it."""
    from mfpcc_experiments.bags import recover
    from pwm_node import interrupts

    with interrupts.undone():
        report = recover.recover(bag)
    click.echo(report)

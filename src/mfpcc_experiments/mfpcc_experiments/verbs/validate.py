"""`mfpcc validate`: the proofs of the simulated drive, and their figures."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(short_help="Check the simulated drive, with figures.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("out/validation"),
    show_default=True,
    help="Folder of the figures.",
)
@click.option(
    "--duration",
    type=click.FloatRange(0.001, 10.0),
    default=0.2,
    show_default=True,
    help="Simulated time (s) for which the closed loop is compared with an independent "
    "integration.",
)
@click.option(
    "--costs/--no-costs", default=True, help="Also measure the computing time of each effect."
)
def command(out: Path, duration: float, costs: bool) -> None:
    """Check the simulated drive against an independent integration and against theory.

    The exit code is 1 if a limit is not kept. The figures of docs/validation.md are drawn with
    --out docs/validation.
    """
    from rich.console import Console
    from rich.table import Table

    from mfpcc_experiments.progress import progress_bar
    from mfpcc_experiments.proofs import effects, validation

    out.mkdir(parents=True, exist_ok=True)
    with progress_bar() as begin:
        tick = begin("validate", 1.0)
        results = validation.validate(out, duration=duration, tick=tick)
    table = Table("proof", "largest", "limit", "")
    for result in results:
        table.add_row(
            result.what,
            f"{result.value:.2g} {result.unit}",
            f"{result.limit:.2g} {result.unit}",
            "holds" if result.holds else "[bold red]EXCEEDED",
        )
    Console().print(table)
    if costs:
        table = Table("effect", "us per period", title="Cost of the plant, each effect by itself")
        for name, cost in effects.costs().items():
            table.add_row(name, f"{cost:.2f}")
        Console().print(table)
    click.echo(f"figures: {out}")
    if not all(result.holds for result in results):
        click.get_current_context().exit(1)

"""Every speed figure beside its reference, measured now: `make bench`, or `python bench`.

Each group of figures is one file. What is compared is measured in turns within the same run, since
the speed of a machine drifts, and a figure is the median over the rounds.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import drives
from figures import Figure, machine, write
from rich.console import Console
from rich.table import Table

#: Groups, in the order of the table; each is a module with `measure(quick)`.
GROUPS = (
    *("loop", "processes", "paced", "recording", "live"),
    *("engine", "checks", "effects", "breakdown", "sweeps"),
)

_WIDTH = 140  # of the table, also where the terminal is narrower or there is none

RESULTS = Path(__file__).with_name("results.json")


def main() -> int:
    """Measure, print the table, write ``results.json``; 1 where a figure falls short."""
    arguments = _arguments()
    # A graph of its own: a drive that somebody runs here is not to be met.
    os.environ["ROS_DOMAIN_ID"] = drives.own_domain()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    console = Console()
    console.width = max(console.width, _WIDTH)
    found: list[Figure] = []
    began_with = machine()
    for name in arguments.only or GROUPS:
        with console.status(f"measuring: {name}"):
            found += importlib.import_module(name).measure(quick=arguments.quick)
    console.print(_table(found))
    console.print(
        "{processor}, {cores} cores, Python {python}, load at the start {load:.1f}".format(
            **began_with
        )
    )
    if began_with["load"] > 0.5:
        console.print("The machine was not idle: trust the ratios rather than the values.")
    if not arguments.only and not arguments.quick:
        write(RESULTS, found)
        console.print(f"written: {os.path.relpath(RESULTS)}")
    return 1 if any(each.met is False for each in found) else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="bench", description=__doc__)
    parser.add_argument(
        "--only",
        action="append",
        choices=GROUPS,
        metavar="GROUP",
        help=f"measure this group only (may be repeated): {', '.join(GROUPS)}",
    )
    parser.add_argument("--quick", action="store_true", help="fewer and shorter rounds")
    return parser.parse_args()


def _table(found: Sequence[Figure]) -> Table:
    table = Table()
    table.add_column("figure")
    table.add_column("measured", justify="right", no_wrap=True)
    table.add_column("reference")
    table.add_column("measured", justify="right", no_wrap=True)
    table.add_column("ratio", justify="right", no_wrap=True)
    table.add_column("asked for", no_wrap=True)
    table.add_column("", no_wrap=True)
    for row in found:
        table.add_row(
            row.figure,
            _number(row.value, row.unit),
            row.reference,
            _number(row.reference_value, row.unit),
            _number(row.ratio),
            row.bar,
            {None: "", True: "yes", False: "[bold red]FALLS SHORT[/]"}[row.met],
        )
    return table


def _number(value: float | None, unit: str = "") -> str:
    if value is None:
        return ""
    return f"{value:.0f} {unit}" if abs(value) >= 1000 else f"{value:.3g} {unit}"


if __name__ == "__main__":
    sys.exit(main())

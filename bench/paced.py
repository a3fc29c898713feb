"""The drive by the wall clock: how late periods begin and are answered, beside the floor."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import drives
from figures import Figure, figure
from floor import in_time, lateness
from rich.console import Console
from rich.table import Table

from pwm_node.lags import Lags

_FREQUENCIES = (2e3, 4e3, 5e3, 8e3, 10e3)  # Hz

#: What is asked for, by kind of drive and frequency: periods answered in time (%).
_BARS = {
    (drives.IN_TWO_PROCESSES, 5e3): "value >= 99.9",
    (drives.IN_TWO_PROCESSES, 10e3): "value >= 99",
    (drives.COMPOSED, 10e3): "value >= 99.99",
}


class _Row(NamedTuple):
    kind: str
    frequency: float
    run: drives.Paced
    floor: Lags  # looking, as the drive does
    asleep: Lags  # sleeping, as cyclictest does
    floor_s: float


def measure(*, quick: bool) -> list[Figure]:
    """Each kind of drive at each frequency, the machine's floor right before it."""
    seconds, floor_s = (3.0, 1.0) if quick else (60.0, 10.0)
    rows = list(_rows(seconds, floor_s))
    Console(width=160).print(_table(rows))
    found = []
    for row in rows:
        name = f"{row.kind}, {row.frequency * 1e-3:g} kHz by the wall clock"
        found += [
            figure(
                f"{name}: periods answered in time",
                row.run.in_time,
                "%",
                "floor: a thread that only looks for the next period",
                in_time(row.floor, row.frequency, row.floor_s),
                bar=_BARS.get((row.kind, row.frequency), ""),
            ),
            figure(
                "the same: start of the period late by, 99.9 %",
                row.run.start.percentiles()[2],
                "us",
                "floor",
                row.floor.percentiles()[2],
            ),
            figure("the same: round trip, 99.9 %", row.run.round_trip.percentiles()[2], "us"),
        ]
    return found


def _rows(seconds: float, floor_s: float) -> Iterator[_Row]:
    for frequency in _FREQUENCIES:
        for kind in (drives.COMPOSED, drives.IN_TWO_PROCESSES):
            floor = lateness(frequency, floor_s)
            asleep = lateness(frequency, floor_s, sleeping=True)
            with tempfile.TemporaryDirectory() as folder:
                run = drives.paced(kind, frequency, seconds, Path(folder))
            yield _Row(kind, frequency, run, floor, asleep, floor_s)


def _table(rows: list[_Row]) -> Table:
    table = Table(title="By the wall clock, of every period: 50 %, 99 %, 99.9 %, longest (us)")
    for name in ("drive", "kHz", "in time (%)", "missed", "left out", "tripped"):
        table.add_column(name, justify="left" if name == "drive" else "right")
    for name in ("start late by", "round trip", "floor, looking", "floor, sleeping"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        run = row.run
        table.add_row(
            row.kind,
            f"{row.frequency * 1e-3:g}",
            f"{run.in_time:.3f}",
            str(run.missed),
            str(run.left_out),
            ", ".join(run.faults) or "no",
            *(_told(each) for each in (run.start, run.round_trip, row.floor, row.asleep)),
        )
    return table


def _told(lags: Lags) -> str:
    return "  ".join(f"{us:.0f}" for us in (*lags.percentiles(), lags.longest * 1e-3))

"""
The report: one HTML file that needs nothing but itself.

Everything is inside: figures, traces, style and the viewer's program; a content security policy
forbids the page to load or send anything. All text that comes from recordings is escaped.

The numbers in the table come from the recordings themselves, not from the traces.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from mfpcc_experiments.measuring import Measured, shown
from mfpcc_experiments.reporting import html
from mfpcc_experiments.reporting.style import COLOURS, mark
from mfpcc_experiments.reporting.table import legend, lines, titles
from mfpcc_experiments.reporting.traces import traces

_CAPTIONS = {
    "phase_currents": "Phase currents of the oversampled waveform where it was recorded, else of "
    "the control samples.",
    "i_dq": "Measured current in the rotor frame on the control samples, with its reference, over "
    "the evaluation window.",
    "lut_error": "Measured minus predicted current over the evaluation window.",
    "spectrum": "Spectrum of phase current a over whole electrical periods. The THD counts all "
    "lines but the fundamental, to half the sampling rate.",
    "speed_torque": "Speed and electromagnetic torque over the whole run; the evaluation window is "
    "shaded.",
    "lags": "A run by the wall clock: how late its periods began, and when in them the command of "
    "the next one was there, of all periods. Percentiles and the longest in us.",
}


def render(runs: Sequence[Measured], figures: Mapping[str, Path]) -> str:
    """
    Make the report of a comparison.

    Parameters
    ----------
    runs : sequence of Measured
        What is compared, in this order.
    figures : mapping of Path
        PNG files by name, from `figures.draw`.

    Returns
    -------
    str
        A complete HTML page.
    """
    rows = [run.row for run in runs]
    first = shown(runs)
    return html.page(
        "report.html",
        title=_title(runs),
        subtitle=_subtitle(runs),
        runs=runs,
        columns=titles(rows),
        legend=legend(rows),
        seeds=len(first) < len(runs),
        keys=[(n % len(COLOURS), mark(n)) for n in range(len(first))],
        table=lines(rows),
        notes=[(run.label, note) for run in runs for note in run.row["notes"]],
        sources=_sources(runs),
        figures=[(name, _CAPTIONS[name], html.embedded(path)) for name, path in figures.items()],
        configurations=[
            (run.label, json.dumps(run.config, indent=2, ensure_ascii=False))
            for run in runs
            if run.config
        ],
        traces=traces(first),
        program=html.source("viewer.js"),
    )


def _distinct(runs: Sequence[Measured], key: str) -> list[str]:
    return list(dict.fromkeys(str(run.row[key]) for run in runs if run.row[key] is not None))


def _title(runs: Sequence[Measured]) -> str:
    return ", ".join(_distinct(runs, "experiment")) or "Recordings"


def _subtitle(runs: Sequence[Measured]) -> str:
    descriptions = {
        str(run.config.get("scenario", {}).get("description", ""))
        for run in runs
        if isinstance(run.config.get("scenario"), dict)
    } - {""}
    parts = [descriptions.pop()] if len(descriptions) == 1 else []
    for key in ("motor", "engine", "seed"):
        names = _distinct(runs, key)
        if names:
            parts.append(f"{key} {', '.join(names)}")
    windows = {tuple(run.row["window_s"]) for run in runs}
    if len(windows) == 1:
        begin, end = windows.pop()
        parts.append(f"evaluated from {begin:g} to {end:g} s")
    rates = {f"{run.row['sampling_rate_hz']['control'] * 1e-3:g}" for run in runs}
    parts.append(f"PWM {', '.join(sorted(rates))} kHz")
    return " · ".join(parts)


def _sources(runs: Sequence[Measured]) -> list[str]:
    """Where the motors come from: a figure is worth as much as the parameters behind it."""
    notes = []
    for run in runs:
        motor = run.config.get("motor_file")
        if isinstance(motor, dict) and motor.get("source"):
            notes.append(f"Motor {motor.get('name')}: {motor['source']}.")
    return list(dict.fromkeys(notes))

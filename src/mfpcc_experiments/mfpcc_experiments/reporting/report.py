"""
The report: one HTML file that needs nothing but itself.

Everything is inside: figures, traces, style and the viewer's program; a content security policy
forbids the page to load or send anything. All text that comes from recordings is escaped.

The traces are stored as 16-bit numbers over the range of each signal (a resolution of 0.0015 %,
below a screen's): a run of 10 s takes 2 to 3 MB per recording. The numbers in the table come from
the recordings themselves.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.measuring.measured import COLOURS, MARKS, Measured, Signal
from mfpcc_experiments.reporting.compare import COLUMNS, best, text

#: Values per signal up to which all are stored. Of longer signals, the extremes of equal spans are,
#: and every value of the evaluation window.
FULL = 250_000
#: Points of the oversampled waveform that are stored, from the begin of the window on.
FINE = 60_000

#: The viewer's panels: title, unit, signals (a dashed line for the second), and whether there is
#: an oversampled waveform for it.
PANELS: tuple[tuple[str, str, tuple[str, ...], str | None], ...] = (
    ("Phase current a", "A", ("i_a",), "i_a"),
    ("i_d", "A", ("i_d", "i_d_ref"), "i_d"),
    ("i_q", "A", ("i_q", "i_q_ref"), "i_q"),
    ("LUT error d", "A", ("error_d",), None),
    ("LUT error q", "A", ("error_q",), None),
    ("Torque", "N m", ("torque", "load_torque"), None),
    ("Speed", "r/min", ("speed", "speed_ref"), None),
)

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
    templates = Path(__file__).parent / "templates"
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(templates),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template("report.html").render(
        title=_title(runs),
        subtitle=_subtitle(runs),
        runs=runs,
        keys=[(n % len(COLOURS), _mark(n)) for n in range(len(runs))],
        table=(table := _table(runs)),
        lut_row=next((n for n, (title, *_) in enumerate(table) if "LUT" in title), None),
        notes=[(run.label, note) for run in runs for note in run.row["notes"]],
        sources=_sources(runs),
        figures=[
            (name, _CAPTIONS[name], base64.b64encode(path.read_bytes()).decode("ascii"))
            for name, path in figures.items()
        ],
        configurations=[
            (run.label, json.dumps(run.config, indent=2, ensure_ascii=False))
            for run in runs
            if run.config
        ],
        traces=_traces(runs),
        style=(templates / "report.css").read_text(encoding="utf-8"),
        program=(templates / "viewer.js").read_text(encoding="utf-8"),
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


def _table(runs: Sequence[Measured]) -> list[tuple[str, str, list[tuple[str, bool]]]]:
    """Rows of text, unit, and per run the figure and if it is among the best, beyond chance."""
    lines = []
    for title, unit, key, less_is_better in COLUMNS:
        cells = [text(run.row, key, unit) for run in runs]
        if all(cell == "–" for cell in cells):
            continue
        marks = best([run.row for run in runs], key) if less_is_better else [False] * len(runs)
        lines.append((title, unit, list(zip(cells, marks, strict=True))))
    return lines


def _mark(n: int) -> str:
    """What tells a recording apart besides its colour."""
    return MARKS[n % len(MARKS)]


# --- Traces ------------------------------------------------------------------------------------


def _traces(runs: Sequence[Measured]) -> dict[str, Any]:
    """All that the viewer shows, as JSON values."""
    panels = []
    for title, unit, names, fine in PANELS:
        series: list[dict[str, Any]] = []
        for n, run in enumerate(runs):
            for dash, name in enumerate(names):
                if name in run.signals:
                    parts = _segments(run.signals[name], run.window.begin, run.window.end)
                    series.append({"run": n, "dash": bool(dash), "fine": False, "parts": parts})
            waveform = None if fine is None else _fine(run, fine)
            if waveform is not None:
                series.append({"run": n, "dash": False, "fine": True, "parts": [waveform]})
        if series:
            panels.append({"title": title, "unit": unit, "series": series})
    ends = [s.begin + s.step * len(s.values) for run in runs for s in run.signals.values()]
    begins = [s.begin for run in runs for s in run.signals.values()]
    first = runs[0]
    frequency = first.row["fundamental"]["frequency_hz"]
    return {
        "runs": [
            {"label": run.label, "n": n, "colour": n % len(COLOURS), "mark": _mark(n)}
            for n, run in enumerate(runs)
        ],
        "span": [min(begins), max(ends)],
        "window": [
            min(run.window.begin for run in runs),
            max(run.window.end for run in runs),
        ],
        "period": 1.0 / first.row["sampling_rate_hz"]["control"],
        "electrical": 1.0 / frequency if frequency > 0.5 else None,
        "panels": panels,
    }


def _segments(signal: Signal, begin: float, end: float) -> list[dict[str, Any]]:
    """A signal from coarse to fine: all of it, and the window in full where all is too much."""
    n = len(signal.values)
    if n <= FULL:
        return [_packed(signal.begin, signal.step, signal.values)]
    span = -(-n // (FULL // 2))
    padded = np.full(-(-n // span) * span, np.nan, dtype=np.float32)
    padded[:n] = signal.values
    blocks = padded.reshape(-1, span)
    empty = np.isnan(blocks).all(axis=1)
    extremes = np.full((len(blocks), 2), np.nan, dtype=np.float32)
    extremes[~empty, 0] = np.nanmin(blocks[~empty], axis=1)
    extremes[~empty, 1] = np.nanmax(blocks[~empty], axis=1)
    coarse = _packed(signal.begin, signal.step * span, extremes.ravel(), pairs=True)
    first = max(0, round((begin - signal.begin) / signal.step))
    last = min(n, round((end - signal.begin) / signal.step), first + FULL)
    part = signal.values[first:last]
    if len(part) < 2:
        return [coarse]
    return [coarse, _packed(signal.begin + first * signal.step, signal.step, part)]


def _fine(run: Measured, name: str) -> dict[str, Any] | None:
    """The oversampled waveform of the window, as far as there is room for it."""
    w = run.window
    if w.fine_time is None or w.fine_abc is None or w.fine_dq is None:
        return None
    values = {"i_a": w.fine_abc[:, 0], "i_d": w.fine_dq.real, "i_q": w.fine_dq.imag}[name]
    step = 1.0 / run.row["sampling_rate_hz"]["oversampled"]
    return _packed(float(w.fine_time[0]), step, values[:FINE].astype(np.float32))


def _packed(
    begin: float, step: float, values: NDArray[np.float32], *, pairs: bool = False
) -> dict[str, Any]:
    """Values as base64 of 16-bit numbers; -32768 is NaN; pairs are lowest and highest of a span."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    scale = (high - low) / 65534.0 or 1.0
    whole = np.full(len(values), -32768, dtype="<i2")
    known = np.isfinite(values)
    whole[known] = np.rint((values[known].astype(np.float64) - low) / scale - 32767.0)
    return {
        "t0": begin,
        "dt": step,
        "low": low,
        "scale": scale,
        "pairs": pairs,
        "data": base64.b64encode(whole.tobytes()).decode("ascii"),
    }

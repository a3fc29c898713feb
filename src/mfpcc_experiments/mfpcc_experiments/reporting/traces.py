"""
The traces of a report's viewer.

They are stored as 16-bit numbers over the range of each signal (a resolution of 0.0015 %, below a
screen's): a run of 10 s takes 2 to 3 MB per recording.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.measuring import QUANTITIES, Measured, Quantity, Signal
from mfpcc_experiments.reporting.style import COLOURS, mark

#: Values per signal up to which all are stored. Of longer signals, the extremes of equal spans are,
#: and every value of the evaluation window.
FULL = 250_000
#: Points of the oversampled waveform that are stored, from the begin of the window on.
FINE = 60_000


def traces(runs: Sequence[Measured]) -> dict[str, Any]:
    """All that the viewer shows, as JSON values."""
    panels = []
    for (title, unit), together in groupby(QUANTITIES, lambda q: (q.panel, q.unit)):
        quantities = list(together)
        series: list[dict[str, Any]] = []
        for n, run in enumerate(runs):
            for dash, quantity in enumerate(quantities):
                if quantity.name in run.signals:
                    signal = run.signals[quantity.name]
                    parts = _segments(signal, run.window.begin, run.window.end)
                    series.append({"run": n, "dash": bool(dash), "fine": False, "parts": parts})
            for quantity in quantities:
                waveform = _fine(run, quantity)
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
            {"label": run.label, "n": n, "colour": n % len(COLOURS), "mark": mark(n)}
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


def _fine(run: Measured, quantity: Quantity) -> dict[str, Any] | None:
    """The oversampled waveform of the window, as far as there is room for it."""
    w = run.window
    values = None if quantity.fine is None else quantity.fine(w)
    if values is None or w.fine_time is None:
        return None
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

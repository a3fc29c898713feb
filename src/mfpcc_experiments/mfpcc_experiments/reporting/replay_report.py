"""The report of a replay: one HTML file that needs nothing but itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mfpcc_experiments.measuring import Samples, scheme_title
from mfpcc_experiments.reporting import html

_CAPTIONS = {
    "replay": "Measured minus predicted current, and the duty of leg a beside the recorded one.",
    "bound": "Prediction error over the speed and over the frequency, beside a linear model that "
    "is fitted to the whole recording by least squares, and a predictor that says: in the rotor "
    "frame nothing changes.",
}


def _ratio(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def render(
    samples: Samples, rows: Sequence[Mapping[str, Any]], figures: Mapping[str, Path], verdict: str
) -> str:
    """
    Make the report.

    Parameters
    ----------
    samples : Samples
        What was replayed.
    rows : sequence of mapping
        Objects of ``metrics.json``, one per scheme.
    figures : mapping of Path
        PNG files by name.
    verdict : str
        Whether the recording is reproduced.

    Returns
    -------
    str
        A complete HTML page.
    """
    begin, end = rows[0]["window_s"]
    judged = rows[0]["least_squares_rms"] is not None
    predictors = [
        ("nothing changes", rows[0]["nothing_changes_rms"]),
        ("least squares", rows[0]["least_squares_rms"]),
        *((scheme_title(row["scheme"]), row["prediction_error_rms"]) for row in rows),
    ]
    ratio = rows[0]["least_squares_rms"] or 0.0
    speeds = [part["speed_rpm"] for part in rows[0]["by_speed"] or []]
    return html.page(
        "replay.html",
        title=f"Replay of {samples.recording.path.name}",
        subtitle=f"{rows[0]['samples']} samples · evaluated from {begin:g} to {end:g} s · motor "
        f"{rows[0]['motor']}",
        verdict=verdict,
        judged=judged,
        overall=[
            (name, f"{rms:.3g}", f"{rms / ratio:.2f}" if ratio else "–") for name, rms in predictors
        ]
        if judged
        else [],
        speeds=[f"{low:.0f} to {high:.0f}" for low, high in speeds] if len(speeds) > 1 else [],
        by_speed=[
            (
                scheme_title(row["scheme"]),
                [_ratio(part["over_least_squares"]) for part in row["by_speed"]],
            )
            for row in rows
            if row["by_speed"]
        ],
        notes=[note for note in rows[0]["notes"] if note["severity"] != "info"],
        figures=[(_CAPTIONS[name], html.embedded(path)) for name, path in figures.items()],
    )

"""The figures of a replay: what came of recorded samples, as one object of its metrics.json."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.measuring.happened import rows_of, scheme_title
from mfpcc_experiments.measuring.metrics import of_the_run
from mfpcc_experiments.measuring.replay import Replay, Samples
from mfpcc_experiments.measuring.steadiness import Need, missing
from mfpcc_experiments.measuring.waveform import per_axis, rms, space_vector
from mfpcc_experiments.measuring.window import window_periods
from mfpcc_experiments.measuring.window import window_rows as rows_in
from mfpcc_experiments.notes import Note, failure, info


def summary(
    samples: Samples, result: Replay, window_s: Sequence[float] | None = None
) -> dict[str, Any]:
    """
    Figures of a replay: one object of its ``metrics.json``.

    Parameters
    ----------
    samples : Samples
        What was fed.
    result : Replay
        What came of it.
    window_s : sequence of two floats, optional
        Evaluated time (s); default: the window stored in the recording, else all of it.

    Returns
    -------
    dict
        Prediction errors in A; differences of the duties (0..1), and of the mean voltage that they
        make in V; `first_difference` is the first period whose command is not the recorded one.
        With the gates off in the evaluated time there are no figures; the `notes` say so.
    """
    rows = window_rows(samples, window_s)
    error = result.error[rows]
    there = samples.answered[rows]
    difference = (result.duty[rows] - samples.duty[rows])[there]
    voltage = space_vector(difference) * samples.feedback["dc_voltage"][rows][there]
    different = np.flatnonzero(result.differs)
    first = int(samples.feedback["period"][different[0]]) + 1 if len(different) else None
    T_s = samples.recording.T_s
    period = samples.feedback["period"]
    row = {
        "experiment": samples.recording.config.get("experiment"),
        "recorded_scheme": recorded_scheme(samples, window_s),
        "scheme": _answered(samples, result),
        "motor": str(samples.values["motor"]),
        "samples": len(error),
        "window_s": [float(period[rows][0] * T_s), float((int(period[rows][-1]) + 1) * T_s)],
        **of_errors(error[:, 0] + 1j * error[:, 1]),
        "duty_difference_max": float(np.abs(difference).max()) if len(difference) else None,
        "voltage_difference_rms": rms(np.abs(voltage)) if len(difference) else None,
        "same_commands_percent": 100.0 * float(np.mean(~result.differs[rows][there]))
        if len(difference)
        else None,
        "first_difference": first,
        "fell_back": result.fell_back,
    }
    if _off(samples, rows) or _gaps(samples, window_s):
        for key in ("lut_error_max", "lut_error_rms"):
            row[key] = {"d": None, "q": None}
        for key in ("duty_difference_max", "voltage_difference_rms", "same_commands_percent"):
            row[key] = None
    notes = [*recorded_notes(samples, window_s), *own_notes(samples, result)]
    row["notes"] = [note.to_json() for note in notes]
    return row


def _answered(samples: Samples, result: Replay) -> str:
    """Who answered: the scheme that was asked, and the fallback where it failed."""
    fallback = samples.values["fallback_scheme"]
    return f"{result.scheme} -> {fallback}" if result.fell_back else result.scheme


def _periods(samples: Samples, rows: slice) -> tuple[int, int]:
    """The evaluated periods, from and to (not included)."""
    period = samples.feedback["period"][rows]
    return int(period[0]), int(period[-1]) + 1


def _off(samples: Samples, rows: slice) -> bool:
    return samples.past.is_off_in(*_periods(samples, rows))


def _gaps(samples: Samples, window_s: Sequence[float] | None) -> list[Note]:
    """What is missing in the evaluated time of what a scheme is asked and compared with."""
    recording = samples.recording
    first, end = _periods(samples, window_rows(samples, window_s))
    window = window_s or recording.window_s
    if window is not None and len(recording.feedback):
        begin, last = window_periods(window, recording.T_s)
        if begin <= first and end <= last:
            first, end = begin, last
    needed = (Need.FEEDBACK, Need.COMMAND)
    found = [note for need, note in missing(recording, first, end) if need in needed]
    return list(dict.fromkeys(found))


def recorded_scheme(samples: Samples, window_s: Sequence[float] | None = None) -> str:
    """Name of what controlled when the evaluated time was recorded."""
    return samples.past.scheme_in(*_periods(samples, window_rows(samples, window_s)))


def recorded_notes(samples: Samples, window_s: Sequence[float] | None = None) -> list[Note]:
    """What there is to say of the recording, whoever is asked."""
    rows = window_rows(samples, window_s)
    notes = [
        *samples.past.notes(*_periods(samples, rows)),
        *_gaps(samples, window_s),
        *samples.recording.notes,
        *of_the_run(samples.recording),
    ]
    if _off(samples, rows):
        notes.append(info("no figures that need a driven motor: the gates were off"))
    return notes


def own_notes(samples: Samples, result: Replay) -> list[Note]:
    """What there is to say of one scheme's answers."""
    if not result.fell_back:
        return []
    asked, fallback = (scheme_title(s) for s in _answered(samples, result).split(" -> "))
    return [failure(f"{asked} gave no valid output, {fallback} answered from there on")]


def window_rows(samples: Samples, window_s: Sequence[float] | None = None) -> slice:
    """Rows of the samples in the evaluated time; all of them where nothing of it is recorded."""
    recording = samples.recording
    window = window_s or recording.window_s
    everything = slice(0, len(samples.feedback))
    if window is None:
        return everything
    rows = rows_in(samples.feedback["period"], window, recording.T_s)
    return rows if rows.stop > rows.start else everything


def recorded(samples: Samples, window_s: Sequence[float] | None = None) -> dict[str, Any] | None:
    """Prediction errors as they were recorded, for the first line of the table; None if none."""
    lut = samples.recording.lut
    period = samples.feedback["period"]
    row, there = rows_of(lut["period"], period) if len(lut) else (None, np.zeros(1, np.bool_))
    rows = window_rows(samples, window_s)
    if row is None or not there[rows].all() or _off(samples, rows):
        return None
    error = lut["prediction_error"][row[rows]]
    if np.isnan(error).any():
        return None  # imported: the predictions were not recorded
    return of_errors(error[:, 0] + 1j * error[:, 1])


def of_errors(error: NDArray[np.complex128]) -> dict[str, Any]:
    """Largest and rms of prediction errors (A), d + 1j q, by axis."""
    axes = np.stack([error.real, error.imag], axis=1)
    return {
        "lut_error_max": per_axis(np.abs(axes).max(axis=0)),
        "lut_error_rms": per_axis(np.sqrt(np.mean(axes**2, axis=0))),
    }

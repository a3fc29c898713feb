"""
Predictions beside what the data allow: a linear model fitted to them, and no model at all.

*Least squares* is the fit of `linear` to the whole recording: what a linear model with fixed
coefficients can predict of the next sample, from one sample and the voltage. It knows the whole
recording, as no scheme does; yet a scheme that filters the noise of its samples, or follows changes
of the drive, may be better. *Nothing changes* predicts that the current in the rotor frame stays
what it is: who is no better than that has learned nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import mfpcc_controller.motor
from mfpcc_experiments.identifying.linear import one_step
from mfpcc_experiments.identifying.steps import of_recording
from mfpcc_experiments.measuring import Replay, Samples
from mfpcc_experiments.measuring.replay_summary import window_rows
from pwm_node.units import RPM

_SPEEDS = 6  # parts of the range of speeds
_FEWEST = 20  # samples that a part is judged by
_SAME = 0.05  # of the largest speed: a range below it is one speed
_SEGMENT = 256  # samples of a spectrum


@dataclass(frozen=True)
class Bound:
    """
    What can be predicted of the samples of a window; one row per sample that is judged.

    Attributes
    ----------
    rows : ndarray of int64, shape (m,)
        Rows of the recording's samples.
    least_squares, unchanged : ndarray of complex, shape (m,)
        Errors of the two predictors (A).
    speed : ndarray, shape (m,)
        Mechanical speed (r/min).
    T_s : float
        (s)
    """

    rows: NDArray[np.int64]
    least_squares: NDArray[np.complex128]
    unchanged: NDArray[np.complex128]
    speed: NDArray[np.float64]
    T_s: float

    def error(self, result: Replay) -> NDArray[np.complex128]:
        """Prediction errors of a scheme at the same samples (A)."""
        error: NDArray[np.complex128] = result.error[self.rows, 0] + 1j * result.error[self.rows, 1]
        return error

    def by_speed(self) -> list[NDArray[np.int64]]:
        """Samples of each part of the range of speeds, from low to high."""
        speed = np.abs(self.speed)
        low, high = float(speed.min()), float(speed.max())
        if high - low < _SAME * high or high == 0.0:
            return [np.arange(len(speed))]
        part = np.minimum((speed - low) / (high - low) * _SPEEDS, _SPEEDS - 1).astype(int)
        parts = [np.flatnonzero(part == k) for k in range(_SPEEDS)]
        return [rows for rows in parts if len(rows) >= _FEWEST]

    def spectrum(
        self, error: NDArray[np.complex128]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """
        Spectral density of an error, both directions of rotation together.

        Returns
        -------
        frequency : ndarray, shape (n,)
            In the rotor frame (Hz), above 0.
        density : ndarray, shape (n,)
            A per square root of Hz.
        """
        from scipy.signal import welch

        # What is missing is bridged, as if it had not been: a spectrum needs even steps.
        length = min(_SEGMENT, len(error))
        frequency, power = welch(
            error, 1.0 / self.T_s, nperseg=length, return_onesided=False, detrend=False
        )
        half = length // 2
        both = power[1:half] + power[-1:-half:-1]
        return frequency[1:half], np.sqrt(both)


def bound(samples: Samples, window_s: Any = None) -> Bound | None:
    """
    Work out what can be predicted of the evaluated samples.

    Parameters
    ----------
    samples : Samples
        What is replayed.
    window_s : sequence of two floats, optional
        Evaluated time (s), as of `replay_summary`.

    Returns
    -------
    Bound or None
        None where too few samples follow each other with a known voltage.
    """
    n_p = mfpcc_controller.motor.load(str(samples.values["motor"])).n_p
    steps = of_recording(samples.recording, n_p)
    fitted = one_step(steps)
    if fitted is None:
        return None
    rows = fitted.rows + 1  # the sample that is predicted
    window = window_rows(samples, window_s)
    inside = (rows >= window.start) & (rows < window.stop)
    if inside.sum() < _FEWEST:
        return None
    return Bound(
        rows=rows[inside],
        least_squares=fitted.error[inside],
        unchanged=fitted.unchanged[inside],
        speed=steps.w_m[fitted.rows[inside]] / n_p / RPM,
        T_s=samples.recording.T_s,
    )


def size(error: NDArray[np.complex128]) -> float:
    """Rms of the length of an error vector (A)."""
    return float(np.sqrt(np.mean(np.abs(error) ** 2)))


def figures(found: Bound | None, result: Replay) -> dict[str, Any]:
    """
    Figures of one scheme for ``metrics.json``.

    Returns
    -------
    dict
        `prediction_error_rms` of the error vector, beside `least_squares_rms` and
        `nothing_changes_rms` at the same samples (A), and `over_least_squares`, their ratio; the
        same for parts of the range of speeds as `by_speed`. None where nothing can be said.
    """
    keys = (
        "prediction_error_rms",
        "least_squares_rms",
        "nothing_changes_rms",
        "over_least_squares",
        "by_speed",
    )
    if found is None:
        return dict.fromkeys(keys)
    error = found.error(result)

    def figures_of(rows: Any) -> dict[str, Any]:
        sizes = [size(e[rows]) for e in (error, found.least_squares, found.unchanged)]
        ratio = sizes[0] / sizes[1] if sizes[1] > 0.0 else None
        return dict(zip(keys, [*sizes, ratio], strict=False))

    speed = np.abs(found.speed)
    return {
        **figures_of(slice(None)),
        "by_speed": [
            {
                "speed_rpm": [float(speed[rows].min()), float(speed[rows].max())],
                "samples": len(rows),
                **figures_of(rows),
            }
            for rows in found.by_speed()
        ],
    }

"""What the figures of merit are computed from: a window, and what its run left behind."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.measuring import happened
from mfpcc_experiments.measuring.copper import resistance
from mfpcc_experiments.measuring.waveform import Fundamental, fundamental, switching_frequency
from mfpcc_experiments.measuring.window import Window, mean_speed, window_rows

if TYPE_CHECKING:
    from mfpcc_experiments.bags import Recording


class Content:
    """
    What a window, or a part of it, holds.

    Parameters
    ----------
    w : Window
        From `window.cut`.
    """

    def __init__(self, w: Window) -> None:
        self.w = w

    @cached_property
    def control(self) -> Fundamental | None:
        """Fundamental of phase current a on the control samples."""
        return fundamental(self.w.i_abc[:, 0], self.w.theta)

    @cached_property
    def oversampled(self) -> Fundamental | None:
        """Fundamental of phase current a on the oversampled waveform."""
        w = self.w
        if w.fine_abc is None or w.fine_theta is None:
            return None
        return fundamental(w.fine_abc[:, 0], w.fine_theta)

    @cached_property
    def deviation(self) -> NDArray[np.complex128] | None:
        """Measured minus reference current (A), at the rows of the diagnostics."""
        w = self.w
        if w.i_dq_ref is None or not len(w.i_dq_ref):
            return None
        i_dq = w.i_dq
        if len(i_dq) != len(w.i_dq_ref):  # decimated diagnostics
            i_dq = np.interp(w.lut_time, w.time, i_dq.real) + 1j * np.interp(
                w.lut_time, w.time, i_dq.imag
            )
        return i_dq - w.i_dq_ref


class RunContent(Content):
    """
    What a window holds, and what its run left behind.

    Parameters
    ----------
    recording : Recording
        From `recording.read`.
    w : Window
        Its window.
    """

    def __init__(self, recording: Recording, w: Window) -> None:
        super().__init__(w)
        self.recording = recording
        self.past = happened.history(recording)
        self.resistance, self.of_resistance = resistance(recording, self.past, (w.begin, w.end))
        self.speed = mean_speed(recording, w)

    @cached_property
    def square(self) -> float:
        """Mean square of the current vector (A^2), oversampled where that was recorded."""
        w = self.w
        return float(np.mean(np.abs(w.i_dq if w.fine_dq is None else w.fine_dq) ** 2))

    @cached_property
    def switching_frequency(self) -> float:
        """Of one leg, with the gates as they were (Hz)."""
        recording, w = self.recording, self.w
        on, _ = happened.gates(recording)
        window = window_rows(recording.command["period"], (w.begin, w.end), recording.T_s)
        command = recording.command[window]
        row_of, known = happened.rows_of(recording.feedback["period"], command["period"])
        return switching_frequency(command["duty"], recording.T_s, on[row_of] | ~known)

    def step_time(self, name: str) -> float | None:
        """Computing time of a step (us), as the controller summed it up."""
        measured = self.recording.summary.get("step_time_us") or {}
        found: float | None = measured.get(name)
        return found

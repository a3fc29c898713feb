"""The evaluation window of a recording: its signals, ready to be measured or drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.measuring.waveform import (
    TWO_PI,
    Array,
    oversample_angle,
    plausible,
    plausible_rows,
    smooth_angle,
    to_dq,
    unwrap,
)
from pwm_node.errors import ForPeople

if TYPE_CHECKING:
    from mfpcc_experiments.bags import Recording


class MetricsError(ForPeople):
    """The recording does not hold what the metrics need; the text says what to do."""


#: Span of the angle's smoothing (s): far below the mechanical time constants, far above a period.
_SMOOTHING = 10e-3


def window_periods(window_s: Sequence[float], T_s: float) -> tuple[int, int]:
    """
    Numbers of the periods that begin in a window: the first, and the one after the last.

    Parameters
    ----------
    window_s : sequence of two floats
        Begin and end (s); the end is not included.
    T_s : float
        Period (s).
    """
    # A thousandth of a period of tolerance: 0.1 s are 1000 periods of 100 us, not 1000.0000000001.
    first, end = (max(0, math.ceil(t / T_s - 1e-3)) for t in window_s)
    return first, end


def window_rows(period: NDArray[np.uint64], window_s: Sequence[float], T_s: float) -> slice:
    """
    Rows of a topic that lie in a window.

    Parameters
    ----------
    period : ndarray, shape (n,)
        Period numbers, rising.
    window_s : sequence of two floats
        Begin and end (s); the end is not included.
    T_s : float
        Period (s).

    Returns
    -------
    slice
        Rows whose period begins in the window.
    """
    periods = np.array(window_periods(window_s, T_s), dtype=np.uint64)
    begin, end = np.searchsorted(period, periods)
    return slice(int(begin), int(end))


def phase_currents(feedback: NDArray[Any]) -> Array:
    """Measured phase currents of `feedback` as one array, shape (n, 3), in A."""
    return np.stack([feedback["i_a"], feedback["i_b"], feedback["i_c"]], axis=1)


@dataclass(frozen=True)
class Window:
    """
    The signals of a recording in its evaluation window, ready to be measured or drawn.

    Attributes
    ----------
    begin, end : float
        The window (s).
    time : ndarray, shape (n,)
        Start of each period (s).
    theta : ndarray, shape (n,)
        Electrical angle at the control samples, unwrapped (rad): the true one where it is recorded
        with each sample, else the encoder's, smoothed.
    i_abc : ndarray, shape (n, 3)
        Measured phase currents (A).
    i_dq : ndarray, shape (n,), complex
        Measured current in the rotor frame (A).
    i_dq_ref : ndarray, shape (m,), complex, or None
        Reference at the rows of `lut_time` (A).
    error : ndarray, shape (m, 2), or None
        Measured minus predicted current, d and q (A), at the rows of `lut_time`.
    lut_time : ndarray, shape (m,)
        Times of the diagnostics (s), which may be decimated.
    fine_time, fine_theta, fine_abc, fine_dq : ndarray or None
        The same on the oversampled waveform (true currents), n * oversampling long.
    state_time : ndarray, shape (s,)
        Times of the plant's states (s), which may be decimated, or may not be there.
    torque : ndarray, shape (s,)
        Electromagnetic torque (N m).
    """

    begin: float
    end: float
    time: Array
    theta: Array
    i_abc: Array
    i_dq: NDArray[np.complex128]
    lut_time: Array
    i_dq_ref: NDArray[np.complex128] | None
    error: Array | None
    fine_time: Array | None
    fine_theta: Array | None
    fine_abc: Array | None
    fine_dq: NDArray[np.complex128] | None
    state_time: Array
    torque: Array

    def between(self, begin: float, end: float) -> Window:
        """
        Return a part of the window.

        Parameters
        ----------
        begin, end : float
            From and to (s); the end is not included.
        """

        def rows(time: Array) -> slice:
            return slice(*np.searchsorted(time, (begin, end)))

        n, m, s = rows(self.time), rows(self.lut_time), rows(self.state_time)
        fine = None if self.fine_time is None else rows(self.fine_time)

        def part(values: Any, rows: slice | None) -> Any:
            return None if values is None or rows is None else values[rows]

        return Window(
            begin=begin,
            end=end,
            time=self.time[n],
            theta=self.theta[n],
            i_abc=self.i_abc[n],
            i_dq=self.i_dq[n],
            lut_time=self.lut_time[m],
            i_dq_ref=part(self.i_dq_ref, m),
            error=part(self.error, m),
            fine_time=part(self.fine_time, fine),
            fine_theta=part(self.fine_theta, fine),
            fine_abc=part(self.fine_abc, fine),
            fine_dq=part(self.fine_dq, fine),
            state_time=self.state_time[s],
            torque=self.torque[s],
        )


def _angle(rows: NDArray[np.void]) -> Array:
    """Unwrapped mechanical angle (rad); what is no number is filled in from its neighbours.

    So the rest keeps its place. No figure is made of it (`steadiness.missing`).
    """
    angle = rows["encoder_angle" if "encoder_angle" in (rows.dtype.names or ()) else "angle"]
    sound = np.flatnonzero(np.isfinite(angle))
    if len(sound) == len(angle):
        return unwrap(angle)
    if not len(sound):
        return np.zeros(len(angle))
    return np.interp(np.arange(len(angle)), sound, unwrap(angle[sound]))


def cut(recording: Recording, window_s: Sequence[float] | None = None) -> Window:
    """
    Take the evaluation window out of a recording.

    Parameters
    ----------
    recording : Recording
        From `recording.read`.
    window_s : sequence of two floats, optional
        Begin and end (s); default: the window stored in the recording, else all of it.

    Returns
    -------
    Window
        Signals with a common meaning of time and angle.

    Raises
    ------
    MetricsError
        If the window holds too few samples, or the number of pole pairs is not known.
    """
    T_s, n_p = recording.T_s, recording.n_p
    feedback = recording.feedback
    first, last = int(feedback["period"][0]), int(feedback["period"][-1])
    if window_s is None:
        window_s = recording.window_s or (first * T_s, (last + 1) * T_s)
    elif not (first - 0.5) * T_s < window_s[0] < window_s[1] < (last + 1.5) * T_s:
        raise MetricsError(
            f"{recording.path}: the recording goes from {first * T_s:g} to {(last + 1) * T_s:g} s; "
            f"{window_s[0]:g} to {window_s[1]:g} s cannot be evaluated"
        )
    rows = window_rows(feedback["period"], window_s, T_s)
    feedback = feedback[rows]
    if len(feedback) < 8:
        raise MetricsError(
            f"{recording.path}: the evaluation window {window_s[0]:g} to {window_s[1]:g} s holds "
            f"{len(feedback)} samples; the recording goes from {first * T_s:g} to "
            f"{(last + 1) * T_s:g} s"
        )
    if n_p is None:
        raise MetricsError(
            f"{recording.path}: the number of pole pairs is not stored in the recording and cannot "
            "be told from its topics"
        )
    rows = window_rows(recording.state["period"], window_s, T_s)
    # Copies: views would keep whole recordings in memory for the sake of their windows.
    feedback, state = plausible_rows(feedback), plausible_rows(recording.state[rows])
    if len(state) == len(feedback):
        theta = n_p * _angle(state)
    else:
        theta = n_p * smooth_angle(_angle(feedback), round(_SMOOTHING / T_s))
    i_abc = phase_currents(feedback)

    lut = plausible_rows(recording.lut[window_rows(recording.lut["period"], window_s, T_s)])
    if len(lut) == len(feedback):
        i_dq = lut["i_dq"][:, 0] + 1j * lut["i_dq"][:, 1]  # what the controller itself saw
    else:
        i_dq = to_dq(i_abc, n_p * _angle(feedback))

    fine_time = fine_theta = fine_abc = fine_dq = None
    if recording.i_abc_oversampled is not None:
        fine = plausible(recording.i_abc_oversampled[rows].copy())
        if len(state) >= 8:
            factor = fine.shape[1]
            fine_time = (state["period"][:, None] + np.arange(factor) / factor).ravel() * T_s
            fine_theta = n_p * oversample_angle(_angle(state), factor)
            fine_abc = fine.reshape(-1, 3)
            fine_dq = to_dq(fine_abc, fine_theta)
    return Window(
        begin=float(window_s[0]),
        end=float(window_s[1]),
        time=feedback["period"] * T_s,
        theta=theta,
        i_abc=i_abc,
        i_dq=i_dq,
        lut_time=lut["period"] * T_s,
        i_dq_ref=lut["i_dq_ref"][:, 0] + 1j * lut["i_dq_ref"][:, 1] if len(lut) else None,
        error=None if np.isnan(lut["prediction_error"]).all() else lut["prediction_error"],
        fine_time=fine_time,
        fine_theta=fine_theta,
        fine_abc=fine_abc,
        fine_dq=fine_dq,
        state_time=state["period"] * T_s,
        torque=state["torque"],
    )


#: Parts of a window, at most, that tell how much its figures scatter.
PARTS = 10


def parts(w: Window) -> list[Window]:
    """
    Divide a window into up to `PARTS` parts of equally many whole electrical periods.

    Parameters
    ----------
    w : Window
        From `cut`.

    Returns
    -------
    list of Window
        Empty where the window holds fewer than four periods.
    """
    turned = np.abs(w.theta - w.theta[0])
    step = turned[-1] / (len(turned) - 1)
    periods = int((turned[-1] + 1.5 * step) / TWO_PI)
    if periods < 4:
        return []
    each = max(1, periods // PARTS)
    T_s = float(w.time[-1] - w.time[0]) / (len(w.time) - 1)
    borders = np.arange(0, periods + 1, each) * TWO_PI
    sample = np.rint(np.interp(borders, turned, np.arange(len(turned))))
    if borders[-1] > turned[-1]:
        sample[-1] = len(turned)
    # A little early, so that a border never falls on either side of a sample by rounding.
    times = (w.time[0] + (sample - 1e-3) * T_s).tolist()
    return [w.between(a, b) for a, b in pairwise(times)]


def speeds(recording: Recording, w: Window) -> Array:
    """Mechanical speed at the control samples (rad/s): the true one if recorded with each."""
    T_s = recording.T_s
    state = recording.state[window_rows(recording.state["period"], (w.begin, w.end), T_s)]
    if len(state) == len(w.time):
        return plausible(np.asarray(state["speed"], dtype=np.float64))
    return np.gradient(w.theta, w.time) / (recording.n_p or 1)


def mean_speed(recording: Recording, w: Window) -> float:
    """Mean mechanical speed (rad/s): the true one where it is recorded, else the encoder's."""
    T_s = recording.T_s
    state = recording.state[window_rows(recording.state["period"], (w.begin, w.end), T_s)]
    if len(state):
        return float(np.mean(plausible(state["speed"])))
    turned = float(w.theta[-1] - w.theta[0]) / float(w.time[-1] - w.time[0])
    return turned / (recording.n_p or 1)

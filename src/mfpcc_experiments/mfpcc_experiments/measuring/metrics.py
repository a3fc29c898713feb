"""
Figures of merit of a recorded drive.

The first part holds pure functions over arrays, one per definition; nothing in them knows of bags,
ROS or the simulator. The second part, `evaluate`, applies them to the evaluation window of a
recording and gives one row of ``metrics.json``.

Definitions
-----------
*Ripple* is the peak-to-peak value (and, separately, the rms deviation from the mean) of i_d and
i_q over the window, on the control samples and on the oversampled waveform.

*THD* is the total harmonic content of a phase current over its fundamental, both over a whole
number of electrical periods, from DC (excluded) to half the sampling rate. "Total" is meant: noise
and inter-harmonics count as well as the multiples of the fundamental. It therefore depends on the
sampling rate, which is stated with it. A window with a transient has none.

*LUT error* is the difference of measured and predicted current per axis: largest absolute value,
and rms.

*Settling* is the number of periods from a step of the reference until the error stays inside 5 %
of the step.

Mean errors are *measured minus reference*. Angles are in rad, currents in A, times in s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.notes import warning
from pwm_node.errors import ForPeople

if TYPE_CHECKING:
    from mfpcc_experiments.bags.recording import Recording

Array = NDArray[np.float64]

TWO_PI = 2.0 * math.pi


class MetricsError(ForPeople):
    """The recording does not hold what the metrics need; the text says what to do."""


# --- Angles and frames -------------------------------------------------------------------------


def to_dq(i_abc: Array, theta_m: Array) -> NDArray[np.complex128]:
    """
    Transform phase currents to the rotor frame (amplitude-invariant).

    Parameters
    ----------
    i_abc : ndarray, shape (..., 3)
        Phase currents (A). A zero-sequence component drops out.
    theta_m : ndarray, shape (...)
        Electrical angle of the d axis (rad).

    Returns
    -------
    ndarray, shape (...), complex
        i_d + 1j i_q (A).
    """
    i_a, i_b, i_c = i_abc[..., 0], i_abc[..., 1], i_abc[..., 2]
    i_ab = (2.0 * i_a - i_b - i_c) / 3.0 + 1j * (i_b - i_c) / math.sqrt(3.0)
    return i_ab * np.exp(-1j * theta_m)


def unwrap(angle: Array) -> Array:
    """
    Continue an angle given modulo one turn.

    Parameters
    ----------
    angle : ndarray, shape (n,)
        Angle (rad), at least two samples per turn.

    Returns
    -------
    ndarray, shape (n,)
        The same angle without jumps (rad).
    """
    return np.unwrap(np.asarray(angle, dtype=np.float64))


def smooth_angle(theta: Array, samples: int) -> Array:
    """
    Remove the quantisation of an encoder from an unwrapped angle.

    A local second-order fit (Savitzky-Golay) over `samples` leaves every real change of the speed
    (inertia makes the angle smooth) and averages the encoder's steps, which would otherwise count
    as phase noise of the fundamental: 12 bits and four pole pairs would add 0.2 % to a THD.

    Parameters
    ----------
    theta : ndarray, shape (n,)
        Unwrapped angle (rad).
    samples : int
        Length of the fit in samples.

    Returns
    -------
    ndarray, shape (n,)
        Smoothed angle (rad).
    """
    from scipy.signal import savgol_filter

    length = min(samples, len(theta)) // 2 * 2 - 1
    if length < 5:
        return theta
    # A straight line is fitted exactly, but only in exact arithmetic: taken out first, so that a
    # large angle costs no digits.
    n = np.arange(len(theta))
    line = theta[0] + (theta[-1] - theta[0]) / (len(theta) - 1) * n
    return line + savgol_filter(theta - line, length, 2, mode="interp")


def oversample_angle(theta: Array, factor: int) -> Array:
    """
    Angle at `factor` equal steps of each control period.

    Parameters
    ----------
    theta : ndarray, shape (n,)
        Unwrapped angle at the control samples (rad); the speed counts as constant within a period.
    factor : int
        Steps per period.

    Returns
    -------
    ndarray, shape (n * factor,)
        Angle (rad); the last period is extrapolated.
    """
    step = np.diff(theta)
    step = np.append(step, step[-1])
    return (theta[:, None] + step[:, None] * (np.arange(factor) / factor)).ravel()


# --- Harmonic content --------------------------------------------------------------------------


@dataclass(frozen=True)
class Fundamental:
    """
    Fundamental of a signal over a whole number of electrical periods.

    Attributes
    ----------
    amplitude : float
        Peak value of the fundamental (unit of the signal).
    periods : int
        Whole electrical periods that were used.
    samples : int
        Samples in them, counted from the first.
    residual : ndarray, shape (samples,)
        The signal less its mean and its fundamental: all that counts as harmonic content.
    """

    amplitude: float
    periods: int
    samples: int
    residual: Array

    @property
    def thd(self) -> float:
        """Total harmonic content over the fundamental (ratio)."""
        return math.sqrt(2.0 * float(np.mean(self.residual**2))) / self.amplitude


def fundamental(x: Array, theta: Array) -> Fundamental | None:
    """
    Separate a signal into mean, fundamental and everything else.

    The window is cut to whole turns of `theta` and ``c + a cos(theta) + b sin(theta)`` is fitted by
    least squares. Working over the angle, not over time, follows a speed that is not exactly
    constant; fitting, not a discrete Fourier transform, needs neither a whole number of samples per
    electrical period nor resampling, so nothing leaks from the fundamental into the content.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Signal at equal steps.
    theta : ndarray, shape (n,)
        Electrical angle at the same instants, unwrapped (rad); either direction.

    Returns
    -------
    Fundamental or None
        None where the window holds no whole period, or no fundamental.
    """
    n = len(x)
    if n < 8:
        return None
    turned = np.abs(theta - theta[0])
    step = turned[-1] / (n - 1)
    # Each sample stands for one step, so n samples cover n steps. Half a step of tolerance: a
    # window of exactly ten periods must not become nine by rounding.
    periods = int((turned[-1] + 1.5 * step) / TWO_PI)
    if periods < 1 or step <= 0.0 or step > math.pi:
        return None
    samples = n
    if periods * TWO_PI <= turned[-1]:
        samples = round(float(np.interp(periods * TWO_PI, turned, np.arange(n))))
    x, theta = x[:samples], theta[:samples]
    basis = np.stack([np.ones(samples), np.cos(theta), np.sin(theta)], axis=1)
    # Normal equations: three unknowns, nearly orthogonal columns; far cheaper than an SVD.
    coefficients = np.linalg.solve(basis.T @ basis, basis.T @ x)
    amplitude = float(np.hypot(coefficients[1], coefficients[2]))
    if not amplitude > 0.0:
        return None
    return Fundamental(amplitude, periods, samples, x - basis @ coefficients)


def spectrum(part: Fundamental, sampling_rate: float) -> tuple[Array, Array]:
    """
    Amplitude spectrum relative to the fundamental.

    The root of the sum of all squared lines but the fundamental's is the THD (Parseval), so the
    picture shows exactly what the number counts.

    Parameters
    ----------
    part : Fundamental
        From `fundamental`.
    sampling_rate : float
        Samples per second (Hz).

    Returns
    -------
    frequency : ndarray, shape (m,)
        Frequency of each line (Hz), DC excluded.
    amplitude : ndarray, shape (m,)
        Amplitude over that of the fundamental (ratio); 1 at the fundamental.
    """
    n = part.samples
    lines = np.abs(np.fft.rfft(part.residual)) * (2.0 / n) / part.amplitude
    if n % 2 == 0:
        lines[-1] /= math.sqrt(2.0)  # the line at half the sampling rate has no mirror image
    lines[part.periods] = 1.0
    return np.fft.rfftfreq(n, 1.0 / sampling_rate)[1:], lines[1:]


def thd(x: Array, theta: Array) -> float | None:
    """
    Total harmonic distortion (ratio), see `fundamental`.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Signal at equal steps.
    theta : ndarray, shape (n,)
        Electrical angle at the same instants, unwrapped (rad).

    Returns
    -------
    float or None
        None where the window holds no whole electrical period.
    """
    part = fundamental(x, theta)
    return None if part is None else part.thd


#: Change of the amplitude within a window, over its mean, from which on it holds a transient. The
#: largest seen in a steady state is 0.02 (one vector per period, 18 % THD).
TRANSIENT = 0.2


def amplitudes(i_dq: NDArray[np.complex128], theta: Array) -> Array:
    """
    Amplitude of the fundamental in each electrical period.

    Parameters
    ----------
    i_dq : ndarray, shape (n,), complex
        Current in the rotor frame (A).
    theta : ndarray, shape (n,)
        Electrical angle, unwrapped (rad).

    Returns
    -------
    ndarray, shape (m,)
        For each whole electrical period (A).
    """
    turn = (np.abs(theta - theta[0]) / TWO_PI).astype(np.int64)
    count = np.bincount(turn)
    mean = (np.bincount(turn, i_dq.real) + 1j * np.bincount(turn, i_dq.imag)) / np.maximum(count, 1)
    # The last period is whole only by chance, or nearly so.
    whole = count > 0.9 * np.median(count)
    amplitude: Array = np.abs(mean[whole])
    return amplitude


def is_steady(i_dq: NDArray[np.complex128], theta: Array) -> bool:
    """
    Whether the amplitude stands still over a window; a THD is defined only then.

    Parameters
    ----------
    i_dq : ndarray, shape (n,), complex
        Current in the rotor frame (A).
    theta : ndarray, shape (n,)
        Electrical angle, unwrapped (rad).
    """
    amplitude = amplitudes(i_dq, theta)
    return len(amplitude) < 2 or float(np.ptp(amplitude)) <= TRANSIENT * float(np.mean(amplitude))


# --- Ripple, errors, steps ---------------------------------------------------------------------


def ripple_pp(x: Array) -> float:
    """Peak-to-peak value of `x`."""
    return float(np.max(x) - np.min(x))


def ripple_rms(x: Array) -> float:
    """Rms deviation of `x` from its mean."""
    return float(np.std(x))


def rms(x: Array) -> float:
    """Root of the mean square of `x`."""
    return math.sqrt(float(np.mean(np.square(x))))


@dataclass(frozen=True)
class StepResponse:
    """
    Response to one step of a reference.

    Attributes
    ----------
    settling : int or None
        Samples from the step until the error stays inside the band; None if it never does.
    overshoot : float
        Largest excursion beyond the new reference over the height of the step (ratio, >= 0).
    """

    settling: int | None
    overshoot: float


def step_response(x: Array, before: float, after: float, *, band: float = 0.05) -> StepResponse:
    """
    Settling and overshoot after a step of the reference.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Signal from the sample of the step on.
    before, after : float
        Reference before and after the step (unit of `x`).
    band : float
        Half width of the settling band over the height of the step.

    Returns
    -------
    StepResponse
        In samples and as a ratio.
    """
    height = after - before
    error = np.asarray(x) - after
    outside = np.flatnonzero(~(np.abs(error) <= band * abs(height)))
    if len(outside) == 0:
        settling: int | None = 0
    elif outside[-1] == len(error) - 1:
        settling = None
    else:
        settling = int(outside[-1]) + 1
    beyond = error * math.copysign(1.0, height) / abs(height)
    return StepResponse(settling, max(0.0, float(np.max(beyond))))


def switching_frequency(duty: Array, T_s: float) -> float:
    """
    Mean switching frequency of one leg.

    Counted from the duties of centre-aligned PWM: a duty strictly between 0 and 1 switches on and
    off once within the period; between two periods a leg switches if one of them ends (starts)
    fully on and the other does not.

    Parameters
    ----------
    duty : ndarray, shape (n, 3)
        On-time of the upper switch of legs a, b, c over consecutive periods (0..1).
    T_s : float
        Period (s).

    Returns
    -------
    float
        Complete on-off cycles per second, mean of the three legs (Hz).
    """
    if len(duty) < 2:
        return 0.0
    inside = np.count_nonzero((duty > 0.0) & (duty < 1.0))
    level = duty >= 1.0
    between = np.count_nonzero(level[1:] != level[:-1])
    return (2 * inside + between) / (2.0 * 3.0 * len(duty) * T_s)


# --- One row of metrics.json -------------------------------------------------------------------

#: Span of the angle's smoothing (s): far below the mechanical time constants, far above a period.
_SMOOTHING = 10e-3


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
    # A thousandth of a period of tolerance: 0.1 s are 1000 periods of 100 us, not 1000.0000000001.
    first, last = (max(0, math.ceil(t / T_s - 1e-3)) for t in window_s)
    begin, end = np.searchsorted(period, np.array([first, last], dtype=np.uint64))
    return slice(int(begin), int(end))


def _pair(values: Any) -> dict[str, float]:
    return {"d": float(values[0]), "q": float(values[1])}


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
        Electrical angle at the control samples, unwrapped (rad).
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
    theta = n_p * smooth_angle(unwrap(feedback["encoder_angle"]), round(_SMOOTHING / T_s))
    i_abc = phase_currents(feedback)

    # Copies: views would keep whole recordings in memory for the sake of their windows.
    lut = recording.lut[window_rows(recording.lut["period"], window_s, T_s)].copy()
    if len(lut) == len(feedback):
        i_dq = lut["i_dq"][:, 0] + 1j * lut["i_dq"][:, 1]  # what the controller itself saw
    else:
        i_dq = to_dq(i_abc, n_p * unwrap(feedback["encoder_angle"]))

    rows = window_rows(recording.state["period"], window_s, T_s)
    state = recording.state[rows].copy()
    fine_time = fine_theta = fine_abc = fine_dq = None
    if recording.i_abc_oversampled is not None:
        fine = recording.i_abc_oversampled[rows].copy()
        if len(state) >= 8:
            factor = fine.shape[1]
            fine_time = (state["period"][:, None] + np.arange(factor) / factor).ravel() * T_s
            fine_theta = n_p * oversample_angle(unwrap(state["angle"]), factor)
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
        error=lut["prediction_error"] if len(lut) else None,
        fine_time=fine_time,
        fine_theta=fine_theta,
        fine_abc=fine_abc,
        fine_dq=fine_dq,
        state_time=state["period"] * T_s,
        torque=state["torque"],
    )


def _current_steps(recording: Recording) -> list[dict[str, Any]]:
    """
    Settling and overshoot of every clear step of the current reference.

    A step is clear if the reference jumps by more than 0.2 A within one period and stands still for
    20 periods before and after (a speed loop moves it all the time; no settling is defined there).
    """
    lut = recording.lut
    steps = []
    for axis, name in enumerate(("d", "q")):
        i, ref = lut["i_dq"][:, axis], lut["i_dq_ref"][:, axis]
        jumps = np.flatnonzero(np.abs(np.diff(ref)) > 0.2) + 1
        for n, k in enumerate(jumps):
            end = int(jumps[n + 1]) if n + 1 < len(jumps) else len(ref)
            if k < 20 or end - k < 20 or np.ptp(ref[k - 20 : k]) > 0 or np.ptp(ref[k:end]) > 0:
                continue
            response = step_response(i[k:end], float(ref[k - 1]), float(ref[k]))
            steps.append(
                {
                    "axis": name,
                    "time_s": float(lut["period"][k] * recording.T_s),
                    "from": float(ref[k - 1]),
                    "to": float(ref[k]),
                    "settling_periods": response.settling,
                    "overshoot_percent": 100.0 * response.overshoot,
                }
            )
    return steps


def _or_none(value: float | None, factor: float = 1.0) -> float | None:
    return None if value is None or not math.isfinite(value) else factor * value


def _figures(w: Window) -> dict[str, Any]:
    """The figures of merit that can be taken of a window, or of a part of it."""
    coarse = fundamental(w.i_abc[:, 0], w.theta)
    fine = None
    if w.fine_abc is not None and w.fine_theta is not None:
        fine = fundamental(w.fine_abc[:, 0], w.fine_theta)
    steady = is_steady(w.i_dq, w.theta)
    pp: dict[str, float | None] = {
        "d": ripple_pp(w.i_dq.real),
        "q": ripple_pp(w.i_dq.imag),
        "d_oversampled": None,
        "q_oversampled": None,
    }
    if w.fine_dq is not None and len(w.fine_dq):
        pp["d_oversampled"] = ripple_pp(w.fine_dq.real)
        pp["q_oversampled"] = ripple_pp(w.fine_dq.imag)
    error_max = error_rms = error_mean = None
    if w.error is not None and w.i_dq_ref is not None and len(w.error):
        error_max = _pair(np.max(np.abs(w.error), axis=0))
        error_rms = _pair(np.sqrt(np.mean(w.error**2, axis=0)))
        i_q = w.i_dq.imag
        if len(i_q) != len(w.i_dq_ref):  # decimated diagnostics
            i_q = np.interp(w.lut_time, w.time, i_q)
        error_mean = float(np.mean(i_q - w.i_dq_ref.imag))
    return {
        "thd_percent": {
            "control": _or_none(coarse.thd if coarse and steady else None, 100.0),
            "oversampled": _or_none(fine.thd if fine and steady else None, 100.0),
        },
        "ripple_pp": pp,
        "ripple_rms": _pair((ripple_rms(w.i_dq.real), ripple_rms(w.i_dq.imag))),
        "lut_error_max": error_max,
        "lut_error_rms": error_rms,
        "i_d_mean": float(np.mean(w.i_dq.real)),
        "i_q_error_mean": error_mean,
        "torque_mean": float(np.mean(w.torque)) if len(w.torque) else None,
        "torque_ripple_pp": ripple_pp(w.torque) if len(w.torque) else None,
        "torque_ripple_rms": ripple_rms(w.torque) if len(w.torque) else None,
    }


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
        Empty where the window holds fewer than four periods, or a transient.
    """
    turned = np.abs(w.theta - w.theta[0])
    step = turned[-1] / (len(turned) - 1)
    periods = int((turned[-1] + 1.5 * step) / TWO_PI)
    if periods < 4 or not is_steady(w.i_dq, w.theta):
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


def scatter(w: Window) -> dict[str, Any]:
    """
    Mean and standard deviation of each figure over the parts of a window.

    They say whether two recordings differ by more than chance. The peak-to-peak and largest values
    of a part are smaller than those of the whole window; compare parts with parts.

    Parameters
    ----------
    w : Window
        From `cut`.

    Returns
    -------
    dict
        ``parts`` (their number), and ``mean`` and ``std``: figures by their keys joined with dots.
    """
    rows = [_flat(_figures(part)) for part in parts(w)]
    mean, std = {}, {}
    for key in rows[0] if len(rows) > 1 else ():
        # a figure that a part cannot give is None, or a group of figures less
        values = [row[key] for row in rows if row.get(key) is not None]
        if len(values) == len(rows):
            mean[key] = float(np.mean(values))
            std[key] = float(np.std(values, ddof=1))
    return {"parts": len(rows), "mean": mean, "std": std}


def _flat(data: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in data.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = value
    return flat


def _clean(value: Any) -> Any:
    """NumPy numbers as Python's; NaN and infinity, which JSON does not know, as None."""
    if isinstance(value, dict):
        return {key: _clean(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_clean(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def evaluate(recording: Recording, window_s: Sequence[float] | None = None) -> dict[str, Any]:
    """
    Measure one recording.

    Parameters
    ----------
    recording : Recording
        From `recording.read`.
    window_s : sequence of two floats, optional
        Evaluation window (s); default: the one stored in the recording, else all of it.

    Returns
    -------
    dict
        One object of ``metrics.json``; a figure that the recording cannot give is None.
    """
    w = cut(recording, window_s)
    T_s, config, summary = recording.T_s, recording.config, recording.summary
    figures = _figures(w)
    coarse = fundamental(w.i_abc[:, 0], w.theta)
    command = recording.command[window_rows(recording.command["period"], (w.begin, w.end), T_s)]
    speed = float(w.theta[-1] - w.theta[0]) / float(w.time[-1] - w.time[0])  # electrical, rad/s
    square = float(np.mean(np.abs(w.i_dq if w.fine_dq is None else w.fine_dq) ** 2))
    R_s = config.get("R_s")
    notes = list(recording.notes)
    if recording.lost_periods:
        notes.insert(0, warning(f"{recording.lost_periods} periods are incomplete"))
    step_time = summary.get("step_time_us") or {}
    row = {
        "experiment": config.get("experiment"),
        "scheme": recording.scheme_name,
        "motor": config.get("motor"),
        "engine": config.get("engine"),
        "seed": config.get("seed"),
        "periods": len(recording.feedback),
        "lost_periods": recording.lost_periods,
        "window_s": [w.begin, w.end],
        **figures,
        "speed_rpm_mean": speed / (recording.n_p or 1) * 60.0 / TWO_PI,
        "step_time_us": {"median": step_time.get("median"), "p99": step_time.get("p99")},
        "steady": is_steady(w.i_dq, w.theta),
        "sampling_rate_hz": {
            "control": 1.0 / T_s,
            "oversampled": recording.oversampling / T_s if recording.oversampling else None,
        },
        "fundamental": {
            "amplitude_a": coarse.amplitude if coarse else None,
            "frequency_hz": abs(speed) / TWO_PI,
            "periods": coarse.periods if coarse else 0,
        },
        "switching_frequency_hz": switching_frequency(command["duty"], T_s),
        "i_rms": math.sqrt(square / 2.0),
        "copper_loss_w": None if R_s is None else 1.5 * float(R_s) * square,
        "current_steps": _current_steps(recording),
        "scatter": scatter(w),
        "notes": [note.to_json() for note in notes],
    }
    cleaned: dict[str, Any] = _clean(row)
    return cleaned

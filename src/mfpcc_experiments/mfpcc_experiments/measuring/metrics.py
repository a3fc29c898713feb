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
sampling rate, which is stated with it.

THD and ripple are figures of a steady state. A window in which speed, load or current change, or
that is too short to tell, has none; nor has one with the gates off, with several schemes in
control, or with samples missing. What then can be told is the *deviation*: rms of measured minus
reference. Whatever is missing, a note says why.

*LUT error* is the difference of measured and predicted current per axis: largest absolute value,
and rms.

*Settling* is the number of periods from a step of the reference until the error stays inside 5 %
of the step.

*Copper loss* is 1.5 R |i|^2 with the resistance that the winding had, warm or drifted.

*Speed* is the true one where the plant has told it, else the encoder's.

Mean errors are *measured minus reference*. Angles are in rad, currents in A, times in s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.measuring import happened
from mfpcc_experiments.notes import Note, failure, info, warning
from pmsm_sim.parameters import TABLE as PLANT
from pmsm_sim.thermal import REFERENCE_TEMPERATURE
from pwm_node.errors import ForPeople

if TYPE_CHECKING:
    from mfpcc_experiments.bags import Recording
    from mfpcc_experiments.measuring.happened import History

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


#: Electrical periods that a window must hold: what is steady can be told by comparison only, of one
#: period with another that begins later.
FEWEST_PERIODS = 1.5

# Turns (electrical) below which a rotor stands still, and into how many parts a window is divided
# then; and the fewest samples of such a part.
_STANDSTILL, _PARTS_AT_STANDSTILL, _FEWEST_SAMPLES = 0.05, 10, 20

#: Deviation of the mean current over one electrical period, over its size, and of the speed, from
#: which on a window holds a transient. The largest seen in a steady state are 0.025 and 0.003
#: (one vector per period, 18 % THD).
TRANSIENT = 0.05

# A slow change below that is one too if it makes so much of the content that THD and ripple count;
# below the second share of the current it is never.
_OF_CONTENT, _NO_CHANGE = 0.3, 0.005

# What is small for a motor: so much of its largest current, speed or torque.
_SMALL = 0.01


def turns(theta: Array) -> Array:
    """
    Electrical turns since the first sample, never less than before.

    Parameters
    ----------
    theta : ndarray, shape (n,)
        Electrical angle, unwrapped (rad); either direction.
    """
    turned: Array = np.maximum.accumulate(np.abs(theta - theta[0])) / TWO_PI
    return turned


def period_means(x: NDArray[Any], theta: Array) -> NDArray[Any]:
    """
    Mean of a signal over one electrical period, from every sample on that has one before it.

    Harmonics of the fundamental vanish in it; what remains changes with the state only. At
    standstill the means of equal parts of the time.

    Parameters
    ----------
    x : ndarray, shape (n,), real or complex
        Signal at equal steps.
    theta : ndarray, shape (n,)
        Electrical angle at the same instants, unwrapped (rad).

    Returns
    -------
    ndarray, shape (m,)
        Empty where there is no whole period.
    """
    n = len(x)
    turned = turns(theta)
    if turned[-1] < _STANDSTILL:
        parts = np.array_split(x, _PARTS_AT_STANDSTILL) if n >= _PARTS_AT_STANDSTILL else []
        return np.array([np.mean(part) for part in parts])
    edges = np.arange(n + 1.0)
    turned = np.append(turned, 2.0 * turned[-1] - turned[-2])
    # half a sample of tolerance, as in `fundamental`
    starts = np.flatnonzero(turned[:-1] + 1.0 <= turned[-1] + 0.5 * (turned[-1] / n))
    ends = np.interp(turned[starts] + 1.0, turned, edges)
    total = np.concatenate([np.zeros(1, x.dtype), np.cumsum(x)])
    at_ends = np.interp(ends, edges, total.real) + 1j * np.interp(ends, edges, total.imag)
    means = (at_ends - total[starts]) / (ends - starts)
    return means if np.iscomplexobj(x) else means.real


def can_be_judged(theta: Array) -> bool:
    """
    Whether a window is long enough to tell if it is steady.

    Parameters
    ----------
    theta : ndarray, shape (n,)
        Electrical angle, unwrapped (rad).
    """
    n, turned = len(theta), float(turns(theta)[-1])
    if turned < _STANDSTILL:
        return n >= _PARTS_AT_STANDSTILL * _FEWEST_SAMPLES
    return turned * (1.0 + 1.5 / (n - 1)) >= FEWEST_PERIODS


def is_steady(
    i_dq: NDArray[np.complex128],
    theta: Array,
    *,
    i_max: float = 0.0,
    waveform: NDArray[np.complex128] | None = None,
) -> bool:
    """
    Whether the current stands still over a window; THD and ripple are defined only then.

    Its mean over one electrical period may move by so little that it is neither a transient of its
    own nor a good part of what THD and ripple count.

    Parameters
    ----------
    i_dq : ndarray, shape (n,), complex
        Current in the rotor frame (A).
    theta : ndarray, shape (n,)
        Electrical angle, unwrapped (rad).
    i_max : float
        Largest current of the motor (A), if known: a hundredth of it is no current.
    waveform : ndarray, complex, optional
        The oversampled current (A), whose content counts then.
    """
    means = period_means(i_dq, theta)
    if not len(means):
        return False
    whole = i_dq if waveform is None else waveform
    size = max(abs(complex(np.mean(means))), _SMALL * i_max)
    away = np.abs(means - np.mean(means))
    moved, content = rms(away), rms(np.abs(whole - np.mean(whole)))
    if moved > max(_NO_CHANGE * size, _OF_CONTENT * content):
        return False
    return bool(np.max(away) <= TRANSIENT * size)


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


def switching_frequency(duty: Array, T_s: float, on: NDArray[np.bool_] | None = None) -> float:
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
    on : ndarray of bool, shape (n,), optional
        Whether the gates were on; blocked ones do not switch, whatever the duty.

    Returns
    -------
    float
        Complete on-off cycles per second, mean of the three legs (Hz).
    """
    if len(duty) < 2:
        return 0.0
    on = np.ones(len(duty), np.bool_) if on is None else on
    inside = np.count_nonzero(((duty > 0.0) & (duty < 1.0))[on])
    level = duty >= 1.0
    between = np.count_nonzero((level[1:] != level[:-1])[on[1:] & on[:-1]])
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
    state = recording.state[rows].copy()
    if len(state) == len(feedback):
        theta = n_p * unwrap(state["angle"])
    else:
        theta = n_p * smooth_angle(unwrap(feedback["encoder_angle"]), round(_SMOOTHING / T_s))
    i_abc = phase_currents(feedback)

    # Copies: views would keep whole recordings in memory for the sake of their windows.
    lut = recording.lut[window_rows(recording.lut["period"], window_s, T_s)].copy()
    if len(lut) == len(feedback):
        i_dq = lut["i_dq"][:, 0] + 1j * lut["i_dq"][:, 1]  # what the controller itself saw
    else:
        i_dq = to_dq(i_abc, n_p * unwrap(feedback["encoder_angle"]))

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


def _current_steps(recording: Recording, past: History, scheme: str) -> list[dict[str, Any]]:
    """
    Settling and overshoot of every clear step of the current reference.

    A step is clear if the reference jumps within one period and stands still for 20 samples before
    and after (a speed loop moves it all the time; no settling is defined there), while the gates
    are on and one scheme, the one that the row is of, controls.
    """
    lut = recording.lut
    steps: list[dict[str, Any]] = []
    if len(lut) < 41:
        return steps
    period = lut["period"].astype(np.int64)
    every = int(np.median(np.diff(period)))
    for axis, name in enumerate(("d", "q")):
        i, ref = lut["i_dq"][:, axis], lut["i_dq_ref"][:, axis]
        jumps = np.flatnonzero(np.diff(ref) != 0.0) + 1
        # what moves in every period is no step, and need not be looked at one by one
        apart = np.diff(jumps, prepend=0, append=len(ref))
        for n in np.flatnonzero((apart[:-1] >= 20) & (apart[1:] >= 20)).tolist():
            k, end = int(jumps[n]), int(jumps[n] + apart[n + 1])
            first, last = int(period[k - 20]), int(period[end - 1])
            whole = last - first == (end - 1 - (k - 20)) * every
            if not whole or past.is_off_in(first, last + 1):
                continue
            if past.scheme_in(first, last + 1) != scheme:
                continue
            response = step_response(i[k:end], float(ref[k - 1]), float(ref[k]))
            settling = response.settling
            steps.append(
                {
                    "axis": name,
                    "time_s": float(period[k] * recording.T_s),
                    "from": float(ref[k - 1]),
                    "to": float(ref[k]),
                    "settling_periods": None if settling is None else settling * every,
                    "overshoot_percent": 100.0 * response.overshoot,
                }
            )
    return steps


def _or_none(value: float | None, factor: float = 1.0) -> float | None:
    return None if value is None or not math.isfinite(value) else factor * value


def _figures(w: Window) -> dict[str, Any]:
    """The figures of merit of a window, or of a part of it, as if it were fit for all of them."""
    coarse = fundamental(w.i_abc[:, 0], w.theta)
    fine = None
    if w.fine_abc is not None and w.fine_theta is not None:
        fine = fundamental(w.fine_abc[:, 0], w.fine_theta)
    pp: dict[str, float | None] = {
        "d": ripple_pp(w.i_dq.real),
        "q": ripple_pp(w.i_dq.imag),
        "d_oversampled": None,
        "q_oversampled": None,
    }
    if w.fine_dq is not None and len(w.fine_dq):
        pp["d_oversampled"] = ripple_pp(w.fine_dq.real)
        pp["q_oversampled"] = ripple_pp(w.fine_dq.imag)
    error_max = error_rms = error_mean = deviation = None
    if w.error is not None and w.i_dq_ref is not None and len(w.error):
        error_max = _pair(np.max(np.abs(w.error), axis=0))
        error_rms = _pair(np.sqrt(np.mean(w.error**2, axis=0)))
        i_dq = w.i_dq
        if len(i_dq) != len(w.i_dq_ref):  # decimated diagnostics
            i_dq = np.interp(w.lut_time, w.time, i_dq.real) + 1j * np.interp(
                w.lut_time, w.time, i_dq.imag
            )
        error = i_dq - w.i_dq_ref
        error_mean = float(np.mean(error.imag))
        deviation = _pair((rms(error.real), rms(error.imag)))
    return {
        "thd_percent": {
            "control": _or_none(coarse.thd if coarse else None, 100.0),
            "oversampled": _or_none(fine.thd if fine else None, 100.0),
        },
        "ripple_pp": pp,
        "ripple_rms": _pair((ripple_rms(w.i_dq.real), ripple_rms(w.i_dq.imag))),
        "deviation_rms": deviation,
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


def scatter(w: Window, kept: Sequence[str] | None = None) -> dict[str, Any]:
    """
    Mean and standard deviation of each figure over the parts of a window.

    They say whether two recordings differ by more than chance. The peak-to-peak and largest values
    of a part are smaller than those of the whole window; compare parts with parts.

    Parameters
    ----------
    w : Window
        From `cut`.
    kept : sequence of str, optional
        Figures that the window can give, by their keys joined with dots; default: all.

    Returns
    -------
    dict
        ``parts`` (their number), and ``mean`` and ``std``: figures by their keys joined with dots.
    """
    rows = [_flat(_figures(part)) for part in parts(w)]
    mean, std = {}, {}
    for key in rows[0] if len(rows) > 1 else ():
        if kept is not None and key not in kept:
            continue
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


def _changes(config: Mapping[str, Any]) -> list[Note]:
    """What the run was to do otherwise than its experiment says."""
    scenario = config.get("scenario")
    changes = scenario.get("changes") if isinstance(scenario, dict) else None
    if not isinstance(changes, dict) or not changes:
        return []
    told = ", ".join(f"{name} = {value}" for name, value in changes.items())
    return [info(f"not as the experiment says: {told}")]


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
        One object of ``metrics.json``; a figure that the recording cannot give, or that would not
        be what its label says, is None, and its ``notes`` say why.
    """
    w = cut(recording, window_s)
    T_s, config, summary = recording.T_s, recording.config, recording.summary
    past = happened.history(recording)
    first, end = (max(0, math.ceil(t / T_s - 1e-3)) for t in (w.begin, w.end))
    state = _State(recording, w, past, first, end)
    scheme = past.scheme_in(first, end)
    coarse = fundamental(w.i_abc[:, 0], w.theta)
    on, _ = happened.gates(recording)
    command = recording.command[window_rows(recording.command["period"], (w.begin, w.end), T_s)]
    row_of, known = happened.rows_of(recording.feedback["period"], command["period"])
    square = float(np.mean(np.abs(w.i_dq if w.fine_dq is None else w.fine_dq) ** 2))
    resistance, of_resistance = _resistance(recording, past, (w.begin, w.end))
    speed = _speed(recording, w)
    step_time = summary.get("step_time_us") or {}
    row = {
        "experiment": config.get("experiment"),
        "scheme": scheme,
        "motor": config.get("motor"),
        "engine": config.get("engine"),
        "seed": config.get("seed"),
        "periods": len(recording.feedback),
        "lost_periods": recording.lost_periods,
        "window_s": [w.begin, w.end],
        **_figures(w),
        "speed_rpm_mean": speed * 60.0 / TWO_PI,
        "step_time_us": {"median": step_time.get("median"), "p99": step_time.get("p99")},
        "steady": state.steady,
        "sampling_rate_hz": {
            "control": 1.0 / T_s,
            "oversampled": recording.oversampling / T_s if recording.oversampling else None,
        },
        "fundamental": {
            "amplitude_a": coarse.amplitude if coarse else None,
            "frequency_hz": abs(speed) * (recording.n_p or 1) / TWO_PI,
            "periods": coarse.periods if coarse else 0,
        },
        "switching_frequency_hz": switching_frequency(command["duty"], T_s, on[row_of] | ~known),
        "i_rms": math.sqrt(square / 2.0),
        "copper_loss_w": None if resistance is None else 1.5 * resistance * square,
        "current_steps": _current_steps(recording, past, scheme),
    }
    taken = state.taken_out()
    for key in taken:
        _take_out(row, key)
    figures = [key for key, value in _flat(row).items() if value is not None]
    row["scatter"] = scatter(w, figures) if state.steady else {"parts": 0, "mean": {}, "std": {}}
    row["notes"] = [
        note.to_json()
        for note in (
            *past.notes(first, end),
            *state.notes,
            *_changes(config),
            *recording.notes,
            *of_the_run(recording),
            *([info(of_resistance)] if of_resistance and "copper_loss_w" not in taken else []),
        )
    ]
    cleaned: dict[str, Any] = _clean(row)
    return cleaned


# Figures that need a steady state, a driven motor, one scheme, and all messages of a topic.
_STEADY = (
    "thd_percent",
    "ripple_pp",
    "ripple_rms",
    "torque_ripple_pp",
    "torque_ripple_rms",
    "fundamental.amplitude_a",
)
_OF_LUT = ("lut_error_max", "lut_error_rms", "i_q_error_mean", "deviation_rms")
_OF_CURRENT = ("i_d_mean", "i_rms", "copper_loss_w")
_OF_STATE = ("torque_mean", "torque_ripple_pp", "torque_ripple_rms")
_OF_SCHEME = ("lut_error_max", "lut_error_rms", "step_time_us")


def _take_out(row: dict[str, Any], key: str) -> None:
    """Set a figure to None; of a group, each one."""
    *path, last = key.split(".")
    for part in path:
        row = row[part]
    if isinstance(row[last], dict):
        row[last] = dict.fromkeys(row[last])
    else:
        row[last] = None


class _State:
    """
    What a window is fit for.

    Attributes
    ----------
    steady : bool or None
        None where it cannot be judged.
    notes : list of Note
        What keeps figures from being given.
    """

    def __init__(
        self, recording: Recording, w: Window, past: History, first: int, end: int
    ) -> None:
        self.notes: list[Note] = []
        self._past, self._first, self._end = past, first, end
        self._keys: set[str] = set()
        self._off = past.is_off_in(first, end)
        schemes = {(reign.scheme, reign.chosen) for reign in past.reigns_in(first, end)}
        self._mixed = len(schemes) > 1
        self._judge_samples(recording)
        self.steady = self._judge_steady(recording, w)
        self._judge_topics(recording, w)
        self._judge_step_time(recording)

    def taken_out(self) -> list[str]:
        """Keys of the figures that are not to be given."""
        keys = set(self._keys)
        if not self.steady:
            keys.update(_STEADY)
        if self._off:
            keys.update(_STEADY + _OF_LUT + _OF_CURRENT + _OF_STATE + _OF_SCHEME)
        if self._mixed:
            keys.update(_OF_SCHEME)
        return sorted(keys)

    def _judge_samples(self, recording: Recording) -> None:
        """Whether all messages of the window are there, topic by topic."""
        first, end = self._first, self._end
        expected = {
            "phase_feedback": (recording.feedback, first, _STEADY + _OF_LUT + _OF_CURRENT),
            # there is none for period 0
            "duty_command": (recording.command, max(first, 1), ("switching_frequency_hz",)),
            "lut_diagnostics": (recording.lut, first, _OF_LUT),
            "drive_state": (
                recording.state,
                first,
                (
                    "thd_percent.oversampled",
                    "ripple_pp.d_oversampled",
                    "ripple_pp.q_oversampled",
                    "copper_loss_w",
                    "i_rms",
                    *_OF_STATE,
                ),
            ),
        }
        self.incomplete = False
        for topic, (rows, begin, keys) in expected.items():
            if not len(rows):
                continue
            missing = _missing(rows["period"], begin, end)
            if missing:
                self._keys.update(keys)
                self.incomplete |= topic == "phase_feedback"
                self.notes.append(
                    failure(
                        f"{missing} of the {end - begin} periods of the window "
                        f"{'are' if missing > 1 else 'is'} missing in {topic}: no figure that "
                        "needs them"
                    )
                )
        if self.incomplete and not len(recording.state):
            self._keys.add("speed_rpm_mean")

    def _judge_steady(self, recording: Recording, w: Window) -> bool | None:
        """Whether the window holds a steady state; tells why not."""
        if self._off:
            self.notes.append(info("no figures that need a driven motor: the gates were off"))
            return False
        if self.incomplete:
            return None
        why = _transients(recording, w, self._past, self._first, self._end)
        if self._mixed:
            why.insert(0, "several schemes controlled")
        if not why and not can_be_judged(w.theta):
            turned = float(turns(w.theta)[-1])
            self.notes.append(
                info(
                    f"whether it is steady cannot be judged: the window holds {turned:.1f} "
                    f"electrical periods, and at least {FEWEST_PERIODS} are needed; no THD and no "
                    "ripple"
                )
            )
            return None
        if why:
            also = ", and no LUT error of either scheme" if self._mixed else ""
            self.notes.append(
                info(
                    f"not steady ({'; '.join(why)}): no THD and no ripple{also}, but the "
                    "deviation from the reference"
                )
            )
        return not why

    def _judge_topics(self, recording: Recording, w: Window) -> None:
        """Say what was not recorded."""
        if not len(recording.lut):
            text = "no lut_diagnostics in the recording: no LUT error, no deviation"
            self.notes.append(info(text))
        if not len(recording.state):
            text = "no drive_state in the recording: no torque, and the speed is the encoder's"
            self.notes.append(info(text))
        elif w.fine_abc is None and self.steady:
            text = "no oversampled waveform in the recording: THD and ripple of the samples only"
            self.notes.append(info(text))

    def _judge_step_time(self, recording: Recording) -> None:
        """The computing time is of the whole run: it is a scheme's if that controlled in all."""
        schemes = {(reign.scheme, reign.chosen) for reign in self._past.reigns}
        if recording.summary.get("step_time_us") and (len(schemes) > 1 or self._past.offs):
            self._keys.add("step_time_us")
            self.notes.append(
                info("no computing time: one scheme did not control throughout, with the gates on")
            )


def _missing(period: NDArray[np.uint64], first: int, end: int) -> int:
    """Periods from `first` to before `end` that a topic, decimated or not, has no rows for."""
    step = np.diff(period.astype(np.int64))
    usual = int(np.median(step)) if len(step) else 1
    begin, stop = np.searchsorted(period, np.array([first, end], dtype=np.uint64))
    inside = period[begin:stop].astype(np.int64)
    if not len(inside):
        return (end - first) // usual * usual if end - first >= usual else 0
    gaps = np.diff(inside)
    count = int(np.sum(gaps[gaps > usual] // usual - 1))
    count += max(0, int(inside[0]) - first) // usual
    count += max(0, end - 1 - int(inside[-1])) // usual
    return count * usual


def _transients(recording: Recording, w: Window, past: History, first: int, end: int) -> list[str]:
    """What changes within a window, in words; nothing in a steady state."""
    T_s, n_p = recording.T_s, recording.n_p or 1
    motor = recording.config.get("motor_file")
    motor = motor if isinstance(motor, dict) else {}
    i_max = float(motor.get("i_max", 0.0))
    w_max = float(motor.get("speed_max_rpm", 0.0)) * TWO_PI / 60.0
    tau_max = 1.5 * n_p * float(motor.get("psi_f", 0.0)) * i_max
    why = [
        f"{change.name} set to {_shown(change.value)} at {change.period * T_s:.3f} s"
        for change in past.changes
        if first < change.period < end and change.name != "scheme"
    ][:3]
    lut = recording.lut[window_rows(recording.lut["period"], (w.begin, w.end), T_s)]
    if len(lut) and not why:
        why += _reference_changes(lut)
    state = recording.state[window_rows(recording.state["period"], (w.begin, w.end), T_s)]
    if len(state) >= 8 and not why:
        load = state["load_torque"]
        small = _SMALL * max(float(np.mean(np.abs(load))), tau_max)
        means = period_means(load, n_p * unwrap(state["angle"]))
        if np.max(np.abs(np.diff(load))) > small or (len(means) and np.ptp(means) > 2 * small):
            why.append(f"the load changes between {load.min():.3g} and {load.max():.3g} N m")
    speed = _speeds(recording, w)
    means = period_means(speed, w.theta) * 60.0 / TWO_PI
    if len(means) and not why:
        small = TRANSIENT * max(float(np.mean(np.abs(means))), _SMALL * w_max * 60.0 / TWO_PI, 1e-3)
        if np.ptp(means) > small:
            low, high = sorted((float(means[0]), float(means[-1])))
            if high - low <= small:
                low, high = float(means.min()), float(means.max())
            why.append(f"the speed changes between {low:.0f} and {high:.0f} r/min")
    judged = can_be_judged(w.theta)
    if judged and not why and not is_steady(w.i_dq, w.theta, i_max=i_max, waveform=w.fine_dq):
        size = np.abs(period_means(w.i_dq, w.theta))
        why.append(f"the current changes between {size.min():.3g} and {size.max():.3g} A")
    return why


def _reference_changes(lut: NDArray[Any]) -> list[str]:
    """What is asked for from outside, and changes: a speed, or in current control a current."""
    speed_ref = lut["speed_ref"]
    in_speed = np.isfinite(speed_ref)
    if in_speed.any() and not in_speed.all():
        return ["the control mode changes"]
    if in_speed.all():
        if np.ptp(speed_ref) == 0.0:
            return []
        low, high = (v * 60.0 / TWO_PI for v in (speed_ref.min(), speed_ref.max()))
        return [f"the speed reference changes between {low:.0f} and {high:.0f} r/min"]
    spans = np.ptp(lut["i_dq_ref"], axis=0)
    axis = int(np.argmax(spans))
    if spans[axis] == 0.0:
        return []
    ref = lut["i_dq_ref"][:, axis]
    name = "dq"[axis]
    return [f"the reference of i_{name} changes between {ref.min():.3g} and {ref.max():.3g} A"]


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _speeds(recording: Recording, w: Window) -> Array:
    """Mechanical speed at the control samples (rad/s): the true one if recorded with each."""
    T_s = recording.T_s
    state = recording.state[window_rows(recording.state["period"], (w.begin, w.end), T_s)]
    if len(state) == len(w.time):
        return np.asarray(state["speed"], dtype=np.float64)
    return np.gradient(w.theta, w.time) / (recording.n_p or 1)


def _speed(recording: Recording, w: Window) -> float:
    """Mean mechanical speed (rad/s): the true one where it is recorded, else the encoder's."""
    T_s = recording.T_s
    state = recording.state[window_rows(recording.state["period"], (w.begin, w.end), T_s)]
    if len(state):
        return float(np.mean(state["speed"]))
    turned = float(w.theta[-1] - w.theta[0]) / float(w.time[-1] - w.time[0])
    return turned / (recording.n_p or 1)


def _resistance(
    recording: Recording, past: History, window_s: Sequence[float]
) -> tuple[float | None, str]:
    """
    Stator resistance that the winding had in the window (ohm), and what there is to say of it.

    R = R_s drift.resistance (1 + alpha_Cu (T - 20 degC)), as of `pmsm_sim.plant`; without a plant
    that tells, the motor file's.
    """
    T_s = recording.T_s
    R_s = recording.config.get("R_s")
    if not isinstance(R_s, (int, float)):
        return None, "no copper loss: the resistance is not stored in the recording"
    if not happened.parameters(recording, "pmsm_sim"):
        return float(R_s), "copper loss with the resistance of the motor file"

    def value(name: str, period: int) -> float:
        found = happened.value_at(recording, past.changes, "pmsm_sim", name, period)
        # recorded by a version without such a parameter
        default: Any = PLANT[name].default
        return float(default if found is None else found)

    rows = window_rows(recording.feedback["period"], window_s, T_s)
    period = recording.feedback["period"][rows].astype(np.int64)
    borders = [c.period for c in past.changes if c.node == "pmsm_sim"]
    starts = sorted({int(period[0]), *(b for b in borders if period[0] < b <= period[-1])})
    state = recording.state[window_rows(recording.state["period"], window_s, T_s)]
    total = 0.0
    for begin, stop in pairwise([*starts, int(period[-1]) + 1]):
        heats = (
            value("drift.thermal_resistance", begin) > 0.0
            or value("drift.time_constant", begin) > 0.0
        )
        inside = (state["period"] >= begin) & (state["period"] < stop)
        if inside.any():
            temperature = float(np.mean(state["temperature"][inside]))
        elif heats:
            return None, "no copper loss: the temperature of the winding is not recorded"
        else:
            temperature = value("drift.temperature", begin)
        rise = temperature - REFERENCE_TEMPERATURE
        ratio = value("drift.resistance", begin) * (
            1.0 + value("drift.copper_coefficient", begin) * rise
        )
        total += ratio * (stop - begin)
    mean = float(R_s) * total / (int(period[-1]) + 1 - int(period[0]))
    different = abs(mean / float(R_s) - 1.0) > 1e-6
    text = f"copper loss with {mean:.3g} ohm, the resistance that the winding had"
    return mean, text if different else ""


# A pace that is kept within this share is kept.
_PACE_KEPT = 0.98


def of_the_run(recording: Recording) -> list[Note]:
    """What the run left behind at its end: its pace, and commands that came too late."""
    summary = recording.summary
    found = []
    if recording.lost_periods:
        text = f"{recording.lost_periods} periods of the recording are incomplete"
        found.append(warning(text))
    pace = summary.get("real_time_factor")
    if isinstance(pace, dict) and pace["achieved"] < _PACE_KEPT * pace["asked"]:
        found.append(
            warning(
                f"the pace was not kept: real_time_factor {pace['asked']:.3g} asked for, "
                f"{pace['achieved']:.3g} achieved"
            )
        )
    missed = summary.get("missed_periods")
    if isinstance(missed, int) and missed > 0:
        found.append(warning(f"in {missed} periods no command had come in time"))
    return found

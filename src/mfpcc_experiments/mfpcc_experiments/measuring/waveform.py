"""
Figures of merit of waveforms: pure functions on arrays, one per definition.

Nothing here knows of bags, ROS or the simulator. Angles are in rad, currents in A, times in s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TWO_PI = 2.0 * math.pi


def space_vector(abc: Array) -> NDArray[np.complex128]:
    """
    Transform three phase quantities to the stationary frame (Clarke, amplitude-invariant).

    Parameters
    ----------
    abc : ndarray, shape (..., 3)
        Phase quantities. A zero-sequence component drops out.

    Returns
    -------
    ndarray, shape (...), complex
        alpha + 1j beta, in the same unit.
    """
    a, b, c = abc[..., 0], abc[..., 1], abc[..., 2]
    vector: NDArray[np.complex128] = (2.0 * a - b - c) / 3.0 + 1j * (b - c) / math.sqrt(3.0)
    return vector


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
    return space_vector(i_abc) * np.exp(-1j * theta_m)


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
    length = min(samples, len(theta)) // 2 * 2 - 1
    if length < 5:
        return theta
    # A straight line is fitted exactly, but only in exact arithmetic: taken out first, so that a
    # large angle costs no digits.
    n = np.arange(len(theta))
    line = theta[0] + (theta[-1] - theta[0]) / (len(theta) - 1) * n
    return line + _parabolas(theta - line, length)


def _parabolas(values: Array, length: int) -> Array:
    """
    Value at each point of the parabola through `length` points around it (Savitzky-Golay).

    Near the ends it is the first and the last whole one's. As `scipy.signal.savgol_filter` with
    ``mode="interp"``, whose package takes longer to import than a comparison to measure.
    """
    half = length // 2
    basis, _ = np.linalg.qr(np.vander(np.arange(-half, half + 1) / half, 3))  # orthonormal
    middle = basis @ basis[half]
    return np.concatenate(
        (
            basis[:half] @ (basis.T @ values[:length]),
            np.convolve(values, middle, mode="valid"),  # symmetric: the order does not matter
            basis[half + 1 :] @ (basis.T @ values[-length:]),
        )
    )


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
    frequency = np.asarray(np.fft.rfftfreq(n, 1.0 / sampling_rate), dtype=np.float64)
    return frequency[1:], lines[1:]


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


#: Turns (electrical) below which a rotor stands still, and into how many parts a window is divided
#: then.
STANDSTILL, PARTS_AT_STANDSTILL = 0.05, 10


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


def period_means(x: NDArray[Any], theta: Array, periods: int = 1) -> NDArray[Any]:
    """
    Mean of a signal over whole electrical periods, from every sample on that has them before it.

    Harmonics of the fundamental vanish in it; what remains changes with the state only. At
    standstill the means of equal parts of the time.

    Parameters
    ----------
    x : ndarray, shape (n,), real or complex
        Signal at equal steps.
    theta : ndarray, shape (n,)
        Electrical angle at the same instants, unwrapped (rad).
    periods : int
        Over how many electrical periods.

    Returns
    -------
    ndarray, shape (m,)
        Empty where there are not so many whole periods.
    """
    n = len(x)
    turned = turns(theta)
    if turned[-1] < STANDSTILL:
        parts = np.array_split(x, PARTS_AT_STANDSTILL) if n >= PARTS_AT_STANDSTILL else []
        return np.array([np.mean(part) for part in parts])
    edges = np.arange(n + 1.0)
    turned = np.append(turned, 2.0 * turned[-1] - turned[-2])
    # half a sample of tolerance, as in `fundamental`
    starts = np.flatnonzero(turned[:-1] + periods <= turned[-1] + 0.5 * (turned[-1] / n))
    ends = np.interp(turned[starts] + periods, turned, edges)
    total = np.concatenate([np.zeros(1, x.dtype), np.cumsum(x)])
    at_ends = np.interp(ends, edges, total.real) + 1j * np.interp(ends, edges, total.imag)
    means = (at_ends - total[starts]) / (ends - starts)
    return means if np.iscomplexobj(x) else means.real


def ripple_pp(x: Array) -> float:
    """Peak-to-peak value of `x`."""
    return float(np.max(x) - np.min(x))


def ripple_rms(x: Array) -> float:
    """Rms deviation of `x` from its mean."""
    return float(np.std(x))


def rms(x: Array) -> float:
    """Root of the mean square of `x`, also where squares would be beyond what a number can be."""
    peak = float(np.max(np.abs(x)))
    if not 0.0 < peak < math.inf:
        return peak
    _, exponent = math.frexp(peak)  # by a power of two nothing is rounded
    scaled = np.ldexp(x, -exponent)
    return math.ldexp(math.sqrt(float(np.mean(np.square(scaled)))), exponent)


def per_axis(values: Any) -> dict[str, float]:
    """Two values, of the axes d and q, as ``metrics.json`` holds them."""
    return {"d": float(values[0]), "q": float(values[1])}


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


# --- Values that are no measurement: not a number, infinite, or beyond anything a drive has ----
# A broken sensor or link records them, and so does a drive into which such faults are injected.

#: Of any quantity in SI units, as in a motor file.
LARGEST = 1e9


def is_plausible(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether each row of some values is plausible; rows of several columns in all of them."""
    sound = np.abs(values) <= LARGEST  # NaN is not
    return sound.all(axis=tuple(range(1, sound.ndim))) if sound.ndim > 1 else sound


def plausible(values: NDArray[Any]) -> NDArray[Any]:
    """Values with NaN in the place of those that are not plausible; a copy where there are any."""
    sound = np.abs(values) <= LARGEST
    return values if sound.all() else np.where(sound, values, np.nan)


def plausible_rows(rows: NDArray[np.void]) -> NDArray[np.void]:
    """A copy of some messages, with NaN in the place of numbers that are not plausible."""
    copy = rows.copy()
    for name in copy.dtype.names or ():
        if copy.dtype[name].base.kind == "f":
            copy[name] = plausible(copy[name])
    return copy

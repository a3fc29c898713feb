"""
The figures of merit of a window as compiled kernels: for many runs that leave no recording.

The definitions are those of `metrics` and `waveform`; only the form differs, loops in place of
array expressions. For a run that is recorded with every message, the figures here are those of
``metrics.json``, to rounding errors; where the file says None, they are NaN.
"""

from __future__ import annotations

import math

import numpy as np

from mfpcc_experiments.measuring.compiled_steadiness import (
    can_be_judged,
    is_steady,
    load_changes,
    mean,
    reference_changes,
    ripple_pp,
    speed_changes,
    turns,
    unwrap,
)
from mfpcc_experiments.measuring.waveform import TWO_PI
from pwm_node.compiled import kernel
from pwm_node.units import RPM

#: The figures of ``metrics.json`` that there are, by their keys there.
KEYS = (
    "thd_percent.oversampled",
    "thd_percent.control",
    "ripple_pp.d",
    "ripple_pp.q",
    "ripple_pp.d_oversampled",
    "ripple_pp.q_oversampled",
    "ripple_rms.d",
    "ripple_rms.q",
    "deviation_rms.d",
    "deviation_rms.q",
    "lut_error_max.d",
    "lut_error_max.q",
    "lut_error_rms.d",
    "lut_error_rms.q",
    "i_d_mean",
    "i_q_error_mean",
    "speed_rpm_mean",
    "torque_mean",
    "torque_ripple_pp",
    "torque_ripple_rms",
    "i_rms",
    "copper_loss_w",
    "switching_frequency_hz",
    "fundamental.amplitude_a",
    "fundamental.frequency_hz",
    "fundamental.periods",
)

#: Figures that there are besides: also outside of a steady state, and of the whole run.
BESIDES = ("i_d_error_mean", "span_pp.d", "span_pp.q")

_AT = {key: n for n, key in enumerate((*KEYS, *BESIDES))}
_THD_OVERSAMPLED, _THD_CONTROL = _AT["thd_percent.oversampled"], _AT["thd_percent.control"]
_RIPPLE_PP, _RIPPLE_RMS = _AT["ripple_pp.d"], _AT["ripple_rms.d"]
_RIPPLE_PP_OVERSAMPLED = _AT["ripple_pp.d_oversampled"]
_DEVIATION_RMS = _AT["deviation_rms.d"]
_ERROR_MAX, _ERROR_RMS = _AT["lut_error_max.d"], _AT["lut_error_rms.d"]
_I_D_MEAN, _I_Q_ERROR_MEAN = _AT["i_d_mean"], _AT["i_q_error_mean"]
_SPEED, _I_RMS, _COPPER = _AT["speed_rpm_mean"], _AT["i_rms"], _AT["copper_loss_w"]
_TORQUE, _TORQUE_PP = _AT["torque_mean"], _AT["torque_ripple_pp"]
_TORQUE_RMS, _SWITCHING = _AT["torque_ripple_rms"], _AT["switching_frequency_hz"]
_AMPLITUDE, _FREQUENCY = _AT["fundamental.amplitude_a"], _AT["fundamental.frequency_hz"]
_PERIODS = _AT["fundamental.periods"]
_I_D_ERROR_MEAN, _SPAN = _AT["i_d_error_mean"], _AT["span_pp.d"]
N_FIGURES = len(_AT)

#: What is kept of each period of a window: rows of one array.
SIGNALS = (
    "angle", "i_a", "i_d", "i_q", "i_d_ref", "i_q_ref", "e_d", "e_q", "torque", "speed",
    "load_torque", "speed_ref", "resistance",
)  # fmt: skip
(
    ANGLE, I_A, I_D, I_Q, I_D_REF, I_Q_REF, E_D, E_Q, TORQUE, SPEED, LOAD_TORQUE, SPEED_REF,
    RESISTANCE,
) = range(len(SIGNALS))  # fmt: skip

#: What else the figures need: of the motor, and of what happened in the window.
COURSE = np.dtype(
    [
        ("T_s", np.float64),  # (s)
        ("n_p", np.float64),
        ("i_max", np.float64),  # of the motor file (A)
        ("w_max", np.float64),  # top speed (rad/s, mechanical)
        ("tau_max", np.float64),  # what i_max makes with the magnets alone (N m)
        ("changed", np.bool_),  # a parameter is set within the window
        ("off", np.bool_),  # the gates were off in one of its periods
        ("mixed", np.bool_),  # several schemes controlled
        ("commands", np.int64),  # periods that there was a command for
        ("inside", np.int64),  # duties strictly between 0 and 1, gates on
        ("between", np.int64),  # legs that switched from one period to the next
    ],
    align=True,
)

#: Answers of `measure`: `steady` of ``metrics.json``.
TRANSIENT_STATE, STEADY, NOT_JUDGED = 0, 1, -1


@kernel
def _fundamental(x, theta):
    """`waveform.fundamental`: amplitude, whole periods (0: none), THD (ratio)."""
    n = x.shape[0]
    if n < 8:
        return np.nan, 0, np.nan
    last = abs(theta[n - 1] - theta[0])
    step = last / (n - 1)
    periods = int((last + 1.5 * step) / TWO_PI)
    if periods < 1 or step <= 0.0 or step > math.pi:
        return np.nan, 0, np.nan
    samples, whole = n, periods * TWO_PI
    if whole <= last:
        k = n - 1
        while abs(theta[k] - theta[0]) > whole:
            k -= 1
        if k < n - 1:
            low, high = abs(theta[k] - theta[0]), abs(theta[k + 1] - theta[0])
            samples = round(k + (whole - low) / (high - low))
    cos, sin = np.empty(samples), np.empty(samples)
    s_c = s_s = s_cc = s_cs = s_ss = s_x = s_cx = s_sx = 0.0
    for k in range(samples):
        c, s = math.cos(theta[k]), math.sin(theta[k])
        cos[k], sin[k] = c, s
        s_c += c
        s_s += s
        s_cc += c * c
        s_cs += c * s
        s_ss += s * s
        s_x += x[k]
        s_cx += c * x[k]
        s_sx += s * x[k]
    # normal equations, less the constant
    m = float(samples)
    a_cc, a_cs, a_ss = s_cc - s_c * s_c / m, s_cs - s_c * s_s / m, s_ss - s_s * s_s / m
    b_c, b_s = s_cx - s_c * s_x / m, s_sx - s_s * s_x / m
    det = a_cc * a_ss - a_cs * a_cs
    of_cos, of_sin = (b_c * a_ss - b_s * a_cs) / det, (b_s * a_cc - b_c * a_cs) / det
    constant = (s_x - of_cos * s_c - of_sin * s_s) / m
    amplitude = math.hypot(of_cos, of_sin)
    if not amplitude > 0.0:
        return np.nan, 0, np.nan
    square = 0.0
    for k in range(samples):
        rest = x[k] - constant - of_cos * cos[k] - of_sin * sin[k]
        square += rest * rest
    return amplitude, periods, math.sqrt(2.0 * (square / m)) / amplitude


@kernel
def _ripple_rms(x):
    """`waveform.ripple_rms`."""
    centre, total = mean(x), 0.0
    for k in range(x.shape[0]):
        total += (x[k] - centre) * (x[k] - centre)
    return math.sqrt(total / x.shape[0])


@kernel
def _mean_square(x):
    total = 0.0
    for k in range(x.shape[0]):
        total += x[k] * x[k]
    return total / x.shape[0]


@kernel
def _largest(x):
    most = 0.0
    for k in range(x.shape[0]):
        most = max(most, abs(x[k]))
    return most


@kernel
def _fine(theta, i_abc):
    """`waveform.oversample_angle` and `to_dq` of the oversampled currents, shape (n, 3 m)."""
    n, m = i_abc.shape[0], i_abc.shape[1] // 3
    fine_theta, d, q, i_a = np.empty(n * m), np.empty(n * m), np.empty(n * m), np.empty(n * m)
    for k in range(n):
        step = theta[k + 1] - theta[k] if k < n - 1 else theta[k] - theta[k - 1]
        for j in range(m):
            a, b, c = i_abc[k, 3 * j], i_abc[k, 3 * j + 1], i_abc[k, 3 * j + 2]
            at = theta[k] + step * (j / m)
            alpha, beta = (2.0 * a - b - c) / 3.0, (b - c) / math.sqrt(3.0)
            cos, sin = math.cos(at), math.sin(at)
            p = k * m + j
            fine_theta[p], i_a[p] = at, a
            d[p], q[p] = alpha * cos + beta * sin, beta * cos - alpha * sin
    return fine_theta, i_a, d, q


@kernel
def _judge(course, w, turned, fine_d, fine_q):
    """`Fitness.steady`."""
    if course.off or course.mixed or course.changed:
        return TRANSIENT_STATE
    if (
        reference_changes(w[SPEED_REF], w[I_D_REF], w[I_Q_REF])
        or load_changes(w[LOAD_TORQUE], course.tau_max, turned)
        or speed_changes(w[SPEED], course.w_max, turned)
    ):
        return TRANSIENT_STATE
    if not can_be_judged(turned):
        return NOT_JUDGED
    steady = is_steady(w[I_D], w[I_Q], turned, course.i_max, fine_d, fine_q)
    return STEADY if steady else TRANSIENT_STATE


@kernel
def measure(course, w, i_abc, figures):
    """
    Measure a window.

    Parameters
    ----------
    course : record of `COURSE`
    w : float64 array, shape (len(SIGNALS), n)
        The signals; the mechanical angle in its first row becomes the electrical one, unwrapped.
    i_abc : float64 array, shape (n, 3 m)
        Oversampled phase currents (A); m may be 0.
    figures : float64 array, shape (N_FIGURES,)
        Written here, in the order of `KEYS` and `BESIDES`.

    Returns
    -------
    int
        `STEADY`, `TRANSIENT_STATE` or `NOT_JUDGED`.
    """
    n = w.shape[1]
    figures[:] = np.nan
    theta, i_d, i_q = w[ANGLE], w[I_D], w[I_Q]
    unwrap(theta)
    for k in range(n):
        theta[k] *= course.n_p
    turned = turns(theta)
    fine = i_abc.shape[1] > 0
    fine_theta, fine_a, fine_d, fine_q = _fine(theta, i_abc)
    steady = _judge(course, w, turned, fine_d, fine_q)

    speed = mean(w[SPEED])
    figures[_SPEED] = speed / RPM
    figures[_FREQUENCY] = abs(speed) * course.n_p / TWO_PI
    amplitude, periods, thd = _fundamental(w[I_A], theta)
    figures[_PERIODS] = periods
    if course.commands >= 2:
        cycles = 2 * course.inside + course.between
        figures[_SWITCHING] = cycles / (2.0 * 3.0 * course.commands * course.T_s)
    else:
        figures[_SWITCHING] = 0.0
    for axis in range(2):
        figures[_SPAN + axis] = ripple_pp(w[I_D + axis])
    if course.off:
        return steady

    figures[_I_D_MEAN] = mean(i_d)
    figures[_TORQUE] = mean(w[TORQUE])
    if fine:
        square = _mean_square(fine_d) + _mean_square(fine_q)
    else:
        square = _mean_square(i_d) + _mean_square(i_q)
    figures[_I_RMS] = math.sqrt(square / 2.0)
    figures[_COPPER] = 1.5 * mean(w[RESISTANCE]) * square
    for axis in range(2):
        deviation = w[I_D + axis] - w[I_D_REF + axis]
        figures[_DEVIATION_RMS + axis] = math.sqrt(_mean_square(deviation))
        figures[_I_D_ERROR_MEAN if axis == 0 else _I_Q_ERROR_MEAN] = mean(deviation)
        if not course.mixed:
            figures[_ERROR_MAX + axis] = _largest(w[E_D + axis])
            figures[_ERROR_RMS + axis] = math.sqrt(_mean_square(w[E_D + axis]))
    if steady != STEADY:
        return steady

    figures[_AMPLITUDE] = amplitude
    figures[_THD_CONTROL] = 100.0 * thd
    figures[_TORQUE_PP] = ripple_pp(w[TORQUE])
    figures[_TORQUE_RMS] = _ripple_rms(w[TORQUE])
    for axis in range(2):
        figures[_RIPPLE_PP + axis] = ripple_pp(w[I_D + axis])
        figures[_RIPPLE_RMS + axis] = _ripple_rms(w[I_D + axis])
    if fine:
        figures[_THD_OVERSAMPLED] = 100.0 * _fundamental(fine_a, fine_theta)[2]
        figures[_RIPPLE_PP_OVERSAMPLED] = ripple_pp(fine_d)
        figures[_RIPPLE_PP_OVERSAMPLED + 1] = ripple_pp(fine_q)
    return steady

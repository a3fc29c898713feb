"""What the drive measures: phase currents, rotor angle, DC-link voltage; and what it is allowed.

A phase-current sensor shows `(1 + gain error) i + offset + noise`; its low-pass and the sampling
instant act on i before that (`general`), the analogue-to-digital converter after it. An
incremental encoder of N lines shows the angle in steps of a quarter line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pmsm_sim import columns as col
from pmsm_sim.frames import phases, stationary
from pmsm_sim.motor import MotorPars
from pmsm_sim.noise import normal
from pmsm_sim.parts.part import MOST_STEPS, Part
from pmsm_sim.parts.protection import allowed_current
from pwm_node.compiled import kernel
from pwm_node.parameters import Parameter

_TWO_PI = 2.0 * math.pi


PARAMETERS = (
    Parameter(
        "sensor.current_gain",
        [1.0, 1.0, 1.0],
        "Gain of the current sensors of phases a, b, c",
        minimum=0.1,
        maximum=10.0,
    ),
    Parameter(
        "sensor.current_offset",
        [0.0, 0.0, 0.0],
        "Offset of the current sensors of phases a, b, c",
        unit="A",
        minimum=-100.0,
        maximum=100.0,
    ),
    Parameter(
        "sensor.current_bandwidth",
        0.0,
        "Bandwidth of the current sensors (first-order low-pass); 0: unlimited",
        unit="Hz",
        minimum=0.0,
        maximum=1e6,
    ),
    Parameter(
        "sensor.adc_bits",
        0,
        "Resolution of the current converters; 0: no quantisation",
        minimum=0,
        maximum=24,
    ),
    Parameter(
        "sensor.adc_range",
        20.0,
        "Largest current of either sign that the converters can show; beyond it they saturate",
        unit="A",
        minimum=0.001,
        maximum=1e4,
    ),
    Parameter(
        "sensor.sampling_lead",
        0.0,
        "Time by which the currents are sampled before the period begins, in periods",
        minimum=0.0,
        maximum=1.0,
    ),
    Parameter(
        "sensor.encoder_lines",
        0,
        "Lines of the incremental encoder, each counted four times; 0: no quantisation",
        minimum=0,
        maximum=1_000_000,
    ),
    Parameter(
        "sensor.encoder_offset",
        0.0,
        "Angle that the encoder shows when the rotor is at zero",
        unit="rad",
        minimum=-6.3,
        maximum=6.3,
    ),
    Parameter(
        "sensor.encoder_latency",
        0.0,
        "Age of the angle at the start of the period; at most one period",
        unit="s",
        minimum=0.0,
        maximum=1e-3,
    ),
    Parameter(
        "sensor.angle_noise",
        0.0,
        "White noise of the angle (resolver), rms",
        unit="rad",
        minimum=0.0,
        maximum=0.1,
    ),
    Parameter(
        "noise.current_rms",
        0.0,
        "White noise of each phase-current sensor, rms",
        unit="A",
        minimum=0.0,
        maximum=100.0,
    ),
    Parameter("seed", 0, "Seed of all noise", minimum=0, maximum=2**53, read_only=True),
)

PAR = (
    ("sensors", np.bool_),  # measurements have more errors than noise
    ("current_rms", np.float64),  # noise of each phase-current sensor (A)
    ("seed", np.uint64),
    ("current_gain", np.float64, (3,)),
    ("current_offset", np.float64, (3,)),  # (A)
    ("filter_rate", np.float64),  # 2 pi times the bandwidth (rad/s); 0: none
    ("adc_step", np.float64),  # (A); 0: no quantisation
    ("adc_codes", np.float64),  # half their number
    ("lead", np.float64),  # currents are sampled so long before the period (s)
    ("encoder_counts", np.float64),  # per turn; 0: no quantisation
    ("encoder_offset", np.float64),  # (rad)
    ("encoder_latency", np.float64),  # (s)
    ("angle_noise", np.float64),  # rms (rad)
)

STATE = (
    ("i_f_alpha", np.float64),  # behind the current sensors' low-pass (A)
    ("i_f_beta", np.float64),
    ("i_sampled", np.float64, (2,)),  # alpha and beta current for the next sample (A)
    ("theta_sampled", np.float64),  # rotor angle for the next sample (rad)
)


def _check(values: Mapping[str, Any]) -> str | None:
    T_s = 1.0 / values["pwm_frequency"]
    latency = values["sensor.encoder_latency"]
    if latency > T_s:
        return (
            f"'sensor.encoder_latency' = {latency:g} is out of range: at "
            f"most one PWM period, 0 to {T_s:g} s"
        )
    for name in ("sensor.current_gain", "sensor.current_offset"):
        if len(values[name]) != 3:
            return f"'{name}' = {values[name]} must have three values, for phases a, b and c"
    return None


def _configure(par: np.void, st: np.void, values: Mapping[str, Any], motor: MotorPars) -> None:
    # a low-pass that is faster than the shortest step cannot be told from it
    par["filter_rate"] = min(_TWO_PI * values["sensor.current_bandwidth"], MOST_STEPS / par["T_s"])
    bits = values["sensor.adc_bits"]
    par["adc_codes"] = 2.0 ** (bits - 1)
    par["adc_step"] = values["sensor.adc_range"] / par["adc_codes"] if bits > 0 else 0.0
    par["lead"] = values["sensor.sampling_lead"] * par["T_s"]
    par["encoder_counts"] = 4.0 * values["sensor.encoder_lines"]
    par["sensors"] = bool(
        bits > 0
        or np.any(par["current_gain"] != 1.0)
        or np.any(par["current_offset"] != 0.0)
        or par["encoder_counts"] > 0.0
        or par["encoder_offset"] != 0.0
        or par["encoder_latency"] > 0.0
        or par["angle_noise"] > 0.0
    )


def _general(par: np.void) -> bool:
    return bool(par["filter_rate"] > 0.0 or par["lead"] > 0.0 or par["encoder_latency"] > 0.0)


PART = Part(
    parameters=PARAMETERS,
    par=PAR,
    state=STATE,
    check=_check,
    configure=_configure,
    general=_general,
)


@kernel
def wrapped(angle):
    """The same angle in [0, 2 pi)."""
    if angle >= 0.0 and angle < _TWO_PI:
        return angle
    angle %= _TWO_PI
    # a tiny negative angle wraps to 2 pi itself by rounding
    return angle if angle < _TWO_PI else 0.0


@kernel
def begin_low_pass(par, st, y, c, s, fresh):
    """State at the start of a period; c and s are cosine and sine of the electrical angle."""
    if fresh:
        st.i_f_alpha, st.i_f_beta = stationary(st.i_d, st.i_q, c, s)
    y[col.I_F_ALPHA], y[col.I_F_BETA] = st.i_f_alpha, st.i_f_beta


@kernel
def low_pass(par, h, i_f, start, middle, end):
    """What the current sensors show after a step of length h (s) (A, stationary frame).

    Exact for a current that is a parabola through its values at start, middle and end:

        i_f(h) = exp(-z) i_f(0) + z int_0^1 exp(-z (1 - x)) i(x h) dx,    z = rate h

    Parameters
    ----------
    i_f : (float, float)
        What they show at the start (A).
    start, middle, end : (float, float)
        The current (A).
    """
    z = par.filter_rate * h
    # z int exp(-z (1 - x)) x^k dx for k = 0, 1, 2; by their series where they would cancel
    if z < 0.05:
        m_2 = z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0 * (1.0 - z / 6.0)))
        m_1 = z / 2.0 * (1.0 - m_2)
        m_0 = z * (1.0 - m_1)
    else:
        m_0 = 1.0 - math.exp(-z)
        m_1 = 1.0 - m_0 / z
        m_2 = 1.0 - 2.0 * m_1 / z
    w_start = m_0 - 3.0 * m_1 + 2.0 * m_2
    w_middle = 4.0 * (m_1 - m_2)
    w_end = 2.0 * m_2 - m_1
    stays = 1.0 - m_0
    return (
        stays * i_f[0] + w_start * start[0] + w_middle * middle[0] + w_end * end[0],
        stays * i_f[1] + w_start * start[1] + w_middle * middle[1] + w_end * end[1],
    )


@kernel
def shown(par, y, i_alpha, i_beta):
    """What the current sensors show of i (A, stationary frame)."""
    if par.filter_rate > 0.0:
        return y[col.I_F_ALPHA], y[col.I_F_BETA]
    return i_alpha, i_beta


@kernel
def end_low_pass(par, st, y, i_alpha, i_beta):
    """State after a period; without a low-pass, where one would begin that is switched on later."""
    st.i_f_alpha, st.i_f_beta = shown(par, y, i_alpha, i_beta)


@kernel
def _converted(par, i):
    """The current as an ADC of `adc_codes` codes of each sign shows it (A); it saturates."""
    code = math.floor(i / par.adc_step + 0.5)
    return par.adc_step * min(max(code, -par.adc_codes), par.adc_codes - 1.0)


@kernel
def _angle(par, st):
    """Rotor angle as the encoder shows it (rad)."""
    angle = st.theta_sampled if st.general_before else st.theta_M
    angle += par.encoder_offset
    if par.angle_noise > 0.0:
        angle += par.angle_noise * normal(par.seed, st.period, np.uint64(3))
    angle = wrapped(angle)
    if par.encoder_counts > 0.0:
        step = _TWO_PI / par.encoder_counts
        angle = step * math.floor(angle / step)
    return angle


@kernel
def sample(par, st, c, s, fb):
    """Fill the measurement record from the state at the start of the period.

    c and s are the cosine and sine of the electrical angle.
    """
    if st.general_before:
        i_alpha, i_beta = st.i_sampled[0], st.i_sampled[1]
    else:
        i_alpha, i_beta = stationary(st.i_d, st.i_q, c, s)
    i_a, i_b, i_c = phases(i_alpha, i_beta)
    angle = st.theta_M
    if par.sensors:
        i_a = par.current_gain[0] * i_a + par.current_offset[0]
        i_b = par.current_gain[1] * i_b + par.current_offset[1]
        i_c = par.current_gain[2] * i_c + par.current_offset[2]
        angle = _angle(par, st)
    if par.current_rms > 0.0:
        i_a += par.current_rms * normal(par.seed, st.period, np.uint64(0))
        i_b += par.current_rms * normal(par.seed, st.period, np.uint64(1))
        i_c += par.current_rms * normal(par.seed, st.period, np.uint64(2))
    if par.sensors and par.adc_step > 0.0:
        i_a, i_b, i_c = _converted(par, i_a), _converted(par, i_b), _converted(par, i_c)
    fb.period = st.period
    fb.i_a = i_a
    fb.i_b = i_b
    fb.i_c = i_c
    fb.encoder_angle = angle
    fb.dc_voltage = st.u_dc if par.rectifier and st.general_before else par.u_dc
    fb.derating = allowed_current(st)

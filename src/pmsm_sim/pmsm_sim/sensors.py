"""What the drive measures: phase currents, rotor angle, DC-link voltage; and what it is allowed.

A phase-current sensor shows `(1 + gain error) i + offset + noise`; its low-pass and the sampling
instant act on i before that (`general`), the analogue-to-digital converter after it. An
incremental encoder of N lines shows the angle in steps of a quarter line.
"""

from __future__ import annotations

import math

import numpy as np

from pmsm_sim.noise import normal
from pmsm_sim.protection import allowed_current
from pwm_node.compiled import kernel

_SQRT3_2 = 0.5 * math.sqrt(3.0)
_TWO_PI = 2.0 * math.pi


@kernel
def wrapped(angle):
    """The same angle in [0, 2 pi)."""
    if angle >= 0.0 and angle < _TWO_PI:
        return angle
    angle %= _TWO_PI
    # a tiny negative angle wraps to 2 pi itself by rounding
    return angle if angle < _TWO_PI else 0.0


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
        i_alpha = c * st.i_d - s * st.i_q
        i_beta = s * st.i_d + c * st.i_q
    i_a = i_alpha
    i_b = -0.5 * i_alpha + _SQRT3_2 * i_beta
    i_c = -0.5 * i_alpha - _SQRT3_2 * i_beta
    angle = st.theta_M
    if par.sensors:
        i_a = par.gain[0] * i_a + par.offset[0]
        i_b = par.gain[1] * i_b + par.offset[1]
        i_c = par.gain[2] * i_c + par.offset[2]
        angle = _angle(par, st)
    if par.noise_rms > 0.0:
        i_a += par.noise_rms * normal(par.seed, st.period, np.uint64(0))
        i_b += par.noise_rms * normal(par.seed, st.period, np.uint64(1))
        i_c += par.noise_rms * normal(par.seed, st.period, np.uint64(2))
    if par.sensors and par.adc_step > 0.0:
        i_a, i_b, i_c = _converted(par, i_a), _converted(par, i_b), _converted(par, i_c)
    fb.period = st.period
    fb.i_a = i_a
    fb.i_b = i_b
    fb.i_c = i_c
    fb.encoder_angle = angle
    fb.dc_voltage = st.u_dc if par.rectifier and st.general_before else par.u_dc
    fb.derating = allowed_current(st)

"""The simulated drive: inverter, machine, mechanics and sensors, one PWM period at a time.

`Plant` holds the records; the kernel `advance` does the work of one period and is what both the
node and the in-process engine call. Nothing here knows of ROS.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pmsm_sim import motor
from pmsm_sim.general import integrate
from pmsm_sim.ideal import integrate_ideal
from pmsm_sim.inverter import take_command
from pmsm_sim.machine import torque
from pmsm_sim.noise import normal
from pmsm_sim.records import PLANT_PAR, PLANT_STATE
from pwm_node.compiled import kernel

# Answers of `latch`
ACCEPTED = 0
WRONG_PERIOD = 1
OUT_OF_RANGE = 2

_TWO_PI = 2.0 * math.pi
_SQRT3_2 = 0.5 * math.sqrt(3.0)


@kernel
def latch(st_, cmd_):
    """Take the command for the period that begins now.

    Returns `ACCEPTED`, `WRONG_PERIOD` or `OUT_OF_RANGE`; only an accepted command has an effect.
    """
    st, cmd = st_[0], cmd_[0]
    if cmd.period == 0:
        return WRONG_PERIOD  # the first command is for period 1
    if cmd.period != st.period or st.latched:
        st.refused += np.uint64(1)
        return WRONG_PERIOD
    for x in range(3):
        # written so that NaN is out of range
        if not (cmd.duty[x] >= 0.0 and cmd.duty[x] <= 1.0):
            st.refused += np.uint64(1)
            return OUT_OF_RANGE
    for x in range(3):
        st.duty[x] = cmd.duty[x]
    st.enable = cmd.enable
    st.latched = True
    return ACCEPTED


@kernel
def _sample(par, st, c, s, fb):
    """Fill the measurement record from the state at the start of the period."""
    i_alpha = c * st.i_d - s * st.i_q
    i_beta = s * st.i_d + c * st.i_q
    i_a = i_alpha
    i_b = -0.5 * i_alpha + _SQRT3_2 * i_beta
    i_c = -0.5 * i_alpha - _SQRT3_2 * i_beta
    if par.noise_rms > 0.0:
        i_a += par.noise_rms * normal(par.seed, st.period, np.uint64(0))
        i_b += par.noise_rms * normal(par.seed, st.period, np.uint64(1))
        i_c += par.noise_rms * normal(par.seed, st.period, np.uint64(2))
    fb.period = st.period
    fb.i_a = i_a
    fb.i_b = i_b
    fb.i_c = i_c
    fb.encoder_angle = st.theta_M
    fb.dc_voltage = par.u_dc


@kernel
def _set_stamp(stamp, period, period_ns):
    t_ns = np.int64(period) * period_ns
    stamp.sec = t_ns // 1_000_000_000
    stamp.nanosec = t_ns % 1_000_000_000


@kernel
def advance(par_, st_, fb_, ds_, i_abc, legs_out):
    """One PWM period: sample, then integrate it with the duties latched for it.

    Parameters
    ----------
    par_, st_ : arrays of length 1 of `PLANT_PAR`, `PLANT_STATE`
    fb_, ds_ : arrays of length 1
        The fixed parts of `PhaseFeedback` and `DriveState`, written here.
    i_abc : float64 array, shape (3 n,)
        Phase currents at n equal steps of the period, written here; n may be 0.
    legs_out : uint8 array, shape (n,)
    """
    par, st, fb, ds = par_[0], st_[0], fb_[0], ds_[0]
    take_command(par, st)
    theta_m = par.n_p * st.theta_M
    c, s = math.cos(theta_m), math.sin(theta_m)
    _set_stamp(fb.stamp, st.period, par.period_ns)
    _set_stamp(ds.stamp, st.period, par.period_ns)
    _sample(par, st, c, s, fb)

    ds.period = st.period
    ds.i_dq[0] = st.i_d
    ds.i_dq[1] = st.i_q
    ds.torque = torque(par, st.i_d, st.i_q)
    ds.speed = st.w_M
    ds.angle = st.theta_M
    ds.load_torque = par.tau_L
    ds.dc_voltage = par.u_dc
    ds.gates_on = st.gates_on

    if st.gates_on:
        turn_M, energy = integrate_ideal(par, st, c, s, i_abc, legs_out)
    else:
        turn_M, energy = integrate(par, st, i_abc, legs_out)

    ds.dc_current = energy / (par.u_dc * par.T_s)
    theta_M = st.theta_M + turn_M
    if not (theta_M >= 0.0 and theta_M < _TWO_PI):
        theta_M %= _TWO_PI
        if theta_M >= _TWO_PI:
            theta_M = 0.0  # a tiny negative angle wraps to 2 pi itself by rounding
    st.theta_M = theta_M
    st.energy_in += energy
    st.period += np.uint64(1)


class Plant:
    """The simulated drive and its parameters.

    Parameters
    ----------
    values : mapping
        A value for every parameter of `pmsm_sim.parameters.TABLE`.

    Attributes
    ----------
    par, st : arrays of length 1 of `PLANT_PAR`, `PLANT_STATE`
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.motor = motor.load(values["motor"])
        self.oversampling: int = values["oversampling"]
        self.par = np.zeros(1, PLANT_PAR)
        self.st = np.zeros(1, PLANT_STATE)

        par = self.par
        for name in ("R_s", "L_d", "L_q", "psi_f", "n_p", "J", "B"):
            par[name] = getattr(self.motor, name)
        par["T_s"] = 1.0 / values["pwm_frequency"]
        par["period_ns"] = round(1e9 / values["pwm_frequency"])
        par["h_max"] = 0.5 * par["T_s"]
        par["seed"] = values["seed"]
        self.apply(values)

        # until the first command comes: the zero vector
        st = self.st
        st["duty"] = 0.5
        st["enable"] = True
        st["w_M"] = values["initial_speed_rpm"] * _TWO_PI / 60.0
        st["theta_M"] = values["initial_angle"] % _TWO_PI

    def apply(self, changes: Mapping[str, Any]) -> None:
        """Take over changed parameters; they act from the next period on."""
        for name, field in _LIVE.items():
            if name in changes:
                self.par[field] = changes[name]
        if "inverter.missing_command" in changes:
            self.par["hold"] = changes["inverter.missing_command"] == "hold"

    def clear_trip(self) -> None:
        """Forget a loss of commands; the gates are driven again with the next one."""
        self.st["tripped"] = False
        self.st["missing_in_row"] = 0


# live parameter -> field of PLANT_PAR
_LIVE = {
    "load_torque": "tau_L",
    "dc_voltage": "u_dc",
    "inverter.command_loss_limit": "loss_limit",
    "noise.current_rms": "noise_rms",
}

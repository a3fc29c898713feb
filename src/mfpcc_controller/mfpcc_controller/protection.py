"""The controller's protection: it judges each sample before it is used, and the drive by it.

A sample that cannot be true is refused and replaced by what was predicted; two in a row disable
the inverter. Faults are latched with the period and the value of their first occurrence. They are
cleared by request only, refused while the cause lasts, and the inverter is enabled again only
after the reference has been at zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mfpcc_controller import stall
from mfpcc_controller.motor import EstimatedPars
from mfpcc_controller.observer import wrapped
from mfpcc_controller.vectors import scaled, square
from pwm_node import faults
from pwm_node.compiled import kernel
from pwm_node.faults import REACT, Fault, Faults
from pwm_node.parameters import Parameter

_DISABLED = "inverter disabled"
_FALLBACK = "the fallback scheme answers the same sample; if that fails too, inverter disabled"

#: What the controller sees; `text` is what it says.
FAULTS = Faults(
    Fault(
        code="FEEDBACK_LOST",
        text="{value:.3g} s without a sample",
        reaction=_DISABLED,
        threshold=Parameter(
            "fault.feedback_timeout",
            1.0,
            "Wall-clock time without a sample after which an enabled controller disables the "
            "inverter, counted in tenths of a second; 0: it waits for ever. It has to be longer "
            "than samples are apart; five samples missing in a row trip in any case",
            unit="s",
            minimum=0.0,
            maximum=1e3,
        ),
    ),
    Fault(
        code="FEEDBACK_INVALID",
        text="two samples in a row that are not newer than the one before, or beyond what sensors "
        "and motor file allow; DC link at {value:.0f} V",
        reaction=_DISABLED + "; one alone is replaced by what was predicted",
    ),
    Fault(
        code="OVERCURRENT",
        text="current amplitude {value:.1f} A",
        reaction=_DISABLED,
        threshold=Parameter(
            "fault.overcurrent",
            1.5,
            "Current amplitude that trips, divided by the motor's current limit",
            minimum=0.1,
            maximum=100.0,
        ),
    ),
    Fault(
        code="CURRENT_SUM",
        text="the phase currents add up to {value:.2f} A",
        reaction=_DISABLED,
        threshold=Parameter(
            "fault.current_sum",
            0.083,
            "Sum of the phase currents (filtered, 1 ms) that trips, divided by the current limit",
            minimum=1e-3,
            maximum=100.0,
        ),
    ),
    Fault(
        code="ENCODER",
        text="the angle jumped, or stood still while the rotor turned, by {value:.3f} rad",
        reaction=_DISABLED,
        threshold=Parameter(
            "fault.encoder_jump",
            0.12,
            "Step of the angle from sample to sample that trips, on top of what 1.5 times top "
            "speed allows; it has to be above the step of a coarse encoder (15 lines: 0.105)",
            unit="rad",
            minimum=0.0,
            maximum=3.2,
        ),
    ),
    Fault(
        code="OVERSPEED",
        text="{value:.0f} rad/s",
        reaction=_DISABLED,
        threshold=Parameter(
            "fault.overspeed",
            1.2,
            "Speed that trips, divided by the motor's top speed",
            minimum=0.1,
            maximum=100.0,
        ),
    ),
    Fault(
        code="SPINOUT",
        text="mechanical power {value:.0f} W while the machine takes electrical power",
        reaction=_DISABLED,
    ),
    Fault(
        code="STALL",
        text="no way made towards the speed's reference in {value:.3g} s, with all the torque that "
        "is allowed: a blocked rotor, or a wrong number of pole pairs",
        reaction=_DISABLED,
        threshold=Parameter(
            "fault.stall_time",
            2.0,
            "Time in which a drive in speed control has to make some way towards its reference, "
            "once it needs all its torque; 0: for ever",
            unit="s",
            minimum=0.0,
            maximum=1e3,
        ),
    ),
    Fault(
        code="PREDICTION",
        text="prediction error {value:.1f} A",
        reaction=_FALLBACK,
        threshold=Parameter(
            "fault.prediction_error",
            0.25,
            "Prediction error at which the fallback scheme takes over, divided by the current "
            "limit",
            minimum=1e-3,
            maximum=100.0,
        ),
    ),
    Fault(
        code="SCHEME",
        text="the scheme gave no valid output",
        text_of_value="ten steps in a row took longer than 'fault.step_budget', the last "
        "{value:.3g} us",
        reaction=_FALLBACK + "; after slow steps it answers the next sample",
        threshold=Parameter(
            "fault.step_budget",
            0.0,
            "Wall-clock time that a step of the scheme may take: ten in a row beyond it bring the "
            "fallback scheme; 0: any time, so that a run does not depend on how fast the machine "
            "is",
            unit="us",
            minimum=0.0,
            maximum=1e6,
        ),
    ),
    Fault(
        code="INVERTER",
        text="the inverter has blocked its gates by itself",
        reaction=_DISABLED,
    ),
)

PARAMETERS = (
    Parameter(
        "stop.ramp_time",
        0.5,
        "Safe stop 1: time from top speed to zero; the gates go off after twice as long at the "
        "latest",
        unit="s",
        minimum=1e-3,
        maximum=1e3,
    ),
    REACT,
    *FAULTS.parameters,
    Parameter(
        "fault.prediction_time",
        5e-3,
        "Time for which every prediction has to exceed 'fault.prediction_error'",
        unit="s",
        minimum=1e-4,
        maximum=10.0,
    ),
)

FEEDBACK_LOST = FAULTS.number("FEEDBACK_LOST")
FEEDBACK_INVALID = FAULTS.number("FEEDBACK_INVALID")
OVERCURRENT = FAULTS.number("OVERCURRENT")
CURRENT_SUM = FAULTS.number("CURRENT_SUM")
ENCODER = FAULTS.number("ENCODER")
OVERSPEED = FAULTS.number("OVERSPEED")
SPINOUT = FAULTS.number("SPINOUT")
STALL = FAULTS.number("STALL")
PREDICTION = FAULTS.number("PREDICTION")
SCHEME = FAULTS.number("SCHEME")
INVERTER = FAULTS.number("INVERTER")

# A step of more periods than this is a loss: five samples in between are missing, or more.
_GAP = np.uint64(5)
# Beyond this multiple of the current limit a sensor shows nothing but nonsense.
_SENSOR_RANGE = 4.0
_ANGLE_END = 2.0 * math.pi + 1e-6
# Overspeed has to last so long: the observer starts with a speed from two angles only.
_OVERSPEED_TIME = 2e-3
# So far (rad), and two steps of the encoder, must the rotor have turned while that stood still: one
# may pass without being seen where it turns back, one is the observer's delay.
_FROZEN = 0.05
# Powers of both signs, over the largest that voltage and current limit make (seed_750: 10 W)
_SPINOUT_POWER = 3e-3
# Dead time that an inverter may have (s), and voltage that it may lose besides, over u_dc. Dead
# time takes from a leg its share of the period, which as a space vector is 4/3 of that.
_DEAD_TIME = 5e-6
_ON_STATE = 0.01
# Filters of the sum of the phase currents, and of the powers that SPINOUT compares (s)
_SUM_TIME = 1e-3
_POWER_TIME = 5e-3

CFG_FIELDS = [
    ("react", np.bool_),  # whether faults disable the inverter
    ("overcurrent_sq", np.float64),  # (A^2)
    ("current_sum", np.float64),  # (A)
    ("sum_rate", np.float64),  # share of a sample in its filter
    ("jump", np.float64),  # largest step of the angle (rad, mechanical)
    ("overspeed", np.float64),  # (rad/s, electrical)
    ("stored", np.float64),  # 0.75 L / T_s of the motor file: power of a change of |i|^2 (ohm)
    ("copper", np.float64),  # twice 1.5 R_s of the motor file (ohm)
    ("torque_per_ampere", np.float64),  # 1.5 psi_f of the motor file: times w_m, power (V s)
    ("power_rate", np.float64),  # share of a sample in the filter of the powers
    ("lost", np.float64),  # 1.5 times the voltage that the inverter may lose, over u_dc
    ("spinout_power", np.float64),  # (W)
    ("stall_time", np.float64),  # (s)
    ("prediction_sq", np.float64),  # (A^2)
    ("prediction_time", np.float64),  # (s)
    ("u_dc", np.float64),  # of the motor file (V)
    ("u_dc_min", np.float64),  # outside these the DC-link sensor is broken (V)
    ("u_dc_max", np.float64),
    ("stop_rate", np.float64),  # of safe stop 1 (rad/s^2)
    ("w_rest", np.float64),  # below this the drive is at rest (rad/s, electrical)
    ("i_rest_sq", np.float64),  # (A^2)
]

MEMORY = np.dtype(
    [
        ("latch", FAULTS.latch),
        ("awaits_zero", np.bool_),  # cleared: disabled until the reference has been at zero
        ("slowing", np.bool_),  # in safe stop 1
        ("stop_left", np.float64),  # time it may still take (s)
        ("invalid", np.uint64),  # samples refused since the start
        ("invalid_in_row", np.int64),
        ("sum", np.float64),  # of the phase currents, filtered (A)
        ("angle", np.float64),  # the encoder's, of the sample before (rad)
        ("step", np.float64),  # smallest of its steps so far (rad)
        ("unseen", np.float64),  # turned by the estimated speed since the encoder last moved (rad)
        ("fast", np.float64),  # time at overspeed (s)
        ("motion", stall.MEMORY),
        ("electrical", np.float64),  # filtered powers (W)
        ("mechanical", np.float64),
        ("wrong", np.float64),  # time with bad predictions (s)
        ("overrun", np.float64),  # step time that was too long too often (us); 0: none was
    ],
    align=True,
)


def configure(cfg: np.void, motor: EstimatedPars, values: Mapping[str, Any]) -> None:
    """Take over the limits, from the motor file and the parameters."""
    T_s, i_max = float(cfg["T_s"]), motor.i_max
    w_M_max = motor.speed_max_rpm * 2.0 * math.pi / 60.0
    cfg["react"] = values["fault.react"]
    cfg["overcurrent_sq"] = (values["fault.overcurrent"] * i_max) ** 2
    cfg["current_sum"] = values["fault.current_sum"] * i_max
    cfg["sum_rate"] = 1.0 - math.exp(-T_s / _SUM_TIME)
    cfg["jump"] = 1.5 * w_M_max * T_s + values["fault.encoder_jump"]
    cfg["overspeed"] = values["fault.overspeed"] * w_M_max * motor.n_p
    cfg["stored"] = 0.75 * max(motor.L_d, motor.L_q) / T_s
    cfg["copper"] = 2.0 * 1.5 * motor.R_s
    cfg["torque_per_ampere"] = 1.5 * motor.psi_f
    cfg["power_rate"] = 1.0 - math.exp(-T_s / _POWER_TIME)
    cfg["lost"] = 1.5 * (4.0 / 3.0 * _DEAD_TIME / T_s + _ON_STATE)
    cfg["spinout_power"] = _SPINOUT_POWER * 1.5 * motor.u_dc / math.sqrt(3.0) * i_max
    cfg["stall_time"] = values["fault.stall_time"] or math.inf
    cfg["prediction_sq"] = (values["fault.prediction_error"] * i_max) ** 2
    cfg["prediction_time"] = values["fault.prediction_time"]
    cfg["u_dc"] = motor.u_dc
    cfg["u_dc_min"] = 0.1 * motor.u_dc
    cfg["u_dc_max"] = 4.0 * motor.u_dc
    cfg["stop_rate"] = w_M_max / values["stop.ramp_time"]
    cfg["w_rest"] = 0.01 * w_M_max * motor.n_p
    cfg["i_rest_sq"] = (0.01 * i_max) ** 2


@kernel
def report(mem, fault, value):
    """Latch a fault with the value that was seen; whether it disables is the caller's matter."""
    faults.report(mem.guard.latch, fault, mem.period, value)


@kernel
def trip(cfg, mem, fault, value):
    """Latch a fault and disable the inverter."""
    faults.trip(mem.guard.latch, fault, mem.period, value, cfg.react)


@kernel
def stale(mem, fb):
    """Whether a sample is not newer than the one before: repeated, or overtaken by it."""
    return mem.running and fb.period <= mem.period


@kernel
def plausible(cfg, fb):
    """Whether a sample can be true; written so that NaN cannot."""
    limit = _SENSOR_RANGE * cfg.i_max
    return (
        abs(fb.i_a) <= limit
        and abs(fb.i_b) <= limit
        and abs(fb.i_c) <= limit
        and fb.encoder_angle >= -1e-6
        and fb.encoder_angle <= _ANGLE_END
        and fb.dc_voltage >= cfg.u_dc_min
        and fb.dc_voltage <= cfg.u_dc_max
        and fb.derating >= 0.0
        and fb.derating <= 1.0
    )


@kernel
def refuse(cfg, mem, fb):
    """Count a sample that cannot be true, or that came again or too late."""
    guard = mem.guard
    guard.invalid += np.uint64(1)
    guard.invalid_in_row += 1
    if guard.invalid_in_row >= 2:
        trip(cfg, mem, FEEDBACK_INVALID, fb.dc_voltage)


@kernel
def accept(cfg, mem, fb, step):
    """Return whether the sample, `step` periods after the one before, is to be used."""
    guard = mem.guard
    guard.latch.present = np.uint32(0)
    if step > _GAP:
        trip(cfg, mem, FEEDBACK_LOST, step * cfg.T_s)
    if plausible(cfg, fb):
        guard.invalid_in_row = 0
        return True
    guard.angle += mem.w_m * cfg.T_s / cfg.n_p
    refuse(cfg, mem, fb)
    return False


@kernel
def _watch_encoder(cfg, mem, angle):
    """The angle against the one before (rad, mechanical) and the estimated speed."""
    guard = mem.guard
    if mem.consecutive:
        turned = abs(wrapped(angle - guard.angle))
        if turned > cfg.jump:
            trip(cfg, mem, ENCODER, turned)
        if turned > 0.0:
            guard.unseen = 0.0
            guard.step = min(guard.step, turned) if guard.step > 0.0 else turned
        else:
            # a rotor that turns back within a step is not seen to do so
            guard.unseen += mem.w_m * cfg.T_s / cfg.n_p
            if abs(guard.unseen) > _FROZEN + 2.0 * guard.step:
                trip(cfg, mem, ENCODER, abs(guard.unseen))
    guard.angle = angle


@kernel
def _watch_power(cfg, mem):
    """Air-gap power by the voltage against that by the angle: they agree unless the angle lies.

    Not counted are what the current stores in the inductance (a step of the current takes and
    gives kilowatts for a few periods), what the inverter may lose, and twice the copper loss of the
    motor file: a reversal, or braking with a warm winding, is no fault.
    """
    guard = mem.guard
    u_dq = mem.past.u * mem.turn_past
    i_dq = scaled(0.5, mem.i_dq + mem.i_dq_past)
    taken = 1.5 * mem.u_dc * (u_dq.real * i_dq.real + u_dq.imag * i_dq.imag)
    stored = cfg.stored * (square(mem.i_dq) - square(mem.i_dq_past))
    size = math.sqrt(square(i_dq))
    electrical = taken - stored - size * (cfg.copper * size + cfg.lost * mem.u_dc)
    mechanical = cfg.torque_per_ampere * mem.i_dq.imag * mem.w_m
    guard.electrical += cfg.power_rate * (electrical - guard.electrical)
    guard.mechanical += cfg.power_rate * (mechanical - guard.mechanical)
    if guard.mechanical < -cfg.spinout_power and guard.electrical > cfg.spinout_power:
        trip(cfg, mem, SPINOUT, guard.mechanical)


@kernel
def watch(cfg, mem, fb):
    """Judge the drive by a sample that was accepted, after the observer has taken it."""
    guard = mem.guard
    if fb.derating == 0.0:
        trip(cfg, mem, INVERTER, 0.0)
    i_sq = square(mem.i_dq)
    if not i_sq <= cfg.overcurrent_sq:
        trip(cfg, mem, OVERCURRENT, math.sqrt(i_sq))
    guard.sum += cfg.sum_rate * (fb.i_a + fb.i_b + fb.i_c - guard.sum)
    if not abs(guard.sum) <= cfg.current_sum:
        trip(cfg, mem, CURRENT_SUM, guard.sum)
    _watch_encoder(cfg, mem, fb.encoder_angle)
    if abs(mem.w_m) <= cfg.overspeed:
        guard.fast = 0.0
    else:
        guard.fast += cfg.T_s
        if guard.fast > _OVERSPEED_TIME:
            trip(cfg, mem, OVERSPEED, mem.w_m / cfg.n_p)
    if mem.past.on and mem.consecutive:
        _watch_power(cfg, mem)
        if stall.stalled(cfg, mem, guard.motion):
            trip(cfg, mem, STALL, cfg.stall_time)
    else:
        guard.motion.time = 0.0
        guard.electrical = 0.0
        guard.mechanical = 0.0


@kernel
def misled(cfg, mem):
    """Whether the scheme has predicted badly for so long that another has to take over."""
    guard = mem.guard
    # written so that a plug-in that predicts nothing is not wrong
    if not square(mem.e) > cfg.prediction_sq:
        guard.wrong = 0.0
        return False
    guard.wrong += cfg.T_s
    if guard.wrong < cfg.prediction_time:
        return False
    guard.wrong = 0.0
    report(mem, PREDICTION, math.sqrt(square(mem.e)))
    return True


@kernel
def overran(cfg, mem):
    """Whether the scheme has taken so long that another has to take over; the node has timed it."""
    took = mem.guard.overrun
    if took == 0.0:
        return False
    mem.guard.overrun = 0.0
    report(mem, SCHEME, took)
    return True


@kernel
def slow_down(cfg, mem):
    """Safe stop 1: the speed reference goes to zero at a given rate, then the gates go off."""
    guard = mem.guard
    step = cfg.stop_rate * cfg.T_s
    cfg.w_M_ref = math.copysign(max(abs(cfg.w_M_ref) - step, 0.0), cfg.w_M_ref)
    guard.stop_left -= cfg.T_s
    if guard.stop_left <= 0.0 or (cfg.w_M_ref == 0.0 and abs(mem.w_m) < cfg.w_rest):
        guard.slowing = False
        guard.latch.tripped = True


@kernel
def released(cfg, mem):
    """Whether the gates may be on: nothing tripped, and the reference was at zero since."""
    guard = mem.guard
    if guard.latch.tripped:
        return False
    if guard.awaits_zero:
        if cfg.speed_control:
            at_zero = abs(cfg.w_M_ref) * cfg.n_p <= cfg.w_rest
        else:
            at_zero = square(cfg.i_dq_ref) <= cfg.i_rest_sq
        guard.awaits_zero = not at_zero
    return not guard.awaits_zero

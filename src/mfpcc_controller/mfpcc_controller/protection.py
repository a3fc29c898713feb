"""The controller's protection: it judges each sample before it is used, and the drive by it.

A sample that cannot be true is refused and replaced by what was predicted; two in a row disable
the inverter. Faults are latched with the period and the value of their first occurrence. They are
cleared by request only, refused while the cause lasts, and the inverter is enabled again only
after the reference has been at zero.
"""

from __future__ import annotations

import math

import numpy as np

from mfpcc_controller.observer import wrapped
from mfpcc_controller.vectors import scaled, square
from pwm_node.compiled import kernel

#: The controller's faults; the position is the bit in `GUARD_MEMORY.faults`.
FAULTS: dict[str, str] = {
    "FEEDBACK_LOST": "{value:.3g} s without a sample",
    "FEEDBACK_INVALID": "two samples in a row that are not newer than the one before, or beyond "
    "what sensors and motor file allow; DC link at {value:.0f} V",
    "OVERCURRENT": "current amplitude {value:.1f} A",
    "CURRENT_SUM": "the phase currents add up to {value:.2f} A",
    "ENCODER": "the angle jumped, or stood still while the rotor turned, by {value:.3f} rad",
    "OVERSPEED": "{value:.0f} rad/s",
    "SPINOUT": "mechanical power {value:.0f} W while the machine takes electrical power",
    "PREDICTION": "prediction error {value:.1f} A",
    "SCHEME": "the scheme gave no valid output",  # or OVERRUN
    "INVERTER": "the inverter has blocked its gates by itself",
}
#: What is said of a scheme that takes too long
OVERRUN = "ten steps in a row took longer than 'fault.step_budget', the last {value:.3g} us"
CODES = tuple(FAULTS)
N_FAULTS = len(CODES)

FEEDBACK_LOST = CODES.index("FEEDBACK_LOST")
FEEDBACK_INVALID = CODES.index("FEEDBACK_INVALID")
OVERCURRENT = CODES.index("OVERCURRENT")
CURRENT_SUM = CODES.index("CURRENT_SUM")
ENCODER = CODES.index("ENCODER")
OVERSPEED = CODES.index("OVERSPEED")
SPINOUT = CODES.index("SPINOUT")
PREDICTION = CODES.index("PREDICTION")
SCHEME = CODES.index("SCHEME")
INVERTER = CODES.index("INVERTER")

# Steps of more periods than this are a loss: five samples in between are missing.
_GAP = np.uint64(5)
# Beyond this multiple of the current limit a sensor shows nothing but nonsense.
_SENSOR_RANGE = 4.0
_ANGLE_END = 2.0 * math.pi + 1e-6
# Overspeed has to last so long: the observer starts with a speed from two angles only.
_OVERSPEED_TIME = 2e-3
# So far (rad) must the rotor have turned while the encoder stood still; a coarse one has steps.
_FROZEN = 0.05
_SPINOUT_POWER = 10.0  # W, of both signs
# Voltage that dead time and on-state voltages may take from the inverter's, over u_dc
_INVERTER = 0.04


@kernel
def report(cfg, mem, fault, value):
    """Latch a fault with the value that was seen; whether it disables is the caller's matter."""
    guard = mem.guard
    bit = np.uint32(1) << np.uint32(fault)
    guard.present |= bit
    if guard.faults & bit == np.uint32(0):
        guard.faults |= bit
        guard.at[fault] = mem.period
        guard.value[fault] = value


@kernel
def trip(cfg, mem, fault, value):
    """Latch a fault and disable the inverter."""
    report(cfg, mem, fault, value)
    if cfg.react:
        mem.guard.tripped = True


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
    guard.present = np.uint32(0)
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
        else:
            guard.unseen += abs(mem.w_m) * cfg.T_s / cfg.n_p
            if guard.unseen > _FROZEN:
                trip(cfg, mem, ENCODER, guard.unseen)
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
    electrical = taken - stored - size * (cfg.copper * size + 1.5 * _INVERTER * mem.u_dc)
    mechanical = cfg.torque_per_ampere * mem.i_dq.imag * mem.w_m
    guard.electrical += cfg.power_rate * (electrical - guard.electrical)
    guard.mechanical += cfg.power_rate * (mechanical - guard.mechanical)
    if guard.mechanical < -_SPINOUT_POWER and guard.electrical > _SPINOUT_POWER:
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
    else:
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
    report(cfg, mem, PREDICTION, math.sqrt(square(mem.e)))
    return True


@kernel
def overran(cfg, mem):
    """Whether the scheme has taken so long that another has to take over; the node has timed it."""
    took = mem.guard.overrun
    if took == 0.0:
        return False
    mem.guard.overrun = 0.0
    report(cfg, mem, SCHEME, took)
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
        guard.tripped = True


@kernel
def released(cfg, mem):
    """Whether the gates may be on: nothing tripped, and the reference was at zero since."""
    guard = mem.guard
    if guard.tripped:
        return False
    if guard.awaits_zero:
        if cfg.speed_control:
            at_zero = abs(cfg.w_M_ref) * cfg.n_p <= cfg.w_rest
        else:
            at_zero = square(cfg.i_dq_ref) <= cfg.i_rest_sq
        guard.awaits_zero = not at_zero
    return not guard.awaits_zero


def named(faults: int) -> list[str]:
    """Codes of the bits that are set."""
    return [code for bit, code in enumerate(CODES) if faults >> bit & 1]

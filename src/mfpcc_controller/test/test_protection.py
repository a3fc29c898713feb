"""The controller's protection: what is wrong disables with the very next command, and stays."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mfpcc_msgs.msg import DutyCommand, LutDiagnostics, PhaseFeedback

from mfpcc_controller import protection
from mfpcc_controller.controller import Controller
from mfpcc_controller.parameters import TABLE
from mfpcc_controller.protection import FAULTS
from pwm_node.compiled import kernel
from pwm_node.wire import fixed_dtype

SPEED = 78.5  # rad/s
TOP = 1500.0 * math.pi / 30.0  # top speed of seed_750 (rad/s)


class Drive:
    """A controller that is shown samples of a machine turning at a steady speed."""

    def __init__(self, **values):
        dotted = {name.replace(".", "_"): name for name in TABLE}
        changes = {"speed_ref_rpm": 750.0, "scheme": "pi_foc"}
        changes |= {dotted[name]: value for name, value in values.items()}
        self.controller = Controller(TABLE.complete(changes))
        self.fb = np.zeros(1, fixed_dtype(PhaseFeedback))
        self.cmd = np.zeros(1, fixed_dtype(DutyCommand))
        self.lut = np.zeros(1, fixed_dtype(LutDiagnostics))
        self.k = 0
        self.speed = SPEED

    def show(self, periods=1, skip=0, add=None, **wrong):
        """Show so many samples; `wrong` replaces what is measured, `add` comes on top of it."""
        for _ in range(periods):
            fb = self.fb
            fb["period"] = self.k
            angle = (self.k * self.speed * 1e-4) % (2.0 * math.pi)
            for x, name in enumerate(("i_a", "i_b", "i_c")):
                fb[name] = -2.0 * math.sin(4.0 * angle - 2.0 * math.pi / 3.0 * x)
            fb["encoder_angle"], fb["dc_voltage"], fb["derating"] = angle, 311.0, 1.0
            for name, value in wrong.items():
                fb[name] = value
            for name, value in (add or {}).items():
                fb[name] += value
            self.controller.step(fb, self.cmd, self.lut, True)
            self.k += 1 + skip
        return self

    @property
    def enabled(self):
        return bool(self.cmd["enable"][0])

    @property
    def codes(self):
        return [code for code, _, _ in self.controller.faults()]


def test_nothing_trips_by_itself():
    drive = Drive().show(300)
    assert drive.enabled and drive.codes == []


def test_a_single_bad_sample_is_bridged_and_two_disable():
    drive = Drive().show(100).show(1, i_a=math.nan)
    assert drive.enabled and drive.codes == []
    assert np.isfinite(drive.cmd["duty"]).all()
    drive.show(1).show(2, encoder_angle=math.inf)
    assert not drive.enabled and drive.codes == ["FEEDBACK_INVALID"]
    assert np.isfinite(drive.cmd["duty"]).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"i_b": 1e9},
        {"dc_voltage": -1.0},
        {"dc_voltage": math.nan},
        {"encoder_angle": -3.0},
        {"derating": math.nan},
        {"derating": 1.1},
    ],
)
def test_samples_out_of_the_sensors_range_are_refused(wrong):
    drive = Drive().show(100).show(2, **wrong)
    assert not drive.enabled and drive.codes == ["FEEDBACK_INVALID"]


def test_overcurrent_disables_with_the_next_command():
    drive = Drive().show(100).show(1, i_a=19.0, i_b=-9.5, i_c=-9.5)
    assert not drive.enabled and drive.codes[0] == "OVERCURRENT"
    assert drive.controller.faults()[0][1] == 100


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("phase", ["i_a", "i_b", "i_c"])
def test_phase_currents_that_do_not_add_up(phase, sign):
    limit = 0.083 * 12.0

    def off_by(amperes):
        drive = Drive().show(100)
        for _ in range(100):
            drive.show(1, add={phase: sign * amperes})
        return drive

    assert off_by(0.98 * limit).codes == []
    drive = off_by(1.02 * limit)
    assert not drive.enabled and drive.codes == ["CURRENT_SUM"]
    assert f"{sign * limit:.1f}" in drive.controller.faults()[0][2]


def test_the_sum_of_the_phase_currents_is_filtered_with_a_millisecond():
    drive, seen = Drive(fault_react=False, fault_overcurrent=100.0).show(1), 0.0
    for _ in range(10):  # 1 ms
        drive.show(1, add={"i_b": 2.0})
        seen = float(drive.controller.mem["guard"]["sum"][0])
    assert seen == pytest.approx(2.0 * (1.0 - math.exp(-1.0)), rel=1e-9)


def test_a_jump_of_the_encoder():
    drive = Drive().show(100).show(1, encoder_angle=5.0)
    assert not drive.enabled and drive.codes == ["ENCODER"]


def test_an_encoder_that_stands_still_while_the_rotor_turns():
    drive = (
        Drive().show(100).show(30, encoder_angle=float(Drive().show(100).fb["encoder_angle"][0]))
    )
    assert not drive.enabled and "ENCODER" in drive.codes


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_overspeed_in_either_direction(sign):
    def at(share):
        drive = Drive(speed_ref_rpm=sign * 750.0, fault_overspeed=SPEED / TOP / share)
        drive.speed = sign * SPEED
        return drive.show(200)

    assert at(0.99).codes == []
    drive = at(1.01)
    assert not drive.enabled and drive.codes == ["OVERSPEED"]
    value = float(drive.controller.mem["guard"]["latch"]["value"][0, FAULTS.number("OVERSPEED")])
    assert value == pytest.approx(sign * SPEED, rel=0.01)


def test_overspeed_has_to_last_for_2_ms():
    drive = Drive().show(200)
    drive.controller.apply({"fault.overspeed": 0.4})
    assert drive.show(19).codes == []
    assert drive.show(2).codes == ["OVERSPEED"]


def test_overspeed_that_is_interrupted_begins_anew():
    drive = Drive().show(200)
    for _ in range(3):
        drive.controller.apply({"fault.overspeed": 0.4})
        drive.show(15)
        drive.controller.apply({"fault.overspeed": 1.2})
        drive.show(1)
    assert drive.codes == []


def test_five_missing_samples_are_a_loss_and_four_are_none():
    assert Drive().show(99).show(1, skip=4).show(1).codes == []
    drive = Drive().show(99).show(1, skip=5).show(1)
    assert not drive.enabled and drive.codes == ["FEEDBACK_LOST"]
    assert drive.controller.faults() == [("FEEDBACK_LOST", 105, "0.0006 s without a sample")]


def test_the_first_sample_may_have_any_number():
    drive = Drive()
    drive.k = 10_000
    assert drive.show(100).enabled and drive.codes == []


def test_a_sample_that_comes_again_has_no_effect():
    drive = Drive().show(100)
    before, memory = drive.cmd.copy(), drive.controller.mem["pll_theta"].copy()
    drive.k -= 1
    drive.show(1, i_a=1.0)
    assert drive.cmd == before and drive.controller.mem["pll_theta"] == memory


def test_bad_predictions_bring_the_fallback_and_then_the_stop():
    drive = Drive(scheme="mbpcc", mismatch_flux=100.0).show(100)
    assert "PREDICTION" in drive.codes
    assert drive.controller.scheme == "pi_foc"


def test_an_inverter_that_has_blocked_its_gates_by_itself():
    drive = Drive().show(100).show(1, derating=0.0)
    assert not drive.enabled and drive.codes == ["INVERTER"]
    assert drive.controller.clear_faults() == ["INVERTER"], "the cause lasts"
    drive.show(100, derating=0.0)
    assert drive.lut["i_dq_ref"][0].tolist() == [0.0, 0.0] and not drive.controller.failed
    drive.show(1)
    assert drive.controller.clear_faults() == [], "the inverter was cleared"
    assert not drive.show(5).enabled, "the reference has not been at zero"


@pytest.mark.parametrize("mode", ["speed", "current"])
@pytest.mark.parametrize("field_weakening", [False, True])
def test_the_current_reference_follows_what_the_inverter_allows(mode, field_weakening):
    values = {
        "control_mode": mode,
        "speed_ref_rpm": 1400.0,
        "i_q_ref": -11.0,
        "i_d_ref": 3.0,
        "field_weakening": field_weakening,
    }
    drive = Drive(**{name.replace(".", "_"): value for name, value in values.items()})

    def amplitude(derating):
        drive.show(50, derating=derating)
        return math.hypot(*drive.lut["i_dq_ref"][0])

    assert amplitude(1.0) > 11.0
    assert amplitude(0.5) == pytest.approx(6.0)
    assert amplitude(0.1) == pytest.approx(1.2)
    assert amplitude(1.0) > 11.0
    assert drive.enabled


def test_without_the_reaction_it_only_tells():
    drive = Drive(fault_react=False).show(100).show(2, i_a=math.nan)
    assert drive.enabled and drive.codes == ["FEEDBACK_INVALID"]


def test_power_returns_only_after_the_reference_has_been_at_zero():
    drive = Drive().show(100).show(2, i_a=math.nan)
    assert drive.controller.clear_faults() == ["FEEDBACK_INVALID"], "the cause lasts"
    drive.show(5)
    assert drive.controller.clear_faults() == []
    drive.show(5)
    assert not drive.enabled and drive.codes == []
    drive.controller.apply({"speed_ref_rpm": 0.0})
    drive.show(1)
    assert drive.enabled
    drive.controller.apply({"speed_ref_rpm": 750.0})
    drive.show(1)
    assert drive.enabled


@pytest.mark.parametrize("reference", [{"i_q_ref": 3.0}, {"i_q_ref": -3.0}, {"i_d_ref": -3.0}])
def test_power_returns_to_a_current_only_after_its_reference_has_been_at_zero(reference):
    drive = Drive(control_mode="current", **reference).show(100)
    assert drive.enabled
    drive.controller.stop()
    drive.show(5)
    assert drive.controller.clear_faults() == []
    assert not drive.show(50).enabled, "it would return into a running set-point"
    (name,) = reference
    drive.controller.apply({name: 0.13})  # 1 % of 12 A is at rest
    assert not drive.show(5).enabled
    drive.controller.apply({name: 0.12})
    assert drive.show(1).enabled
    drive.controller.apply(reference)
    assert drive.show(5).enabled


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_speed_of_one_percent_is_at_rest(sign):
    drive = Drive().show(10)
    drive.controller.stop()
    drive.show(1)
    assert drive.controller.clear_faults() == []
    drive.controller.apply({"speed_ref_rpm": sign * 15.1})
    assert not drive.show(5).enabled
    drive.controller.apply({"speed_ref_rpm": sign * 14.9})
    assert drive.show(1).enabled


def test_safe_torque_off():
    drive = Drive().show(100)
    drive.controller.stop()
    assert not drive.show(1).enabled
    assert not drive.show(50).enabled


def test_safe_stop_1_ramps_down_and_then_disables():
    drive = Drive(stop_ramp_time=0.01).show(100)
    drive.controller.slow_down()
    drive.show(1)
    assert drive.enabled
    assert drive.controller.cfg["w_M_ref"][0] < SPEED
    drive.show(60)
    assert drive.controller.cfg["w_M_ref"][0] == 0.0
    drive.show(200)
    assert not drive.enabled, "the machine did not come to rest in time"


def test_the_limits_of_a_motor_by_hand():
    """`seed_750`: 12 A, 1500 r/min, 311 V, 15 mH, 1.5 ohm, 0.14 V s, 4 pole pairs, at 10 kHz."""
    limits = {
        "overcurrent_sq": 324.0,
        "current_sum": 0.996,
        "sum_rate": 0.09516258,
        "jump": 0.1435619,
        "overspeed": 753.98224,
        "stored": 112.5,
        "copper": 4.5,
        "torque_per_ampere": 0.21,
        "power_rate": 0.01980133,
        "lost": 0.115,
        "spinout_power": 9.69602,
        "stall_time": 2.0,
        "prediction_sq": 9.0,
        "prediction_time": 0.005,
        "u_dc": 311.0,
        "u_dc_min": 31.1,
        "u_dc_max": 1244.0,
        "stop_rate": 314.159265,
        "w_rest": 6.2831853,
        "i_rest_sq": 0.0144,
    }
    cfg = Drive().controller.cfg
    assert {name: float(cfg[name][0]) for name in limits} == pytest.approx(limits, rel=1e-6)
    assert Drive(fault_stall_time=0.0).controller.cfg["stall_time"][0] == math.inf


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("phase", ["i_a", "i_b", "i_c"])
def test_a_sensor_shows_at_most_four_times_the_current_limit(phase, sign):
    def refused(amperes):
        drive = Drive(fault_react=False).show(10).show(1, **{phase: sign * amperes})
        return int(drive.controller.mem["guard"]["invalid"][0])

    assert [refused(48.0), refused(48.01)] == [0, 1]


@kernel
def _watch_power(cfg, mem):
    protection._watch_power(cfg[0], mem[0])


def test_the_two_powers_by_the_textbook():
    """Air-gap power by the voltage, less what it may be wrong by, and by torque and speed."""
    controller = Drive().controller
    cfg, mem = controller.cfg, controller.mem
    rng = np.random.default_rng(1)
    electrical = mechanical = 0.0
    for _ in range(20):
        u, i, i_past = (complex(*rng.uniform(-8.0, 8.0, 2)) for _ in range(3))
        turn, w_m = np.exp(1j * rng.uniform(0.0, 6.0)), rng.uniform(-600.0, 600.0)
        mem["u_dc"], mem["w_m"], mem["i_dq"], mem["i_dq_past"] = 300.0, w_m, i, i_past
        mem["past"]["u"], mem["turn_past"] = u / 20.0, turn
        _watch_power(cfg, mem)
        mean = 0.5 * (i + i_past)
        voltage = 300.0 * u / 20.0 * turn
        power = 1.5 * (voltage * mean.conjugate()).real
        power -= 0.75 * 15e-3 * (abs(i) ** 2 - abs(i_past) ** 2) / 1e-4
        power -= 2.0 * 1.5 * 1.5 * abs(mean) ** 2 + 0.115 * 300.0 * abs(mean)
        share = 1.0 - math.exp(-1e-4 / 5e-3)
        electrical += share * (power - electrical)
        mechanical += share * (1.5 * 4 * 0.14 * i.imag * w_m / 4 - mechanical)
        guard = mem["guard"][0]
        assert guard["electrical"] == pytest.approx(electrical, rel=1e-9)
        assert guard["mechanical"] == pytest.approx(mechanical, rel=1e-9)


def test_what_an_inverter_that_blocked_its_gates_by_itself_is_told_with():
    drive = Drive().show(100).show(1, derating=0.0)
    assert drive.controller.mem["guard"]["latch"]["value"][0, FAULTS.number("INVERTER")] == 0.0

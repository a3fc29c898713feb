"""The inverter's protection: same period, latched, cleared only when the cause has gone."""

from __future__ import annotations

import numpy as np
import pytest

from pmsm_sim.parameters import TABLE
from pwm_node.parameters import ParameterError


def _codes(drive):
    return [code for code, _, _ in drive.plant.faults()]


def _dc_voltage(volts):
    return lambda drive: drive.plant.apply({"dc_voltage": volts})


def _current(amperes):
    def cause(drive):
        drive.st["i_q"] = amperes

    return cause


CAUSES = {
    "OVERCURRENT": _current(18.1),
    "DC_OVERVOLTAGE": _dc_voltage(411.0),
    "DC_UNDERVOLTAGE": _dc_voltage(199.0),
    "OVERTEMPERATURE": lambda drive: drive.plant.apply({"drift.temperature": 126.0}),
}


@pytest.mark.parametrize("code", CAUSES)
def test_a_fault_blocks_the_gates_in_the_same_period(bench, code):
    drive = bench().run(5)
    assert drive.column("gates_on").all()
    CAUSES[code](drive)
    drive.run(1)
    assert not drive.state[-1]["gates_on"]
    assert _codes(drive) == [code]
    assert drive.plant.faults()[0][1] == 5


@pytest.mark.parametrize(("code", "volts"), [("DC_OVERVOLTAGE", 411.0), ("DC_UNDERVOLTAGE", 199.0)])
def test_the_voltage_behind_a_rectifier_is_that_of_its_capacitor(bench, code, volts):
    """What is charged by the grid or by braking, whatever the parameter `dc_voltage` says."""
    drive = bench(dc_link_kind="rectifier").run(5)
    assert drive.column("gates_on").all() and _codes(drive) == []
    drive.st["u_dc"] = volts
    drive.run(1)
    assert not drive.state[-1]["gates_on"]
    assert _codes(drive) == [code] and f"{volts:.0f} V" in drive.plant.faults()[0][2]


def test_a_rectifier_begins_at_the_dc_voltage(bench):
    drive = bench(dc_link_kind="rectifier", dc_voltage=420.0).run(1)
    assert _codes(drive) == ["DC_OVERVOLTAGE"]


@pytest.mark.parametrize(
    ("code", "just_within", "just_beyond"),
    [
        ("OVERCURRENT", _current(18.0), _current(18.000001)),
        ("OVERCURRENT", _current(-18.0), _current(-18.000001)),
        ("DC_OVERVOLTAGE", _dc_voltage(1.318 * 311.0), _dc_voltage(1.318 * 311.0 + 1e-6)),
        ("DC_UNDERVOLTAGE", _dc_voltage(0.643 * 311.0), _dc_voltage(0.643 * 311.0 - 1e-6)),
    ],
)
def test_what_is_at_the_limit_does_not_trip(bench, code, just_within, just_beyond):
    drive = bench().run(5)
    just_within(drive)
    drive.run(1)
    assert _codes(drive) == []
    just_beyond(drive)
    drive.run(1)
    assert _codes(drive) == [code]


def test_both_components_count_for_the_current(bench):
    for i_d, i_q, codes in [(-12.0, 13.0, []), (-13.0, -13.0, ["OVERCURRENT"])]:
        drive = bench().run(1)
        drive.st["i_d"], drive.st["i_q"] = i_d, i_q
        drive.run(1)
        assert _codes(drive) == codes
    assert "18.4 A, limit 18.0 A" in drive.plant.faults()[0][2]


def test_a_dc_link_that_is_still_charging_does_not_trip_before_the_first_command(bench):
    drive = bench(dc_voltage=50.0).run(5, command=False)
    assert _codes(drive) == []
    drive.run(1)
    assert _codes(drive) == ["DC_UNDERVOLTAGE"]
    drive = bench(dc_voltage=50.0).run(1)
    drive.plant.apply({"dc_voltage": 311.0})
    drive.run(1)
    assert drive.plant.clear_faults() == []
    drive.plant.apply({"dc_voltage": 50.0})
    drive.run(1, command=False)
    assert _codes(drive) == ["DC_UNDERVOLTAGE"], "also in a period whose command is missing"


@pytest.mark.parametrize("code", CAUSES)
def test_without_the_reaction_the_gates_stay_on(bench, code):
    drive = bench(fault_react=False).run(5)
    CAUSES[code](drive)
    drive.run(1)
    assert drive.state[-1]["gates_on"]
    assert _codes(drive) == [code]


@pytest.mark.parametrize(
    ("temperature", "share"), [(20.0, 1.0), (100.0, 1.0), (110.0, 0.6), (124.0, 0.04), (126.0, 0.0)]
)
def test_less_current_is_allowed_before_the_temperature_trips(bench, temperature, share):
    drive = bench(drift_temperature=temperature).run(2)
    assert drive.feedback[-1]["derating"] == pytest.approx(share)
    assert drive.column("gates_on").all() == (share > 0.0)


def test_at_the_limits_of_the_temperature(bench):
    drive = bench(drift_temperature=125.0).run(2)
    assert drive.feedback[-1]["derating"] == 0.0
    assert drive.column("gates_on").all() and _codes(drive) == []
    both = {"fault_derating_temperature": 130.0, "fault_overtemperature": 130.0}
    drive = bench(drift_temperature=130.0, **both).run(2)
    assert drive.feedback[-1]["derating"] == 1.0 and _codes(drive) == []
    drive = bench(drift_temperature=130.1, fault_react=False, **both).run(2)
    assert drive.feedback[-1]["derating"] == 0.0 and _codes(drive) == ["OVERTEMPERATURE"]


def test_an_injected_warmth_comes_on_top(bench):
    warm = {"fault_injection": True, "injections": ["0.0 1.0 temperature wrong 30"]}
    drive = bench(drift_temperature=85.0, **warm).run(3)
    assert drive.feedback[-1]["derating"] == pytest.approx(0.4)


def test_gates_that_are_blocked_are_told_as_no_current_allowed(bench):
    drive = bench().run(2)
    drive.plant.stop()
    drive.run(1)
    assert drive.feedback[-1]["derating"] == 0.0
    assert drive.plant.clear_faults() == []
    drive.run(1)
    assert drive.feedback[-1]["derating"] == 0.0, "the command has not been off"
    drive.run(1, enable=False)
    assert drive.feedback[-1]["derating"] == 1.0


def test_gates_that_nobody_wants_to_be_driven_come_back_after_an_off_command(bench):
    drive = bench().run(2)
    drive.plant.block(True)
    drive.run(2).run(1, enable=False).run(1)
    assert not drive.column("gates_on")[2:].any()
    assert [row["derating"] for row in drive.feedback[2:]] == [0.0] * 4
    drive.plant.block(False)
    drive.run(1)
    assert drive.state[-1]["gates_on"], "the command has been off meanwhile"
    drive.plant.block(True)
    drive.plant.block(False)
    drive.run(3)
    assert not drive.state[-1]["gates_on"]
    drive.run(1, enable=False).run(1)
    assert drive.state[-1]["gates_on"] and _codes(drive) == []


def test_the_derating_begins_below_the_trip():
    with pytest.raises(ParameterError, match=r"fault\.derating_temperature"):
        TABLE.complete({"fault.derating_temperature": 130.0})
    TABLE.complete({"fault.derating_temperature": 130.0, "fault.overtemperature": 130.0})


def test_a_current_that_is_no_number_trips(bench):
    drive = bench().run(1)
    _current(np.nan)(drive)
    drive.run(1)
    assert _codes(drive) == ["OVERCURRENT"]
    assert not drive.state[-1]["gates_on"]


def test_clearing_is_refused_while_the_cause_lasts_and_power_waits_for_an_off_command(bench):
    drive = bench().run(2)
    drive.plant.apply({"dc_voltage": 420.0})
    drive.run(3)
    assert drive.plant.clear_faults() == ["DC_OVERVOLTAGE"]
    drive.plant.apply({"dc_voltage": 311.0})
    drive.run(1)
    assert not drive.state[-1]["gates_on"], "latched"
    assert drive.plant.clear_faults() == []
    assert _codes(drive) == []
    drive.run(3)
    assert not drive.state[-1]["gates_on"], "the command has not been off"
    drive.run(1, enable=False).run(1)
    assert drive.state[-1]["gates_on"]


def test_the_first_fault_keeps_its_period_and_value(bench):
    drive = bench().run(2)
    drive.plant.apply({"dc_voltage": 420.0})
    drive.run(1)
    drive.plant.apply({"dc_voltage": 450.0})
    drive.run(5)
    assert drive.plant.faults() == [("DC_OVERVOLTAGE", 2, "DC link at 420 V, limit 410 V")]


def test_safe_torque_off_stays_until_cleared(bench):
    drive = bench().run(2)
    drive.plant.stop()
    drive.run(3)
    assert not drive.column("gates_on")[2:].any()
    assert drive.plant.clear_faults() == []
    drive.run(1, enable=False).run(1)
    assert drive.state[-1]["gates_on"]

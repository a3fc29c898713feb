"""All six switches off: the currents flow through the diodes until they have ended."""

from __future__ import annotations

import numpy as np
import pytest

from pwm_node import bits

_RPM = 2.0 * np.pi / 60.0


@pytest.fixture
def bench(unprotected):
    return unprotected


def test_currents_end_and_stay_away(bench):
    drive = bench(initial_speed_rpm=750.0, i_dq=(0.0, 5.0), oversampling=20).run(50, enable=False)
    i = drive.waveform
    assert abs(i[0]).max() > 4.0
    assert np.all(i[200:] == 0.0)
    assert abs(i.sum(axis=1)).max() < 1e-12
    assert not drive.column("gates_on").any()
    # with the currents gone, the machine only coasts
    assert drive.column("torque")[20:] == pytest.approx(0.0, abs=1e-12)


def test_the_field_energy_returns_to_the_supply(bench):
    """Locked rotor: what the field had is what the supply gets, less the copper loss."""
    drive = bench(i_dq=(3.0, 2.0), oversampling=1000)
    drive.par["J"] = 1e9
    L, R = drive.par["L_d"][0], drive.par["R_s"][0]
    field = 1.5 * 0.5 * L * (3.0**2 + 2.0**2)
    drive.run(20, enable=False)
    copper = R * np.sum(drive.waveform**2) * drive.par["T_s"][0] / 1000
    assert drive.st["energy_in"][0] == pytest.approx(-(field - copper), rel=2e-3)
    assert abs(drive.waveform[-1]).max() < 1e-12


def test_one_phase_ends_first_and_the_others_go_on_in_series(bench):
    """Locked rotor: three diodes conduct, then two with the third terminal floating, then none.

    With u_dc across two phases in series, di/dt = -(u_dc + 2 R i) / (2 L).
    """
    drive = bench(i_dq=(3.0, 2.0), oversampling=1000)
    drive.par["J"] = 1e9
    L, R, u = drive.par["L_d"][0], drive.par["R_s"][0], drive.par["u_dc"][0]
    drive.run(5, enable=False)
    i = drive.waveform
    dt = drive.par["T_s"][0] / 1000
    alive = abs(i) > 1e-9
    two = np.flatnonzero(alive.sum(axis=1) == 2)
    assert len(two) > 50
    assert not np.any(alive.sum(axis=1) == 1)
    x = np.flatnonzero(alive[two[0]])[0]
    first, last = two[0], two[-1]
    t = dt * np.arange(last - first + 1)
    sign = np.sign(i[first, x])
    i_0 = sign * i[first, x]
    expected = -u / (2 * R) + (i_0 + u / (2 * R)) * np.exp(-R / L * t)
    assert sign * i[first : last + 1, x] == pytest.approx(expected, abs=1e-9)


def test_nothing_flows_below_the_supply_voltage(bench):
    """The line-to-line EMF stays below u_dc: the diodes block."""
    w_m = 311.0 / (np.sqrt(3.0) * 0.14)
    drive = bench(initial_speed_rpm=0.99 * w_m / 4 / _RPM, oversampling=20)
    drive.run(200, enable=False)
    assert abs(drive.waveform).max() == 0.0
    assert drive.st["energy_in"][0] == 0.0


def test_above_the_supply_voltage_the_machine_feeds_back(bench):
    """Conduction starts where a line-to-line EMF passes u_dc, and brakes the machine."""
    w_m = 311.0 / (np.sqrt(3.0) * 0.14)
    drive = bench(initial_speed_rpm=1.2 * w_m / 4 / _RPM, oversampling=20).run(300, enable=False)
    assert abs(drive.waveform).max() > 0.3
    assert drive.st["energy_in"][0] < 0.0
    assert drive.column("dc_current").max() <= 1e-12
    # the kinetic energy pays for what the supply gets and for the copper
    J, R = drive.par["J"][0], drive.par["R_s"][0]
    given = 0.5 * J * (drive.state[0]["speed"] ** 2 - drive.st["w_M"][0] ** 2)
    copper = R * np.sum(drive.waveform**2) * drive.par["T_s"][0] / 20
    field = 0.75 * drive.par["L_d"][0] * (drive.st["i_d"][0] ** 2 + drive.st["i_q"][0] ** 2)
    assert given == pytest.approx(copper + field - drive.st["energy_in"][0], rel=2e-3)


def test_power_comes_back_with_the_gates(bench):
    drive = bench(initial_speed_rpm=750.0, i_dq=(0.0, 5.0)).run(20, enable=False)
    assert drive.state[-1]["i_dq"] == pytest.approx([0.0, 0.0], abs=1e-12)
    drive.run(20, duty=(0.5, 0.5, 0.5))
    assert abs(drive.state[-1]["i_dq"][1]) > 1.0
    assert drive.state[-1]["gates_on"]


def test_oversampling_does_not_change_the_run(bench):
    runs = []
    for n in (0, 7, 50):
        drive = bench(initial_speed_rpm=4000.0, i_dq=(1.0, 5.0), oversampling=n)
        runs.append(drive.run(100, enable=False).st.copy())
    assert bits.of(runs[0]) == bits.of(runs[1]) == bits.of(runs[2])

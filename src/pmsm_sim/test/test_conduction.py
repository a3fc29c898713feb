"""The conduction of the legs: how often it changes by itself, and what floating legs do."""

from __future__ import annotations

import numpy as np
import pytest

# Of one period, twelve changes for three legs would be a lot.
_MANY = 12

SERVO = {
    "inverter_dead_time": 2e-6,
    "inverter_switch_voltage": 1.1,
    "inverter_switch_resistance": 0.05,
    "inverter_diode_voltage": 0.9,
    "inverter_diode_resistance": 0.03,
}
TRACTION = {
    "motor": "ipmsm",
    "machine_flux_map": "ipmsm_saturated",
    "machine_iron_loss_resistance": 300.0,
    "machine_emf_5": 0.03,
    "inverter_dead_time": 2e-6,
}
DRIVES = {
    "servo": SERVO,
    "traction": TRACTION,
    "everything": {**TRACTION, **SERVO},
    "everything but saturation": {**SERVO, "machine_iron_loss_resistance": 300.0},
    "saturation without iron loss": {**TRACTION, "machine_iron_loss_resistance": 0.0},
    "little iron loss": {**SERVO, "machine_iron_loss_resistance": 1e6},
}


@pytest.fixture
def bench(unprotected):
    return unprotected


def events(drive, periods, **command):
    """Largest number of changes within one period."""
    most = 0
    for _ in range(periods):
        drive.run(1, (0.53, 0.5, 0.48), **command)
        most = max(most, int(drive.st["events"][0]))
    return most


@pytest.mark.parametrize("speed", [0.0, 750.0, 3000.0])
@pytest.mark.parametrize("name", DRIVES)
def test_few_changes_in_a_period(bench, name, speed):
    """Also with currents far beyond the flux map, which such a voltage drives at 3000 r/min."""
    drive = bench(load_kind="speed", load_speed_rpm=speed, initial_speed_rpm=speed, **DRIVES[name])
    assert events(drive, 900) < _MANY
    assert events(drive, 100, enable=False) < _MANY


def test_nothing_conducts_has_one_name(bench):
    """From rest with all gates off, the first pair of legs to conduct is found at once."""
    drive = bench(load_kind="speed", load_speed_rpm=750.0, initial_speed_rpm=750.0, **TRACTION)
    drive.run(1)
    assert drive.st["events"][0] <= 2


@pytest.mark.parametrize("R_iron", [0.0, 400.0])
def test_a_leg_without_current_has_none_at_its_terminal(bench, R_iron):
    drive = bench(
        initial_speed_rpm=750.0,
        i_dq=(0.0, 3.0),
        oversampling=50,
        machine_iron_loss_resistance=R_iron,
        inverter_diode_voltage=0.9,
    )
    drive.run(8, enable=False)
    waveform = abs(drive.waveform)
    floats = (waveform < 1e-12).sum(axis=1)
    assert (floats == 1).any() and (floats == 3).any()
    assert not ((waveform > 1e-12) & (waveform < 1e-9)).any()


def test_the_field_dies_away_in_the_iron(bench):
    """No leg conducts at standstill: L di/dt = -i / G."""
    R_iron = 50.0
    drive = bench(i_dq=(0.2, 0.0), machine_iron_loss_resistance=R_iron)
    drive.par["J"] = 1e12
    drive.run(1, enable=False)
    tau = float(drive.par["L_d"][0]) / R_iron
    start = float(drive.st["i_d"][0])
    drive.run(5, enable=False)
    assert start > 1e-3
    expected = start * np.exp(-5.0 * float(drive.par["T_s"][0]) / tau)
    assert float(drive.st["i_d"][0]) == pytest.approx(expected, rel=1e-6)

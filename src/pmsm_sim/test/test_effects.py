"""Every effect acts, as its equation says, and live where it may."""

from __future__ import annotations

import numpy as np
import pytest

from pmsm_sim.noise import normal
from pmsm_sim.parameters import TABLE
from pmsm_sim.plant import Plant, PlantError
from pwm_node import bits
from pwm_node.parameters import ParameterError

_RPM = 2.0 * np.pi / 60.0


@pytest.fixture
def bench(unprotected):
    return unprotected


def _feedback(drive, name="i_a"):
    return np.array([row[name] for row in drive.feedback])


# Sensors ------------------------------------------------------------------------------------


def test_gain_and_offset(bench):
    ideal = bench(i_dq=(3.0, 1.0)).run(20)
    wrong = bench(
        i_dq=(3.0, 1.0),
        sensor_current_gain=[1.02, 0.97, 1.0],
        sensor_current_offset=[0.1, 0.0, -0.2],
    ).run(20)
    assert _feedback(wrong) == pytest.approx(1.02 * _feedback(ideal) + 0.1, abs=1e-12)
    assert _feedback(wrong, "i_b") == pytest.approx(0.97 * _feedback(ideal, "i_b"), abs=1e-12)
    assert _feedback(wrong, "i_c") == pytest.approx(_feedback(ideal, "i_c") - 0.2, abs=1e-12)


def test_adc_quantises_and_saturates(bench):
    ideal = bench(i_dq=(30.0, 1.0)).run(50)
    drive = bench(i_dq=(30.0, 1.0), sensor_adc_bits=10, sensor_adc_range=20.0).run(50)
    step = 20.0 / 512
    i = _feedback(drive)
    assert np.allclose(i / step, np.round(i / step))
    assert i[0] == 20.0 - step
    inside = np.abs(_feedback(ideal)) < 19.9
    assert np.abs(i - _feedback(ideal))[inside].max() <= 0.5 * step + 1e-12


def test_bandwidth_delays_the_current(bench):
    """A ramp comes out late by 1 / (2 pi bandwidth)."""
    drive = bench(sensor_current_bandwidth=10e3)
    drive.par["J"] = 1e12
    drive.run(12, (0.9, 0.1, 0.1))
    true = drive.column("i_dq")[:, 0]
    slope = (true[-1] - true[-3]) / 2e-4
    late = (true[-1] - _feedback(drive)[-1]) / slope
    assert late == pytest.approx(1.0 / (2.0 * np.pi * 10e3), rel=0.25)


def test_a_low_pass_switched_on_while_running_begins_at_the_current(bench):
    drive = bench(inverter_dead_time=1e-6, i_dq=(3.0, 0.0)).run(20, (0.55, 0.5, 0.45))
    drive.plant.apply({"sensor.current_bandwidth": 20e3})
    drive.run(2, (0.55, 0.5, 0.45))
    assert _feedback(drive)[-1] == pytest.approx(_feedback(drive)[-3], abs=0.5)


def test_a_run_that_makes_no_sense_ends_with_an_error(bench):
    drive = bench(motor="maxon_ec45flat_30w_12v", load_torque=-1e4)
    with pytest.raises(PlantError, match="check the motor file"):
        drive.run(300).run(100, enable=False)
    for row in drive.feedback:
        assert all(np.isfinite(row[name]) for name in ("i_a", "encoder_angle", "dc_voltage"))


def test_sampling_lead(bench):
    """Currents sampled half a period early are those of the middle of the period before."""
    drive = bench(sensor_sampling_lead=0.5, oversampling=10, i_dq=(1.0, 0.0))
    drive.run(30, (0.6, 0.5, 0.45))
    seen = _feedback(drive)[1:]
    middle = np.array([i[5, 0] for i in drive.i_abc])[:-1]
    assert seen == pytest.approx(middle, abs=1e-9)


def test_encoder(bench):
    values = {"initial_speed_rpm": 300.0, "load_kind": "speed", "load_speed_rpm": 300.0}
    true = bench(**values).run(100).column("angle")
    coarse = _feedback(bench(sensor_encoder_lines=100, **values).run(100), "encoder_angle")
    step = 2.0 * np.pi / 400
    assert np.all((true - coarse >= -1e-12) & (true - coarse < step))
    offset = _feedback(bench(sensor_encoder_offset=-0.2, **values).run(100), "encoder_angle")
    assert offset == pytest.approx((true - 0.2) % (2.0 * np.pi), abs=1e-9)
    late = _feedback(bench(sensor_encoder_latency=4e-5, **values).run(100), "encoder_angle")
    assert (true - late)[1:] == pytest.approx(300.0 * _RPM * 4e-5, abs=1e-9)
    noisy = _feedback(bench(sensor_angle_noise=1e-3, **values).run(100), "encoder_angle")
    assert 0.5e-3 < np.std((noisy - true + np.pi) % (2.0 * np.pi) - np.pi) < 2e-3


def test_noise_is_normal_and_the_same_for_all(bench):
    numbers = np.array([normal(np.uint64(3), np.uint64(k), np.uint64(0)) for k in range(20_000)])
    assert abs(numbers.mean()) < 0.03
    assert numbers.std() == pytest.approx(1.0, abs=0.02)
    assert np.mean(numbers**4) == pytest.approx(3.0, abs=0.2)
    one = bench(noise_current_rms=0.1, seed=3).run(10)
    two = bench(noise_current_rms=0.1, seed=3, i_dq=(2.0, 0.0)).run(10, (0.6, 0.4, 0.4))
    noise_one = _feedback(one) - one.column("i_dq")[:, 0]
    noise_two = _feedback(two) - two.column("i_dq")[:, 0]
    assert noise_one == pytest.approx(noise_two, abs=1e-9)


# Inverter -----------------------------------------------------------------------------------


def test_duties_are_rounded_to_the_timer(bench):
    drive = bench(inverter_timer_clock=2e6)  # 100 counts up, 100 down
    drive.run(2, (0.123456, 0.5, 0.999))
    assert drive.st["duty"][0] == pytest.approx([0.12, 0.5, 1.0], abs=1e-15)


def test_short_pulses_are_left_out(bench):
    drive = bench(inverter_min_pulse=2e-6).run(2, (0.015, 0.5, 0.99))
    assert drive.st["duty"][0].tolist() == [0.0, 0.5, 1.0]


# Mechanics ----------------------------------------------------------------------------------


def _coast(bench, **values):
    """Speed of a machine with blocked gates; the duration is 0.1 s."""
    drive = bench(initial_speed_rpm=600.0, **values)
    drive.run(1000, enable=False)
    return drive, 600.0 * _RPM, float(drive.st["w_M"][0]), float(drive.par["J"][0])


def test_viscous_and_coulomb_friction(bench):
    _, w_0, w, J = _coast(bench, load_viscous_friction=0.01)
    assert w == pytest.approx(w_0 * np.exp(-0.01 / J * 0.1), rel=1e-9)
    _, w_0, w, J = _coast(bench, load_coulomb_friction=0.5)
    assert w == pytest.approx(w_0 - 0.5 / J * 0.1, rel=1e-5)


def test_quadratic_load(bench):
    _, w_0, w, J = _coast(bench, load_quadratic=1e-3)
    assert w == pytest.approx(1.0 / (1.0 / w_0 + 1e-3 / J * 0.1), rel=1e-9)


def test_inertia_adds_up(bench):
    drive = bench(load_inertia=5e-3)
    assert drive.par["J"][0] == pytest.approx(drive.plant.motor.J + 5e-3)


def test_load_profile(bench):
    drive, w_0, w, J = _coast(bench, load_profile=[0.02, 0.0, 0.04, 1.0, 0.06, 1.0])
    # 0.02 s with half the torque, 0.06 s with all of it
    assert w == pytest.approx(w_0 - 1.0 / J * (0.5 * 0.02 + 0.06), rel=1e-6)
    assert drive.column("load_torque")[300] == pytest.approx(0.5)


def test_the_powder_brake_lags_and_stops_without_reversing(bench):
    drive = bench(initial_speed_rpm=600.0, load_kind="brake", load_brake_lag=0.02)
    drive.run(10, enable=False)
    drive.plant.apply({"load_torque": 2.0})
    drive.run(200, enable=False)
    expected = 2.0 * (1.0 - np.exp(-0.02 / 0.02))
    assert drive.column("load_torque")[-1] == pytest.approx(expected, rel=0.01)
    drive.run(2000, enable=False)
    assert abs(drive.st["w_M"][0]) < 0.1


def test_two_masses_swing_at_their_natural_frequency(bench):
    J, J_L, k = 3e-3, 2e-3, 200.0
    drive = bench(load_inertia=J_L, load_shaft_stiffness=k, initial_speed_rpm=300.0)
    drive.run(1, enable=False)
    drive.st["twist"] = 0.01
    drive.run(2000, enable=False)
    w = drive.column("speed")[1:]
    spectrum = np.abs(np.fft.rfft((w - w.mean()) * np.hanning(len(w))))
    frequency = np.fft.rfftfreq(len(w), 1e-4)[spectrum.argmax()]
    assert frequency == pytest.approx(np.sqrt(k * (1 / J + 1 / J_L)) / (2 * np.pi), abs=5.0)


def test_cogging_swings_with_the_angle(bench):
    drive = bench(machine_cogging_torque=0.3, machine_cogging_periods=12, initial_angle=0.02)
    drive.run(2000, enable=False)
    # a rotor let go beside a detent swings about it: +- 0.02 rad about 0
    angle = (drive.column("angle") + np.pi) % (2.0 * np.pi) - np.pi
    assert angle.min() == pytest.approx(-0.02, rel=1e-2)
    assert angle.max() == pytest.approx(0.02, rel=1e-2)


# Drift --------------------------------------------------------------------------------------


def test_temperature_changes_resistance_and_flux(bench):
    drive = bench().run(2)
    drive.plant.apply({"drift.temperature": 120.0})
    assert drive.par["R_s"][0] == pytest.approx(1.5 * (1.0 + 0.00393 * 100.0))
    assert drive.par["psi_f"][0] == pytest.approx(0.14 * (1.0 - 0.0012 * 100.0))
    drive.run(1)
    assert drive.state[-1]["temperature"] == 120.0


def test_temperature_follows_slowly(bench):
    drive = bench(drift_temperature=100.0, drift_time_constant=0.05).run(500)
    assert drive.column("temperature")[-1] == pytest.approx(
        100.0 - 80.0 * np.exp(-0.05 / 0.05), rel=1e-3
    )


def test_copper_loss_warms(bench):
    drive = bench(drift_thermal_resistance=0.5, drift_time_constant=0.01, i_dq=(5.0, 0.0))
    drive.par["J"] = 1e12
    drive.run(2000, (0.52, 0.48, 0.48))
    st, par = drive.st[0], drive.par[0]
    copper = 1.5 * par["R_s"] * (st["i_d"] ** 2 + st["i_q"] ** 2)
    assert st["temperature"] == pytest.approx(20.0 + 0.5 * copper, rel=1e-3)


def test_flux_drift_moves_the_flux_map(bench):
    drive = bench(motor="ipmsm", machine_flux_map="ipmsm_saturated", drift_flux=0.9)
    assert drive.par["psi_shift"][0] == pytest.approx(-0.012, rel=1e-6)


# Parameters ---------------------------------------------------------------------------------

_LIVE = [
    name
    for name in TABLE
    if not TABLE[name].read_only
    and name.startswith(("inverter.", "machine.", "dc_", "load", "sensor.", "drift.", "noise."))
]
# Where the general rule for another value would not do
_OTHER = {
    "dc_link.chopper_off": 322.0,
    "dc_link.chopper_on": 325.0,
    "drift.time_constant": 1e-3,
    "inverter.command_loss_limit": 1,
    "inverter.missing_command": "hold",
    "inverter.timer_clock": 1e6,
    "load.kind": "torque",
    "machine.iron_loss_resistance": 500.0,
    "sensor.current_bandwidth": 5e3,
}
# And where the run has to be another one for the parameter to have something to act on
_CONDITIONS = {
    "dc_link.chopper_on": {"dc_link_chopper_on": 340.0, "dc_link_chopper_off": 300.0},
    "dc_link.grid_resistance": {"dc_voltage": 305.0},
    "dc_voltage": {"dc_link_kind": "stiff"},
    "inverter.command_loss_limit": {"fault_react": True},
    "load.speed_rpm": {"load_kind": "speed"},
}


def _another(name, old):
    """An accepted value that is not the old one."""
    if name in _OTHER:
        return _OTHER[name]
    if isinstance(old, list):
        return [x + 0.1 for x in old]
    if isinstance(old, int):
        return old + 3
    if old:
        return 1.5 * old
    largest = TABLE[name].maximum
    return 2e-6 if largest < 1e-3 else 0.05 * largest if largest < 20.0 else 0.01


@pytest.mark.parametrize("name", _LIVE)
def test_every_live_parameter_acts_when_changed_live(bench, name):
    """A run in which the parameter changes differs from one in which it does not."""
    values = {
        "dc_link_chopper_off": 326.0,
        "dc_link_chopper_on": 329.5,
        "dc_link_chopper_resistance": 100.0,
        "dc_link_kind": "rectifier",
        "dc_voltage": 330.0,
        "drift_temperature": 40.0,
        "drift_thermal_resistance": 0.1,
        "i_dq": (0.0, 4.0),
        "initial_speed_rpm": 700.0,
        "load_brake_lag": 0.01,
        "load_inertia": 1e-3,
        "load_kind": "brake",
        "load_shaft_stiffness": 1e3,
        "load_torque": 1.0,
        "machine_cogging_torque": 0.1,
        "sensor_adc_bits": 12,
        **_CONDITIONS.get(name, {}),
    }
    old = bench(**values).plant._values
    change = TABLE.validate({name: _another(name, old[name])}, old)
    duty = (0.013, 0.53337, 0.4421)

    def seen(change):
        drive = bench(**values).run(5, duty)
        if name != "load_torque":
            drive.plant.apply({"load_torque": 2.0})
        drive.plant.apply(change)
        drive.run(20, duty)
        drive.run(2, command=False)
        drive.run(10, duty)
        return b"".join(bits.of(row) for row in drive.feedback + drive.state)

    assert (seen(change) == seen({})) is False


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("inverter.dead_time", 6e-5, "0 to 5e-05 s"),
        ("inverter.dead_time", -1e-6, "0 to 0.0001 s"),
        ("inverter.min_pulse", 5e-5, "0 to 5e-05 s"),
        ("inverter.timer_clock", 1e3, "at least 80000 Hz"),
        ("sensor.adc_range", 0.0, "0.001 to 10000 A"),
        ("sensor.adc_bits", 25, "0 to 24"),
        ("sensor.encoder_latency", 2e-4, "0 to 0.0001 s"),
        ("sensor.current_gain", [1.0, 1.0], "three values"),
        ("dc_link.chopper_off", 400.0, "below 'dc_link.chopper_on'"),
        ("dc_link.capacitance", 0.0, "1e-06 to 10 F"),
        ("load.kind", "fan", ["torque", "brake", "speed"][0]),
        ("machine.emf_5", 0.9, "-0.5 to 0.5"),
        ("dc_voltage", float("nan"), "finite"),
    ],
)
@pytest.mark.parametrize("live", [False, True])
def test_bad_values_are_refused_with_name_value_and_range(name, value, said, live):
    with pytest.raises(ParameterError) as caught:
        TABLE.validate({name: value}, TABLE.defaults() if live else None)
    reason = caught.value.reason
    assert name in reason and said in reason
    if not isinstance(value, list):
        assert str(value) in reason or f"{value:g}" in reason


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"load.profile": [0.0, 1.0, 0.0, 2.0]}, "increase"),
        ({"load.profile": [0.0, 1.0, 2.0]}, "pairs"),
        ({"load.shaft_stiffness": 100.0}, "load.inertia"),
    ],
)
def test_bad_combinations_are_refused(changes, said):
    with pytest.raises(ParameterError, match=said):
        TABLE.validate(changes)


def test_the_ideal_model_runs_where_nothing_asks_for_more():
    plant = Plant(TABLE.defaults())
    assert not plant.par["general"][0]
    plant.apply({"sensor.encoder_lines": 2500, "noise.current_rms": 0.02})
    assert not plant.par["general"][0]
    plant.apply({"inverter.dead_time": 1e-6})
    assert plant.par["general"][0]
    plant.apply({"inverter.dead_time": 0.0})
    assert not plant.par["general"][0]

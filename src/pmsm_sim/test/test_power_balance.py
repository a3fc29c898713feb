"""Energy is neither made nor lost, whatever effects are switched on together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st


@pytest.fixture
def bench(unprotected):
    return unprotected


STORED = ("field", "capacitor", "kinetic", "shaft", "cogging")
LOST = ("inverter", "copper", "iron", "friction", "chopper", "load")

# One value that switches each effect on, in a strength met in practice.
EFFECTS = {
    "inverter_dead_time": 2e-6,
    "inverter_switch_voltage": 1.1,
    "inverter_switch_resistance": 0.05,
    "inverter_diode_voltage": 0.9,
    "inverter_diode_resistance": 0.03,
    "inverter_min_pulse": 3e-6,
    "inverter_timer_clock": 1e8,
    "machine_iron_loss_resistance": 400.0,
    "machine_emf_5": 0.05,
    "machine_emf_7": -0.03,
    "machine_emf_11": 0.02,
    "machine_emf_13": 0.01,
    "machine_cogging_torque": 0.2,
    "machine_flux_map": "ipmsm_saturated",
    "dc_link_kind": "rectifier",
    "dc_link_chopper_resistance": 60.0,
    "load_kind": "brake",
    "load_brake_lag": 0.02,
    "load_quadratic": 1e-4,
    "load_coulomb_friction": 0.1,
    "load_viscous_friction": 2e-3,
    "load_shaft_stiffness": 300.0,
    "load_profile": [0.0, 0.0, 0.01, 1.0, 0.02, 0.5],
    "sensor_current_bandwidth": 2e4,
    "sensor_encoder_latency": 2e-5,
}


def imbalance(drive, before):
    """What is missing in the balance, over the energy that went through."""
    after = drive.plant.energies()
    change = {name: after[name] - before[name] for name in after}
    missing = change["supply"] - sum(change[n] for n in LOST) - sum(change[n] for n in STORED)
    return missing / max(abs(change["supply"]), sum(abs(change[n]) for n in LOST))


def _duty(drive, seed):
    """Duties of about the back-EMF with disturbances, as a controller would give."""
    rng = np.random.default_rng(seed)

    def duty(_):
        st, par = drive.st[0], drive.par[0]
        u_q = par["n_p"] * st["w_M"] * par["psi_f"] + 6.0
        angle = par["n_p"] * st["theta_M"] + 0.5 * np.pi
        phases = np.cos(angle - np.array([0.0, 2.0, 4.0]) * np.pi / 3.0)
        return np.clip(0.5 + u_q / 311.0 * phases + 0.03 * rng.standard_normal(3), 0.0, 1.0)

    return duty


@settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    on=st.sets(st.sampled_from(sorted(EFFECTS))),
    motor=st.sampled_from(["seed_750", "ipmsm"]),
    load=st.floats(-3.0, 6.0),
    speed=st.floats(-1500.0, 1500.0),
    i_dq=st.tuples(st.floats(-8.0, 8.0), st.floats(-8.0, 8.0)),
    seed=st.integers(0, 1000),
)
def test_every_combination_of_effects(bench, on, motor, load, speed, i_dq, seed):
    values = {name: EFFECTS[name] for name in on}
    drive = bench(
        motor=motor,
        load_torque=load,
        load_inertia=4e-3,
        initial_speed_rpm=speed,
        i_dq=i_dq,
        **values,
    )
    drive.par["general"] = True  # the books are kept there
    drive.run(1)
    before = drive.plant.energies()
    drive.run(60, _duty(drive, seed))
    drive.run(20, enable=False)
    assert abs(imbalance(drive, before)) < 1e-4


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_each_effect_alone(bench, name):
    drive = bench(
        motor="ipmsm",
        load_torque=2.0,
        load_inertia=4e-3,
        initial_speed_rpm=800.0,
        **{name: EFFECTS[name]},
    )
    drive.par["general"] = True
    drive.run(1)
    before = drive.plant.energies()
    drive.run(150, _duty(drive, 1))
    assert abs(imbalance(drive, before)) < 1e-4


def test_an_imposed_speed_is_paid_by_the_shaft(bench):
    drive = bench(load_kind="speed", load_speed_rpm=600.0, load_coulomb_friction=0.3)
    drive.par["general"] = True
    drive.run(1)
    before = drive.plant.energies()
    drive.run(200, _duty(drive, 1))
    assert drive.column("speed")[-1] == pytest.approx(600.0 * np.pi / 30.0, rel=1e-12)
    assert abs(imbalance(drive, before)) < 1e-4

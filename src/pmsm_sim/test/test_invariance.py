"""What must not matter: which phase is first, which way it turns, which units are used."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pwm_node import bits


@pytest.fixture
def bench(unprotected):
    return unprotected


# Effects that treat all phases and both directions alike
SYMMETRIC = {
    "none": {},
    "inverter": {
        "inverter_dead_time": 2e-6,
        "inverter_switch_voltage": 1.1,
        "inverter_diode_voltage": 0.9,
        "inverter_diode_resistance": 0.02,
    },
    "machine": {
        "machine_flux_map": "ipmsm_saturated",
        "machine_emf_5": 0.04,
        "machine_emf_7": 0.02,
        "machine_iron_loss_resistance": 300.0,
    },
    "mechanics": {"load_coulomb_friction": 0.2, "load_quadratic": 1e-4},
}

_SETTINGS = settings(
    max_examples=10,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def _duties(seed, periods):
    rng = np.random.default_rng(seed)
    base = rng.uniform(0.45, 0.55, (periods // 10 + 1, 3)).repeat(10, axis=0)[:periods]
    return np.clip(base + 0.03 * rng.standard_normal((periods, 3)), 0.0, 1.0)


def _run(bench, duties, angle=0.3, **values):
    drive = bench(motor="ipmsm", initial_angle=angle, oversampling=5, **values)
    return drive.run(len(duties), lambda k: duties[k])


@_SETTINGS
@given(effects=st.sampled_from(sorted(SYMMETRIC)), seed=st.integers(0, 10_000))
def test_turning_by_120_degrees_permutes_the_phases(bench, effects, seed):
    duties = _duties(seed, 40)
    values = {"initial_speed_rpm": 600.0, "load_torque": 1.0, **SYMMETRIC[effects]}
    one = _run(bench, duties, **values)
    # 120 electrical degrees on: phase b now does what a did
    two = _run(bench, duties[:, [2, 0, 1]], angle=0.3 + 2.0 * np.pi / 3.0 / 4.0, **values)
    assert two.waveform == pytest.approx(one.waveform[:, [2, 0, 1]], abs=1e-6)
    assert two.column("torque") == pytest.approx(one.column("torque"), abs=1e-6)
    assert two.column("speed") == pytest.approx(one.column("speed"), abs=1e-6)


@_SETTINGS
@given(effects=st.sampled_from(sorted(SYMMETRIC)), seed=st.integers(0, 10_000))
def test_mirroring_the_speed_mirrors_the_torque(bench, effects, seed):
    """Exchange b and c, turn the other way: q currents, torque and speed change sign."""
    duties = _duties(seed, 40)
    one = _run(bench, duties, initial_speed_rpm=600.0, load_torque=1.0, **SYMMETRIC[effects])
    two = _run(
        bench,
        duties[:, [0, 2, 1]],
        angle=-0.3,
        initial_speed_rpm=-600.0,
        load_torque=-1.0,
        **SYMMETRIC[effects],
    )
    assert two.waveform == pytest.approx(one.waveform[:, [0, 2, 1]], abs=1e-6)
    assert two.column("torque") == pytest.approx(-one.column("torque"), abs=1e-6)
    assert two.column("speed") == pytest.approx(-one.column("speed"), abs=1e-6)
    assert two.column("dc_current") == pytest.approx(one.column("dc_current"), abs=1e-6)


@pytest.mark.parametrize("general", [False, True])
def test_scaling_of_units(bench, general):
    """Volts and amperes in thousandths, milliseconds instead of seconds: the same drive.

    With voltage times a, current times b and time times c, every parameter has its own factor,
    and the run is the same in the new units.
    """
    a, b, c = 3.0, 0.5, 2.0
    power = a * b
    factor = {
        "R_s": a / b,
        "L_d": a * c / b,
        "L_q": a * c / b,
        "psi_f": a * c,
        "J": power * c**3,
        "B": power * c,
        "tau_L": power * c,
        "u_dc": a,
        "T_s": c,
        "h_max": c,
        "h_general": c,
    }
    duties = _duties(3, 60)
    one = bench(motor="ipmsm", initial_speed_rpm=600.0, load_torque=1.0)
    two = bench(motor="ipmsm", initial_speed_rpm=600.0, load_torque=1.0)
    two.st["w_M"] /= c
    for drive in (one, two):
        drive.par["general"] = general
    for name, f in factor.items():
        two.par[name] = one.par[name] * f
    for drive in (one, two):
        drive.run(60, lambda k: duties[k])
    assert two.column("i_dq") == pytest.approx(one.column("i_dq") * b, rel=1e-9, abs=1e-9)
    assert two.column("speed") == pytest.approx(one.column("speed") / c, rel=1e-10)
    assert two.st["energy_in"][0] == pytest.approx(one.st["energy_in"][0] * power * c, rel=1e-8)


def test_a_run_is_the_same_bit_for_bit(bench):
    duties = _duties(5, 100)
    values = {
        **SYMMETRIC["inverter"],
        **SYMMETRIC["machine"],
        "noise_current_rms": 0.02,
        "seed": 7,
        "initial_speed_rpm": 500.0,
    }
    runs = []
    for n in (0, 0, 13):
        drive = bench(motor="ipmsm", oversampling=n, **values)
        drive.run(100, lambda k: duties[k])
        runs.append((bits.of(drive.st["i_d"]), [bits.of(row) for row in drive.feedback]))
    assert runs[0] == runs[1] == runs[2]

"""What stands around the current loop, on drives other than the usual: in the closed loop."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from mfpcc_controller import motor as motors
from mfpcc_experiments.method.drives import ENCODER, random_drive, settled
from mfpcc_experiments.running.closed_loop import Run, run
from pwm_node import bits, yaml_files

RPM = math.pi / 30.0


def motor_file(folder: Path, name: str, **changes: float) -> str:
    """A motor like that of this name, but for the changes."""
    values = yaml.safe_load(yaml_files.find("motors", name).read_text())
    path = folder / "motor.yaml"
    path.write_text(yaml.safe_dump({**values, **changes}))
    return str(path)


def codes(r: Run) -> list[str]:
    return [code for code, _, _ in r.controller.faults()]


# --- Rivals --------------------------------------------------------------------------------------


def test_the_gain_trades_speed_for_survival():
    """A model of up to five times the inductance: a third stands it at 1, nearly all at 0.24."""
    share = {}
    for scheme in ("neso_mfpcc", "ultra_local_eso", "ultra_local_smo"):
        for gain in (1.0, 0.0):
            good = 0
            for seed in range(40):
                options = random_drive(seed)
                options["controller"]["deadbeat.gain"] = gain
                good += settled(run(scheme, 0.25, **options), 0.6)
            share[scheme, gain] = good / 40
        assert share[scheme, 1.0] < 0.5, scheme
        assert share[scheme, 0.0] > 0.8, scheme


@pytest.mark.parametrize("scheme", ["mls_mfpcc", "mls_mfpcc_paper", "mbpcc", "mfpcc"])
def test_some_schemes_are_deadbeat_by_themselves(scheme):
    own, deadbeat = (
        run(scheme, 0.05, plant=ENCODER, controller={"deadbeat.gain": gain}) for gain in (0.0, 1.0)
    )
    assert bits.of(own.command) == bits.of(deadbeat.command)


@pytest.mark.parametrize("frequency", [1e3, 2e3])
@pytest.mark.parametrize("motor", ["seed_750", "ipmsm", "textbook_spmsm"])
def test_the_fallback_is_stable_with_few_periods(motor, frequency):
    pwm = {"pwm_frequency": frequency}
    for rpm in (0.0, 300.0, 750.0):
        r = run(
            "pi_foc",
            0.6,
            motor=motor,
            rpm=rpm,
            plant={**ENCODER, **pwm},
            controller=pwm,
            schedule=["0.3 load_torque 4.0"],
        )
        assert codes(r) == []
        assert r.ripple(0.5).max() < 0.6
        assert np.abs(r.error(0.5).mean(axis=0)).max() < 0.05


@pytest.mark.parametrize("scheme", ["mfpcc", "mfpcc_two_vector"])
@pytest.mark.parametrize("motor", ["maxon_ec45flat_30w_12v", "teknic_m2310p", "seed_750"])
def test_the_table_learns_whatever_the_voltage(scheme, motor):
    r = run(
        scheme,
        0.3,
        motor=motor,
        load=0.03,
        plant={**ENCODER, "noise.current_rms": 2e-3 * motors.load(motor).i_max},
        controller={"mismatch.inductance": 2.0},
    )
    table, est = r.controller.mem[scheme][0], r.controller.motor
    gains = np.array([table["gain_d"] * est.L_d, table["gain_q"] * est.L_q]) / r.T_s
    assert codes(r) == []
    assert gains == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("scheme", ["neso_mfpcc", "ultra_local_smo", "mfpcc", "mfpcc_two_vector"])
def test_all_that_is_set_in_volts_or_amperes_scales_with_the_motor(scheme, tmp_path):
    """The same drive with a tenth of the voltage, and a fifth of the current, does the same."""
    small = motor_file(
        tmp_path, "seed_750", u_dc=31.1, i_max=2.4, L_d=7.5e-3, L_q=7.5e-3, R_s=0.75, psi_f=0.014,
        J=6e-5,
    )  # fmt: skip
    big_run, small_run = (
        run(scheme, 0.1, motor=motor, load=load, plant={**ENCODER, "noise.current_rms": noise})
        for motor, load, noise in (("seed_750", 2.0, 0.02), (small, 0.04, 0.004))
    )
    assert small_run.lut["i_dq"] * 5.0 == pytest.approx(big_run.lut["i_dq"], abs=1e-6)


# --- References ----------------------------------------------------------------------------------


def possible_speed(est: motors.EstimatedPars, torque: float, voltage: float) -> float:
    """Largest speed (r/min) of all currents within the limits that make this torque."""
    i_d, i_q = np.meshgrid(
        np.linspace(-est.i_max, 0.0, 801), np.linspace(0.01 * est.i_max, est.i_max, 800)
    )
    made = 1.5 * est.n_p * (est.psi_f + (est.L_d - est.L_q) * i_d) * i_q
    psi_d, psi_q = est.psi_f + est.L_d * i_d, est.L_q * i_q
    # |R i + j w psi|^2 = u^2, solved for w
    a = psi_d**2 + psi_q**2
    b = 2.0 * est.R_s * (i_q * psi_d - i_d * psi_q)
    c = est.R_s**2 * (i_d**2 + i_q**2) - voltage**2
    w = (np.sqrt(b * b - 4.0 * a * c) - b) / (2.0 * a)
    w[(made < torque) | (i_d**2 + i_q**2 > est.i_max**2)] = 0.0
    return float(w.max()) / est.n_p / RPM


@pytest.mark.parametrize(
    ("scheme", "torque"),
    [("mls_mfpcc", 5.0), ("mls_mfpcc", 10.0), ("pi_foc", 5.0), ("pi_foc", 20.0), ("mbpcc", 10.0)],
)
def test_deep_field_weakening_reaches_the_possible_speed(scheme, torque, tmp_path):
    """Beyond the short-circuit current (50 A of 100) more negative i_d is more voltage."""
    deep = motor_file(
        tmp_path, "ipmsm", R_s=0.1, L_d=1.2e-3, L_q=3.6e-3, psi_f=0.06, n_p=4, J=1e-3, u_dc=300.0,
        i_max=100.0, speed_max_rpm=20_000,
    )  # fmt: skip
    pwm = {"pwm_frequency": 20e3}
    r = run(
        scheme,
        1.5,
        motor=deep,
        rpm=200.0,
        load=torque,
        plant={**ENCODER, **pwm, "noise.current_rms": 0.1},
        controller={**pwm, "mtpa": True, "field_weakening": True, "fault.overspeed": 10.0},
        schedule=["0.1 speed_ref_rpm 60000"],
    )
    est = r.controller.motor
    assert codes(r) == []
    possible = possible_speed(est, torque, 0.98 * est.u_dc / math.sqrt(3.0))
    assert r.state["speed"][-1] / RPM == pytest.approx(possible, rel=0.03)


@pytest.mark.parametrize("psi_f", [0.12, 0.01, 0.002])
@pytest.mark.parametrize("how", [{"mtpa": True}, {"i_d_ref": -8.0}])
def test_the_speed_loop_is_the_same_whatever_makes_the_torque(psi_f, how, tmp_path):
    motor = motor_file(tmp_path, "ipmsm", psi_f=psi_f, L_d=2e-3, L_q=8e-3)
    r = run(
        "mbpcc",
        0.9,
        motor=motor,
        rpm=0.0,
        load=1.0,
        plant=ENCODER,
        controller=how,
        schedule=["0.3 speed_ref_rpm 300", "0.6 load_torque 3.0"],
    )
    rpm = r.state["speed"] / RPM
    assert rpm[r.rows(0.3, 0.6)].max() < 1.01 * 300.0
    # 2 N m over J = 5e-3 kg m^2 and a critically damped loop of 50 rad/s
    dip = 2.0 / 5e-3 / 50.0 / math.e / RPM
    assert 300.0 - rpm[r.rows(0.6)].min() == pytest.approx(dip, rel=0.2)
    assert r.lut["i_dq_ref"][r.rows(0.8), 1].std() < 0.2


@pytest.mark.parametrize(("told", "least", "most"), [(0.0, 1.3, 2.0), (0.03, 1.0, 1.01)])
def test_the_inertia_of_the_load_is_told(told, least, most):
    r = run(
        "mbpcc",
        0.8,
        rpm=0.0,
        load=0.0,
        plant={**ENCODER, "load.inertia": 0.03},
        controller={"load.inertia": told},
        schedule=["0.1 speed_ref_rpm 300"],
    )
    assert least <= r.state["speed"].max() / RPM / 300.0 <= most


# --- Protection ----------------------------------------------------------------------------------


@pytest.mark.parametrize("lines", [15, 20, 30, 60])
@pytest.mark.parametrize("load", [0.0, 5.0])
def test_a_coarse_encoder_is_no_fault(lines, load):
    for rpm in (50.0, 300.0, 750.0, 1200.0):
        r = run(
            "mls_mfpcc",
            0.6,
            rpm=rpm,
            load=load,
            plant={"sensor.encoder_lines": lines},
            schedule=[f"0.2 speed_ref_rpm {-rpm}"],
        )
        assert codes(r) == []
        assert r.state["speed"][r.rows(0.55)].mean() / RPM == pytest.approx(-rpm, abs=10.0)


@pytest.mark.parametrize("lines", [0, 15, 2500])
def test_an_encoder_that_stands_still_is_found(lines):
    r = run(
        "mls_mfpcc",
        0.2,
        plant={
            "sensor.encoder_lines": lines,
            "fault_injection": True,
            "injections": ["0.1 0.1 encoder stuck"],
        },
    )
    assert "ENCODER" in codes(r)


@pytest.mark.parametrize("scheme", ["mls_mfpcc", "pi_foc"])
@pytest.mark.parametrize(
    ("motor", "frequency", "dead_time", "rpm"),
    [
        ("ipmsm", 20e3, 4e-6, 100.0),
        ("ipmsm", 40e3, 2e-6, 100.0),
        ("seed_750", 20e3, 4e-6, 750.0),
        ("seed_750", 40e3, 2e-6, 1400.0),
        ("maxon_ec45flat_70w", 20e3, 2e-6, 1000.0),
    ],
)
def test_what_dead_time_takes_is_no_spinout(scheme, motor, frequency, dead_time, rpm):
    pwm = {"pwm_frequency": frequency}
    r = run(
        scheme,
        0.5,
        motor=motor,
        rpm=rpm,
        load=0.0,
        plant={**ENCODER, **pwm, "inverter.dead_time": dead_time},
        controller=pwm,
        schedule=[f"0.2 speed_ref_rpm {1.2 * rpm}", f"0.35 speed_ref_rpm {0.9 * rpm}"],
    )
    assert codes(r) == []


@pytest.mark.parametrize("n_p", [1, 2, 3, 5])
@pytest.mark.parametrize("load", [0.0, 2.0])
def test_a_wrong_number_of_pole_pairs_is_found(n_p, load, tmp_path):
    wrong = motor_file(tmp_path, "seed_750", n_p=n_p)
    r = run(
        "pi_foc",
        7.0,
        rpm=0.0,
        load=load,
        plant=ENCODER,
        controller={"motor": wrong},
        schedule=["0.1 speed_ref_rpm 300"],
    )
    assert codes(r)[0] == "STALL"


def test_a_blocked_rotor_is_a_stall_only_where_it_is_to_turn():
    blocked = {**ENCODER, "load.kind": "speed", "load.speed_rpm": 0.0}
    for controller, found in (
        ({"speed_ref_rpm": 300.0}, ["STALL"]),
        ({"speed_ref_rpm": 300.0, "fault.stall_time": 0.0}, []),
        ({"speed_ref_rpm": 0.0}, []),
        ({"control_mode": "current", "i_q_ref": 11.9}, []),
    ):
        r = run("pi_foc", 2.5, rpm=0.0, load=0.0, plant=blocked, controller=controller)
        assert codes(r) == found


@pytest.mark.parametrize("rpm", [300.0, -300.0])
def test_a_heavy_load_that_is_slow_is_no_stall(rpm):
    """It reverses for longer than the time that makes a stall, at the limit of the torque."""
    r = run(
        "pi_foc",
        6.0,
        rpm=-rpm,
        load=0.0,
        plant={**ENCODER, "load.inertia": 0.8},
        schedule=[f"0.1 speed_ref_rpm {rpm}"],
    )
    assert codes(r) == []
    assert r.state["speed"][-1] / RPM == pytest.approx(rpm, rel=0.02)

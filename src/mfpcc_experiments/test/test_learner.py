"""What the learner of mls_mfpcc holds to where drives are not ideal.

The rivals know the true parameters. Medians over few seeds; `mfpcc_experiments.method` has more of
both.
"""

from __future__ import annotations

import numpy as np
import pytest

from mfpcc_controller import motor as motors
from mfpcc_experiments.method.drives import (
    ENCODER,
    dirty_drive,
    motor_like,
    random_drive,
    real_deviation,
    real_run,
    time_constant,
)
from mfpcc_experiments.running.closed_loop import Run, run

SEEDS = (1, 2, 3, 4, 5)


def gain_over_truth(r: Run) -> np.ndarray:
    """Learned answer of the current to the voltage, d and q, over that of the motor file."""
    table, est = r.controller.mem["mls_mfpcc"][0], r.controller.motor
    return np.array([table["m_d"].real * est.L_d, table["m_q"].imag * est.L_q]) / r.T_s


@pytest.mark.parametrize(
    ("case", "limit"),
    [
        # the largest and the least of 2000 samples, of few seeds, scatter by some per cent
        ("sensors of 3 kHz", 1.12),
        ("sensors of 2 kHz", 1.12),
        ("sensors of 1 kHz", 1.12),
        ("sampled 0.3 of a period early", 1.12),
        ("sampled half a period early", 1.12),
        ("the same, `ipmsm`", 1.15),
        ("noise of 100 mA", 1.06),
        ("converters of 10 bits", 1.12),
        ("encoder of 500 lines", 1.12),
    ],
)
def test_sensors_of_a_real_drive_cost_no_ripple(case, limit):
    ripple = {
        scheme: np.median([real_run(scheme, case, seed).ripple(0.2) for seed in SEEDS], axis=0)
        for scheme in ("mbpcc", "pi_foc", "mls_mfpcc")
    }
    best = np.minimum(ripple["mbpcc"], ripple["pi_foc"])
    assert np.all(ripple["mls_mfpcc"] <= limit * best)


@pytest.mark.parametrize(
    ("case", "limit"),
    [
        ("dead time 2 us", 0.9),
        ("EMF: 8 % 5th, 5 % 7th", 0.75),
        ("`textbook_spmsm`, 1500 r/min, 5 % 5th", 0.75),
    ],
)
def test_what_no_rival_models_is_learned(case, limit):
    thd = {
        scheme: np.median([real_run(scheme, case, seed, 20).thd(0.2) for seed in SEEDS])
        for scheme in ("mbpcc", "pi_foc", "mls_mfpcc")
    }
    assert thd["mls_mfpcc"] <= limit * min(thd["mbpcc"], thd["pi_foc"])


@pytest.mark.parametrize(
    ("plant", "motor", "within"),
    [
        ({}, "seed_750", 0.1),
        # the encoder's steps turn some of i_q to i_d: 0.9 of the truth, give or take 0.05
        ({}, "ipmsm", 0.15),
        ({"sensor.sampling_lead": 0.5}, "seed_750", 0.1),
    ],
)
def test_the_gain_is_the_truth_where_noise_moves_the_voltage(plant, motor, within):
    """A fit to the errors of filtered predictions finds 1.5 times the truth here."""
    found = [
        gain_over_truth(run("mls_mfpcc", 0.5, motor=motor, seed=seed, plant={**ENCODER, **plant}))
        for seed in SEEDS
    ]
    assert np.median(found, axis=0) == pytest.approx(1.0, abs=within)


@pytest.mark.parametrize(("motor", "rpm"), [("seed_750", 750.0), ("ipmsm", 1500.0)])
def test_without_noise_the_gain_is_no_worse_than_the_first_guess(motor, rpm):
    quiet = {**ENCODER, "noise.current_rms": 0.0}
    r = run("mls_mfpcc", 0.5, motor=motor, rpm=rpm, plant=quiet)
    est = r.controller.motor
    guess = 2.0 * np.array([est.L_d, est.L_q]) / (est.L_d + est.L_q)
    assert np.all(np.abs(np.log(gain_over_truth(r))) <= np.abs(np.log(guess)) + 0.05)


def test_a_quiet_drive_keeps_its_map_through_a_step_of_the_speed():
    frequency = {"pwm_frequency": 20e3}
    r = run(
        "mls_mfpcc",
        0.3,
        motor="maxon_ecmax40_120w",
        rpm=2000.0,
        load=0.0,
        plant={**ENCODER, **frequency, "noise.current_rms": 0.0},
        controller=frequency,
        schedule=["0.1 speed_ref_rpm 6000.0"],
    )
    assert r.controller.faults() == []
    assert r.largest_current() < 1.2 * r.controller.motor.i_max


def step_of_i_q(scheme: str, seed: int, plant: dict) -> tuple[float, float]:
    """Overshoot, and largest i_d (A), after a step from 2 to 6 A on `ipmsm` at 1500 r/min."""
    r = run(
        scheme,
        0.33,
        motor="ipmsm",
        rpm=1500.0,
        seed=seed,
        plant={**ENCODER, "load.kind": "speed", "load.speed_rpm": 1500.0, **plant},
        controller={"control_mode": "current", "i_q_ref": 2.0},
        schedule=["0.3 i_q_ref 6.0"],
    )
    i = r.state["i_dq"][3000:]
    return float(i[:, 1].max() - 6.0) / 4.0, float(np.abs(i[:, 0]).max())


def test_a_step_with_harmonics_of_the_emf_is_as_the_true_model_makes_it():
    plant = {"machine.emf_5": 0.05}
    mbpcc, mls = (
        np.median([step_of_i_q(scheme, seed, plant) for seed in SEEDS], axis=0)
        for scheme in ("mbpcc", "mls_mfpcc")
    )
    assert np.all(mls <= 1.05 * mbpcc)


def test_a_step_with_dead_time_in_a_quiet_drive():
    """The map is bent by the shape of the dead time; it was ten times the true model's 0.45 A."""
    plant = {"inverter.dead_time": 2e-6, "noise.current_rms": 0.00245}
    overshoot, i_d = np.median([step_of_i_q("mls_mfpcc", seed, plant) for seed in SEEDS], axis=0)
    assert overshoot < 0.02
    assert i_d < 2.0


@pytest.mark.parametrize(("motor", "rpm"), [("textbook_spmsm", 1700.0), ("ipmsm", 2200.0)])
def test_an_empty_table_is_filled_at_speed_within_the_limit(motor, rpm):
    for seed in SEEDS:
        r = run(
            "mls_mfpcc",
            0.2,
            motor=motor,
            rpm=rpm,
            seed=seed,
            plant=ENCODER,
            controller={"mls.start": "empty"},
        )
        assert r.controller.faults() == []
        assert r.largest_current() < 0.8 * r.controller.motor.i_max


@pytest.mark.parametrize("ratio", [0.1, 0.3, 1.0, 3.0, 10.0])
def test_a_first_guess_that_is_wrong_by_far_is_safe_at_speed(ratio):
    wrong = {"mismatch.inductance": ratio}
    r = run("mls_mfpcc", 0.2, motor="ipmsm", rpm=2200.0, plant=ENCODER, controller=wrong)
    assert r.controller.faults() == []
    assert r.largest_current() < r.controller.motor.i_max


@pytest.mark.parametrize("saliency", [2.0, 8.0])
@pytest.mark.parametrize("rpm", [0.0, 2200.0])
@pytest.mark.parametrize("ratio", [0.0, 0.1, 1.0, 10.0])
def test_salient_machines_start_from_any_table(saliency, rpm, ratio):
    """`ratio` of 0: an empty one."""
    start = {"mismatch.inductance": ratio} if ratio else {"mls.start": "empty"}
    motor = motor_like("ipmsm", L_d=1.5e-3, L_q=1.5e-3 * saliency)
    for seed in (1, 2):
        r = run("mls_mfpcc", 0.2, motor=motor, rpm=rpm, seed=seed, plant=ENCODER, controller=start)
        assert r.controller.faults() == []
        assert r.largest_current() < 1.3 * r.controller.motor.i_max
        found, guess = gain_over_truth(r), np.array([2.0, 2.0 * saliency]) / (1.0 + saliency)
        if ratio:
            # nearer to the truth than what it started from
            assert np.all(np.abs(np.log(found)) < np.abs(np.log(guess / ratio)))
        assert 0.5 < found[1] < 1.2


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("torque", [5.0, 10.0, 20.0])
def test_a_fast_run_up_of_a_salient_machine_keeps_its_map(torque, seed):
    """The d gain once went to zero here: the cross-coupling was taken for smaller than it is."""
    deep = motor_like(
        "ipmsm", R_s=0.1, L_d=1.2e-3, L_q=3.6e-3, psi_f=0.06, n_p=4, J=1e-3, u_dc=300.0,
        i_max=100.0, speed_max_rpm=20_000,
    )  # fmt: skip
    pwm = {"pwm_frequency": 20e3}
    r = run(
        "mls_mfpcc",
        0.25,
        motor=deep,
        rpm=200.0,
        load=torque,
        seed=seed,
        plant={**ENCODER, **pwm, "noise.current_rms": 0.1},
        controller={**pwm, "mtpa": True, "field_weakening": True, "fault.overspeed": 10.0},
        schedule=["0.1 speed_ref_rpm 60000"],
    )
    assert r.controller.faults() == []
    assert r.largest_current() < 1.05 * r.controller.motor.i_max
    assert np.all(np.abs(gain_over_truth(r) - 1.0) < 0.4)


@pytest.mark.parametrize("motor", ["maxon_ec45flat_30w_12v", "maxon_ec45flat_70w", "teknic_m2310p"])
@pytest.mark.parametrize("frequency", [10e3, 20e3])
def test_small_motors_run_up_at_their_first_step(motor, frequency):
    """An error that was cut told less: P once shrank as if it had not been, and A stayed wrong."""
    est, pwm = motors.load(motor), {"pwm_frequency": frequency}
    for seed in SEEDS:
        r = run(
            "mls_mfpcc",
            0.2,
            motor=motor,
            rpm=0.0,
            load=0.0,
            seed=seed,
            plant={**ENCODER, **pwm, "noise.current_rms": 2e-3 * est.i_max},
            controller=pwm,
            schedule=[f"0.05 speed_ref_rpm {0.9 * est.speed_max_rpm}"],
        )
        assert r.controller.faults() == []
        assert r.largest_current() < 1.25 * est.i_max


LIGHT_ROTOR = """
name: light_rotor
description: A servo motor without a load
source: The data sheet of docs/own_motor.md
R_s: 0.95
L_d: 2.8e-3
L_q: 2.8e-3
psi_f: 0.0936
n_p: 4
J: 6.0e-5
i_max: 4.81
speed_max_rpm: 3000
u_dc: 311
"""


@pytest.mark.parametrize("noise", [1e-3, 5e-3])
@pytest.mark.parametrize("event", ["0.0 load_torque 0.68", "0.05 speed_ref_rpm -900"])
def test_a_speed_that_falls_faster_than_its_estimate_bends_no_map(tmp_path, noise, event):
    """What of the EMF the estimate did not tell once went to the legs, and to their signs."""
    motor = tmp_path / "light_rotor.yaml"
    motor.write_text(LIGHT_ROTOR)
    for seed in SEEDS:
        r = run(
            "mls_mfpcc",
            0.2,
            motor=str(motor),
            rpm=1500.0,
            load=0.5,
            seed=seed,
            plant={"noise.current_rms": noise * 4.81},
            schedule=[event],
        )
        assert r.controller.faults() == []
        assert r.largest_current() < 1.1 * r.controller.motor.i_max


def test_a_decay_within_the_period_is_no_delay():
    """L / R of four periods: with the gain of both taps a step went 15 % beyond its end."""
    over = [real_deviation("mls_mfpcc", "L / R 0.2 ms: `maxon_ecmax40_120w`", s) for s in SEEDS]
    first, third = np.median(over, axis=0)
    assert first < 0.02
    assert third < 0.006


@pytest.mark.parametrize("case", ["ideal", "dead time 3 us", "L / R 1 ms"])
def test_one_step_teaches_what_noise_does_not(case):
    """The first large step tells R, and the legs, from the constant."""
    mbpcc, mls = (
        np.median([real_deviation(scheme, case, seed)[1] for seed in SEEDS])
        for scheme in ("mbpcc", "mls_mfpcc")
    )
    assert mls < 0.9 * mbpcc


def test_a_short_time_constant_is_predicted_as_the_true_model_does():
    """0.57 ms sampled at 50 us, i_q in steps at standstill: once 3 to 5 times as wrong."""
    motor, pwm = time_constant(0.57e-3), {"pwm_frequency": 20e3}
    random = np.random.default_rng(1)
    steps = [f"{0.1 + 1e-3 * n:.3f} i_q_ref {random.uniform(-4.0, 4.0):.3f}" for n in range(300)]
    rms = {}
    for scheme in ("mbpcc", "mls_mfpcc"):
        r = run(
            scheme,
            0.4,
            motor=motor,
            rpm=0.0,
            load=0.0,
            plant={**ENCODER, **pwm, "load.kind": "speed", "load.speed_rpm": 0.0},
            controller={**pwm, "control_mode": "current"},
            schedule=steps,
        )
        rms[scheme] = np.sqrt(np.mean(r.lut["prediction_error"][r.rows(0.2)] ** 2))
    assert rms["mls_mfpcc"] < 1.1 * rms["mbpcc"]


@pytest.mark.parametrize("case", ["no noise", "noise of 2 mA", "noise of 5 mA"])
def test_quiet_drives_are_as_calm_as_with_the_true_model(case):
    """An error below a threshold once went to the constant alone: 1.3 times the ripple at 2 mA."""
    ripple = {
        scheme: np.median([real_run(scheme, case, seed).ripple(0.2) for seed in SEEDS], axis=0)
        for scheme in ("mbpcc", "mls_mfpcc")
    }
    assert np.all(ripple["mls_mfpcc"] <= 1.05 * ripple["mbpcc"])


def test_random_drives_with_slow_sensors_settle():
    for seed in range(20):
        options = random_drive(seed)
        options["plant"] = {**options["plant"], "sensor.current_bandwidth": 2e3}
        r = run("mls_mfpcc", 0.3, **options)
        assert r.controller.faults() == []
        assert r.ripple(0.2).max() < 0.9, seed


def test_random_dirty_drives_settle_better_than_true_models():
    over = []
    for seed in range(5000, 5012):
        options = dirty_drive(seed)
        r = run("mls_mfpcc", 0.3, **options)
        assert r.controller.faults() == []
        assert r.ripple(0.2).max() < 0.9, seed
        true = {
            **options, "controller": {"pwm_frequency": options["controller"]["pwm_frequency"]}
        }  # fmt: skip
        rivals = (run("mbpcc", 0.3, **true), run("pi_foc", 0.3, **true))
        over.append(
            np.sqrt(np.mean(r.error(0.2) ** 2))
            / min(np.sqrt(np.mean(rival.error(0.2) ** 2)) for rival in rivals)
        )
    assert np.median(over) < 0.6

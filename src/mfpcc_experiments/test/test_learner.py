"""What the learner of mls_mfpcc holds to where drives are not ideal.

The rivals know the true parameters. Medians over few seeds; `mfpcc_experiments.method` has more of
both.
"""

from __future__ import annotations

import numpy as np
import pytest

from mfpcc_experiments.method.drives import ENCODER, dirty_drive, random_drive, real_run
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
        ("sensors of 1 kHz", 1.25),
        ("sampled half a period early", 1.12),
        ("the same, `ipmsm`", 1.15),
        ("noise of 100 mA", 1.05),
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
    ("plant", "motor"),
    [({}, "seed_750"), ({}, "ipmsm"), ({"sensor.sampling_lead": 0.5}, "seed_750")],
)
def test_the_gain_is_the_truth_where_noise_moves_the_voltage(plant, motor):
    """A fit to the errors of filtered predictions finds 1.5 times the truth here."""
    found = [
        gain_over_truth(run("mls_mfpcc", 0.5, motor=motor, seed=seed, plant={**ENCODER, **plant}))
        for seed in SEEDS
    ]
    assert np.median(found, axis=0) == pytest.approx(1.0, abs=0.1)


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
        true = {**options, "controller": {}}
        rivals = (run("mbpcc", 0.3, **true), run("pi_foc", 0.3, **true))
        over.append(
            np.sqrt(np.mean(r.error(0.2) ** 2))
            / min(np.sqrt(np.mean(rival.error(0.2) ** 2)) for rival in rivals)
        )
    assert np.median(over) < 0.6

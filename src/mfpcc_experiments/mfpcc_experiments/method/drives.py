"""
The drives of docs/method.md, as options of `closed_loop.run`.

Motor `seed_750`, noise of 20 mA on i_d and i_q and an encoder of 2500 lines with quadrature, unless
a case says otherwise.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mfpcc_experiments.running.closed_loop import Run, run

ENCODER = {"sensor.encoder_lines": 2500}
LOAD_STEP = ("0.2 load_torque 5.0",)
MISMATCH = {"a": (0.5, 0.1, 2.0), "b": (2.0, 10.0, 0.7), "c": (2.0, 1.0, 2.0)}


def wrong_model(inductance: float, resistance: float, flux: float) -> dict[str, float]:
    """Controller parameters of a model that is wrong by these ratios."""
    return {
        "mismatch.inductance": inductance,
        "mismatch.resistance": resistance,
        "mismatch.flux": flux,
    }


def random_drive(seed: int) -> dict[str, Any]:
    """Options of `run` for a drive with a wrong model, at any speed, with a load step.

    Model over actual: L 0.2 to 5, R 0 to 10, psi_f 0 to 3; 0 to 1200 r/min in both directions; the
    load brakes with 0 to 5 N m.
    """
    random = np.random.default_rng(seed)
    ratios = (random.uniform(0.2, 5.0), random.uniform(0.0, 10.0), random.uniform(0.0, 3.0))
    rpm = random.uniform(-1200.0, 1200.0)
    before, after = np.copysign(random.uniform(0.0, 5.0, 2), rpm)
    return {
        "rpm": float(rpm),
        "load": float(before),
        "seed": seed,
        "plant": ENCODER,
        "controller": wrong_model(*map(float, ratios)),
        "schedule": [f"0.1 load_torque {float(after)}"],
    }


def dirty_drive(seed: int) -> dict[str, Any]:
    """Options of `run` for a random drive none of whose parts is ideal.

    Besides what `random_drive` draws: encoder of 500 to 5000 lines; sensors of 1 to 5 kHz, or that
    sample up to half a period early; dead time to 3 us; fifth harmonic of the EMF to 6 %; noise of
    1 to 63 mA.
    """
    options = random_drive(seed)
    random = np.random.default_rng([seed, 1])
    plant: dict[str, Any] = {
        "sensor.encoder_lines": int(random.integers(500, 5001)),
        "inverter.dead_time": float(random.uniform(0.0, 3e-6)),
        "machine.emf_5": float(random.uniform(0.0, 0.06)),
        "noise.current_rms": float(10.0 ** random.uniform(-3.0, -1.2)),
    }
    if random.random() < 0.5:
        plant["sensor.current_bandwidth"] = float(random.uniform(1e3, 5e3))
    else:
        plant["sensor.sampling_lead"] = float(random.uniform(0.0, 0.5))
    return {**options, "plant": plant}


def settled(r: Run, ripple: float) -> bool:
    """Whether a random drive kept its limit and settled, with no more than this ripple (A)."""
    return (
        r.controller.faults() == []
        and r.largest_current() < 1.2 * r.controller.motor.i_max
        and bool(np.abs(r.error(0.2).mean(axis=0)).max() < 0.1)
        and bool(r.ripple(0.2).max() < ripple)
    )


#: What a drive has that simulations leave out: options of `run` on top of the encoder.
REALITY: dict[str, dict[str, Any]] = {
    "ideal": {},
    "sensors of 3 kHz": {"plant": {"sensor.current_bandwidth": 3e3}},
    "sensors of 2 kHz": {"plant": {"sensor.current_bandwidth": 2e3}},
    "sensors of 1 kHz": {"plant": {"sensor.current_bandwidth": 1e3}},
    "sampled half a period early": {"plant": {"sensor.sampling_lead": 0.5}},
    "the same, `ipmsm`": {"motor": "ipmsm", "plant": {"sensor.sampling_lead": 0.5}},
    "noise of 2 mA": {"plant": {"noise.current_rms": 0.00245}},
    "noise of 100 mA": {"plant": {"noise.current_rms": 0.1225}},
    "converters of 10 bits": {"plant": {"sensor.adc_bits": 10}},
    "encoder of 500 lines": {"plant": {"sensor.encoder_lines": 500}},
    "dead time 2 us": {"plant": {"inverter.dead_time": 2e-6}},
    "dead time 4 us": {"plant": {"inverter.dead_time": 4e-6}},
    "EMF: 8 % 5th, 5 % 7th": {"plant": {"machine.emf_5": 0.08, "machine.emf_7": -0.05}},
    "`textbook_spmsm`, 1500 r/min, 5 % 5th": {
        "motor": "textbook_spmsm",
        "rpm": 1500.0,
        "plant": {"machine.emf_5": 0.05},
    },
    "`ipmsm`, saturated, 8 N m": {
        "motor": "ipmsm",
        "load": 8.0,
        "plant": {"machine.flux_map": "ipmsm_saturated"},
    },
    "PWM 4 kHz": {
        "plant": {"pwm_frequency": 4e3},
        "controller": {"pwm_frequency": 4e3},
    },
    "PWM 40 kHz": {
        "plant": {"pwm_frequency": 40e3},
        "controller": {"pwm_frequency": 40e3},
    },
}


def real_run(scheme: str, case: str, seed: int, oversampling: int = 0) -> Run:
    """A steady run of 0.4 s with one piece of reality."""
    options = dict(REALITY[case])
    options["plant"] = {**ENCODER, **options.get("plant", {})}
    return run(scheme, 0.4, seed=seed, oversampling=oversampling, **options)

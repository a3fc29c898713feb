"""
The drives of docs/method.md, as options of `closed_loop.run`.

Motor `seed_750`, noise of 20 mA on i_d and i_q and an encoder of 2500 lines with quadrature, unless
a case says otherwise.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mfpcc_controller import motor as motors
from mfpcc_experiments.files import write_whole
from mfpcc_experiments.running.closed_loop import NOISE, Run, run
from mfpcc_experiments.scratch import scratch
from pwm_node import yaml_files

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


@functools.cache
def motor_like(name: str, **changes: float) -> str:
    """Path of a motor file like that of this name, but for the changes; it lasts as the process."""
    values = yaml.safe_load(yaml_files.find("motors", name).read_text())
    text = yaml.safe_dump({**values, **changes})
    # processes that share the folder write the same file, or another one
    path = _folder() / f"{hashlib.sha256(text.encode()).hexdigest()}.yaml"
    write_whole(path, text)
    return str(path)


@functools.cache
def _folder() -> Path:
    work = contextlib.ExitStack()
    atexit.register(work.close)
    return work.enter_context(scratch("mfpcc-motors-"))


def time_constant(seconds: float) -> str:
    """`seed_750` with another L / R (s): both are moved, so that its voltages stay possible."""
    factor = math.sqrt(seconds / 10e-3)
    return motor_like("seed_750", L_d=15e-3 * factor, L_q=15e-3 * factor, R_s=1.5 / factor)


def dirty_drive(seed: int) -> dict[str, Any]:
    """Options of `run` for a random drive none of whose parts is ideal.

    Besides what `random_drive` draws: PWM of 4 to 40 kHz; L / R of 0.3 to 50 ms, or (one of five)
    the salient `ipmsm`, saturated; encoder of 500 to 5000 lines; converters of 10 to 14 bits;
    sensors with a tenth to half of the PWM frequency as bandwidth, or that sample up to half a
    period early; dead time to 3 us, and 3 % of the period; 5th and 7th harmonic of the EMF to 8 %
    together; noise of 1 to 63 mA.
    """
    options = random_drive(seed)
    random = np.random.default_rng([seed, 1])
    frequency = float(4e3 * 10.0 ** random.uniform(0.0, 1.0))
    fifth, seventh = random.uniform(-0.06, 0.06), random.uniform(-0.02, 0.02)
    plant: dict[str, Any] = {
        "pwm_frequency": frequency,
        "sensor.encoder_lines": int(random.integers(500, 5001)),
        "sensor.adc_bits": int(random.integers(10, 15)),
        "inverter.dead_time": float(min(random.uniform(0.0, 3e-6), 0.03 / frequency)),
        "machine.emf_5": float(fifth),
        "machine.emf_7": float(seventh),
        "noise.current_rms": float(10.0 ** random.uniform(-3.0, -1.2)),
    }
    if random.random() < 0.5:
        plant["sensor.current_bandwidth"] = float(frequency * random.uniform(0.1, 0.5))
    else:
        plant["sensor.sampling_lead"] = float(random.uniform(0.0, 0.5))
    motor = time_constant(float(0.3e-3 * (50.0 / 0.3) ** random.uniform(0.0, 1.0)))
    if random.random() < 0.2:
        motor = "ipmsm"
        plant |= {"machine.flux_map": "ipmsm_saturated", "sensor.adc_range": 40.0}
    controller = {**options["controller"], "pwm_frequency": frequency}
    return {**options, "motor": motor, "plant": plant, "controller": controller}


def settled(r: Run, ripple: float) -> bool:
    """Whether a random drive kept its limit and settled, with no more than this ripple (A)."""
    return (
        r.controller.faults() == []
        and r.largest_current() < 1.2 * r.controller.motor.i_max
        and bool(np.abs(r.error(0.2).mean(axis=0)).max() < 0.1)
        and bool(r.ripple(0.2).max() < ripple)
    )


def _at(frequency: float) -> dict[str, Any]:
    pwm = {"pwm_frequency": frequency}
    return {"plant": pwm, "controller": pwm}


def _small(motor: str, rpm: float, load: float) -> dict[str, Any]:
    """A small motor at 20 kHz, with a noise of 0.17 % of its current limit, as the others have."""
    noise = NOISE / 12.0 * motors.load(motor).i_max
    own = _at(20e3)
    own["plant"] = {**own["plant"], "noise.current_rms": noise}
    return {"motor": motor, "rpm": rpm, "load": load, **own}


#: What a drive has that simulations leave out: options of `run` on top of the encoder.
REALITY: dict[str, dict[str, Any]] = {
    "ideal": {},
    "sensors of 3 kHz": {"plant": {"sensor.current_bandwidth": 3e3}},
    "sensors of 2 kHz": {"plant": {"sensor.current_bandwidth": 2e3}},
    "sensors of 1 kHz": {"plant": {"sensor.current_bandwidth": 1e3}},
    "sampled 0.3 of a period early": {"plant": {"sensor.sampling_lead": 0.3}},
    "sampled half a period early": {"plant": {"sensor.sampling_lead": 0.5}},
    "the same, `ipmsm`": {"motor": "ipmsm", "plant": {"sensor.sampling_lead": 0.5}},
    "no noise": {"plant": {"noise.current_rms": 0.0}},
    "noise of 2 mA": {"plant": {"noise.current_rms": 0.00245}},
    "noise of 5 mA": {"plant": {"noise.current_rms": 0.006125}},
    "noise of 100 mA": {"plant": {"noise.current_rms": 0.1225}},
    "converters of 10 bits": {"plant": {"sensor.adc_bits": 10}},
    "encoder of 500 lines": {"plant": {"sensor.encoder_lines": 500}},
    "dead time 1 us": {"plant": {"inverter.dead_time": 1e-6}},
    "dead time 2 us": {"plant": {"inverter.dead_time": 2e-6}},
    "dead time 3 us": {"plant": {"inverter.dead_time": 3e-6}},
    "dead time 4 us": {"plant": {"inverter.dead_time": 4e-6}},
    "EMF: 4 % 5th, 3 % 7th": {"plant": {"machine.emf_5": 0.04, "machine.emf_7": 0.03}},
    "EMF: 8 % 5th, 5 % 7th": {"plant": {"machine.emf_5": 0.08, "machine.emf_7": -0.05}},
    "EMF: 8 % 5th, 8 % 7th": {"plant": {"machine.emf_5": 0.08, "machine.emf_7": 0.08}},
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
    "PWM 4 kHz": _at(4e3),
    "PWM 8 kHz": _at(8e3),
    "PWM 20 kHz": _at(20e3),
    "PWM 40 kHz": _at(40e3),
    "L / R 0.2 ms: `maxon_ecmax40_120w`": _small("maxon_ecmax40_120w", 4000.0, 0.1),
    "L / R 0.5 ms: `maxon_ec45flat_30w_12v`": _small("maxon_ec45flat_30w_12v", 1500.0, 0.04),
    "L / R 0.3 ms": {"motor": time_constant(0.3e-3)},
    "L / R 1 ms": {"motor": time_constant(1e-3)},
    "L / R 3 ms": {"motor": time_constant(3e-3)},
    "L / R 50 ms": {"motor": time_constant(50e-3)},
}


def _with_encoder(case: str, plant: dict[str, Any]) -> dict[str, Any]:
    options = dict(REALITY[case])
    options["plant"] = {**ENCODER, **options.get("plant", {}), **plant}
    return options


def real_run(scheme: str, case: str, seed: int, oversampling: int = 0) -> Run:
    """A steady run of 0.4 s with one piece of reality."""
    return run(scheme, 0.4, seed=seed, oversampling=oversampling, **_with_encoder(case, {}))


def real_deviation(scheme: str, case: str, seed: int) -> tuple[float, float]:
    """Largest deviation after a step of i_q, the first and the third, over the current limit.

    At a speed that is held i_q steps from 0.1 to 0.4 of the current limit, and back in between.
    Within the 20 ms after a step, the larger of what the true i_q goes beyond its reference and of
    what i_d leaves its own by. The first step is the first thing that moves the drive.
    """
    options = _with_encoder(case, {"load.kind": "speed"})
    i_max = motors.load(options.get("motor", "seed_750")).i_max
    options["plant"]["load.speed_rpm"] = options.get("rpm", 750.0)
    low, high = 0.1 * i_max, 0.4 * i_max
    options["controller"] = {
        **options.get("controller", {}), "control_mode": "current", "i_q_ref": low
    }  # fmt: skip
    steps = [f"{0.3 + 0.025 * n:g} i_q_ref {low if n % 2 else high}" for n in range(5)]
    r = run(scheme, 0.42, seed=seed, schedule=steps, **options)

    def after(start: float) -> float:
        i = r.state["i_dq"][r.rows(start, start + 0.02)]
        return float(max(np.abs(i[:, 0]).max(), i[:, 1].max() - high) / i_max)

    return after(0.3), after(0.4)

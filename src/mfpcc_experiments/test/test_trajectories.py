"""Short drives of every scheme and every part of the plant, held against stored ones.

What the schemes and the plant have to do is tested elsewhere. This notices where they do something
else than before, however little: a sign, a factor or a bound that no other test would miss. Where
that is meant, store anew what it does now, and look at the difference:

    python src/mfpcc_experiments/test/test_trajectories.py

A drive is stored by one number for each field of the loop's messages: the sum over its periods and
elements, each with a fixed weight of its own.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mfpcc_controller.parameters import SCHEMES
from mfpcc_experiments.running.closed_loop import Run, run

STORED = Path(__file__).with_name("trajectories.json")

SECONDS = 0.012
#: Of the plant's parts: without its compiler the plant with switches is slow.
OF_PLANT = 0.004
ENCODER = {"sensor.encoder_lines": 2500}
BACK = ["0.006 i_q_ref -6.0", "0.006 i_d_ref -2.0", "0.009 i_q_ref 1.0"]
#: What a scheme has to cope with: salient, wrong model, forwards; then in reverse, both axes moved.
FORWARDS: dict[str, Any] = {
    "motor": "ipmsm",
    "rpm": 700.0,
    "plant": ENCODER,
    "controller": {"mismatch.inductance": 1.4, "mismatch.resistance": 2.0, "mtpa": True},
    "schedule": ["0.004 load_torque 6.0", "0.006 speed_ref_rpm 800.0"],
}
REVERSE: dict[str, Any] = {
    "rpm": -900.0,
    "load": -1.0,
    "plant": {"load.kind": "speed", "load.speed_rpm": -900.0, "inverter.dead_time": 2e-6},
    "controller": {"control_mode": "current", "i_q_ref": -2.0, "mismatch.flux": 0.8},
    "schedule": BACK,
}

#: Further settings of schemes, in reverse.
SETTINGS: dict[str, dict[str, Any]] = {
    "mls_mfpcc empty": {"mls.start": "empty", "sector_search": "ranking"},
    "mls_mfpcc onto the hexagon": {"overmodulation": "project", "deadbeat.gain": 0.7},
    "mls_mfpcc_paper": {"mls.window": 3, "mls.e_0": 0.3, "mls.g_max": 2.0},
    "mfpcc last": {"mfpcc.update": "last"},
    "mfpcc last_refresh": {"mfpcc.update": "last_refresh", "mfpcc.refresh": 9},
    "ultra_local_smo": {"smo.gain": 3000.0, "smo.width": 0.5},
    "mbpcc onto the hexagon": {"overmodulation": "project", "i_q_ref": -11.0},
    "pi_foc weakened field": {
        "control_mode": "speed",
        "speed_ref_rpm": -2200.0,
        "field_weakening": True,
    },
}

SWITCHES = {
    "inverter.dead_time": 2e-6,
    "inverter.switch_voltage": 1.2,
    "inverter.switch_resistance": 0.05,
    "inverter.diode_voltage": 0.9,
    "inverter.diode_resistance": 0.03,
}

#: Parts of the plant, one or some at a time.
PLANT: dict[str, dict[str, Any]] = {
    "ideal": {},
    "switches": SWITCHES,
    "timer": {**SWITCHES, "inverter.min_pulse": 3e-6, "inverter.timer_clock": 20e6},
    "emf": {"machine.emf_5": 0.05, "machine.emf_7": -0.03, "machine.emf_11": 0.02},
    "more emf": {"machine.emf_13": 0.02, "initial_angle": 1.0},
    "cogging": {"machine.cogging_torque": 0.5, "machine.cogging_periods": 24},
    "iron": {"machine.iron_loss_resistance": 400.0},
    "saturated": {"motor": "ipmsm", "machine.flux_map": "ipmsm_saturated"},
    "saturated, switches": {"motor": "ipmsm", "machine.flux_map": "ipmsm_saturated", **SWITCHES},
    "drift": {"drift.resistance": 1.5, "drift.flux": 0.9, "drift.temperature": 80.0},
    "heat": {"drift.time_constant": 0.05, "drift.thermal_resistance": 2.0},
    "brake": {"load.kind": "brake", "load.brake_lag": 0.004, "load.coulomb_friction": 0.2},
    "fan": {"load.quadratic": 2e-4, "load.viscous_friction": 0.01, "load.inertia": 1e-3},
    "profile": {"load.profile": [0.0, 0.5, 1.5, -0.5]},
    "shaft": {"load.shaft_stiffness": 80.0, "load.shaft_damping": 0.05, "load.inertia": 2e-3},
    "held": {"load.kind": "speed", "load.speed_rpm": 760.0},
    "rectifier": {"dc_link.kind": "rectifier", "dc_link.capacitance": 2e-4},
    "chopper": {
        "dc_link.kind": "rectifier",
        "dc_link.capacitance": 1e-4,
        "dc_link.chopper_resistance": 50.0,
        "dc_link.chopper_on": 312.0,
        "dc_link.chopper_off": 305.0,
        "load_torque": -6.0,
    },
    "sensors": {
        "sensor.current_gain": [1.02, 0.99, 1.0],
        "sensor.current_offset": [0.05, -0.02, 0.0],
        "sensor.current_bandwidth": 3000.0,
        "sensor.adc_bits": 12,
        "sensor.sampling_lead": 0.3,
    },
    "encoder": {
        "sensor.encoder_lines": 1000,
        "sensor.encoder_offset": 0.02,
        "sensor.encoder_latency": 2e-5,
        "sensor.angle_noise": 1e-3,
    },
    "faults": {
        "fault_injection": True,
        "fault.react": False,
        "injections": ["0.001 0.001 current_a stuck", "0.0025 0.001 duty_link intermittent"],
        "inverter.missing_command": "hold",
    },
    "gates off": {"fault.dc_overvoltage": 1.05, **SWITCHES},
}


def _in_reverse(scheme: str, **more: Any) -> dict[str, Any]:
    controller = {**REVERSE["controller"], **more}
    return {"scheme": scheme, "seconds": SECONDS, **REVERSE, "controller": controller}


def _cases() -> Iterator[tuple[str, dict[str, Any]]]:
    for scheme in SCHEMES:
        yield f"{scheme}, forwards", {"scheme": scheme, "seconds": SECONDS, **FORWARDS}
        yield f"{scheme}, reverse", _in_reverse(scheme)
        other = "mbpcc" if scheme == "pi_foc" else "pi_foc"
        yield (
            f"{scheme}, taken over",
            {"scheme": other, "seconds": 0.005, "schedule": [f"0.002 scheme {scheme}"]},
        )
    for name, settings in SETTINGS.items():
        yield name, _in_reverse(name.split()[0], **settings)
    for name, values in PLANT.items():
        options: dict[str, Any] = {"motor": values.get("motor", "seed_750"), "oversampling": 3}
        if name == "gates off":
            options |= {"rpm": 1400.0, "schedule": ["0.002 dc_voltage 335.0"]}
        options |= {"scheme": "pi_foc", "plant": values, "seconds": OF_PLANT}
        yield f"plant: {name}", options


CASES = dict(_cases())


def numbers(case: str) -> dict[str, float]:
    """What is stored of a drive."""
    r = run(**CASES[case])
    found = {
        f"{message}.{field}": _sum(rows[field])
        for message in ("feedback", "command", "lut", "state")
        for rows in (getattr(r, message),)
        for field in rows.dtype.names
        if field != "step_time" and rows.dtype[field].base.kind in "biuf"
    }
    if r.i_abc.size:
        found["i_abc"] = _sum(r.i_abc)
    return {name: value for name, value in found.items() if value} | _learned(r)


def _learned(r: Run) -> dict[str, float]:
    """What the scheme in control remembers."""
    memory = r.controller.mem
    if r.controller.scheme not in (memory.dtype.names or ()):
        return {}
    own = memory[r.controller.scheme]
    return {
        f"memory.{name}": _sum(own[name])
        for name in own.dtype.names
        if own.dtype[name].base.kind in "fc" and _sum(own[name])
    }


def _sum(values: np.ndarray) -> float:
    flat = values.reshape(-1)
    if np.iscomplexobj(flat):
        flat = np.stack([flat.real, flat.imag]).reshape(-1)
    weights = np.random.default_rng(0).uniform(0.5, 1.5, flat.size)
    return float(weights @ flat.astype(np.float64))


@pytest.mark.parametrize("case", CASES)
def test_a_drive_goes_as_it_went_before(case: str) -> None:
    stored = json.loads(STORED.read_text())[case]
    assert numbers(case) == pytest.approx(stored, rel=1e-7, abs=1e-9, nan_ok=True)


if __name__ == "__main__":
    STORED.write_text(json.dumps({case: numbers(case) for case in CASES}, indent=1) + "\n")

"""Effects of the plant, alone and in the sets that realistic drives have, and what they cost."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from mfpcc_msgs.msg import DriveState, PhaseFeedback

from pmsm_sim.parameters import TABLE as PLANT
from pmsm_sim.plant import Plant, advance
from pwm_node.compiled import kernel
from pwm_node.wire import fixed_dtype

#: Every effect by itself, in a strength met in practice.
EFFECTS: Mapping[str, Mapping[str, Any]] = {
    "none": {},
    "current noise": {"noise.current_rms": 0.0245},
    "ADC 12 bit": {"sensor.adc_bits": 12},
    "encoder 2500 lines": {"sensor.encoder_lines": 2500},
    "duties rounded to 100 MHz": {"inverter.timer_clock": 1e8},
    "temperature": {"drift.temperature": 80.0, "drift.time_constant": 10.0},
    "dead time 2 us": {"inverter.dead_time": 2e-6},
    "on-state drops": {
        "inverter.switch_voltage": 1.1,
        "inverter.switch_resistance": 0.05,
        "inverter.diode_voltage": 0.9,
        "inverter.diode_resistance": 0.03,
    },
    "back-EMF harmonics": {"machine.emf_5": 0.04, "machine.emf_7": -0.03},
    "cogging": {"machine.cogging_torque": 0.1},
    "iron loss": {"machine.iron_loss_resistance": 400.0},
    "saturation": {"motor": "ipmsm", "machine.flux_map": "ipmsm_saturated"},
    "rectifier": {"dc_link.kind": "rectifier"},
    "elastic shaft": {"load.inertia": 3e-3, "load.shaft_stiffness": 300.0},
    "friction, quadratic load": {"load.coulomb_friction": 0.1, "load.quadratic": 1e-4},
    "current bandwidth 20 kHz": {"sensor.current_bandwidth": 2e4},
}

#: What is on together in realistic drives.
SETS: Mapping[str, Mapping[str, Any]] = {
    "servo": {
        "inverter.dead_time": 2e-6,
        "inverter.switch_voltage": 1.1,
        "inverter.switch_resistance": 0.05,
        "inverter.diode_voltage": 0.9,
        "inverter.diode_resistance": 0.03,
        "sensor.encoder_lines": 2500,
        "sensor.adc_bits": 12,
        "noise.current_rms": 0.0245,
        "load.coulomb_friction": 0.1,
        "load.viscous_friction": 1e-3,
    },
    "traction": {
        "motor": "ipmsm",
        "machine.flux_map": "ipmsm_saturated",
        "machine.iron_loss_resistance": 300.0,
        "machine.emf_5": 0.03,
        "machine.emf_7": 0.02,
        "inverter.dead_time": 2e-6,
        "dc_link.kind": "rectifier",
    },
}

#: All that can be on together, for the balance of energy.
ALL_ON: Mapping[str, Any] = {
    "motor": "ipmsm",
    "machine.flux_map": "ipmsm_saturated",
    "machine.emf_5": 0.03,
    "machine.emf_7": 0.02,
    "machine.cogging_torque": 0.1,
    "machine.iron_loss_resistance": 300.0,
    "inverter.dead_time": 2e-6,
    "inverter.switch_voltage": 1.1,
    "inverter.switch_resistance": 0.05,
    "inverter.diode_voltage": 0.9,
    "inverter.diode_resistance": 0.03,
    "dc_link.kind": "rectifier",
    "dc_link.capacitance": 5e-4,
    "load.coulomb_friction": 0.1,
    "load.viscous_friction": 1e-3,
    "load.quadratic": 5e-5,
    "load.inertia": 3e-3,
    "load.shaft_stiffness": 300.0,
    "load.shaft_damping": 0.02,
}

#: What the table of costs goes through: every effect by itself, and sets of them.
COSTED: Mapping[str, Mapping[str, Any]] = {
    **EFFECTS,
    **SETS,
    "everything": {
        **SETS["servo"],
        **ALL_ON,
        "sensor.current_bandwidth": 2e4,
        "sensor.encoder_latency": 2e-5,
        "inverter.timer_clock": 1e8,
        "drift.temperature": 80.0,
        "drift.time_constant": 10.0,
    },
}


@kernel
def _advance_many(par, st, feedback, state, i_abc, legs, n):  # type: ignore[no-untyped-def]
    for _ in range(n):
        st[0].latched = True
        advance(par, st, feedback, state, i_abc, legs)


def costs(*, repeats: int = 7, periods: int = 400) -> dict[str, float]:
    """
    Time of one period of the plant with effects, inside compiled code.

    Returns
    -------
    dict
        Microseconds by the names of `COSTED`: the best of several runs.
    """
    found = {}
    feedback, state = np.zeros(1, fixed_dtype(PhaseFeedback)), np.zeros(1, fixed_dtype(DriveState))
    nothing, no_legs = np.zeros(0), np.zeros(0, np.uint8)
    for name, values in COSTED.items():
        plant = Plant(PLANT.complete({"initial_speed_rpm": 750.0, "fault.react": False, **values}))
        plant.par["J"] = 1e12  # the speed stays
        plant.st["duty"] = [[0.53, 0.5, 0.48]]
        start, best = plant.st.copy(), np.inf
        for _ in range(repeats + 1):
            plant.st[:] = start
            begin = time.perf_counter()
            _advance_many(plant.par, plant.st, feedback, state, nothing, no_legs, periods)
            best = min(best, (time.perf_counter() - begin) / periods)
        found[name] = 1e6 * best
    return found

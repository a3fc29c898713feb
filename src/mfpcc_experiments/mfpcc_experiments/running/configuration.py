"""What is stored with a recording of an experiment, so that it can be made again."""

from __future__ import annotations

from typing import Any

from mfpcc_experiments.bags import versions
from mfpcc_experiments.running.scenario import Scenario
from pmsm_sim import motor


def configuration(scenario: Scenario, scheme: str, engine: str, seed: int) -> dict[str, Any]:
    """All that a run can be repeated from: it is stored inside the recording."""
    plant, controller = scenario.node_parameters(scheme, seed)
    machine = motor.load(scenario.motor)
    return {
        "experiment": scenario.name,
        "scheme": scheme,
        "motor": machine.name,
        "engine": engine,
        "seed": seed,
        "T_s": 1.0 / scenario.pwm_frequency,
        "window_s": list(scenario.window_s),
        "n_p": machine.n_p,
        "R_s": machine.R_s,
        "scenario": scenario.model_dump(mode="json"),
        "parameters": {"pmsm_sim": plant, "mfpcc_controller": controller},
        "motor_file": machine.model_dump(mode="json"),
        "versions": versions(),
    }

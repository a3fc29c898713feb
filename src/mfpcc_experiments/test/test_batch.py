"""A run of a batch is the run that is recorded: the same bits, and the figures of metrics.json."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mfpcc_experiments.bags import read
from mfpcc_experiments.measuring import evaluate
from mfpcc_experiments.measuring.compiled import KEYS
from mfpcc_experiments.measuring.metrics import METRICS
from mfpcc_experiments.running import run, scenario
from mfpcc_experiments.running.batch import FIGURES, OUTCOME, Batch, drive_of
from mfpcc_experiments.running.engine import Engine
from pwm_node import bits

#: Steady and not, at speed and at standstill, tripped, fallen back, with effects and without.
CASES = {
    "steady": ("steady_750_2", "mls_mfpcc", ["duration=0.3", "window_s=[0.15,0.3]"]),
    "backwards": (
        "steady_750_2",
        "pi_foc",
        ["speed_rpm=-300", "oversampling=0", "duration=0.3", "window_s=[0.1,0.3]"],
    ),
    "standstill": ("steady_750_2", "mbpcc", ["speed_rpm=0", "duration=0.3", "window_s=[0.1,0.3]"]),
    "too short": ("steady_750_2", "mbpcc", ["speed_rpm=20", "duration=0.2", "window_s=[0,0.2]"]),
    "one vector": ("steady_750_2", "mfpcc", ["duration=0.3", "window_s=[0.15,0.3]"]),
    "load steps before": ("mismatch_b", "mbpcc", []),
    "load steps within": ("load_step", "mls_mfpcc", ["duration=0.3", "window_s=[0.1,0.3]"]),
    "speed steps": ("speed_step", "neso_mfpcc", []),
    "slow transient": ("speed_step", "mbpcc", ["window_s=[0.22,0.5]"]),
    "current control": (
        "steady_750_2",
        "mbpcc",
        ["control_mode=current", "i_q_ref=2", "load.kind=speed", "load.speed_rpm=300"],
    ),
    "tripped in the window": ("load_step", "mbpcc", ["controller.fault.overcurrent=0.5"]),
    "tripped at the start": ("steady_750_2", "mbpcc", ["controller.fault.overcurrent=0.1"]),
    "fallen back": (
        "steady_750_2",
        "mfpcc",
        ["fault.prediction_error=0.001", "fault.prediction_time=0.01"],
    ),
    "falls back in the window": (
        "steady_750_2",
        "mfpcc",
        ["fault.prediction_error=0.001", "fault.prediction_time=0.01", "window_s=[0,0.3]"],
    ),
    "warm, coarse encoder": (
        "steady_750_2",
        "mls_mfpcc",
        ["drift.thermal_resistance=0.5", "drift.time_constant=0.2", "sensor.encoder_lines=1000"],
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_same_bits_and_same_figures(case, tmp_path):
    experiment, scheme, changes = CASES[case]
    wanted = scenario.load(experiment)
    wanted = scenario.changed(wanted, changes)
    run.run(wanted, scheme, "inprocess", tmp_path, 7, lambda done: None)
    row = evaluate(read(tmp_path / scheme))

    plant_values, controller_values = wanted.node_parameters(scheme, 7)
    batch = Batch(
        wanted.periods, wanted.window_s, wanted.pwm_frequency, plant_values["oversampling"]
    )
    outcome = np.zeros(1, OUTCOME)
    plant, controller = batch.one(drive_of(plant_values, controller_values), outcome)

    engine = Engine(plant_values, controller_values)
    traces = list(engine.run(wanted.periods))
    assert bits.of(plant.st) == bits.of(engine.plant.st)
    assert bits.of(controller.mem) == bits.of(engine.controller.mem)

    assert {True: 1, False: 0, None: -1}[row["steady"]] == outcome["steady"][0]
    for key, figure in zip(FIGURES, outcome["figures"][0].tolist(), strict=True):
        if key not in KEYS:
            continue
        expected = row
        for name in key.split("."):
            expected = None if expected is None else expected[name]
        if expected is None:
            assert math.isnan(figure), key
        else:
            assert figure == pytest.approx(expected, rel=1e-9, abs=1e-12), key
    i_dq = np.concatenate([trace.state["i_dq"] for trace in traces])
    assert outcome["i_peak"][0] == np.max(np.hypot(*i_dq.T))
    assert bool(outcome["faults_controller"][0]) == bool(engine.controller.faults())
    assert bool(outcome["faults_plant"][0]) == bool(engine.plant.faults())
    assert outcome["fell_back"][0] == engine.controller.fallen


def test_the_cases_are_what_they_are_called():
    """The figures are compared where they exist, and where they must not."""
    found = {}
    for case in ("steady", "tripped in the window", "fallen back", "slow transient"):
        experiment, scheme, changes = CASES[case]
        wanted = scenario.changed(scenario.load(experiment), changes)
        values = wanted.node_parameters(scheme, 7)
        batch = Batch(wanted.periods, wanted.window_s, wanted.pwm_frequency, 0)
        found[case] = batch.run([drive_of(*values)])[0]
    assert found["steady"]["steady"] == 1
    assert found["slow transient"]["steady"] == 0
    assert found["tripped in the window"]["faults_controller"] != 0
    assert found["fallen back"]["fell_back"]


def test_every_figure_of_a_window_is_there():
    """A metric that is added is not forgotten: all but what only a recording can tell."""
    of_recordings = {
        "step_time_us.median",
        "step_time_us.p99",
        "lost_periods",
        "sampling_rate_hz.control",
        "sampling_rate_hz.oversampled",
    }
    assert set(KEYS) == {metric.key for metric in METRICS} - of_recordings


def test_a_drive_that_runs_away_is_a_row_without_figures_and_spoils_no_other():
    wanted = scenario.changed(scenario.load("steady_750_2"), ["duration=0.2", "window_s=[0.1,0.2]"])
    good = drive_of(*wanted.node_parameters("mbpcc", 1))
    feather = good.plant_motor.model_copy(update={"J": 1e-8})
    bad = replace(good, plant={**good.plant, "load_torque": -1e4}, plant_motor=feather)
    batch = Batch(wanted.periods, wanted.window_s, wanted.pwm_frequency, 0)
    rows = batch.run([good, bad, good, bad])
    assert rows["ran_away"].tolist() == [False, True, False, True]
    assert np.isnan(rows["figures"][1]).all()
    assert bits.of(rows[0]) == bits.of(rows[2])
    assert bits.of(rows[1]) == bits.of(rows[3])


def test_what_was_set_up_before_is_the_same_as_set_up_anew():
    """Drives that begin alike but for the seed, with steps of the load in between."""
    wanted = scenario.changed(scenario.load("load_step"), ["duration=0.25", "window_s=[0.1,0.25]"])
    drives = []
    for seed, torque in ((1, 2.0), (2, 2.0), (3, 1.0), (1, 2.0), (1, 1.0)):
        plant, controller = wanted.node_parameters("mls_mfpcc", seed)
        drives.append(drive_of({**plant, "load_torque": torque}, controller))
    batch = Batch(wanted.periods, wanted.window_s, wanted.pwm_frequency, 0)
    anew = batch.run(drives)
    keyed = [
        replace(drive, plant_key=(drive.plant["load_torque"],), controller_key=("all",))
        for drive in drives
    ]
    assert bits.of(batch.run(keyed)) == bits.of(anew)
    assert bits.of(anew[0]) == bits.of(anew[3]) != bits.of(anew[1])

"""Scenario files: what they mean, and what is said of a bad one."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from mfpcc_controller import motor as nominal_motor
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.running import scenario
from mfpcc_experiments.running.configuration import configuration
from pmsm_sim import motor
from pmsm_sim.parameters import TABLE as PLANT
from pwm_node import schedule, yaml_files
from pwm_node.parameters import ParameterError

EXPERIMENTS = [
    "current_step",
    "dirty_drive",
    "load_step",
    "mismatch_a",
    "mismatch_b",
    "mismatch_c",
    "speed_step",
    "steady_1000_2",
    "steady_300_2",
    "steady_750_2",
    "steady_750_5",
]

GOOD = """\
description: Two steps
motor: seed_750
speed_rpm: 500
duration: 0.5
window_s: [0.1, 0.4]
plant:
  load_torque: 2
controller:
  mismatch.inductance: 0.5
schedule:
  - {at: 0.2, load_torque: 5, speed_ref_rpm: 750.0}
  - {at: 0.3, scheme: mfpcc, mls.e_0: 1.0e-5}
"""


def write(folder: Path, text: str) -> str:
    path = folder / "two_steps.yaml"
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_the_experiments_that_users_name_are_there(name: str) -> None:
    experiment = scenario.load(name)
    assert experiment.name == name
    assert experiment.description
    plant, controller = experiment.node_parameters("mls_mfpcc", 1)
    assert plant["noise.current_rms"] == 0.0245
    assert plant["oversampling"] == 20
    assert plant["periods"] == round(experiment.duration * 10_000)
    # 0.2 s at least, so that the slowest (20 Hz) gives four whole electrical periods; a step of the
    # current is over after a few ms
    shortest = 0.05 if name == "current_step" else 0.2
    assert experiment.window_s[1] - experiment.window_s[0] >= shortest - 1e-12
    assert controller["scheme"] == "mls_mfpcc"


def test_no_experiment_is_there_that_is_not_tested() -> None:
    assert sorted(yaml_files.available("experiments")) == EXPERIMENTS


@pytest.mark.parametrize(
    ("name", "ratios"),
    [("mismatch_a", (0.5, 0.1, 2.0)), ("mismatch_b", (2, 10, 0.7)), ("mismatch_c", (2, 1, 2))],
)
def test_mismatch_is_the_papers(name: str, ratios: tuple[float, float, float]) -> None:
    _, controller = scenario.load(name).node_parameters("mbpcc", 0)
    found = [controller[f"mismatch.{part}"] for part in ("inductance", "resistance", "flux")]
    assert found == list(ratios)


@pytest.mark.parametrize("name", ["ipmsm", "seed_750", "textbook_spmsm"])
def test_motor_files_serve_both_nodes_and_ask_for_no_more_than_the_inverter_has(name: str) -> None:
    machine = motor.load(name)
    assert machine.name == name
    nominal = nominal_motor.load(name).model_dump()
    assert nominal == {key: getattr(machine, key) for key in nominal}
    w_m = machine.n_p * machine.speed_max_rpm * math.pi / 30
    u_d = -w_m * machine.L_q * machine.i_max  # with i_d = 0
    u_q = machine.R_s * machine.i_max + w_m * machine.psi_f
    assert math.hypot(u_d, u_q) < machine.u_dc / math.sqrt(3)


def test_node_parameters_are_complete_and_each_goes_to_its_node(tmp_path: Path) -> None:
    two_steps = scenario.load(write(tmp_path, GOOD))
    assert two_steps.name == "two_steps"
    plant, controller = two_steps.node_parameters("mbpcc", 7)
    assert list(plant) == list(PLANT)
    assert list(controller) == list(CONTROLLER)
    assert plant["motor"] == controller["motor"] == "seed_750"
    assert plant["seed"] == 7
    assert plant["periods"] == 5000
    assert plant["initial_speed_rpm"] == controller["speed_ref_rpm"] == 500.0
    assert plant["load_torque"] == 2.0
    assert controller["scheme"] == "mbpcc"
    assert controller["mismatch.inductance"] == 0.5
    assert schedule.parse(plant["schedule"], PLANT, 1e-4) == [(2000, {"load_torque": 5.0})]
    assert schedule.parse(controller["schedule"], CONTROLLER, 1e-4) == [
        (2000, {"speed_ref_rpm": 750.0}),
        (3000, {"scheme": "mfpcc", "mls.e_0": 1e-5}),
    ]


def test_a_section_wins_over_the_common_speed(tmp_path: Path) -> None:
    text = GOOD.replace("load_torque: 2\n", "initial_speed_rpm: 0\n")
    plant, controller = scenario.load(write(tmp_path, text)).node_parameters("mbpcc", 0)
    assert plant["initial_speed_rpm"] == 0.0
    assert controller["speed_ref_rpm"] == 500.0


def test_a_parameter_of_both_nodes_is_set_for_each(tmp_path: Path) -> None:
    text = GOOD.replace("  load_torque: 2\n", "  fault.react: false\n  fault.overcurrent: 3\n")
    text = text.replace("mismatch.inductance: 0.5", "fault.overcurrent: 2")
    text = text.replace(
        "load_torque: 5,", "plant.fault.react: true, controller.fault.react: false,"
    )
    plant, controller = scenario.load(write(tmp_path, text)).node_parameters("mbpcc", 0)
    assert (plant["fault.react"], controller["fault.react"]) == (False, True)
    assert (plant["fault.overcurrent"], controller["fault.overcurrent"]) == (3.0, 2.0)
    assert schedule.parse(plant["schedule"], PLANT, 1e-4) == [(2000, {"fault.react": True})]
    assert schedule.parse(controller["schedule"], CONTROLLER, 1e-4)[0] == (
        2000,
        {"fault.react": False, "speed_ref_rpm": 750.0},
    )


def test_changes_are_checked_as_the_file_is_and_stored(tmp_path: Path) -> None:
    two_steps = scenario.load(write(tmp_path, GOOD))
    other = scenario.changed(two_steps, ["load_torque=3", "motor=ipmsm", "load_torque = 4"])
    assert (other.plant["load_torque"], other.motor) == (4.0, "ipmsm")
    assert other.changes == {"load_torque": 4.0, "motor": "ipmsm"}
    assert scenario.changed(two_steps, []) == two_steps
    more = scenario.changed(other, ["controller.fault.overcurrent=2"])
    assert more.controller["fault.overcurrent"] == 2.0
    assert more.changes == {**other.changes, "controller.fault.overcurrent": 2.0}
    stored = configuration(more, "mbpcc", "ros", 0)
    assert stored["scenario"]["changes"] == more.changes
    assert stored["parameters"]["pmsm_sim"]["load_torque"] == 4.0
    # a step later than the new end
    with pytest.raises(ParameterError, match=r"schedule\[1\].at"):
        scenario.changed(two_steps, ["duration=0.3", "window_s=[0.1, 0.2]"])


def test_it_is_the_same_after_being_stored_with_a_run(tmp_path: Path) -> None:
    two_steps = scenario.load(write(tmp_path, GOOD))
    assert scenario.Scenario.model_validate_json(two_steps.model_dump_json()) == two_steps


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("duration: 0.5\n", "", ["'duration'", "missing", "simulated time"]),
        ("duration: 0.5", "duration: long", ["'duration'", "number", "'long'"]),
        ("duration: 0.5", "duration: -1", ["'duration'", "greater than 0"]),
        ("duration: 0.5", "duration: .inf", ["'duration'"]),
        ("duration: 0.5", "duraton: 0.5", ["unknown key 'duraton'", "'duration'"]),
        ("motor: seed_750", "motor: seed_75", ["'motor'", "did you mean 'seed_750'"]),
        ("motor: seed_750", "motor: nowhere/m.yaml", ["'motor'", "nowhere/m.yaml", "no such file"]),
        ("[0.1, 0.4]", "[0.1, 0.9]", ["'window_s'", "0.5 s"]),
        ("[0.1, 0.4]", "[0.4, 0.1]", ["'window_s'", "start < end"]),
        ("[0.1, 0.4]", "[.nan, 0.4]", ["'window_s'"]),
        ("[0.1, 0.4]", "[0.1]", ["window_s"]),
        ("  load_torque: 2\n", "  load_torqe: 2\n", ["'plant'", "'load_torqe'", "'load_torque'"]),
        ("  load_torque: 2\n", "  load_torque: much\n", ["'plant'", "'load_torque'", "a number"]),
        ("  load_torque: 2\n", "  load_torque: 1e9\n", ["'plant'", "'load_torque'", "range"]),
        ("  load_torque: 2\n", "  i_q_ref: 2\n", ["'plant'", "move it to 'controller'"]),
        ("  load_torque: 2\n", "  seed: 2\n", ["'plant'", "--seed"]),
        ("  load_torque: 2\n", "  motor: ipmsm\n", ["'plant'", "top of the file"]),
        ("  load_torque: 2\n", "", ["'plant'"]),
        ("mismatch.inductance", "mismatch.inductanc", ["'mismatch.inductance'"]),
        ("mismatch.inductance", "dc_voltage", ["'controller'", "move it to 'plant'"]),
        ("mismatch.inductance: 0.5", "scheme: mbpcc", ["'controller'", "--scheme"]),
        ("load_torque: 5,", "load_torqu: 5,", ["'schedule[0]'", "did you mean 'load_torque'"]),
        ("load_torque: 5,", "oversampling: 5,", ["'schedule[0]'", "fixed at start"]),
        ("load_torque: 5,", "motor: ipmsm,", ["'schedule[0]'", "fixed at start"]),
        ("scheme: mfpcc", "scheme: mfpc", ["'schedule[1]'", "did you mean 'mfpcc'"]),
        ("load_torque: 5,", "fault.react: false,", ["'plant.fault.react'", "both nodes"]),
        ("load_torque: 5,", "plant.fault.reactt: true,", ["did you mean 'fault.react'"]),
        ("  load_torque: 2\n", "  plant.load_torque: 2\n", ["here it is 'load_torque'"]),
        ("  load_torque: 2\n", "  recorders: 2\n", ["'recorders' is set by what records"]),
        ("mismatch.inductance", "mismatch.L", ["did you mean 'mismatch.inductance'"]),
        ("duration: 0.5", "changes: {duration: 0.4}\nduration: 0.5", ["not for files"]),
        ("at: 0.2", "at: 0.5", ["'schedule[0].at'", "0 to 0.5 s"]),
        ("at: 0.2", "at: soon", ["'schedule[0]'", "at: SECONDS"]),
        ("at: 0.2, ", "", ["'schedule[0]'", "at: SECONDS"]),
        ("load_torque: 5, speed_ref_rpm: 750.0", "", ["'schedule[0]'", "changes nothing"]),
        ("  - {at: 0.2", "  {at: 0.2", ["line"]),
    ],
)
def test_a_bad_file_is_told_file_key_and_what_is_expected(
    tmp_path: Path, old: str, new: str, said: list[str]
) -> None:
    assert GOOD.count(old) == 1
    path = write(tmp_path, GOOD.replace(old, new))
    with pytest.raises(yaml_files.FileError) as caught:
        scenario.load(path)
    for words in [path, *said]:
        assert words in str(caught.value)


def test_an_unknown_experiment_is_told_the_nearest() -> None:
    with pytest.raises(yaml_files.FileError, match="did you mean 'steady_750_2'"):
        scenario.load("steady_752_2")


def test_an_unknown_scheme_is_told_the_nearest() -> None:
    with pytest.raises(ParameterError, match="did you mean 'mbpcc'"):
        scenario.load("load_step").node_parameters("mbpc", 0)

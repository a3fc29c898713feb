"""The node `replay`: recorded samples answered by a live controller."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from harness import Process

from mfpcc_experiments.bags import recording
from mfpcc_experiments.graph.replayer import write_parameters
from mfpcc_experiments.running import run
from mfpcc_experiments.running.scenario import Scenario

Start = Callable[..., Process]

PERIODS = 400


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with a change of the load, of the scheme and of its model."""
    folder = tmp_path_factory.mktemp("recorded")
    scenario = Scenario.model_validate(
        {
            "name": "short",
            "motor": "seed_750",
            "speed_rpm": 500.0,
            "duration": PERIODS * 1e-4,
            "window_s": [0.0, PERIODS * 1e-4],
            "plant": {"load_torque": 2.0, "noise.current_rms": 0.0245, "oversampling": 2},
            "schedule": [
                {"at": 0.01, "load_torque": 4.0},
                {"at": 0.02, "scheme": "mfpcc"},
                {"at": 0.03, "scheme": "mls_mfpcc", "mismatch.inductance": 2.0},
            ],
        }
    )
    run.run(scenario, "mls_mfpcc", "inprocess", folder, 3, lambda done: None)
    return folder / "mls_mfpcc"


@pytest.fixture(scope="module")
def parameters(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recorded parameters of the controller, for `--params-file`."""
    path = tmp_path_factory.mktemp("parameters") / "controller.yaml"
    write_parameters(recording.read(bag), path)
    return path


def controller(start: Start, *arguments: str) -> Process:
    return start("mfpcc_controller", "controller", "--ros-args", *arguments)


def test_a_controller_with_the_recorded_parameters_gives_the_recorded_commands(
    start: Start, bag: Path, parameters: Path, tmp_path: Path
) -> None:
    answering = controller(start, "--params-file", str(parameters), "-p", "recorders:=1")
    again = tmp_path / "again"
    recorder = start("mfpcc_experiments", "record", "--out", str(again))
    replay = start("mfpcc_experiments", "replay", str(bag), "--ros-args", "-p", "recorders:=1")
    assert replay.wait() == 0
    assert f"all {PERIODS} commands equal the recorded ones" in replay.output, replay.output
    answering.signal(signal.SIGINT)
    assert answering.wait() == 0
    recorder.signal(signal.SIGINT)
    assert recorder.wait() == 0, recorder.output
    one, other = recording.read(bag), recording.read(again)
    for topic in ("feedback", "lut", "state"):
        assert (getattr(one, topic) == getattr(other, topic)).all(), topic
    assert (one.i_abc_oversampled == other.i_abc_oversampled).all()
    # after the last sample, the controller that is stopped sends a command that blocks the gates
    assert (one.command == other.command[:PERIODS]).all()


def test_another_scheme_answers_otherwise_and_the_first_difference_is_told(
    start: Start, bag: Path, parameters: Path
) -> None:
    controller(start, "--params-file", str(parameters), "-p", "mls.start:=empty")
    replay = start("mfpcc_experiments", "replay", str(bag))
    assert replay.wait() == 0
    assert "commands are not the recorded ones, first that of period" in replay.output


def test_paced_it_waits_for_nobody_but_for_the_first_and_the_last_answer(
    start: Start, bag: Path, parameters: Path
) -> None:
    controller(start, "--params-file", str(parameters))
    replay = start("mfpcc_experiments", "replay", str(bag), "--rate", "0.02")
    assert replay.wait() == 0
    assert f"{PERIODS} of {PERIODS} samples replayed" in replay.output


def test_nobody_answers(start: Start, bag: Path) -> None:
    replay = start("mfpcc_experiments", "replay", str(bag), "--patience", "1")
    assert replay.wait() == 1
    assert "giving up" in replay.output
    assert "ros2 run mfpcc_controller controller" in replay.output


def test_what_is_no_recording_is_told(start: Start, tmp_path: Path) -> None:
    replay = start("mfpcc_experiments", "replay", str(tmp_path))
    assert replay.wait() == 1
    assert "no recording here" in replay.output
    assert "Traceback" not in replay.output

"""The same run gives the same messages: twice, in either engine, in one process or two."""

from __future__ import annotations

from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader

from mfpcc_experiments.bags import recording
from mfpcc_experiments.measuring import replay
from mfpcc_experiments.running import run
from mfpcc_experiments.running.scenario import Scenario

TOPICS = ("/phase_feedback", "/duty_command", "/lut_diagnostics", "/drive_state")


def scenario() -> Scenario:
    return Scenario.model_validate(
        {
            "name": "short",
            "motor": "seed_750",
            "speed_rpm": 500.0,
            "duration": 0.06,
            "window_s": [0.0, 0.06],
            "plant": {"load_torque": 2.0, "noise.current_rms": 0.0245, "oversampling": 4},
            "schedule": [
                {"at": 0.02, "load_torque": 4.0, "speed_ref_rpm": 700.0},
                {"at": 0.03, "scheme": "mfpcc"},
                {"at": 0.04, "scheme": "mls_mfpcc", "mismatch.inductance": 2.0},
            ],
        }
    )


def messages(bag: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Log time and serialized message of each topic, in order, without padding at the end."""
    found: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in TOPICS}
    with Reader(bag) as reader:
        for connection, time, data in reader.messages():
            # between processes DDS pads a message to a multiple of four bytes
            found[connection.topic].append((time, bytes(data).rstrip(b"\x00")))
    return found


def recorded(
    folder: Path, engine: str, seed: int = 3, plan: Scenario | None = None, **options: bool
) -> dict[str, list[tuple[int, bytes]]]:
    run.run(plan or scenario(), "mls_mfpcc", engine, folder, seed, lambda done: None, **options)
    return messages(folder / "mls_mfpcc")


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[int, bytes]]]:
    return recorded(tmp_path_factory.mktemp("inprocess"), "inprocess")


def test_the_engine_records_every_period(reference: dict[str, list]) -> None:
    assert {topic: len(found) for topic, found in reference.items()} == dict.fromkeys(TOPICS, 600)


def test_graph_and_engine_agree(reference: dict[str, list], tmp_path: Path) -> None:
    _same(recorded(tmp_path, "ros"), reference)


def test_two_runs_on_the_graph_agree(tmp_path: Path) -> None:
    _same(recorded(tmp_path / "one", "ros"), recorded(tmp_path / "two", "ros"))


def test_two_processes_agree_with_one(reference: dict[str, list], tmp_path: Path) -> None:
    _same(recorded(tmp_path, "ros", separate=True), reference)
    _changes_are_kept(tmp_path / "mls_mfpcc")


def test_graph_and_engine_agree_on_decimated_topics(tmp_path: Path) -> None:
    plan = scenario().model_copy(
        update={"plant": {"state_decimation": 10}, "controller": {"diagnostics_decimation": 7}}
    )
    graph = recorded(tmp_path / "graph", "ros", plan=plan)
    _same(graph, recorded(tmp_path / "engine", "inprocess", plan=plan))
    assert [len(graph[topic]) for topic in TOPICS] == [600, 600, 86, 60]


def test_changes_of_parameters_are_kept_in_the_recording(tmp_path: Path) -> None:
    recorded(tmp_path, "ros")
    _changes_are_kept(tmp_path / "mls_mfpcc")


def test_another_seed_is_another_run(reference: dict[str, list], tmp_path: Path) -> None:
    other = recorded(tmp_path, "inprocess", seed=4)
    assert other["/phase_feedback"] != reference["/phase_feedback"]


def _same(one: dict[str, list], other: dict[str, list]) -> None:
    for topic in TOPICS:
        assert len(one[topic]) == len(other[topic]), topic
        for k, (a, b) in enumerate(zip(one[topic], other[topic], strict=True)):
            assert a == b, f"{topic}, message {k}"


def _changes_are_kept(bag: Path) -> None:
    """Each with its period, so that the recording's own scheme gives its commands again."""
    changes = recording.read(bag).summary["parameter_changes"]
    told = {(c["period"], c["node"], c["name"], c["value"]) for c in changes}
    assert told == {
        (200, "pmsm_sim", "load_torque", 4.0),
        (200, "mfpcc_controller", "speed_ref_rpm", 700.0),
        (300, "mfpcc_controller", "scheme", "mfpcc"),
        (400, "mfpcc_controller", "scheme", "mls_mfpcc"),
        (400, "mfpcc_controller", "mismatch.inductance", 2.0),
    }
    samples = replay.Samples(recording.read(bag))
    replay.require_same(samples, replay.verify(samples))

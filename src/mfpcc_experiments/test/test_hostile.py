"""Recordings of strangers: one line or figures, whatever stands in them or in their place."""

from __future__ import annotations

import copy
import json
import os
import shutil
import socket
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
from hypothesis import HealthCheck, example, settings
from hypothesis import strategies as st
from mfpcc_msgs import msg
from synthetic_drive import Message, messages

from mfpcc_experiments import cli
from mfpcc_experiments.bags import BagWriter, recording
from mfpcc_experiments.measuring import metrics, replay, replay_summary
from mfpcc_experiments.running import scenario
from mfpcc_experiments.running.configuration import configuration
from pwm_node.errors import ForPeople
from pwm_node.parameters import ParameterError
from pwm_node.wire import Wire

MESSAGES = list(messages(300))
CONFIG = configuration(scenario.load("steady_750_2"), "mls_mfpcc", "inprocess", 1)
CONFIG["window_s"] = [0.0, 0.03]
SUMMARY = {
    "step_time_us": {"median": 3.0, "p99": 9.0},
    "parameter_changes": [
        {"period": 100, "node": "pmsm_sim", "name": "load_torque", "value": 3.0},
        {"period": 120, "node": "mfpcc_controller", "name": "speed_ref_rpm", "value": 800.0},
    ],
    "faults": [{"node": "pmsm_sim", "code": "OVERCURRENT", "period": 90, "detail": "13 A"}],
    "real_time_factor": {"asked": 1.0, "achieved": 0.9},
    "missed_periods": 3,
}

Place = tuple[str | int, ...]


def places(tree: Any, at: Place = ()) -> Iterator[Place]:
    items: Any = tree.items() if isinstance(tree, Mapping) else enumerate(tree)
    for key, value in items:
        yield (*at, key)
        if isinstance(value, (Mapping, list)):
            yield from places(value, (*at, key))


def changed(tree: Any, place: Place, value: Any) -> Any:
    tree = copy.deepcopy(tree)
    inner = tree
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    return tree


ODD = [
    1e-300, 1e300, float("inf"), float("-inf"), float("nan"), 0, -1, 0.5, 1 << 63, 10**400, "",
    "text", "two\nlines", "x" * 1_000_000, None, True, [], [[]], {}, {"a": {"b": 1}}, [1, 2, 3],
    [float("inf")] * 2, [0.2, 0.1], "../../../../etc/passwd", "/dev/zero", "/etc/passwd",
]  # fmt: skip
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=6,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("hostile")


def written(path: Path, config: Any, summary: Any, source: list[Message] = MESSAGES) -> Path:
    shutil.rmtree(path, ignore_errors=True)
    with BagWriter(path, config=config) as bag:
        for message in source:
            bag.write(*message)
        bag.close(summary)
    return path


def judge(path: Path) -> list[str]:
    """Measure and replay a recording; returns what was refused, in lines for people."""
    said = []
    try:
        found = recording.read(path)
    except ForPeople as error:
        return [str(error)]
    try:
        row = metrics.evaluate(found)
        text = json.dumps(row, allow_nan=False)
        assert len(text) < 50_000
        assert "root:" not in text
    except ForPeople as error:
        said.append(str(error))
    try:
        samples = replay.Samples(found)
        if not samples.why_not_verifiable:
            replay.verify(samples)
        replay_summary.summary(samples, replay.replay(samples, "mbpcc"))
    except (ForPeople, ParameterError) as error:
        said.append(str(error))
    for line in said:
        assert line and len(line) < 1_000 and "\n" not in line, line
        assert "root:" not in line
    return said


SETTINGS = settings(
    max_examples=25,
    deadline=None,
    derandomize=True,  # a run that fails fails again
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@SETTINGS
@hypothesis.given(place=st.sampled_from(list(places(CONFIG))), value=st.sampled_from(ODD) | JSON)
@example(("T_s",), 1e-300)
@example(("n_p",), 10**400)
@example(("R_s",), 0)
@example(("window_s",), [float("inf")] * 2)
@example(("scheme",), "x" * 1_000_000)
@example(("parameters",), "text")
@example(("parameters", "mfpcc_controller", "motor"), "../../../../etc/passwd")
@example(("parameters", "mfpcc_controller", "schedule"), [1, 2, 3])
@example(("parameters", "pmsm_sim", "drift.temperature"), "text")
def test_a_configuration_with_anything_in_it(folder: Path, place: Place, value: Any) -> None:
    judge(written(folder / "bag", changed(CONFIG, place, value), SUMMARY))


@SETTINGS
@hypothesis.given(place=st.sampled_from(list(places(SUMMARY))), value=st.sampled_from(ODD) | JSON)
@example(("parameter_changes", 0, "period"), "text")
@example(("faults",), [{}])
@example(("real_time_factor", "asked"), "text")
def test_a_summary_with_anything_in_it(folder: Path, place: Place, value: Any) -> None:
    judge(written(folder / "bag", CONFIG, changed(SUMMARY, place, value)))


TYPES = {
    "phase_feedback": msg.PhaseFeedback,
    "duty_command": msg.DutyCommand,
    "lut_diagnostics": msg.LutDiagnostics,
    "drive_state": msg.DriveState,
}
FIELDS = [
    (topic, name)
    for topic, kind in TYPES.items()
    for name, (dtype, _) in Wire(kind).fixed.dtype.fields.items()
    if dtype.base.kind == "f"
]


def spoilt(topic: str, name: str, value: float, rows: set[int]) -> list[Message]:
    wire = Wire(TYPES[topic])
    found = []
    for n, (at_topic, time, data) in enumerate(MESSAGES):
        content = data
        if at_topic == topic and n // 4 in rows:
            wire.load(data)
            wire.fixed[name] = value
            content = wire.to_bytes()
        found.append((at_topic, time, content))
    return found


@pytest.mark.parametrize(("topic", "name"), FIELDS)
def test_a_field_that_is_no_number_a_drive_can_have(topic: str, name: str, folder: Path) -> None:
    whole = given(metrics.evaluate(recording.read(written(folder / "bag", CONFIG, {}))))
    for value, rows in ((np.nan, {150}), (np.inf, set(range(300))), (1e308, {150})):
        path = written(folder / "bag", CONFIG, {}, spoilt(topic, name, value, rows))
        judge(path)
        row = metrics.evaluate(recording.read(path))
        gone = whole - given(row)
        told = " ".join(note["text"] for note in row["notes"])
        reasons = ("is no number that a drive can have", "not steady (")
        assert not gone or any(reason in told for reason in reasons), (value, gone, told)


def given(row: Any, at: tuple[str, ...] = ()) -> set[tuple[str, ...]]:
    """The figures that are given."""
    if not isinstance(row, dict):
        return set() if row is None else {at}
    return {place for key, value in row.items() for place in given(value, (*at, key))}


@pytest.fixture(scope="module")
def strange(folder: Path) -> dict[str, Path]:
    """What may stand in the place of a file: nothing that can be read to its end."""
    found = {}
    for suffix in (".mcap", ".yaml"):
        os.mkfifo(folder / f"fifo{suffix}")
        listening = socket.socket(socket.AF_UNIX)
        listening.bind(str(folder / f"socket{suffix}"))
        listening.close()
        (folder / f"device{suffix}").symlink_to("/dev/zero")
        (folder / f"itself{suffix}").symlink_to(folder / f"itself{suffix}")
        (folder / f"folder{suffix}").mkdir()
        (folder / f"folder{suffix}" / "again").symlink_to(folder / f"folder{suffix}")
        found |= {
            f"{kind}{suffix}": folder / f"{kind}{suffix}"
            for kind in ("fifo", "socket", "device", "itself", "folder")
        }
    return found


VERBS: dict[str, list[str]] = {
    ".mcap": [
        "compare {file} --out {out}",
        "replay {file} --scheme mbpcc --out {out}",
        "export {file} --format csv",
        "recover {file}",
    ],
    ".yaml": ["run {file} --engine inprocess --out {out}"],
}


@pytest.mark.parametrize("kind", ["fifo", "socket", "device", "itself", "folder"])
@pytest.mark.parametrize("verb", [verb for verbs in VERBS.values() for verb in verbs])
def test_what_is_no_file(
    kind: str,
    verb: str,
    strange: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    suffix = ".mcap" if verb in VERBS[".mcap"] else ".yaml"
    words = verb.format(file=strange[kind + suffix], out=tmp_path / "out").split()
    assert cli.run(words) in (1, 2)
    said = [line for line in capsys.readouterr().err.splitlines() if "mfpcc: " in line]
    assert len(said) == 1 and "this is a bug" not in said[0], said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("verb", VERBS[".mcap"])
def test_a_hostile_recording_is_one_line_for_every_verb(
    verb: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its encoder told nothing now and then, and the true angle is not in it."""
    monkeypatch.chdir(tmp_path)
    config = changed(CONFIG, ("parameters", "mfpcc_controller", "motor"), "../../../etc/passwd")
    config |= {"scheme": "x" * 1_000_000, "T_s": 1e-300, "n_p": 10**400}
    spoilt_by = spoilt("phase_feedback", "encoder_angle", np.nan, {150})
    source = [message for message in spoilt_by if message[0] != "drive_state"]
    path = written(tmp_path / "bag", config, SUMMARY, source)
    code = cli.run(verb.format(file=path, out=tmp_path / "out").split())
    said = capsys.readouterr()
    assert code in (0, 1, 3) and "this is a bug" not in said.err, said.err
    assert len(said.out + said.err) < 30_000 and "root:" not in said.out + said.err

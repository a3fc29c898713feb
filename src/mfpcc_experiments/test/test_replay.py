"""Replay off the graph: recordings are reproduced exactly, and schemes told what really acted."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mfpcc_controller.parameters import SCHEMES
from mfpcc_experiments import cli
from mfpcc_experiments.bags import Recording, recording
from mfpcc_experiments.measuring import replay, replay_summary
from mfpcc_experiments.notes import NOT_AS_ASKED
from mfpcc_experiments.running import run
from mfpcc_experiments.running.scenario import Scenario

PERIODS = 600


def scenario(**changes: Any) -> Scenario:
    return Scenario.model_validate(
        {
            "name": "short",
            "motor": "seed_750",
            "speed_rpm": 500.0,
            "duration": PERIODS * 1e-4,
            "window_s": [0.02, PERIODS * 1e-4],
            "plant": {"load_torque": 2.0, "noise.current_rms": 0.0245},
            "schedule": [{"at": 0.03, "load_torque": 4.0, "speed_ref_rpm": 600.0}],
            **changes,
        }
    )


def record(folder: Path, scheme: str, **changes: Any) -> Path:
    run.run(scenario(**changes), scheme, "inprocess", folder, 3, lambda done: None)
    return folder / scheme


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Recordings of the schemes, made when they are asked for."""
    folder = tmp_path_factory.mktemp("bags")

    def bag(scheme: str) -> Path:
        return folder / scheme if (folder / scheme).exists() else record(folder, scheme)

    return bag


def changed(read: Recording, name: str, rows: Any) -> Recording:
    """A recording with another array."""
    return dataclasses.replace(read, **{name: rows})


# --- As recorded --------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_scheme_gives_its_recorded_commands_again(
    bags: Callable[[str], Path], scheme: str
) -> None:
    read = recording.read(bags(scheme))
    samples = replay.Samples(read)
    assert samples.why_not_verifiable == ""
    own = replay.verify(samples)
    replay.require_same(samples, own)
    assert not own.differs.any() and samples.answered.all()
    assert (own.error == read.lut["prediction_error"]).all()
    # that it is told what acted anyway makes no difference
    told = replay.replay(samples, scheme)
    assert not told.differs.any()
    assert (told.error == own.error).all()


def test_switches_of_scheme_and_model_are_reproduced(tmp_path: Path) -> None:
    switches = [
        {"at": 0.02, "scheme": "mfpcc"},
        {"at": 0.03, "scheme": "pi_foc", "mismatch.inductance": 2.0},
        {"at": 0.04, "scheme": "mls_mfpcc", "mls.window": 8},
    ]
    samples = replay.Samples(recording.read(record(tmp_path, "mbpcc", schedule=switches)))
    replay.require_same(samples, replay.verify(samples))
    # a scheme that is named answers throughout
    row = replay_summary.summary(samples, replay.replay(samples, "mbpcc"))
    assert row["first_difference"] == 201


def test_the_first_command_that_is_not_reproduced_is_named(bags: Callable[[str], Path]) -> None:
    read = recording.read(bags("mls_mfpcc"))
    command = read.command.copy()
    command["duty"][99, 1] += 1e-6
    command["duty"][300, 0] -= 0.1
    samples = replay.Samples(changed(read, "command", command))
    with pytest.raises(replay.ReplayError, match=r"2 of 600 differ, first that of period 100 "):
        replay.require_same(samples, replay.verify(samples))


def test_a_change_of_the_scheme_is_found(bags: Callable[[str], Path]) -> None:
    read = recording.read(bags("mls_mfpcc"))
    samples = replay.Samples(read, {"mismatch.inductance": 2.0})
    with pytest.raises(replay.ReplayError, match="has changed since"):
        replay.require_same(samples, replay.verify(samples))


# --- Told what acted ----------------------------------------------------------------------------


@pytest.mark.parametrize("recorded", ["mls_mfpcc", "mfpcc"])
def test_predictions_are_about_the_output_that_acted(
    bags: Callable[[str], Path], recorded: str
) -> None:
    """The true model predicts to noise whatever the recorded scheme did; its own choice did not."""
    samples = replay.Samples(recording.read(bags(recorded)))
    rows = {
        s: replay_summary.summary(samples, replay.replay(samples, s)) for s in ("mbpcc", "pi_foc")
    }
    for row in rows.values():
        # two samples' noise of 20 mA rms each, and the model's own error
        assert 0.025 < row["lut_error_rms"]["d"] < 0.040
        assert 0.025 < row["lut_error_rms"]["q"] < 0.040
        assert row["duty_difference_max"] > 0.0
    untold = samples.feed("pi_foc", tell=False)
    assert np.abs(untold.error).max() > 0.4


def test_the_scheme_that_is_asked_answers_however_badly_it_predicts(
    bags: Callable[[str], Path],
) -> None:
    """In the drive, protection and fallback would end this."""
    wrong = {"mismatch.inductance": 0.02, "fault.prediction_error": 0.01}
    samples = replay.Samples(recording.read(bags("mls_mfpcc")), wrong)
    result = replay.replay(samples, "mbpcc")
    assert np.abs(result.error[-50:]).max() > 5.0
    assert not result.fell_back
    assert (result.duty[-50:] > 0.0).any()


def test_summary_of_a_known_difference(bags: Callable[[str], Path]) -> None:
    read = recording.read(bags("mls_mfpcc"))
    samples = replay.Samples(read)
    own = replay.replay(samples, "mls_mfpcc")
    duty, differs = own.duty.copy(), own.differs.copy()
    duty[400:, 0] += 0.03  # 2/3 of it, times 311 V, in the mean voltage
    differs[400:] = True
    row = replay_summary.summary(
        samples, dataclasses.replace(own, duty=duty, differs=differs), (0.0, 0.06)
    )
    assert row["first_difference"] == 401
    assert row["duty_difference_max"] == pytest.approx(0.03)
    assert row["same_commands_percent"] == pytest.approx(100.0 * 400 / 600)
    assert row["voltage_difference_rms"] == pytest.approx(
        2.0 / 3.0 * 0.03 * 311.0 * np.sqrt(1.0 / 3.0)
    )
    assert row["samples"] == 600


def test_a_recording_that_begins_late_or_has_gaps(bags: Callable[[str], Path]) -> None:
    read = recording.read(bags("mfpcc"))
    rows = np.r_[50:200, 260:600]
    part = dataclasses.replace(
        read,
        feedback=read.feedback[rows],
        command=read.command[rows],
        lut=read.lut[rows],
        lost_periods=60,
    )
    samples = replay.Samples(part)
    assert "begins with period 50" in samples.why_not_verifiable
    error = replay.replay(samples, "mbpcc").error
    assert np.abs(error).max() < 0.2  # none where it begins, none behind the gap
    assert (error[0] == 0.0).all()


def test_duties_count_where_vectors_are_not_told_or_wrong(bags: Callable[[str], Path]) -> None:
    read = recording.read(bags("mls_mfpcc"))
    error = replay.replay(replay.Samples(read), "mbpcc").error
    for vectors, dwell in ((0, 0.0), (255, 0.5)):
        command = read.command.copy()
        command["vectors"], command["dwell"] = vectors, dwell
        samples = replay.Samples(changed(read, "command", command))
        assert replay.replay(samples, "mbpcc").error == pytest.approx(error, abs=1e-12)
    command["duty"][7] = np.nan
    with pytest.raises(replay.ReplayError, match=r"not within 0\.\.1"):
        replay.Samples(changed(read, "command", command))


def test_a_bag_without_configuration_needs_a_motor(bags: Callable[[str], Path]) -> None:
    read = recording.read(bags("mls_mfpcc"))
    bare = dataclasses.replace(read, config={}, summary={})
    with pytest.raises(replay.ReplayError, match="--set motor=NAME"):
        replay.Samples(bare)
    samples = replay.Samples(bare, {"motor": "seed_750"})
    assert "no parameters" in samples.why_not_verifiable
    row = replay_summary.summary(samples, replay.replay(samples, "mbpcc"))
    assert row["lut_error_max"]["q"] < 0.3
    assert row["window_s"] == [0.0, pytest.approx(0.06)]


# --- The verb -----------------------------------------------------------------------------------


def test_the_verb(
    bags: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    line = ["replay", str(bags("mls_mfpcc")), "--out", str(out), "--scheme", "mbpcc"]
    assert cli.run([*line, "--scheme", "mls_mfpcc"]) == 0
    printed = capsys.readouterr().out
    assert "reproduced: mls_mfpcc gives its 600 recorded commands again, exactly" in printed
    assert "recorded (mls_mfpcc)" in printed
    rows = json.loads((out / "metrics.json").read_text())
    assert [row["scheme"] for row in rows] == ["mbpcc", "mls_mfpcc"]
    assert rows[1]["same_commands_percent"] == 100.0 and rows[1]["first_difference"] is None
    assert (out / "replay.png").read_bytes()[1:4] == b"PNG"
    assert cli.run(line) == 1
    assert "--force" in capsys.readouterr().err


def test_what_the_figures_leave_out_is_an_error_if_one_is_strict(
    bags: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "bag"
    shutil.copytree(bags("mbpcc"), bag)
    (bag / "stray.mcap").write_bytes(b"")
    line = ["replay", str(bag), "--out", str(tmp_path / "out"), "--scheme", "mbpcc", "--force"]
    assert cli.run(line) == 0
    assert "stray.mcap in the folder is not a part of the bag" in capsys.readouterr().out
    assert cli.run([*line, "--strict"]) == NOT_AS_ASKED


def test_the_verb_fails_where_the_recording_is_not_reproduced(
    bags: Callable[[str], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    read = recording.read(bags("mfpcc"))
    read.config["parameters"]["mfpcc_controller"]["mfpcc.u_min"] = 150.0
    monkeypatch.setattr(recording, "read", lambda path, **options: read)
    line = ["replay", "bag", "--out", str(tmp_path / "out"), "--scheme", "mfpcc", "--force"]
    assert cli.run(line) == 1
    said = capsys.readouterr()
    assert "mfpcc does not give its recorded commands again" in said.err
    assert "Traceback" not in said.err
    # what it would do now is there to be looked at
    assert (tmp_path / "out/replay.png").is_file()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--scheme mls_mfpc", "did you mean 'mls_mfpcc'"),
        ("--set mls.windo=3", "did you mean 'mls.window'"),
        ("--set mls.window=100", "out of range"),
        ("--set mls.window", "NAME=VALUE is expected"),
        ("--set scheme=mfpcc", "--scheme"),
    ],
)
def test_a_command_line_that_makes_no_sense(
    options: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["replay", "bag", "--out", str(tmp_path / "o"), *options.split()]) == 2
    assert said in capsys.readouterr().err

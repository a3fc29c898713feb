"""The black box of a real drive: one in its process, and one in a recorder beside it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import yaml
from harness import Process
from rosbags.rosbag2 import Reader

from mfpcc_experiments import cli
from mfpcc_experiments.bags import recording
from mfpcc_experiments.measuring import replay
from mfpcc_experiments.running import run
from mfpcc_experiments.running.scenario import Scenario

Start = Callable[..., Process]

SEED = 3


def scenario(periods: int) -> Scenario:
    """The encoder stands still from 0.25 s on."""
    return Scenario.model_validate(
        {
            "name": "faulty",
            "motor": "seed_750",
            "speed_rpm": 750.0,
            "duration": periods * 1e-4,
            "window_s": [0.0, periods * 1e-4],
            "plant": {
                "load_torque": 2.0,
                "noise.current_rms": 0.0245,
                "fault_injection": True,
                "injections": ["0.25 1.0 encoder stuck"],
            },
            "controller": {"speed_ref_rpm": 750.0},
            "schedule": [{"at": 0.01, "load_torque": 2.5}, {"at": 0.2, "load_torque": 3.0}],
        }
    )


def start_drive(start: Start, folder: Path, periods: int, *more: str) -> Process:
    """`drive` with the parameters that the engine in process has."""
    plant, controller = scenario(periods).node_parameters("mls_mfpcc", SEED)
    content = {
        name: {"ros__parameters": {key: value for key, value in own.items() if value != []}}
        for name, own in (("/pmsm_sim", plant), ("/mfpcc_controller", controller))
    }
    file = folder / "parameters.yaml"
    file.write_text(yaml.safe_dump(content))
    extra = [part for value in more for part in ("-p", value)]
    return start("mfpcc_experiments", "drive", "--ros-args", "--params-file", str(file), *extra)


def messages(bag: Path, topic: str) -> dict[int, bytes]:
    """Messages of a topic by log time, without padding at the end."""
    with Reader(bag) as reader:
        return {
            time: bytes(data).rstrip(b"\x00")
            for connection, time, data in reader.messages()
            if connection.topic == topic
        }


def test_it_holds_what_a_full_recording_holds(start: Start, tmp_path: Path) -> None:
    """Both boxes: the same messages, bit for bit, as of a run of the same scenario in process."""
    periods = 4000
    here, beside = tmp_path / "here", tmp_path / "beside"
    recorder = start("mfpcc_experiments", "record", "--black-box", str(beside))
    drive = start_drive(start, tmp_path, periods, "recorders:=1", f"black_box:={here}")
    run.run(scenario(periods), "mls_mfpcc", "inprocess", tmp_path, SEED, lambda done: None)
    assert drive.wait() == 0, drive.output
    recorder.wait_for("black box: ENCODER in period")

    for directory in (here, beside):
        (page,) = yaml.safe_load((directory / "trips.yaml").read_text())
        assert (page["code"], page["node"]) == ("ENCODER", "mfpcc_controller")
        fault = page["period"]
        assert 2500 < fault < 2600
        bag = directory / page["bag"]
        for topic in ("/phase_feedback", "/duty_command", "/lut_diagnostics", "/drive_state"):
            full = messages(tmp_path / "mls_mfpcc", topic)
            window = {
                time: data
                for time, data in full.items()
                if fault - 2000 <= time // 100_000 <= fault + 1000
            }
            assert len(window) == 3001
            assert messages(bag, topic) == window, (directory.name, topic)
        assert len(messages(bag, "/drive_status")) >= 2
        found = recording.read(bag)
        if directory is here:  # a recorder asks for the parameters, and may get them later
            assert found.config["parameters"]["pmsm_sim"]["load_torque"] == 2.5
        (change,) = found.summary["parameter_changes"]
        assert (change["period"], change["value"]) == (2000, 3.0)

    out = tmp_path / "report"
    # the gates are off from the fault on, which is a failure of the drive
    assert cli.run(["compare", str(bag), "--out", str(out)]) == 3
    assert (out / "report.html").exists() and (out / "figures" / "i_dq.png").exists()
    samples = replay.Samples(found)
    error = replay.replay(samples, "mbpcc").error
    assert abs(error[100:1900]).max() < 0.5


def test_a_directory_that_cannot_be_written_costs_one_line(start: Start, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    directory = tmp_path / "file" / "box"
    drive = start_drive(start, tmp_path, 2800, f"black_box:={directory}")
    assert drive.wait() == 0, drive.output
    lines = [line for line in drive.output.splitlines() if "black_box" in line]
    assert len(lines) == 1, drive.output
    assert "the drive goes on" in lines[0] and "Not a directory" in lines[0]

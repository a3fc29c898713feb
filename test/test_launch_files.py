"""`ros2 launch`: the drive as one process and as two, recorded whole; two axes side by side."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
from pathlib import Path

import pytest
from harness import PATIENCE, Process

from mfpcc_experiments.bags.recording import read

ROS2 = shutil.which("ros2")
PERIODS = 2000

pytestmark = pytest.mark.skipif(ROS2 is None, reason="needs `source setup.bash`")


def launch(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(ROS2), "launch", "mfpcc_experiments", *arguments],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """A parameter file with which a run ends by itself."""
    file = tmp_path / "short.yaml"
    file.write_text(
        f"/**/pmsm_sim: {{ros__parameters: {{periods: {PERIODS}}}}}\n"
        "/**/mfpcc_controller: {ros__parameters: {speed_ref_rpm: 500.0}}\n"
    )
    return file


@pytest.mark.parametrize("file", ["drive.launch.py", "two_axes.launch.py"])
def test_arguments_are_described(file: str) -> None:
    outcome = launch(file, "--show-args")
    assert outcome.returncode == 0, outcome.stderr
    arguments = re.findall(r"^    '([\w.]+)':\n        (.+)$", outcome.stdout, re.MULTILINE)
    assert len(arguments) > 8
    assert all(len(description) > 20 for _, description in arguments)


@pytest.mark.parametrize(
    ("argument", "reason"),
    [
        ("scheme:=mbpc", "unknown scheme 'mbpc'; did you mean 'mbpcc'?"),
        ("load_torque:=much", "'load_torque' = 'much' has the wrong type"),
        ("composed:=maybe", "Valid options are: ['true', 'false']"),
        ("parameters:=/nope.yaml", "/nope.yaml: no such parameter file"),
    ],
)
def test_bad_argument_is_refused_before_anything_starts(argument: str, reason: str) -> None:
    outcome = launch("drive.launch.py", argument)
    assert outcome.returncode == 1
    assert reason in outcome.stdout + outcome.stderr
    assert "process started" not in outcome.stdout


@pytest.mark.parametrize("composed", ["true", "false"])
def test_drive_is_recorded_whole(composed: str, short: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    outcome = launch(
        "drive.launch.py",
        f"composed:={composed}",
        f"parameters:={short}",
        f"record:={bag}",
        "scheme:=mbpcc",
        "namespace:=axis1",
    )
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    assert "process has died" not in outcome.stdout
    recording = read(bag)
    assert list(recording.feedback["period"]) == list(range(PERIODS))
    assert recording.lost_periods == 0
    assert set(recording.scheme) == {"mbpcc"}


def test_two_axes_do_not_touch_each_other() -> None:
    with Process(
        [
            str(ROS2),
            "launch",
            "mfpcc_experiments",
            "two_axes.launch.py",
            "real_time_factor:=0.02",
            "axis1_scheme:=mbpcc",
            "axis2_scheme:=mfpcc",
            "axis2_load_torque:=1.0",
        ]
    ) as process:
        for name, value in (
            ("/axis1/mfpcc_controller scheme", "String value is: mbpcc\n"),
            ("/axis2/mfpcc_controller scheme", "String value is: mfpcc\n"),
            ("/axis1/pmsm_sim load_torque", "Double value is: 0.0\n"),
            ("/axis2/pmsm_sim load_torque", "Double value is: 1.0\n"),
        ):
            answer = subprocess.run(
                [str(ROS2), "param", "get", "--timeout", str(int(PATIENCE)), *name.split()],
                capture_output=True,
                text=True,
                timeout=PATIENCE * PATIENCE,
            )
            assert answer.stdout == value, process.output + answer.stderr
        # a moment of running together: each axis sees its own loop only
        for axis in ("axis1", "axis2"):
            echo = [str(ROS2), "topic", "echo", "--once", f"/{axis}/duty_command"]
            taken = subprocess.run(echo, capture_output=True, text=True, timeout=PATIENCE)
            assert "enable: true" in taken.stdout, process.output
        process.signal(signal.SIGTERM)
        assert process.wait() == 0
    assert "began anew" not in process.output

"""What is wrong before ROS starts is said in plain words."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from rclpy.context import Context

from pwm_node.ros import ros_environment
from pwm_node.ros.ros_environment import RosError


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("ROS_DOMAIN_ID", "abc", "ROS_DOMAIN_ID=abc: a whole number from 0 to 232"),
        ("ROS_DOMAIN_ID", "-1", "ROS_DOMAIN_ID=-1: a whole number from 0 to 232"),
        ("ROS_DOMAIN_ID", "233", "ROS_DOMAIN_ID=233: a whole number from 0 to 232"),
        ("ROS_DOMAIN_ID", "5e1", "ROS_DOMAIN_ID=5e1: a whole number"),
        ("RMW_IMPLEMENTATION", "rmw_x", "RMW_IMPLEMENTATION=rmw_x: there is no such middleware"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "off", "RANGE=off: there are only SUBNET, LOCALHOST"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "/nope.xml", "FILE=/nope.xml: no such file"),
    ],
)
def test_variables(monkeypatch, name, value, reason):
    monkeypatch.setenv(name, value)
    with pytest.raises(RosError, match=reason):
        ros_environment.check()


def test_good_ones(monkeypatch):
    for name, value in (("ROS_DOMAIN_ID", "232"), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")):
        monkeypatch.setenv(name, value)
    ros_environment.check()
    with pytest.raises(RosError, match="RANGE=OFF: 2 processes would never find each other"):
        ros_environment.check(processes=2)


def test_a_full_shared_memory(monkeypatch):
    full = SimpleNamespace(f_bavail=2, f_frsize=4096, f_blocks=100)
    monkeypatch.setattr(os, "statvfs", lambda path: full)
    with pytest.raises(RosError, match=r"^/dev/shm is full \(8 KiB free, 4 MiB needed\)"):
        ros_environment.check()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ("-r x", r"'-r x': not a remap rule \(FROM:=TO\)"),
        ("-r __node:=a/b", "'-r __node:=a/b': not a remap rule"),
        ("-p x", "'-p x': not a parameter override rule"),
        ("--params-file /nope", "'--params-file /nope': error opening YAML file"),
        ("--log-level nope", "'--log-level nope': not a log level"),
        ("--bad --worse", "unknown arguments after --ros-args: --bad --worse"),
    ],
)
def test_arguments(domain, arguments, reason):
    with pytest.raises(RosError, match=f"^{reason}") as caught:
        ros_environment.init(["--ros-args", *arguments.split()], Context())
    assert "/src/" not in str(caught.value) and "\n" not in str(caught.value)


def test_without_a_home_the_logs_go_elsewhere(monkeypatch, tmp_path, capsys):
    for name in ("ROS_LOG_DIR", "ROS_HOME"):
        monkeypatch.setenv(name, "")  # as if it were not there
    monkeypatch.setenv("HOME", "/proc/nohome")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    ros_environment.check()
    ros_environment.check()
    said = capsys.readouterr().err
    assert said.startswith("/proc/nohome/.ros/log cannot be written to: ROS's logs go to")
    assert said.count("\n") == 1
    assert Path(os.environ["ROS_LOG_DIR"]).parent == tmp_path
    context = Context()
    ros_environment.init([], context)
    context.shutdown()


def test_a_home_that_can_be_written_to_has_the_logs(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("ROS_LOG_DIR", "")
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    ros_environment.check()
    assert not os.environ["ROS_LOG_DIR"] and not capsys.readouterr().err
    assert not list((tmp_path / "log").iterdir())


def test_no_place_for_the_logs():
    text = (
        "failed to initialize logging: Failed to create log directory '/x/.ros/log': 2, "
        "at /project/src/rcl_logging_spdlog.cpp:154"
    )
    assert ros_environment.plain(text).startswith("/x/.ros/log: the folder of ROS's logs cannot be")


EXECUTABLES = sorted(Path(__file__).resolve().parents[2].glob("*/bin/*"))


@pytest.mark.parametrize("path", EXECUTABLES, ids=lambda path: path.name)
def test_an_executable_says_in_one_line_that_there_is_no_such_middleware(path):
    """Importing rclpy would end the process, with a line of its C sources."""
    environment = {**os.environ, "RMW_IMPLEMENTATION": "rmw_x"}
    process = subprocess.run(
        [sys.executable, path, *(["--version"] if path.name == "mfpcc" else [])],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    if path.name == "mfpcc":  # a verb that needs no ROS does not mind
        assert (process.returncode, process.stderr) == (0, "")
        return
    assert process.returncode == 1
    assert process.stderr.startswith("error: RMW_IMPLEMENTATION=rmw_x: there is no such middleware")
    assert process.stderr.count("\n") == 1 and process.stdout == ""

"""`ros2 param dump` of a run, given to nodes that start, makes the same run again."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from harness import PATIENCE, Process

from mfpcc_experiments.bags.recording import Recording, read

Start = Callable[..., Process]

ROS2 = shutil.which("ros2")
PERIODS = 300

#: Each kind of value there is, and what is awkward in YAML: empty texts and lists, small numbers,
#: numbers that look whole, texts that look like something else.
PLANT = {
    "periods": PERIODS,
    "seed": 5,
    "load_torque": 2.0,
    "noise.current_rms": 0.0245,
    "inverter.dead_time": 1e-6,
    "sensor.current_offset": [0.0, 1e-3, -0.01],
    "oversampling": 2,
    "initial_speed_rpm": 500.0,
    "fault_injection": True,
    "injections": ["0.005 0.001 current_a wrong 0.1", "0.01 0.0005 encoder off"],
    "recorders": 1,
}
CONTROLLER = {
    "speed_ref_rpm": 500.0,
    "mls.eta_min": 1e-5,
    "mtpa": True,
    "schedule": ["0.01 scheme mbpcc", "0.02 mismatch.inductance 0.5"],
    "recorders": 1,
}

pytestmark = pytest.mark.skipif(ROS2 is None, reason="needs `source setup.bash`")


def ros2_param(verb: str, *arguments: str) -> str:
    """What `ros2 param` prints; it waits for the node."""
    command = [str(ROS2), "param", verb, "--timeout", str(int(PATIENCE)), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE * PATIENCE)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def dumped(node: str, folder: Path) -> Path:
    file = folder / f"{node}.yaml"
    file.write_text(ros2_param("dump", f"/{node}"))
    return file


def parameter_file(node: str, values: dict[str, object], folder: Path) -> Path:
    file = folder / f"first_{node}.yaml"
    file.write_text(yaml.safe_dump({f"/{node}": {"ros__parameters": values}}))
    return file


@pytest.fixture
def record(start: Start, tmp_path: Path) -> Callable[..., Recording]:
    """Record the drive that waits for a recorder, to its end."""

    def run(name: str, *drive: Process) -> Recording:
        recorder = start("mfpcc_experiments", "record", "--out", str(tmp_path / name))
        assert drive[0].wait() == 0, drive[0].output  # the plant ends after its periods
        for process in (*drive[1:], recorder):
            process.interrupt()
            assert process.wait() == 0, process.output
        return read(tmp_path / name)

    return run


def test_a_dumped_run_is_the_same_again(
    start: Start, record: Callable[..., Recording], tmp_path: Path
) -> None:
    plant_file = parameter_file("pmsm_sim", PLANT, tmp_path)
    controller_file = parameter_file("mfpcc_controller", CONTROLLER, tmp_path)
    plant = start("pmsm_sim", "pmsm_sim", "--ros-args", "--params-file", str(plant_file))
    controller = start(
        "mfpcc_controller", "controller", "--ros-args", "--params-file", str(controller_file)
    )
    # both wait for the recorder
    files = [dumped("pmsm_sim", tmp_path), dumped("mfpcc_controller", tmp_path)]
    first = record("first", plant, controller)

    arguments = [word for file in files for word in ("--params-file", str(file))]
    again = record("again", start("mfpcc_experiments", "drive", "--ros-args", *arguments))

    assert first.feedback["period"].tolist() == list(range(PERIODS))
    for topic in ("feedback", "lut", "state", "scheme"):
        one, other = getattr(first, topic), getattr(again, topic)
        assert len(one) == len(other), f"{topic}: {first.notes} {again.notes}"
        assert (one == other).all(), topic
    assert first.i_abc_oversampled is not None and again.i_abc_oversampled is not None
    assert (first.i_abc_oversampled == again.i_abc_oversampled).all()
    # a controller that is stopped sends one more, which blocks the gates
    assert (first.command[:PERIODS] == again.command[:PERIODS]).all()


def test_a_dump_brings_a_running_drive_back(start: Start, tmp_path: Path) -> None:
    start("mfpcc_experiments", "drive", "--ros-args", "-p", "scheme:=mbpcc")
    file = dumped("mfpcc_controller", tmp_path)
    before = file.read_text()
    ros2_param("set", "/mfpcc_controller", "scheme", "pi_foc")
    ros2_param("load", "/mfpcc_controller", str(file))
    assert dumped("mfpcc_controller", tmp_path).read_text() == before

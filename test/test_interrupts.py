"""Ctrl-C at any moment of any executable: no traceback, the right code, and nothing is left behind.

The moments are not times, which would differ from machine to machine, but what Python does: a
module in the path of each program sends SIGINT when the program is about to import, or make, this
or that. "start" is before the program's own first line.
"""

from __future__ import annotations

import os
import pty
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from harness import PATIENCE, Process, until
from mcap.reader import make_reader

HERE = Path(__file__).resolve().parent
REFERENCE = HERE.parent / "bags/reference/pi_foc"

AT = """
import os
import signal
import sys

moment = os.environ.get("INTERRUPT_AT", "")


def interrupt():
    global moment
    moment = ""
    os.kill(os.getpid(), signal.SIGINT)


def hook(event, arguments):
    if moment and moment == (f"import {arguments[0]}" if event == "import" else event):
        interrupt()


if moment == "start":
    interrupt()
elif moment:
    sys.addaudithook(hook)
"""

EXPERIMENT = """
motor: seed_750
speed_rpm: 300.0
duration: 0.05
window_s: [0.01, 0.05]
"""

RUN = "mfpcc run short.yaml --scheme mbpcc --out a/b"
COMPARE = f"mfpcc compare {REFERENCE} --out a/b"


def program(line: str) -> list[str]:
    """The program and arguments of a line; `PACKAGE/EXECUTABLE` is found as `ros2 run` does."""
    name, *arguments = line.split()
    package, _, executable = name.partition("/")
    if executable:
        name = str(Path(get_package_prefix(package), "lib", package, executable))
    return [name, *arguments]


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder to run in, that holds an experiment and nothing else."""
    (tmp_path / "path").mkdir()
    (tmp_path / "path/sitecustomize.py").write_text(AT)
    (tmp_path / "tmp").mkdir()
    place = tmp_path / "place"
    place.mkdir()
    (place / "short.yaml").write_text(EXPERIMENT)
    return place


def run(line: str, place: Path, **variables: str) -> Process:
    path = os.pathsep.join([str(place.parent / "path"), os.environ.get("PYTHONPATH", "")])
    temporary = {"TMPDIR": str(place.parent / "tmp")}
    return Process(
        program(line), cwd=place, env={**os.environ, "PYTHONPATH": path, **temporary, **variables}
    )


@pytest.mark.parametrize(
    ("line", "moment", "code", "said"),
    [
        ("mfpcc list", "start", 130, "mfpcc: interrupted\n"),
        ("mfpcc list", "import click", 130, "mfpcc: interrupted\n"),
        (RUN, "import numba", 130, "mfpcc: interrupted\n"),
        (RUN, "import rclpy", 130, "mfpcc: interrupted\n"),
        (RUN, "import numba.core.dispatcher", 130, "mfpcc: interrupted\n"),
        (RUN, "os.mkdir", 130, "mfpcc: interrupted\n"),
        (RUN, "import mfpcc_experiments.graph.composed", 130, "mfpcc: interrupted\n"),
        (f"{RUN} --separate", "subprocess.Popen", 130, "mfpcc: interrupted\n"),
        (f"{RUN} --engine inprocess", "import matplotlib.figure", 130, "mfpcc: interrupted\n"),
        (COMPARE, "import matplotlib", 130, "mfpcc: interrupted\n"),
        (COMPARE, "os.rename", 130, "mfpcc: interrupted\n"),
        ("pmsm_sim/pmsm_sim", "start", 0, ""),
        ("pmsm_sim/pmsm_sim", "import rclpy", 0, ""),
        ("mfpcc_controller/controller", "import numba", 0, ""),
        ("mfpcc_experiments/drive", "import pmsm_sim.plant", 0, ""),
        ("mfpcc_experiments/record --out bag", "import argparse", 0, ""),
        (f"mfpcc_experiments/replay {REFERENCE}", "import mcap", 0, ""),
        ("ros2 node list", "start", 2, ""),
        ("ros2 node list", "import rclpy", 2, ""),
        ("ros2 run pmsm_sim pmsm_sim", "import ros2_standin.index", 2, ""),
    ],
)
def test_at_any_moment(place: Path, line: str, moment: str, code: int, said: str) -> None:
    with run(line, place, INTERRUPT_AT=moment) as process:
        assert process.wait() == code, process.output
    assert process.output.endswith(said), process.output
    assert "Traceback" not in process.output and "bug" not in process.output
    if code:
        # but a recording, which may be all that there is of a long run
        kept = {"a"} if "what was recorded until then is kept in" in process.output else set()
        assert {path.name for path in place.iterdir()} == {"short.yaml", *kept}, process.output
    assert not left_behind(place)
    with pytest.raises(ProcessLookupError):
        os.killpg(process.pid, 0)  # nobody of its group is left


def left_behind(place: Path) -> list[str]:
    """What is left where temporary files go, but for the locks by which nodes know each other."""
    names = (path.name for path in (place.parent / "tmp").iterdir())
    return [name for name in names if not name.startswith("mfpcc_node_")]


@pytest.mark.parametrize(
    ("line", "code", "said"),
    [("pmsm_sim/pmsm_sim", 0, ""), (RUN, 130, "mfpcc: interrupted\n")],
)
def test_while_kernels_compile(place: Path, line: str, code: int, said: str) -> None:
    with run(line, place, MFPCC_CACHE=str(place.parent / "cache")) as process:
        process.wait_for("compiling kernels")
        process.interrupt()
        assert process.wait() == code, process.output
    assert process.output.endswith(said) and "Traceback" not in process.output
    assert {path.name for path in place.iterdir()} == {"short.yaml"}


def children(pid: int) -> list[int]:
    return [int(n) for n in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def test_whoever_is_killed_takes_its_children_along(place: Path) -> None:
    slow = "pwm_frequency: 10000.0\nplant: {real_time_factor: 0.001}\n"
    (place / "short.yaml").write_text(EXPERIMENT + slow)
    with run(f"{RUN} --separate", place) as process:
        until(lambda: bool(children(process.pid)), "the controller was started")
        (controller,) = children(process.pid)
        process.kill()
        until(lambda: not Path(f"/proc/{controller}").exists(), "the controller has ended")
    assert not left_behind(place)


def test_the_terminal_is_closed(start: Callable[..., Process], place: Path) -> None:
    terminal, inside = pty.openpty()
    record = subprocess.Popen(
        ["setsid", "--ctty", *program("mfpcc_experiments/record --out bag")],
        stdin=inside,
        stdout=inside,
        stderr=inside,
        cwd=place,
    )
    os.close(inside)
    drive = start("mfpcc_experiments", "drive", "--ros-args", "-p", "recorders:=1")
    file = place / "bag/bag_0.mcap"
    until(lambda: file.exists() and file.stat().st_size > 100_000, "it is recorded")
    os.close(terminal)
    assert record.wait(PATIENCE) == 0
    assert (place / "bag/metadata.yaml").exists()
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()  # which only a finished file has
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count > 100
    drive.signal(signal.SIGHUP)
    assert drive.wait() == 0
    assert "gates" not in drive.output and "Traceback" not in drive.output

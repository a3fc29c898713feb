"""The black box without a graph: which faults count, what is written of them, and what is kept."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from mfpcc_msgs.msg import DriveFault, DriveStatus
from rclpy.serialization import serialize_message

from mfpcc_experiments.bags import recording
from mfpcc_experiments.bags.disk.sink import McapSink
from mfpcc_experiments.graph.archive import KEPT, LIST, PAGE, Archive
from mfpcc_experiments.graph.black_box import BlackBox


class Host:
    """Stands for the node that has the box; the test calls its timers."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.timers: list[Callable[[], None]] = []

    def get_namespace(self) -> str:
        return "/axis1"

    def get_logger(self) -> Any:
        return SimpleNamespace(info=self.lines.append, error=self.lines.append)

    def create_timer(self, interval: float, callback: Callable[[], None], clock: Any) -> Any:
        self.timers.append(callback)
        return callback

    def destroy_timer(self, timer: Any) -> None:
        self.timers.remove(timer)


class Drive:
    """A box of the synthetic drive."""

    def __init__(self, folder: Path, messages: Callable[..., Any]) -> None:
        self.host: Any = Host()
        self.nodes = {
            name: SimpleNamespace(values={}, changes=[], missed_periods=1, lost_periods=0)
            for name in ("pmsm_sim", "mfpcc_controller")
        }
        self.folder = folder / "axis1"
        self.box = BlackBox(self.host, folder, self.nodes, 1e4)
        self._messages = messages

    def run(self, periods: int, *, first: int) -> None:
        for topic, _, data in self._messages(periods, first=first):
            self.box.rings[topic].append(data)
        for look in list(self.host.timers):
            look()

    def tell(self, node: str, state: str, *faults: tuple[str, int], period: int = 0) -> None:
        told = [DriveFault(code=code, period=at, detail="as seen") for code, at in faults]
        status = DriveStatus(node=node, state=state, period=period, faults=told)
        status.stamp.sec, status.stamp.nanosec = divmod(period * 100_000, 10**9)
        self.box.on_status(serialize_message(status))

    def written(self) -> list[dict[str, Any]]:
        """All that was written, after the last of it is."""
        self.box.close()
        file = self.folder / LIST
        return yaml.safe_load(file.read_text()) if file.exists() else []


@pytest.fixture
def drive(tmp_path: Path, drive_messages: Callable[..., Any]) -> Drive:
    return Drive(tmp_path, drive_messages)


def test_the_time_around_a_fault_is_written(drive: Drive) -> None:
    drive.nodes["pmsm_sim"].values = {"load_torque": 3.0, "oversampling": 0, "motor": "no_such"}
    drive.nodes["pmsm_sim"].changes += [
        {"period": period, "name": "load_torque", "value": value, "was": value - 1.0}
        for period, value in ((400, 1.0), (2100, 2.0), (3200, 3.0))
    ]
    drive.run(2510, first=0)
    drive.tell("mfpcc_controller", "running", period=0)
    drive.tell("pmsm_sim", "tripped", ("OVERCURRENT", 2500), period=2500)
    drive.tell("mfpcc_controller", "tripped", ("OVERCURRENT", 2501), period=2501)
    drive.run(1100, first=2510)
    (page,) = drive.written()
    assert (page["code"], page["node"], page["period"]) == ("OVERCURRENT", "pmsm_sim", 2500)
    assert page["then"][0]["node"] == "mfpcc_controller"
    assert page["values"]["i_d, i_q (A)"] == [0.2, 3.0] and page["values"]["missed periods"] == 2
    assert len(page["values"]) > 20
    found = recording.read(drive.folder / page["bag"])
    for rows in (found.feedback, found.command, found.lut, found.state):
        assert rows["period"].tolist() == list(range(500, 3501))
    assert found.notes == []
    assert found.config["parameters"]["pmsm_sim"]["load_torque"] == 1.0  # when the bag begins
    assert [change["value"] for change in found.summary["parameter_changes"]] == [2.0, 3.0]
    assert (drive.folder / page["bag"] / "metadata.yaml").exists()


def test_what_comes_after_a_trip_is_no_other_one_until_it_is_cleared(drive: Drive) -> None:
    drive.run(100, first=0)
    drive.tell("pmsm_sim", "tripped", ("OVERCURRENT", 50))
    drive.run(1100, first=100)
    drive.tell("mfpcc_controller", "tripped", ("ENCODER", 1150))
    drive.tell("pmsm_sim", "running")
    drive.tell("mfpcc_controller", "running")
    drive.run(1100, first=1200)
    drive.tell("pmsm_sim", "tripped", ("OVERCURRENT", 2200))
    drive.run(1100, first=2300)
    assert [page["period"] for page in drive.written()] == [2200, 50]


def test_a_fault_that_does_not_stop_the_drive_counts(drive: Drive) -> None:
    drive.run(100, first=0)
    drive.tell("mfpcc_controller", "running", ("SCHEME", 60))
    drive.run(1100, first=100)
    drive.tell("mfpcc_controller", "tripped", ("SCHEME", 60), ("OVERSPEED", 1190))
    drive.run(1100, first=1200)
    assert [page["code"] for page in drive.written()] == ["OVERSPEED", "SCHEME"]


def test_a_stop_that_was_asked_for_is_no_fault(drive: Drive) -> None:
    drive.run(100, first=0)
    drive.tell("mfpcc_controller", "tripped")
    assert drive.written() == []


def test_a_fault_from_before_the_box_was_there_is_not_written(drive: Drive) -> None:
    drive.run(100, first=5000)
    drive.tell("pmsm_sim", "tripped", ("OVERCURRENT", 3000))
    assert drive.written() == []


def test_at_the_end_of_the_run_there_is_what_there_was(drive: Drive) -> None:
    drive.run(100, first=0)
    drive.tell("pmsm_sim", "tripped", ("OVERCURRENT", 90))
    (page,) = drive.written()
    found = recording.read(drive.folder / page["bag"])
    assert found.feedback["period"].tolist() == list(range(100))


def test_a_drive_that_began_anew_is_not_mixed_with_the_one_before(drive: Drive) -> None:
    drive.run(3000, first=0)
    drive.tell("pmsm_sim", "tripped", ("OVERCURRENT", 2990))
    drive.run(40, first=0)
    (page,) = drive.written()
    found = recording.read(drive.folder / page["bag"])
    assert found.feedback["period"].tolist() == list(range(990, 3000))


def test_the_newest_are_kept(tmp_path: Path) -> None:
    archive = Archive(tmp_path)
    for n in range(KEPT + 1):
        with archive.new(f"{n:02d}_CODE") as folder:
            folder.mkdir()
            (folder / PAGE).write_text(f"- bag: {n:02d}_CODE\n")
    names = [f"{n:02d}_CODE" for n in range(KEPT, 0, -1)]
    assert [page["bag"] for page in yaml.safe_load((tmp_path / LIST).read_text())] == names
    assert sorted(path.name for path in tmp_path.iterdir()) == [*reversed(names), LIST]


def test_a_full_disk_leaves_nothing_behind(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(McapSink, "chunk", full)
    drive.run(100, first=0)
    drive.tell("pmsm_sim", "tripped", ("OVERCURRENT", 90))
    assert drive.written() == []
    assert list(drive.folder.iterdir()) == []
    (line,) = drive.host.lines
    assert "OVERCURRENT in period 90 is not kept" in line and "No space left on device" in line

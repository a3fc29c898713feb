"""A plug-in that does not return holds up its own process, and only until it is interrupted."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from harness import Process
from outside import Outside

#: 4 periods a second: the ten commands that the inverter misses take longer than any hold-up of a
#: busy machine, and end before the scheme is interrupted.
PACED = ("-p", "real_time_factor:=0.0004")

ENDLESS = """
from mfpcc_controller.plug_in import Scheme

class Endless(Scheme):
    def step(self, sample):
        while sample.period > 3:
            pass
        return sample.u_dq
"""


@pytest.fixture
def outside(domain: int) -> Iterator[Outside]:
    it = Outside()
    yield it
    it.close()


@pytest.fixture
def endless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package with the scheme `endless`."""
    (tmp_path / "mine.py").write_text(ENDLESS)
    about = tmp_path / "mine-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[mfpcc_controller.schemes]\nendless = mine:Endless\n")
    paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    monkeypatch.setenv("PYTHONPATH", paths)


@pytest.mark.usefixtures("endless")
def test_the_inverter_trips_and_the_controller_hears_ctrl_c(
    start: Callable[..., Process], outside: Outside
) -> None:
    plant = start("pmsm_sim", "pmsm_sim", "--ros-args", *PACED)
    scheme = ("-p", "scheme:=endless", "-p", "speed_ref_rpm:=100.0")
    controller = start("mfpcc_controller", "controller", "--ros-args", *scheme)
    outside.until(
        lambda: outside.codes("pmsm_sim") == ["COMMAND_LOST"] or controller.ended,
        "the inverter gives it up",
    )
    assert not controller.ended, controller.output
    assert not outside.status["pmsm_sim"].enabled
    controller.signal(signal.SIGINT)
    assert controller.wait() == 0, controller.output
    assert "scheme 'endless' failed in period 4: did not return; 'pi_foc' took over" in (
        controller.output
    )
    assert plant.end(signal.SIGINT) == 0, plant.output


@pytest.mark.usefixtures("endless")
def test_in_lock_step_the_fallback_takes_over(
    start: Callable[..., Process], outside: Outside
) -> None:
    scheme = ("-p", "scheme:=endless", "-p", "speed_ref_rpm:=100.0")
    drive = start("mfpcc_experiments", "drive", "--ros-args", *scheme)
    outside.until(
        lambda: outside.codes("mfpcc_controller") == ["SCHEME"] or drive.ended, "it is interrupted"
    )
    assert not drive.ended, drive.output
    (fault,) = outside.status["mfpcc_controller"].faults
    assert "scheme 'endless' failed in period 4" in fault.detail
    outside.until_beyond(50, "the loop goes on")
    assert outside.enabled("mfpcc_controller")
    assert drive.end(signal.SIGINT) == 0, drive.output

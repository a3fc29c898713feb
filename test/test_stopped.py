"""Processes that are stopped for a while, or killed, in the middle of a run."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from harness import Process
from mfpcc_msgs.msg import PhaseFeedback
from outside import Outside

from mfpcc_experiments.bags import recording

#: 4 periods a second: nobody is late by ten of them on a busy machine who has not been stopped.
PACED = ("-p", "real_time_factor:=0.0004")

#: Looks without anything new after which the loop is taken to stand.
STANDS = 100

Start = Callable[..., Process]


@pytest.fixture
def outside(domain: int) -> Iterator[Outside]:
    it = Outside()
    yield it
    it.close()


@contextmanager
def stopped(process: Process) -> Iterator[None]:
    process.signal(signal.SIGSTOP)
    yield
    process.signal(signal.SIGCONT)


def until_it_stands(outside: Outside, process: Process) -> None:
    """Wait until the loop stands, as it does while somebody is stopped whom it waits for.

    For a recorder it does so only after thousands of periods: so many are not waited for.
    """
    looks, last, enough = 0, outside.period, outside.period + 1000

    def stands() -> bool:
        nonlocal looks, last
        looks = looks + 1 if outside.period == last else 0
        last = outside.period
        return looks > STANDS or last > enough

    outside.until(stands, f"the loop stands without {process.command[0]}")


def test_in_lock_step_whoever_is_stopped_is_waited_for_and_nothing_is_lost(
    start: Start, outside: Outside, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    recorder = start("mfpcc_experiments", "record", "--out", str(bag))
    patient = ("-p", "fault.feedback_timeout:=0.0")
    controller = start(
        "mfpcc_controller", "controller", "--ros-args", "-p", "recorders:=1", *patient
    )
    plant = start("pmsm_sim", "pmsm_sim", "--ros-args", "-p", "recorders:=1")
    outside.until_beyond(50, "the loop runs")
    for process in (controller, plant, recorder):
        with stopped(process):
            until_it_stands(outside, process)
        outside.until_beyond(outside.period + 100, f"goes on after {process.command[0]}")
    assert not outside.codes("pmsm_sim") and not outside.codes("mfpcc_controller")
    for process in (plant, controller, recorder):
        process.signal(signal.SIGINT)
        assert process.wait() == 0, process.output
    found = recording.read(bag)
    assert found.lost_periods == 0, found.notes
    assert found.feedback["period"][0] == 0
    assert found.summary["faults"] == []


def run_again(outside: Outside) -> None:
    """Clear both, the reference to zero and up again: the drive must run."""
    # the inverter has to get a command first; its samples tell the controller that it is well again
    for node in ("pmsm_sim", "mfpcc_controller"):
        outside.until(
            lambda node=node: outside.call(node, "clear_faults").success,  # type: ignore[misc]
            f"{node} is cleared",
        )
    (answer,) = outside.set("mfpcc_controller", speed_ref_rpm=0.0)
    assert answer.successful, answer.reason
    outside.until(lambda: outside.enabled("pmsm_sim"), "the gates are on again")
    (answer,) = outside.set("mfpcc_controller", speed_ref_rpm=200.0)
    assert answer.successful, answer.reason
    period = outside.period
    outside.until(
        lambda: outside.enabled("pmsm_sim") and outside.period > period + 5,
        "the drive runs again",
    )


@pytest.mark.parametrize("ahead", [2, 6, 99])
def test_in_lock_step_a_forged_sample_does_not_stop_the_loop_for_ever(
    start: Start, outside: Outside, ahead: int
) -> None:
    """The controller takes it for a sample that overtook others, and those for late ones."""
    speed = ("-p", "speed_ref_rpm:=200.0")
    controller = start("mfpcc_controller", "controller", "--ros-args", *speed)
    plant = start("pmsm_sim", "pmsm_sim", "--ros-args")
    forger = outside.node.create_publisher(PhaseFeedback, "phase_feedback", 10)
    outside.until_beyond(50, "the loop runs")

    def heard() -> bool:
        forger.publish(b"no message")
        return "phase_feedback refused" in controller.output

    outside.until(heard, "the controller hears it")
    with stopped(controller):
        until_it_stands(outside, controller)
        forged = outside.sample
        assert forged is not None
        forged.period += ahead
        forger.publish(forged)
    stood = forged.period
    outside.until_beyond(stood + 100, "the loop goes on")

    def drives() -> bool:
        if outside.codes("mfpcc_controller") or outside.codes("pmsm_sim"):
            run_again(outside)
        return outside.enabled("pmsm_sim") and outside.enabled("mfpcc_controller")

    outside.until(drives, "both are enabled")
    for process in (controller, plant):
        process.signal(signal.SIGINT)
        assert process.wait() == 0, process.output


def test_paced_the_inverter_does_not_wait_for_a_controller(start: Start, outside: Outside) -> None:
    plant = start("pmsm_sim", "pmsm_sim", "--ros-args", *PACED, "-p", "load_torque:=1.0")
    speed = ("--ros-args", "-p", "speed_ref_rpm:=200.0")
    controller = start("mfpcc_controller", "controller", *speed)
    outside.until_beyond(5, "the loop runs")

    # stopped: the inverter trips, and so does the controller that has missed it all
    with stopped(controller):
        outside.until(
            lambda: outside.codes("pmsm_sim") == ["COMMAND_LOST"], "the inverter gives it up"
        )
        # more samples than its subscription holds
        outside.until_beyond(outside.period + 20, "time goes on")
    outside.until(
        lambda: "FEEDBACK_LOST" in outside.codes("mfpcc_controller"), "the controller sees a gap"
    )
    assert not outside.status["pmsm_sim"].enabled
    run_again(outside)

    # killed: the same for the inverter; a new one takes over without a restart of the plant
    outside.gates.clear()
    del outside.status["mfpcc_controller"]
    controller.kill()
    outside.until(lambda: outside.codes("pmsm_sim") == ["COMMAND_LOST"], "the inverter gives it up")
    tripped = outside.status["pmsm_sim"].faults[0].period
    outside.until_beyond(tripped + 5, "time goes on")
    assert all(on == (period < tripped) for period, on in outside.gates if period > tripped - 10)
    start("mfpcc_controller", "controller", *speed)
    outside.until(lambda: "mfpcc_controller" in outside.status, "a new controller is there")
    outside.until_beyond(outside.period + 5, "time goes on")
    assert outside.codes("pmsm_sim") == ["COMMAND_LOST"] and not outside.enabled("pmsm_sim")
    run_again(outside)
    assert "began anew" not in plant.output

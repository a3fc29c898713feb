"""Paced mode: periods follow the wall clock, and what is not in time is counted, not made up for.

A busy machine makes everything late, and nothing early. So it is held that the drive is never
faster than its pace; how much slower it may be is the machine's business.
"""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Iterator

import pytest
from harness import Process, until
from outside import Outside

#: 200 periods a second.
FACTOR = 0.02
RATE = 1e4 * FACTOR  # periods per second

Start = Callable[..., Process]


@pytest.fixture
def outside(domain: int) -> Iterator[Outside]:
    it = Outside()
    yield it
    it.close()


def start_nodes(start: Start, package: str, executable: str, *more: str) -> Process:
    values = (f"real_time_factor:={FACTOR}", *more)
    arguments = [part for value in values for part in ("-p", value)]
    return start(package, executable, "--ros-args", *arguments)


def time_of(outside: Outside, periods: int) -> float:
    """Wall-clock time (s) of so many periods from now on."""
    begin = time.monotonic()
    outside.until_beyond(outside.period + periods, f"{periods} more periods")
    return time.monotonic() - begin


def test_periods_follow_the_wall_clock(start: Start, outside: Outside) -> None:
    start_nodes(start, "mfpcc_experiments", "drive")
    outside.until_beyond(20, "the drive runs")
    # a sample may have been on its way here for a while
    assert time_of(outside, 200) > 0.8 * 200 / RATE


def test_missed_periods_are_counted_and_published(start: Start, outside: Outside) -> None:
    start_nodes(start, "pmsm_sim", "pmsm_sim", "inverter.command_loss_limit:=100000")
    controller = start("mfpcc_controller", "controller")
    outside.until_beyond(20, "the loop runs")

    def missed() -> float:
        outside.look()
        return outside.diagnostic("pmsm_sim: loop", "missed periods")

    until(lambda: missed() >= 0, "diagnostics come")
    before = missed()
    controller.signal(signal.SIGSTOP)
    try:
        outside.until_beyond(outside.period + 50, "the plant goes on without a controller")
        until(lambda: missed() >= before + 40, "the missed periods are told")
    finally:
        controller.signal(signal.SIGCONT)

    def nothing_missed() -> bool:
        """From one message on /diagnostics to the next, with the loop going on."""
        misses, period = missed(), outside.diagnostic("pmsm_sim: loop", "period")
        until(
            lambda: missed() >= 0 and outside.diagnostic("pmsm_sim: loop", "period") > period,
            "diagnostics go on",
        )
        return missed() == misses

    until(nothing_missed, "the controller is in time again")


def test_lost_wall_clock_time_is_not_made_up_for(start: Start, outside: Outside) -> None:
    drive = start_nodes(start, "mfpcc_experiments", "drive")
    outside.until_beyond(20, "the drive runs")
    drive.signal(signal.SIGSTOP)
    time.sleep(1.0)  # the disturbance itself: 200 periods of wall-clock time
    while outside.period != _latest(outside):
        pass  # what was on its way
    began = time.monotonic()
    drive.signal(signal.SIGCONT)
    outside.until_beyond(outside.period + 100, "the drive goes on")
    assert time.monotonic() - began > 0.8 * 100 / RATE, "periods were run in a burst"

    def left_out() -> float:
        outside.look()
        return outside.diagnostic("pmsm_sim: inverter", "periods left out (wall clock)")

    until(lambda: left_out() >= 0.5 * RATE, "the periods left out are told")


def _latest(outside: Outside) -> int:
    outside.look()
    return outside.period


def test_the_pace_can_be_changed_while_it_runs(start: Start, outside: Outside) -> None:
    start_nodes(start, "mfpcc_experiments", "drive")
    outside.until_beyond(20, "the drive runs, paced")
    (answer,) = outside.set("pmsm_sim", real_time_factor=0.0)
    assert answer.successful, answer.reason
    assert time_of(outside, 2000) < 0.5 * 2000 / RATE, "not as fast as it goes"
    (answer,) = outside.set("pmsm_sim", real_time_factor=FACTOR)
    assert answer.successful, answer.reason
    for _ in range(20):
        outside.look()  # what was on its way
    assert time_of(outside, 100) > 0.8 * 100 / RATE, "not paced again"
    (answer,) = outside.set("pmsm_sim", real_time_factor=0.5 * FACTOR)
    assert answer.successful, answer.reason
    assert time_of(outside, 50) > 0.8 * 50 / (0.5 * RATE), "not at the new pace"
    assert not math.isnan(outside.diagnostic("pmsm_sim: loop", "missed periods"))

"""Commands that are late, wrong or absent."""

from __future__ import annotations

import numpy as np
import pytest
from mfpcc_msgs.msg import DutyCommand

from pmsm_sim.plant import ACCEPTED, OUT_OF_RANGE, WRONG_PERIOD, latch
from pwm_node.wire import Wire


def _command(period, duty=(0.6, 0.5, 0.4), enable=True):
    cmd = Wire(DutyCommand).fixed
    cmd["period"] = period
    cmd["duty"] = duty
    cmd["enable"] = enable
    return cmd


def _duties(drive):
    return drive.st["duty"][0].tolist()


def test_period_0_has_the_zero_vector_and_then_a_command_has_to_come(bench):
    drive = bench().run(1, command=False)
    assert drive.state[0]["gates_on"] and _duties(drive) == [0.5, 0.5, 0.5]
    drive.run(20, command=False)
    assert not drive.state[-1]["gates_on"]
    assert drive.st["missed"][0] == 0 and not drive.st["latch"]["tripped"][0]
    assert latch(drive.st, _command(21)) == ACCEPTED
    drive.run(1, command=False)
    assert drive.state[-1]["gates_on"] and _duties(drive) == [0.6, 0.5, 0.4]


def test_missing_commands_give_the_zero_vector_then_block_the_gates(bench):
    drive = bench().run(3, (0.6, 0.5, 0.4))
    drive.run(9, command=False)
    assert _duties(drive) == [0.5, 0.5, 0.5]
    assert drive.column("gates_on").all()
    drive.run(1, command=False)
    assert not drive.state[-1]["gates_on"] and drive.st["latch"]["tripped"][0]
    assert drive.st["missed"][0] == 10
    # latched: a new command alone does not bring the power back
    drive.run(3, (0.6, 0.5, 0.4))
    assert not drive.state[-1]["gates_on"]
    assert drive.plant.clear_faults() == []
    # nor does it afterwards, before one has had the gates off
    drive.run(1, (0.6, 0.5, 0.4))
    assert not drive.state[-1]["gates_on"]
    drive.run(1, enable=False).run(1, (0.6, 0.5, 0.4))
    assert drive.state[-1]["gates_on"]


def test_clearing_counts_missing_commands_from_the_beginning(bench):
    drive = bench().run(3).run(5, command=False)
    drive.plant.stop()
    drive.run(1, command=False)
    assert drive.plant.clear_faults() == []
    drive.run(9, command=False)
    assert drive.plant.faults() == [], "nine in a row since they were cleared"
    drive.run(1, command=False)
    assert drive.plant.faults() == [
        ("COMMAND_LOST", 18, "10 periods in a row without a valid command")
    ]


def test_clearing_is_refused_while_commands_are_missing(bench):
    drive = bench().run(3).run(10, command=False)
    assert drive.plant.clear_faults() == ["COMMAND_LOST"]
    drive.run(1, enable=False)
    assert drive.plant.clear_faults() == []


def test_hold_repeats_the_command_once(bench):
    drive = bench(inverter_missing_command="hold", inverter_command_loss_limit=3)
    drive.run(2, (0.6, 0.5, 0.4))
    seen = []
    for _ in range(3):
        drive.run(1, command=False)
        seen.append((_duties(drive)[0], bool(drive.state[-1]["gates_on"])))
    assert seen == [(0.6, True), (0.5, True), (0.5, False)]


def test_hold_does_not_enable_what_was_disabled(bench):
    drive = bench(inverter_missing_command="hold").run(2, enable=False).run(3, command=False)
    assert not drive.column("gates_on").any()


@pytest.mark.parametrize("bad", [np.nan, -0.01, 1.01, np.inf])
def test_duties_out_of_range_are_refused_and_counted(bench, bad):
    drive = bench().run(1)
    assert latch(drive.st, _command(1, (0.5, bad, 0.5))) == OUT_OF_RANGE
    assert drive.st["refused"][0] == 1
    drive.run(1, command=False)
    assert drive.st["missed"][0] == 1


@pytest.mark.parametrize("period", [0, 4, 6])
def test_commands_for_other_periods_are_refused(bench, period):
    drive = bench().run(5)
    assert latch(drive.st, _command(period)) == WRONG_PERIOD
    assert latch(drive.st, _command(5)) == ACCEPTED
    assert latch(drive.st, _command(5)) == WRONG_PERIOD  # the same again

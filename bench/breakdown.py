"""Where the microseconds of a period go: the loop of the composed drive, a clock after each part.

The same topics, records and kernels as in the nodes, one call after the other. What the nodes do
beside (checks, counting, the spin loop) is the rest to the period of the composed drive.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import drives
from figures import Figure, figure
from mfpcc_msgs.msg import DriveState, DutyCommand, LutDiagnostics, PhaseFeedback

from mfpcc_controller.controller import Controller
from mfpcc_controller.node import MfpccController
from mfpcc_experiments.bags import BagWriter
from mfpcc_experiments.graph.session import sink
from pmsm_sim.node import PmsmSim
from pmsm_sim.plant import Plant, advance, latch
from pwm_node import compiled
from pwm_node.ros.diagnostics import StepTimes
from pwm_node.wire import Wire

_BLOCK = 1_000  # periods per sample of the clock readings


def measure(*, quick: bool) -> list[Figure]:
    """One row per part."""
    blocks = 10 if quick else 50
    with drives.graph() as context, tempfile.TemporaryDirectory() as folder:
        plant = drives.plant(context, 0)
        controller = drives.controller(context)
        for node in (plant, controller):
            node.trigger_configure()
        with BagWriter(Path(folder, "bag"), config={}) as writer:
            parts = _timed(plant, controller, writer, blocks)
        for node in (plant, controller):
            node.destroy_node()
    period = median(drives.composed(20_000)[0].period_us() for _ in range(2 if quick else 5))
    parts["the rest: checks, counting, spinning"] = period - sum(
        us for name, us in parts.items() if name != _RECORD
    )
    rows = [figure(f"period: {name}", us, "us", "period", period) for name, us in parts.items()]
    return [*rows, figure("period of the composed drive", period, "us")]


_RECORD = "record (only where it records)"


def _timed(
    plant_node: PmsmSim, controller_node: MfpccController, writer: BagWriter, blocks: int
) -> dict[str, float]:
    """Median time of each part of a period (us)."""
    feedback_out, state_out = (each.publish for each in plant_node.loop_publishers)
    command_out, lut_out = (each.publish for each in controller_node.loop_publishers)
    take_command = plant_node.loop_subscriptions[0].take
    take_feedback = controller_node.loop_subscriptions[0].take
    plant, controller = Plant(plant_node.values), Controller(controller_node.values)
    sample, state, command, lut = (
        Wire(each) for each in (PhaseFeedback, DriveState, DutyCommand, LutDiagnostics)
    )
    received, heard = Wire(PhaseFeedback), Wire(DutyCommand)
    waveform = state.tail["i_abc_oversampled"], state.tail["legs_oversampled"]
    records = plant.par, plant.st, sample.fixed, state.fixed, *waveform
    take_over = compiled.direct(latch, plant.st, heard.fixed)
    integrate = compiled.direct(advance, *records)
    controller.bind(received.fixed, command.fixed, lut.fixed)
    step_times = StepTimes()
    sinks = [
        sink(writer, topic)
        for topic in ("phase_feedback", "drive_state", "duty_command", "lut_diagnostics")
    ]
    clock = time.perf_counter_ns

    def block(number: int) -> dict[str, int]:
        spent = dict.fromkeys(_PARTS, 0)
        for _ in range(number):
            t0 = clock()
            take_over(plant.st, heard.fixed)
            integrate(*records)
            t1 = clock()
            sample_bytes, state_bytes = sample.to_bytes(), state.to_bytes()
            t2 = clock()
            feedback_out(sample_bytes)
            t3 = clock()
            state_out(state_bytes)
            t4 = clock()
            taken = take_feedback(PhaseFeedback, True)
            t5 = clock()
            received.load(taken[0])
            t6 = clock()
            controller.step(received.fixed, command.fixed, lut.fixed, True)
            t7 = clock()
            step_times.add(t7 - t6)
            t8 = clock()
            command_bytes, lut_bytes = command.to_bytes(), lut.to_bytes()
            t9 = clock()
            command_out(command_bytes)
            t10 = clock()
            lut_out(lut_bytes)
            t11 = clock()
            taken = take_command(DutyCommand, True)
            t12 = clock()
            heard.load(taken[0])
            t13 = clock()
            for append, data in zip(
                sinks, (sample_bytes, state_bytes, command_bytes, lut_bytes), strict=True
            ):
                append(data)
            t14 = clock()
            spent["publish phase_feedback, duty_command"] += (t3 - t2) + (t10 - t9)
            spent["publish drive_state, lut_diagnostics"] += (t4 - t3) + (t11 - t10)
            spent["take phase_feedback, duty_command"] += (t5 - t4) + (t12 - t11)
            spent["conversion: two messages in, four out"] += (
                (t2 - t1) + (t6 - t5) + (t9 - t8) + (t13 - t12)
            )
            spent["plant, call included"] += t1 - t0
            spent["scheme mls_mfpcc and lut_diagnostics, call included"] += t7 - t6
            spent["diagnostics: step times"] += t8 - t7
            spent[_RECORD] += t14 - t13
        return spent

    block(100)
    readings = [block(_BLOCK) for _ in range(blocks)]
    clock_us = _cost_of(clock)
    return {
        part: median(each[part] for each in readings) / _BLOCK * 1e-3 - intervals * clock_us
        for part, intervals in _PARTS.items()
    }


#: Parts, and how many readings of the clock are in each.
_PARTS = {
    "publish phase_feedback, duty_command": 2,
    "publish drive_state, lut_diagnostics": 2,
    "take phase_feedback, duty_command": 2,
    "conversion: two messages in, four out": 4,
    "plant, call included": 1,
    "scheme mls_mfpcc and lut_diagnostics, call included": 1,
    "diagnostics: step times": 1,
    _RECORD: 1,
}


def _cost_of(clock: Callable[[], Any]) -> float:
    """Time of one reading of the clock (us)."""
    begin = time.perf_counter()
    for _ in range(100_000):
        clock()
    return (time.perf_counter() - begin) * 10.0

"""The in-process engine: the whole closed loop compiled, without ROS.

Plant and controller are the same kernels that the nodes call, on the same records, in the same
order; so its result equals that of the ROS graph sample by sample.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from mfpcc_msgs.msg import DriveState, DutyCommand, LutDiagnostics, PhaseFeedback
from numpy.typing import NDArray

from mfpcc_controller.controller import Controller, answer
from mfpcc_controller.parameters import TABLE as CONTROLLER
from pmsm_sim.parameters import TABLE as PLANT
from pmsm_sim.plant import Plant, advance, latch
from pwm_node import schedule
from pwm_node.compiled import kernel
from pwm_node.wire import Wire, fixed_dtype

# Periods per call of the compiled loop: long enough to hide the call, short enough for a
# progress bar and for bounded memory.
_CHUNK = 2_000

# Periods per timed block of `step_time`: a single step is far shorter than the clock's resolution.
_TIMED_BLOCK = 100


@dataclass
class Trace:
    """What passed on the loop in n consecutive periods, one row each.

    Attributes
    ----------
    feedback, command, lut, state : structured arrays, shape (n,)
        The fixed parts of `PhaseFeedback`, `DutyCommand` (the command computed in that period),
        `LutDiagnostics` and `DriveState`.
    i_abc : float64 array, shape (n, 3 m)
        Oversampled phase currents (A), m points per period.
    legs : uint8 array, shape (n, m)
    scheme, fallback : str
        Who was to control, and who does in its place once it has failed.
    fallen : bool array, shape (n,)
        Whether it had.
    """

    feedback: NDArray[np.void]
    command: NDArray[np.void]
    lut: NDArray[np.void]
    state: NDArray[np.void]
    i_abc: NDArray[np.float64]
    legs: NDArray[np.uint8]
    fallen: NDArray[np.bool_]
    scheme: str
    fallback: str

    @classmethod
    def empty(cls, n: int, oversampling: int, scheme: str, fallback: str) -> Trace:
        """Room for n periods."""
        return cls(
            feedback=np.zeros(n, fixed_dtype(PhaseFeedback)),
            command=np.zeros(n, fixed_dtype(DutyCommand)),
            lut=np.zeros(n, fixed_dtype(LutDiagnostics)),
            state=np.zeros(n, fixed_dtype(DriveState)),
            i_abc=np.zeros((n, 3 * oversampling)),
            legs=np.zeros((n, oversampling), np.uint8),
            fallen=np.zeros(n, np.bool_),
            scheme=scheme,
            fallback=fallback,
        )


@kernel
def _loop(par, st, cfg, mem, cmd, feedback, command, lut, state, i_abc, legs, fallen):
    """Closed loop over as many periods as the arrays have rows.

    `cmd` carries the last command in and out.
    """
    for k in range(feedback.shape[0]):
        latch(st, cmd)
        advance(par, st, feedback[k : k + 1], state[k : k + 1], i_abc[k], legs[k])
        # none or two only where a fault of the link is injected
        for _ in range(st[0].injector.copies):
            answer(cfg[0], mem[0], feedback[k], cmd[0], lut[k], True)
        command[k] = cmd[0]
        fallen[k] = mem[0].fallen


@kernel
def _controller_block(cfg, mem, feedback, cmd, diag):
    for k in range(feedback.shape[0]):
        answer(cfg[0], mem[0], feedback[k], cmd[0], diag[0], True)


def _loop_in_python(
    plant: Plant, controller: Controller, cmd: NDArray[np.void], trace: Trace
) -> None:
    """The same as `_loop`, period by period, with a plug-in in Python in the controller."""
    for k in range(len(trace.feedback)):
        latch(plant.st, cmd)
        feedback = trace.feedback[k : k + 1]
        advance(
            plant.par, plant.st, feedback, trace.state[k : k + 1], trace.i_abc[k], trace.legs[k]
        )
        for _ in range(plant.st["injector"]["copies"][0]):
            controller.step(feedback, cmd, trace.lut[k : k + 1], True)
        trace.command[k] = cmd[0]
        trace.fallen[k] = controller.fallen


class Engine:
    """A closed loop of plant and controller.

    Parameters
    ----------
    plant_values, controller_values : mapping
        A value for every parameter of the two tables.

    Raises
    ------
    pwm_node.schedule.ScheduleError, pwm_node.yaml_files.FileError
        A schedule entry or a motor file that cannot be used.
    """

    def __init__(
        self, plant_values: Mapping[str, Any], controller_values: Mapping[str, Any]
    ) -> None:
        self.plant = Plant(plant_values)
        self.controller = Controller(controller_values)
        T_s = 1.0 / plant_values["pwm_frequency"]
        self._due = [
            (period, part, changes)
            for part, table, values in (
                (self.plant, PLANT, plant_values),
                (self.controller, CONTROLLER, controller_values),
            )
            for period, changes in schedule.parse(values["schedule"], table, T_s, values)
        ]
        self._due.sort(key=lambda item: item[0])
        self._command = Wire(DutyCommand).fixed
        self.period = 0

    def run(self, periods: int) -> Iterator[Trace]:
        """Advance by so many periods; yields what passed, piece by piece."""
        end = self.period + periods
        while self.period < end:
            while self._due and self._due[0][0] <= self.period:
                _, part, changes = self._due.pop(0)
                part.apply(changes)
            limit = min(end, self.period + _CHUNK)
            if self._due:
                limit = min(limit, self._due[0][0])
            n = limit - self.period
            values = self.controller.values
            trace = Trace.empty(
                n, self.plant.oversampling, values["scheme"], values["fallback_scheme"]
            )
            if self.controller.compiled:
                _loop(
                    self.plant.par,
                    self.plant.st,
                    self.controller.cfg,
                    self.controller.mem,
                    self._command,
                    trace.feedback,
                    trace.command,
                    trace.lut,
                    trace.state,
                    trace.i_abc,
                    trace.legs,
                    trace.fallen,
                )
            else:
                _loop_in_python(self.plant, self.controller, self._command, trace)
            self.period = limit
            yield trace


def parallel(engines: Sequence[Engine], periods: int) -> list[list[Trace]]:
    """Advance independent drives by so many periods, on all cores; what passed in each of them.

    The compiled loop runs without the interpreter's lock, so threads are enough. Drives share
    nothing, so each runs as it does alone, bit for bit.

    Parameters
    ----------
    engines : sequence of Engine
        Each a drive of its own.
    periods : int
    """
    runs = [engine.run(periods) for engine in engines]
    passed: list[list[Trace]] = [[] for _ in engines]
    # Piece by piece in turn: cores are not equally fast, and the last one at work is waited for.
    turns = deque(range(len(engines)))

    def work() -> None:
        while True:
            try:
                n = turns.popleft()
            except IndexError:
                return
            trace = next(runs[n], None)
            if trace is not None:
                passed[n].append(trace)
                turns.append(n)

    cores = len(os.sched_getaffinity(0))
    with ThreadPoolExecutor(max_workers=cores) as pool:
        for worker in [pool.submit(work) for _ in range(cores)]:
            worker.result()
    return passed


def step_time(controller: Controller, feedback: NDArray[np.void]) -> dict[str, float]:
    """Time of one controller step (us), over blocks of the samples given.

    Built-in schemes run inside compiled code; a plug-in is called from Python.

    Parameters
    ----------
    controller : Controller
        A fresh one; its memory is used.
    feedback : structured array, shape (n,)
        Recorded samples.

    Returns
    -------
    dict
        `median` and `p99` over blocks of 100 steps.
    """
    command, lut = Wire(DutyCommand).fixed, Wire(LutDiagnostics).fixed
    # compiles, or loads the kernel, before the clock runs
    _controller_block(controller.cfg, controller.mem, feedback[:0], command, lut)
    times = []
    for start in range(0, len(feedback), _TIMED_BLOCK):
        block = feedback[start : start + _TIMED_BLOCK]
        begin = time.perf_counter_ns()
        if controller.compiled:
            _controller_block(controller.cfg, controller.mem, block, command, lut)
        else:
            for k in range(len(block)):
                controller.step(block[k : k + 1], command, lut, True)
        times.append((time.perf_counter_ns() - begin) / len(block) * 1e-3)
    return {"median": float(np.median(times)), "p99": float(np.percentile(times, 99))}

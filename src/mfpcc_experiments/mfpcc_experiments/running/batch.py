"""Many runs of one experiment, measured inside the compiled loop: no messages, no recording.

Plant and controller are the kernels of the in-process engine, in its order, on its records; so a
run of a batch has the same bits as that run recorded by the engine. What a run leaves is one row of
figures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from mfpcc_msgs.msg import DriveState, DutyCommand, LutDiagnostics, PhaseFeedback
from numpy.typing import NDArray

import mfpcc_controller.motor
import pmsm_sim.motor
from mfpcc_controller.controller import Controller, answer
from mfpcc_controller.motor import EstimatedPars
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.measuring.compiled import (
    ANGLE,
    BESIDES,
    COURSE,
    E_D,
    E_Q,
    I_A,
    I_D,
    I_D_REF,
    I_Q,
    I_Q_REF,
    KEYS,
    LOAD_TORQUE,
    N_FIGURES,
    RESISTANCE,
    SIGNALS,
    SPEED,
    SPEED_REF,
    TORQUE,
    measure,
)
from mfpcc_experiments.measuring.window import window_periods
from pmsm_sim.motor import MotorPars
from pmsm_sim.parameters import TABLE as PLANT
from pmsm_sim.parts.thermal import REFERENCE_TEMPERATURE
from pmsm_sim.plant import Plant, PlantError, advance, latch
from pwm_node import schedule
from pwm_node.compiled import direct, kernel
from pwm_node.units import RPM
from pwm_node.wire import Wire

Part = TypeVar("Part", Plant, Controller)

# What is remembered from one piece of a run to the next.
_STATE = np.dtype(
    [
        ("first", np.int64),  # period of the window
        ("end", np.int64),  # the one after its last
        ("i_peak", np.float64),  # largest |i| so far, true (A)
        ("active", np.int64),  # who controlled in the window, and who had been chosen; -1: nobody
        ("chosen", np.int64),
        ("was_on", np.bool_),  # gates, and legs that were on throughout the period before
        ("level", np.uint8, (3,)),
        ("course", COURSE),
    ],
    align=True,
)


@kernel
def _watch(course, seen, duty, on):
    """Count how the legs switch, as `waveform.switching_frequency` does."""
    for x in range(3):
        level = np.uint8(duty[x] >= 1.0)
        if on and duty[x] > 0.0 and duty[x] < 1.0:
            course.inside += 1
        if course.commands > 0 and on and seen.was_on and level != seen.level[x]:
            course.between += 1
        seen.level[x] = level
    seen.was_on = on
    course.commands += 1


@kernel
def _keep(par, cfg, mem, fb, ds, signals, n):
    """Keep what the figures need of a period, as row n of the window."""
    signals[ANGLE, n] = ds.angle
    signals[I_A, n] = fb.i_a
    signals[I_D, n], signals[I_Q, n] = mem.i_dq.real, mem.i_dq.imag
    signals[I_D_REF, n], signals[I_Q_REF, n] = mem.i_dq_ref.real, mem.i_dq_ref.imag
    signals[E_D, n], signals[E_Q, n] = mem.e.real, mem.e.imag
    signals[TORQUE, n] = ds.torque
    signals[SPEED, n] = ds.speed
    signals[LOAD_TORQUE, n] = ds.load_torque
    signals[SPEED_REF, n] = cfg.w_M_ref if cfg.speed_control else np.nan
    rise = ds.temperature - REFERENCE_TEMPERATURE
    signals[RESISTANCE, n] = par.R_20 * (1.0 + par.copper_coefficient * rise)


@kernel
def _advance(par, st, cfg, mem, cmd, fb, ds, lut, seen_, stop, signals, i_abc, legs):
    """Closed loop until period `stop`, as `engine._loop`; what is in the window is kept."""
    seen = seen_[0]
    course = seen.course
    none, no_legs = i_abc[0, :0], legs[:0]
    for k in range(np.int64(st[0].period), stop):
        n = k - seen.first
        inside = n >= 0 and k < seen.end
        latch(st, cmd)
        if inside:
            advance(par, st, fb, ds, i_abc[n], legs)
        else:
            advance(par, st, fb, ds, none, no_legs)
        seen.i_peak = max(seen.i_peak, math.hypot(ds[0].i_dq[0], ds[0].i_dq[1]))
        if inside and k > 0:
            _watch(course, seen, cmd[0].duty, ds[0].gates_on)
        answer(cfg[0], mem[0], fb[0], cmd[0], lut[0], False)
        if inside:
            _keep(par[0], cfg[0], mem[0], fb[0], ds[0], signals, n)
            if not ds[0].gates_on:
                course.off = True
            other = mem[0].active != seen.active or mem[0].chosen != seen.chosen
            if other and seen.active >= 0:
                course.mixed = True
            seen.active, seen.chosen = mem[0].active, mem[0].chosen


@kernel
def _measured(seen_, signals, i_abc, figures):
    return measure(seen_[0].course, signals, i_abc, figures)


@dataclass(frozen=True)
class Drive:
    """
    What one run of a batch is made of.

    Attributes
    ----------
    plant, controller : mapping
        A value for every parameter of the two tables.
    plant_motor, controller_motor : MotorPars, EstimatedPars
        The motor file as either reads it.
    changes : tuple of (int, dict, dict)
        Period, and the parameters of plant and controller that change at its beginning, in the
        order of time.
    plant_key, controller_key : tuple
        Tell drives of one batch apart whose plant, or controller, begins differently (but for the
        seed); empty: nothing is known.
    """

    plant: Mapping[str, Any]
    controller: Mapping[str, Any]
    plant_motor: MotorPars
    controller_motor: EstimatedPars
    changes: tuple[tuple[int, Mapping[str, Any], Mapping[str, Any]], ...] = ()
    plant_key: tuple[Any, ...] = ()
    controller_key: tuple[Any, ...] = ()


def drive_of(plant: Mapping[str, Any], controller: Mapping[str, Any]) -> Drive:
    """
    The drive of these parameters, its motor file and its schedule.

    Parameters
    ----------
    plant, controller : mapping
        A value for every parameter of the two tables, as from `Scenario.node_parameters`.

    Raises
    ------
    pwm_node.schedule.ScheduleError, pwm_node.yaml_files.FileError
        A schedule entry or a motor file that cannot be used.
    """
    T_s = 1.0 / plant["pwm_frequency"]
    changes = [
        *((k, c, {}) for k, c in schedule.parse(plant["schedule"], PLANT, T_s, plant)),
        *(
            (k, {}, c)
            for k, c in schedule.parse(controller["schedule"], CONTROLLER, T_s, controller)
        ),
    ]
    return Drive(
        plant,
        controller,
        pmsm_sim.motor.load(plant["motor"]),
        mfpcc_controller.motor.load(controller["motor"]),
        tuple(sorted(changes, key=lambda change: change[0])),
    )


#: What a batch tells of each run besides the figures of merit.
OUTCOME = np.dtype(
    [
        ("steady", np.int8),  # of the window: 1 yes, 0 no, -1 cannot be judged
        ("i_peak", np.float64),  # largest amplitude of the true current in the whole run (A)
        ("i_peak_over_limit", np.float64),  # the same over the motor's current limit
        ("faults_plant", np.uint32),  # latched faults, bit by bit
        ("faults_controller", np.uint32),
        ("fell_back", np.bool_),  # the fallback scheme controlled at the end
        ("ran_away", np.bool_),  # beyond what can be simulated: no figures
        ("figures", np.float64, (N_FIGURES,)),
    ],
    align=True,
)

#: Names of `figures`, in their order.
FIGURES = (*KEYS, *BESIDES)


class _Kept(Generic[Part]):
    """What was set up before, for drives that begin alike."""

    def __init__(self) -> None:
        self._key: tuple[Any, ...] = ()
        self._kept: Part | None = None
        self._twin: Part | None = None

    def get(
        self,
        key: tuple[Any, ...],
        set_up: Callable[[], Part],
        begin: Callable[[Part, Part], None],
    ) -> Part:
        """
        Return one for this key.

        Where nothing but the key differs from run to run, none is kept. Else `begin(twin, kept)`
        has a second one begin as the one that is kept.
        """
        if not key or key != self._key:
            self._key, self._kept = key, None
            return set_up()
        if self._kept is None:
            self._kept = set_up()
        if self._twin is None:
            self._twin = set_up()
        begin(self._twin, self._kept)
        return self._twin


class Batch:
    """
    Room for runs of the same length and window, one after the other.

    Parameters
    ----------
    periods : int
        Of each run.
    window_s : tuple of float
        From when to when it is measured (s).
    pwm_frequency : float
        (Hz)
    oversampling : int
        Points of the waveform per period of the window.
    """

    def __init__(
        self, periods: int, window_s: tuple[float, float], pwm_frequency: float, oversampling: int
    ) -> None:
        self.periods = periods
        self.T_s = 1.0 / pwm_frequency
        self._first, self._end = window_periods(window_s, self.T_s)
        self._end = min(self._end, periods)
        n = self._end - self._first
        self.signals = np.empty((len(SIGNALS), n))
        self.i_abc = np.zeros((n, 3 * oversampling))
        self._legs = np.zeros(oversampling, np.uint8)
        self._seen, self._unseen = np.zeros(1, _STATE), np.zeros(1, _STATE)
        kinds = (DutyCommand, PhaseFeedback, DriveState, LutDiagnostics)
        self._messages = [Wire(kind).fixed for kind in kinds]
        self._fresh = [message.copy() for message in self._messages]
        self._plants, self._controllers = _Kept[Plant](), _Kept[Controller]()
        self._advance: Any = None
        self._measure: Any = None

    def run(self, drives: Iterable[Drive]) -> NDArray[np.void]:
        """
        Run drives and measure them.

        Returns
        -------
        structured array of `OUTCOME`, shape (n,)
        """
        outcomes = []
        for drive in drives:
            outcome = np.zeros(1, OUTCOME)
            self.one(drive, outcome)
            outcomes.append(outcome)
        return np.concatenate(outcomes) if outcomes else np.zeros(0, OUTCOME)

    def one(self, drive: Drive, outcome: NDArray[np.void]) -> tuple[Plant, Controller]:
        """
        Run a drive. `outcome` has one row, of `OUTCOME`.

        Returns plant and controller as they are at the end, which the next drive may change.
        """
        plant = self._plants.get(
            drive.plant_key,
            lambda: Plant(drive.plant, drive.plant_motor),
            lambda plant, like: plant.begin_as(like, seed=drive.plant["seed"]),
        )
        controller = self._controllers.get(
            drive.controller_key,
            lambda: Controller(drive.controller, drive.controller_motor),
            Controller.begin_as,
        )
        seen, row = self._begin(drive), outcome[0]
        arguments = [plant.par, plant.st, controller.cfg, controller.mem, *self._messages, seen]
        if self._advance is None:
            self._advance = direct(
                _advance, *arguments, self.periods, self.signals, self.i_abc, self._legs
            )
            self._measure = direct(_measured, seen, self.signals, self.i_abc, row["figures"])
        try:
            for period, of_plant, of_controller in drive.changes:
                self._advance(*arguments, period, self.signals, self.i_abc, self._legs)
                if of_plant:
                    plant.apply(of_plant)
                if of_controller:
                    controller.apply(of_controller)
            self._advance(*arguments, self.periods, self.signals, self.i_abc, self._legs)
            row["steady"] = self._measure(seen, self.signals, self.i_abc, row["figures"])
        except PlantError:
            row["ran_away"] = True
            row["figures"] = np.nan
        row["i_peak"] = seen["i_peak"][0]
        row["i_peak_over_limit"] = row["i_peak"] / drive.controller_motor.i_max
        row["faults_plant"] = plant.st["latch"]["faults"][0]
        row["faults_controller"] = controller.mem["guard"]["latch"]["faults"][0]
        row["fell_back"] = controller.fallen
        return plant, controller

    def _begin(self, drive: Drive) -> NDArray[np.void]:
        motor, seen = drive.controller_motor, self._seen
        seen[:] = self._unseen
        seen["first"], seen["end"] = self._first, self._end
        seen["active"] = -1
        course = seen["course"]
        course["T_s"] = self.T_s
        course["n_p"], course["i_max"] = motor.n_p, motor.i_max
        course["w_max"] = motor.speed_max_rpm * RPM
        course["tau_max"] = 1.5 * motor.n_p * motor.psi_f * motor.i_max
        course["changed"] = any(
            self._first < period < self._end and {*of_plant, *of_controller} != {"scheme"}
            for period, of_plant, of_controller in drive.changes
        )
        for message, fresh in zip(self._messages, self._fresh, strict=True):
            message[:] = fresh
        return seen

"""Any commands at any time, with any parameters: the state stays finite, and no trip is missed.

The oracle is written anew from the table of faults in docs/reliability.md; it shares no code with
the plant.
"""

from __future__ import annotations

import math

import fuzz
import numpy as np
from mfpcc_msgs.msg import DriveState, DutyCommand, PhaseFeedback

from pmsm_sim.parameters import TABLE
from pmsm_sim.plant import ACCEPTED, Plant, PlantError, advance, latch
from pwm_node.parameters import ParameterError
from pwm_node.wire import fixed_dtype

PERIODS = 100
COMMAND, FEEDBACK, STATE = map(fixed_dtype, (DutyCommand, PhaseFeedback, DriveState))
#: A decision this near to its limit may be rounded either way.
ABOVE = 1.0 + 1e-9


def make_command(rng: np.random.Generator, k: int) -> np.ndarray:
    """A command for period k, sometimes with something wrong in it."""
    cmd = np.zeros(1, COMMAND)
    cmd["period"], cmd["duty"], cmd["enable"] = k, rng.random(3), rng.random() < 0.9
    kind = rng.integers(12)
    if kind == 0:
        cmd["duty"][0, rng.integers(3)] = fuzz.any_float(rng)
    elif kind == 1:
        cmd["duty"] = [fuzz.any_float(rng) for _ in range(3)]
    elif kind == 2:
        cmd["period"] = max(0, k + int(rng.integers(-3, 4)))
    elif kind == 3:
        cmd["period"] = fuzz.any_integer(rng)
    elif kind == 4:
        cmd["duty"] = rng.integers(0, 2, 3)
    return cmd


class Oracle:
    """What the inverter has to do, told from the commands and the truth at each period's start."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.duty: list[float] | None = None  # of a valid command for the period at hand
        self.enable = True
        self.armed = False
        self.missing = 0
        self.tripped = False
        self.awaits_off = False

    def take(self, cmd: np.void) -> bool:
        """Judge a command; returns whether it is to be followed."""
        k = int(self.plant.st["period"][0])
        duty = [float(d) for d in cmd["duty"]]
        valid = int(cmd["period"]) == k > 0 and all(0.0 <= d <= 1.0 for d in duty)
        if self.duty is not None or not valid:
            return False
        self.duty, self.enable = duty, bool(cmd["enable"])
        return True

    def begin(self) -> None:
        """What the period that begins now must not miss."""
        plant, st, par = self.plant, self.plant.st[0], self.plant.par[0]
        values = plant._values
        if self.duty is not None:
            self.armed, self.missing = True, 0
            if not self.enable:
                self.awaits_off = False
        elif self.armed:
            self.missing += 1
            self.tripped |= self.missing >= values["inverter.command_loss_limit"]
        current = math.hypot(st["i_d"], st["i_q"])
        self.tripped |= not current <= ABOVE * values["fault.overcurrent"] * plant.motor.i_max
        u_dc = st["u_dc"] if par["rectifier"] and st["general_before"] else values["dc_voltage"]
        self.tripped |= not u_dc <= ABOVE * values["fault.dc_overvoltage"] * plant.motor.u_dc
        low = values["fault.dc_undervoltage"] * plant.motor.u_dc
        self.tripped |= self.armed and u_dc * ABOVE < low

    def end(self, state: np.void) -> None:
        """Compare with what was done."""
        st = self.plant.st[0]
        if state["gates_on"]:
            assert not self.tripped, "gates on after a trip"
            assert not self.awaits_off, "gates on before a command has had them off"
            assert self.enable, "gates on without leave"
            assert self.armed or int(state["period"]) == 0, "gates on without a first command"
        hold = self.plant._values["inverter.missing_command"] == "hold"
        if self.missing and not (hold and self.missing == 1) and not self.plant.par["modulator"][0]:
            assert np.all(st["duty"] == 0.5), "no zero vector without a command"
        self.duty = None


def disturb(rng: np.random.Generator, plant: Plant, oracle: Oracle) -> None:
    """What an operator does in between."""
    kind = rng.integers(4)
    if kind == 0:
        if not plant.clear_faults():
            oracle.awaits_off |= oracle.tripped
            oracle.tripped = False
            oracle.missing = 0
    elif kind == 1:
        plant.stop()
        oracle.tripped = True
    else:
        changes = {
            name: value
            for name, value in fuzz.legal_values(TABLE, rng, 0.02).items()
            if not TABLE[name].read_only and name != "fault.react"
        }
        try:
            plant.apply(TABLE.validate(changes, plant._values))
        except ParameterError:
            return  # against a rule across parameters


def run(rng: np.random.Generator, values: dict[str, object]) -> None:
    plant = Plant(TABLE.complete({**values, "fault.react": True, "oversampling": 3}))
    oracle = Oracle(plant)
    feedback = np.zeros(PERIODS, FEEDBACK)
    state = np.zeros(PERIODS, STATE)
    i_abc, legs = np.zeros((PERIODS, 9)), np.zeros(3, np.uint8)
    missing, busy = rng.choice([0.0, 0.1, 0.7]), rng.choice([0.0, 0.02, 0.2])
    for k in range(PERIODS):
        if rng.random() < busy:
            disturb(rng, plant, oracle)
        for _ in range(0 if rng.random() < missing else int(rng.integers(1, 4))):
            cmd = make_command(rng, k)
            assert (latch(plant.st, cmd) == ACCEPTED) == oracle.take(cmd[0])
        oracle.begin()
        now = slice(k, k + 1)
        advance(plant.par, plant.st, feedback[now], state[now], i_abc[k], legs)
        oracle.end(state[k])
    assert feedback["period"].tolist() == state["period"].tolist() == list(range(PERIODS))
    for record in (feedback, state):
        for name in set(record.dtype.names) - {"stamp"}:
            assert np.all(np.isfinite(record[name])), (name, record[name])
    assert np.all(np.isfinite(i_abc))


def test_any_commands() -> None:
    for rng in fuzz.cases(60):
        run(rng, {})


def test_any_commands_with_any_parameters() -> None:
    for rng in fuzz.cases(30):
        try:
            run(rng, fuzz.legal_values(TABLE, rng, rng.choice([0.02, 0.1, 0.5])))
        except PlantError:
            continue  # a thousand times the load at a hundred times the speed: said, not sent

"""From what varies in a row to the drive of its run, without the way through a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pmsm_sim.motor
from mfpcc_controller.motor import EstimatedPars
from mfpcc_controller.parameters import SCHEMES
from mfpcc_experiments.running import Scenario
from mfpcc_experiments.running import scenario as scenarios
from mfpcc_experiments.running.batch import Drive, drive_of
from mfpcc_experiments.sweeping.errors import SweepError
from pmsm_sim.motor import MotorPars
from pwm_node.names import unknown
from pwm_node.parameters import ParameterError
from pwm_node.schedule import period_of
from pwm_node.yaml_files import validated

# What every run of a sweep needs to have, so that its figures are those of its recording.
_REQUIRED = {
    "state_decimation": ("plant", 1),
    "real_time_factor": ("plant", 0.0),
    "fault_injection": ("plant", False),
    "diagnostics_decimation": ("controller", 1),
}

# What cannot vary within a sweep, and why.
_FIXED = {
    **dict.fromkeys(
        ("duration", "window_s", "pwm_frequency", "oversampling"),
        "is the same in all runs of a sweep: give it in 'set'",
    ),
    **dict.fromkeys(_REQUIRED, "cannot vary in a sweep"),
    "scheme": "does not vary: name the schemes in 'schemes'",
    "schedule": "varies entry by entry: 'schedule[0].NAME'",
}


@dataclass(frozen=True)
class Place:
    """
    Where the values of something that varies go.

    Attributes
    ----------
    plant, controller : str
        Name of the parameter there; empty: nothing goes there.
    motor : str
        Entry of the motor file; `*` for all of it.
    scheduled : tuple of (int, str)
        Entry of the experiment's schedule, -1 for none, and the parameter.
    whole : bool
        Whether its values are whole numbers.
    """

    plant: str = ""
    controller: str = ""
    motor: str = ""
    scheduled: tuple[int, str] = (-1, "")
    whole: bool = False


def place(base: Scenario, name: str) -> Place:
    """
    Find out where something that varies goes.

    Raises
    ------
    ParameterError
        If there is nothing of this name, or it cannot vary.
    """
    if name in _FIXED:
        raise ParameterError(f"'{name}' {_FIXED[name]}")
    if name == "seed":
        return Place(plant="seed", whole=True)
    if name == "motor":
        return Place(motor="*")
    if name == "speed_rpm":
        return Place(
            plant="" if "initial_speed_rpm" in base.plant else "initial_speed_rpm",
            controller="" if "speed_ref_rpm" in base.controller else "speed_ref_rpm",
        )
    part, _, entry = name.partition(".")
    if part == "motor":
        fields = MotorPars.model_fields
        if entry not in fields or fields[entry].annotation not in (int, float):
            numbers = [n for n, f in fields.items() if f.annotation in (int, float)]
            raise ParameterError(unknown("entry of a motor file", entry, numbers))
        return Place(motor=entry, whole=fields[entry].annotation is int)
    found = scenarios.scheduled(base, name)
    if found is not None:
        owner, parameter = _resolved(found[1])
        return Place(scheduled=found, whole=scenarios.TABLES[owner][parameter].kind == "int")
    owner, parameter = _resolved(name)
    if parameter in _FIXED or parameter in scenarios.ELSEWHERE:
        raise ParameterError(f"'{name}' {_FIXED.get(parameter, 'cannot vary in a sweep')}")
    whole = scenarios.TABLES[owner][parameter].kind == "int"
    if owner == "controller":
        return Place(controller=parameter, whole=whole)
    told = parameter == scenarios.TOLD and scenarios.TOLD not in base.controller
    return Place(plant=parameter, controller=parameter if told else "", whole=whole)


def _resolved(name: str) -> tuple[str, str]:
    try:
        return scenarios.resolve(name, ("speed_rpm", "motor", "seed"))
    except ValueError as error:
        raise ParameterError(str(error)) from None


def check(base: Scenario, name: str, where: Place, value: Any) -> None:
    """
    Look at one value of what varies.

    Raises
    ------
    ParameterError, pwm_node.yaml_files.FileError
        If it cannot be.
    """
    if where.motor == "*":
        pmsm_sim.motor.load(str(value))
    elif where.motor:
        _motor(pmsm_sim.motor.load(base.motor), {where.motor: value})
    elif where.scheduled[0] >= 0:
        owner, parameter = _resolved(where.scheduled[1])
        scenarios.TABLES[owner][parameter].validate(value)
    else:
        for part, parameter in (("plant", where.plant), ("controller", where.controller)):
            if parameter:
                scenarios.TABLES[part][parameter].validate(value)


def _motor(motor: MotorPars, entries: Mapping[str, Any]) -> MotorPars:
    return validated({**motor.model_dump(), **entries}, MotorPars)


class _Noted(dict[str, Any]):
    """Values that note which of them are looked at."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        super().__init__(values)
        self.read: set[str] = set()

    def __getitem__(self, name: str) -> Any:
        self.read.add(name)
        return super().__getitem__(name)


class Drives:
    """
    Makes the drives of rows.

    All that is the same in all rows is read once.

    Parameters
    ----------
    base : Scenario
        The experiment of the sweep.
    scheme : str
        Who controls.
    places : mapping of str to Place
        What varies.
    motors : mapping of str to MotorPars
        The motor files, by their names.

    Raises
    ------
    SweepError
        If the experiment is none that a sweep can run.
    """

    def __init__(
        self,
        base: Scenario,
        scheme: str,
        places: Mapping[str, Place],
        motors: Mapping[str, MotorPars],
    ) -> None:
        self.base, self._places = base, places
        plant, controller = base.node_parameters(scheme, 0)
        for name, (part, value) in _REQUIRED.items():
            if (plant if part == "plant" else controller)[name] != value:
                raise SweepError(f"a sweep runs with '{name}' = {value} only")
        self._drive = drive_of(plant, controller)
        self._motors = {
            name: (motor, EstimatedPars.model_validate(motor.model_dump()))
            for name, motor in motors.items()
        }
        self._follows = "dc_voltage" not in base.plant
        self._checked = [
            part
            for part, values in (("plant", plant), ("controller", controller))
            if self._depends(part, values)
        ]
        self._of_the_motor = [name for name, where in places.items() if where.motor]
        self._of_plant = [n for n, where in places.items() if where.plant and n != "seed"]
        self._of_controller = [name for name, where in places.items() if where.controller]
        for change in self._drive.changes:
            if change[2].get("scheme", SCHEMES[0]) not in SCHEMES:
                raise SweepError("a sweep runs compiled schemes only, no plug-ins")

    def _depends(self, part: str, values: Mapping[str, Any]) -> bool:
        """Whether a rule across the parameters of a node is about one that varies."""
        noted = _Noted(values)
        scenarios.TABLES[part].rule(noted)
        return any(getattr(where, part) in noted.read for where in self._places.values())

    def drive(self, values: Mapping[str, Any]) -> Drive:
        """
        The drive of one row.

        Parameters
        ----------
        values : mapping
            What varies, by name, and the seed.

        Raises
        ------
        SweepError
            If the values are not acceptable together.
        """
        plant, controller = {**self._drive.plant}, {**self._drive.controller}
        motor, changes = str(values.get("motor", self.base.motor)), self._drive.changes
        entries: dict[str, Any] = {}
        plant["seed"] = values["seed"]
        for name, where in self._places.items():
            value = values[name]
            if where.plant:
                plant[where.plant] = value
            if where.controller:
                controller[where.controller] = value
            if where.motor not in ("", "*"):
                entries[where.motor] = value
            if where.scheduled[0] >= 0:
                changes = self._rescheduled(changes, where.scheduled, value)
        plant["motor"] = controller["motor"] = motor
        of_plant, of_controller = self._motors[motor]
        if entries:
            of_plant = _motor(of_plant, entries)
            of_controller = EstimatedPars.model_validate(of_plant.model_dump())
        if self._follows and "dc_voltage" not in self._places:
            plant["dc_voltage"] = of_plant.u_dc
        for part in self._checked:
            reason = scenarios.TABLES[part].rule(plant if part == "plant" else controller)
            if reason is not None:
                raise SweepError(reason)
        begin = motor, *(values[name] for name in self._of_the_motor)
        return Drive(
            plant,
            controller,
            of_plant,
            of_controller,
            changes,
            (*begin, *(values[name] for name in self._of_plant)),
            (*begin, *(values[name] for name in self._of_controller)),
        )

    def _rescheduled(self, changes: Any, scheduled: tuple[int, str], value: Any) -> Any:
        """The changes with another value of one entry of the schedule."""
        number, name = scheduled
        owner, parameter = _resolved(name)
        at = self.base.schedule[number]["at"]
        period = period_of(at, 1.0 / self.base.pwm_frequency)
        found = []
        for when, of_plant, of_controller in changes:
            if when == period and parameter in (of_plant if owner == "plant" else of_controller):
                if owner == "plant":
                    of_plant = {**of_plant, parameter: value}
                else:
                    of_controller = {**of_controller, parameter: value}
            found.append((when, of_plant, of_controller))
        return tuple(found)

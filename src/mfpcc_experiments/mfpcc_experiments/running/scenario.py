"""
A scenario: one experiment as data (`config/experiments/*.yaml`), without ROS.

A scenario is the parameters that both nodes start with, and the changes of parameters at given
simulated times: load steps, speed steps, switches of the scheme and mismatch are all the same
mechanism. It holds nothing that the nodes do not offer as parameters, so whatever it does can be
done by hand with `ros2 param set`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from mfpcc_controller.parameters import TABLE as CONTROLLER
from pmsm_sim.parameters import TABLE as PLANT
from pwm_node import yaml_files
from pwm_node.names import unknown
from pwm_node.parameters import ParameterError, Table

_TABLES: Mapping[str, Table] = {"plant": PLANT, "controller": CONTROLLER}

# Parameters that a scenario's sections may not set, and where they come from instead.
_ELSEWHERE = {
    "motor": "stands at the top of the file, for both nodes",
    "pwm_frequency": "stands at the top of the file, for both nodes",
    "schedule": "stands at the top of the file, for both nodes",
    "periods": "follows from 'duration'",
    "scheme": "is chosen by --scheme when the experiment is run",
    "seed": "is chosen by --seed when the experiment is run",
}


def _owner(name: str) -> str:
    """Which of the two nodes a parameter belongs to; an unknown name raises with the nearest."""
    for part, table in _TABLES.items():
        if name in table:
            return part
    raise ValueError(
        unknown("parameter", name, [n for t in _TABLES.values() for n in t if n not in _ELSEWHERE])
    )


def _validated(part: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Values in their parameters' types."""
    try:
        return dict(_TABLES[part].validate(values))
    except ParameterError as error:
        raise ValueError(error.reason) from None


def _section(part: str) -> AfterValidator:
    """Check of the section `plant:` or `controller:` against that node's table."""

    def check(values: dict[str, Any]) -> dict[str, Any]:
        for name in values:
            if name in _ELSEWHERE:
                raise ValueError(f"'{name}' {_ELSEWHERE[name]}")
            owner = _owner(name)
            if owner != part:
                raise ValueError(f"'{name}' is a parameter of the {owner}: move it to '{owner}'")
        return _validated(part, values)

    return AfterValidator(check)


def _check_change(change: dict[str, Any]) -> dict[str, Any]:
    """Check one entry of the schedule: `at`, and parameters that can change while it runs."""
    at = change.get("at")
    if isinstance(at, bool) or not isinstance(at, (int, float)) or not math.isfinite(at):
        raise ValueError("the time is missing or no number; expected {at: SECONDS, NAME: VALUE}")
    checked: dict[str, Any] = {"at": float(at)}
    for name in (key for key in change if key != "at"):
        owner = _owner(name)
        if _TABLES[owner][name].read_only:
            raise ValueError(f"'{name}' is fixed at start: it cannot be in the schedule")
        checked.update(_validated(owner, {name: change[name]}))
    if len(checked) == 1:
        raise ValueError("it changes nothing; expected {at: SECONDS, NAME: VALUE}")
    return checked


def _check_motor(motor: str) -> str:
    """A motor that there is; a path stays what it is."""
    try:
        yaml_files.find("motors", motor)
    except yaml_files.FileError as error:
        raise ValueError(str(error)) from None
    return motor


class Scenario(BaseModel):
    """
    One experiment, for any scheme.

    Attributes
    ----------
    name : str
        The file's name without its ending, unless the file says otherwise.
    description : str
        One line for `mfpcc list` and for the report.
    motor : str
        A name of `config/motors`, or the path of a motor file.
    pwm_frequency : float
        PWM and control frequency (Hz).
    speed_rpm : float
        Mechanical speed at the start, and the first speed reference (r/min). `plant` and
        `controller` may say otherwise with `initial_speed_rpm` and `speed_ref_rpm`.
    duration : float
        Simulated time (s).
    window_s : tuple of float
        Start and end of the time that the metrics are taken from (s).
    plant, controller : dict
        What differs from the defaults of the simulator's and the controller's parameters.
    schedule : list of dict
        Changes while it runs: `at` (s) and the parameters' new values.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = ""
    description: str = ""
    motor: Annotated[str, AfterValidator(_check_motor)]
    pwm_frequency: float = Field(default=10_000.0, ge=1_000.0, le=100_000.0)
    speed_rpm: float = Field(default=0.0, ge=-1e5, le=1e5)
    duration: float = Field(gt=0, le=3_600.0, description="simulated time, s")
    window_s: tuple[float, float] = Field(description="[start, end] of the evaluated time, s")
    plant: Annotated[dict[str, Any], _section("plant")] = {}
    controller: Annotated[dict[str, Any], _section("controller")] = {}
    schedule: list[Annotated[dict[str, Any], AfterValidator(_check_change)]] = []

    @model_validator(mode="after")
    def _check_times(self) -> Scenario:
        start, end = self.window_s
        if not 0.0 <= start < end <= self.duration:
            raise ValueError(
                f"'window_s' must be [start, end] with 0 <= start < end <= duration "
                f"({self.duration:g} s); it is [{start:g}, {end:g}]"
            )
        for number, change in enumerate(self.schedule):
            if not 0.0 <= change["at"] < self.duration:
                raise ValueError(
                    f"'schedule[{number}].at' must lie in 0 to {self.duration:g} s, the duration; "
                    f"it is {change['at']:g}"
                )
        return self

    @property
    def periods(self) -> int:
        """Number of PWM periods."""
        return round(self.duration * self.pwm_frequency)

    def node_parameters(self, scheme: str, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
        """
        Parameters that the two nodes start with.

        Parameters
        ----------
        scheme : str
            Who controls the current at the start.
        seed : int
            Seed of all noise.

        Returns
        -------
        plant, controller : dict
            Complete and validated: every parameter of each node's table.

        Raises
        ------
        ParameterError
            If there is no such scheme, or the seed is out of its range.
        """
        both = {"motor": self.motor, "pwm_frequency": self.pwm_frequency}
        plant = PLANT.complete(
            {
                "initial_speed_rpm": self.speed_rpm,
                **self.plant,
                **both,
                "seed": seed,
                "periods": self.periods,
                "schedule": self._entries("plant"),
            }
        )
        # in lock-step what happens must not depend on how fast the machine is
        in_lock_step = {"fault.feedback_timeout": 0.0} if plant["real_time_factor"] == 0.0 else {}
        controller = {
            "speed_ref_rpm": self.speed_rpm,
            **in_lock_step,
            **self.controller,
            **both,
            "scheme": scheme,
            "schedule": self._entries("controller"),
        }
        return plant, CONTROLLER.complete(controller)

    def _entries(self, part: str) -> list[str]:
        """The schedule of one node as its parameter wants it: 'SECONDS NAME VALUE'."""
        return [
            f"{change['at']!r} {name} {_yaml_scalar(value)}"
            for change in self.schedule
            for name, value in change.items()
            if name != "at" and _owner(name) == part
        ]


def _yaml_scalar(value: Any) -> str:
    """YAML of a value on one line (JSON will not do: YAML 1.1 reads its 1e-05 as a text)."""
    text: str = yaml.safe_dump(value, default_flow_style=True, width=math.inf)
    return text.removesuffix("\n").removesuffix("\n...")


def load(name_or_path: str | Path) -> Scenario:
    """
    Read a scenario.

    Parameters
    ----------
    name_or_path : str or Path
        A name of `config/experiments`, or the path of a file.

    Raises
    ------
    pwm_node.yaml_files.FileError
        If there is none, or its content is not a scenario: file, key, what is expected.
    """
    path = yaml_files.find("experiments", name_or_path)
    scenario = yaml_files.load(path, Scenario)
    return scenario if scenario.name else scenario.model_copy(update={"name": path.stem})

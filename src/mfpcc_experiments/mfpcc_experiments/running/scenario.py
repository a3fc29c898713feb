"""
A scenario: one experiment as data (`config/experiments/*.yaml`), without ROS.

A scenario is the parameters that both nodes start with, and the changes of parameters at given
simulated times: load steps, speed steps, switches of the scheme and mismatch are all the same
mechanism. It holds nothing that the nodes do not offer as parameters, so whatever it does can be
done by hand with `ros2 param set`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from mfpcc_controller.parameters import TABLE as CONTROLLER
from pmsm_sim.parameters import TABLE as PLANT
from pwm_node import yaml_files
from pwm_node.names import unknown
from pwm_node.parameters import ParameterError, Table

#: The parameters of the two nodes.
TABLES: Mapping[str, Table] = {"plant": PLANT, "controller": CONTROLLER}

#: Parameters that a scenario's sections may not set, and where they come from instead.
ELSEWHERE = {
    "motor": "stands at the top of the file, for both nodes",
    "pwm_frequency": "stands at the top of the file, for both nodes",
    "schedule": "stands at the top of the file, for both nodes",
    "periods": "follows from 'duration'",
    "scheme": "is chosen by --scheme when the experiment is run",
    "seed": "is chosen by --seed when the experiment is run",
    "recorders": "is set by what records",
}

#: A parameter of the plant that the controller is told as well, unless its section says otherwise.
TOLD = "load.inertia"

# Keys of the file that are no section: what may be said otherwise with `changed`.
_KEYS = ("motor", "pwm_frequency", "speed_rpm", "duration", "window_s")


def resolve(name: str, beside: Iterable[str] = ()) -> tuple[str, str]:
    """
    Which of the two nodes a parameter belongs to, and what that node calls it.

    Parameters
    ----------
    name : str
        As the node calls it, if only one of them has it; else `plant.NAME` or `controller.NAME`.
    beside : iterable of str
        What else could have been meant.

    Raises
    ------
    ValueError
        If there is none of this name, with the nearest; or if both nodes have one.
    """
    part, _, rest = name.partition(".")
    if part in TABLES and rest:
        if rest not in TABLES[part]:
            raise ValueError(TABLES[part].unknown(rest).reason)
        return part, rest
    parts = [part for part, table in TABLES.items() if name in table]
    if len(parts) > 1 and name not in (*ELSEWHERE, TOLD):
        raise ValueError(
            f"both nodes have a parameter '{name}': say which one is meant, "
            + " or ".join(f"'{part}.{name}'" for part in parts)
        )
    if parts:
        return parts[0], name
    names = {n for table in TABLES.values() for n in table if n not in ELSEWHERE}
    also = {other: n for table in TABLES.values() for other, n in table.also.items()}
    raise ValueError(unknown("parameter", name, names | set(beside), also))


def _validated(part: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Values in their parameters' types."""
    try:
        return dict(TABLES[part].validate(values))
    except ParameterError as error:
        raise ValueError(error.reason) from None


def _section(part: str) -> AfterValidator:
    """Check of the section `plant:` or `controller:` against that node's table."""

    def check(values: dict[str, Any]) -> dict[str, Any]:
        for name in values:
            if name in ELSEWHERE:
                raise ValueError(f"'{name}' {ELSEWHERE[name]}")
            if name not in TABLES[part]:
                owner, parameter = resolve(name)
                where = f"move it to '{owner}'" if owner != part else f"here it is '{parameter}'"
                raise ValueError(f"'{name}' is a parameter of the {owner}: {where}")
        return _validated(part, values)

    return AfterValidator(check)


def _check_change(change: dict[str, Any]) -> dict[str, Any]:
    """Check one entry of the schedule: `at`, and parameters that can change while it runs."""
    at = change.get("at")
    if isinstance(at, bool) or not isinstance(at, (int, float)) or not math.isfinite(at):
        raise ValueError("the time is missing or no number; expected {at: SECONDS, NAME: VALUE}")
    checked: dict[str, Any] = {"at": float(at)}
    for name in (key for key in change if key != "at"):
        owner, parameter = resolve(name)
        if TABLES[owner][parameter].read_only:
            raise ValueError(f"'{name}' is fixed at start: it cannot be in the schedule")
        checked[name] = _validated(owner, {parameter: change[name]})[parameter]
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
        Changes while it runs: `at` (s) and the parameters' new values. A parameter that both nodes
        have is named `plant.NAME` or `controller.NAME`.
    changes : dict
        What a run was to do otherwise than the file says (see `changed`); not in a file.
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
    changes: dict[str, Any] = {}

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
            TOLD: plant[TOLD],
            **self.controller,
            **both,
            "scheme": scheme,
            "schedule": self._entries("controller"),
        }
        return plant, CONTROLLER.complete(controller)

    def _entries(self, part: str) -> list[str]:
        """The schedule of one node as its parameter wants it: 'SECONDS NAME VALUE'."""
        return [
            f"{change['at']!r} {parameter} {_yaml_scalar(value)}"
            for change in self.schedule
            for name, value in change.items()
            if name != "at"
            for owner, parameter in [resolve(name)]
            if owner == part
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
    if scenario.changes:
        raise yaml_files.FileError(
            f"{path}: 'changes' is not for files: write the values into 'plant' and 'controller'"
        )
    return scenario if scenario.name else scenario.model_copy(update={"name": path.stem})


def changed(scenario: Scenario, changes: Iterable[str]) -> Scenario:
    """
    The scenario with other values than its file says.

    Parameters
    ----------
    scenario : Scenario
        What the file says.
    changes : iterable of str
        NAME=VALUE each, as on a command line: a key of the file (`duration=0.5`,
        `window_s=[0.1, 0.5]`) or a parameter of one of the nodes (`mls.window=10`), with `plant.`
        or `controller.` before it if both have it. Of several for one name the last counts.

    Raises
    ------
    pwm_node.parameters.ParameterError
        If a name or a value is not acceptable, by the rules of the file and of the node.
    """
    values = scenario.model_dump()
    places: dict[str, tuple[str, str]] = {}
    for text in changes:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals):
            raise ParameterError(f"'{text}': NAME=VALUE is expected")
        if name in _KEYS:
            values[name] = value.strip("[]").split(",") if name == "window_s" else value
            places[name] = "", name
            continue
        if name in ELSEWHERE:
            raise ParameterError(f"'{name}' {ELSEWHERE[name]}")
        try:
            part, parameter = resolve(name, _KEYS)
        except ValueError as error:
            raise ParameterError(str(error)) from None
        values[part][parameter] = TABLES[part][parameter].parse(value)
        places[name] = part, parameter
    return _revised(scenario, values, places)


def with_parameters(
    scenario: Scenario, *, plant: Mapping[str, Any], controller: Mapping[str, Any]
) -> Scenario:
    """
    The scenario with other parameters of the two nodes than its file says.

    Parameters
    ----------
    scenario : Scenario
        What the file says.
    plant, controller : mapping
        Values by the names of the node's parameters.

    Raises
    ------
    pwm_node.parameters.ParameterError
        If a name or a value is not acceptable, by the rules of the file and of the node.
    """
    values = scenario.model_dump()
    places: dict[str, tuple[str, str]] = {}
    for part, changes in (("plant", plant), ("controller", controller)):
        values[part].update(changes)
        for name in changes:
            of_both = all(name in table for table in TABLES.values())
            places[f"{part}.{name}" if of_both else name] = part, name
    return _revised(scenario, values, places)


def _revised(
    scenario: Scenario, values: dict[str, Any], places: Mapping[str, tuple[str, str]]
) -> Scenario:
    """The scenario of some values; it tells those at some places (section, key) as its changes."""
    try:
        found = yaml_files.validated(values, Scenario)
    except yaml_files.FileError as error:
        raise ParameterError(str(error)) from None
    listed = {
        name: getattr(found, part)[key] if part else getattr(found, key)
        for name, (part, key) in places.items()
    }
    return found.model_copy(update={"changes": {**scenario.changes, **listed}})


def varied(scenario: Scenario, values: Mapping[str, Any]) -> Scenario:
    """
    The scenario with other values, of its schedule too.

    Parameters
    ----------
    scenario : Scenario
        What the file says.
    values : mapping
        By the name of a key or a parameter, as with `changed`, or `schedule[N].NAME`.

    Raises
    ------
    pwm_node.parameters.ParameterError
        If a name or a value is not acceptable, by the rules of the file and of the node.
    """
    content = scenario.model_dump()
    places: dict[str, tuple[str, str]] = {}
    for name, value in values.items():
        entry = scheduled(scenario, name)
        if entry is not None:
            number, parameter = entry
            content["schedule"][number][parameter] = value
        elif name in _KEYS:
            content[name] = value
            places[name] = "", name
        else:
            try:
                part, parameter = resolve(name, _KEYS)
            except ValueError as error:
                raise ParameterError(str(error)) from None
            content[part][parameter] = value
            places[name] = part, parameter
    return _revised(scenario, content, places)


def scheduled(scenario: Scenario, name: str) -> tuple[int, str] | None:
    """
    Which entry of the schedule a name such as `schedule[0].load_torque` means, and what of it.

    Returns
    -------
    tuple of (int, str), or None
        None where the name is of another kind.

    Raises
    ------
    pwm_node.parameters.ParameterError
        If there is no such entry.
    """
    found = re.fullmatch(r"schedule\[(\d+)\]\.(.+)", name)
    if found is None:
        return None
    number, parameter = int(found[1]), found[2]
    if number >= len(scenario.schedule) or parameter not in scenario.schedule[number]:
        raise ParameterError(
            f"'{name}': the schedule of the experiment has no such entry; it has "
            + (
                ", ".join(
                    f"schedule[{n}].{key}"
                    for n, entry in enumerate(scenario.schedule)
                    for key in entry
                    if key != "at"
                )
                or "none"
            )
        )
    return number, parameter

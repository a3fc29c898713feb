"""
The map of a measured file: what its columns are.

A map is a YAML file, in `config/maps` or anywhere. It names the columns and says how their numbers
become SI units; what it does not name is not known, and the import says what follows from that.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from pwm_node import yaml_files
from pwm_node.names import unknown

_DEGREE = math.pi / 180.0
_TURN = 2.0 * math.pi

#: What a column may be in, by quantity: how much of the SI unit it is.
UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "current": {"A": 1.0, "mA": 1e-3, "kA": 1e3},
    "voltage": {"V": 1.0, "mV": 1e-3, "kV": 1e3},
    "angle": {"rad": 1.0, "deg": _DEGREE, "turn": _TURN},
    "speed": {"rad/s": 1.0, "rpm": _TURN / 60.0, "deg/s": _DEGREE, "Hz": _TURN},
    "number": {"1": 1.0, "%": 1e-2},
}


class Column(BaseModel):
    """
    Where a quantity stands, and how its numbers become SI units: ``scale (number - zero)``.

    Attributes
    ----------
    column : str or int, optional
        Name of the column, or its place, counted from 1.
    constant : float, optional
        In the place of a column: the quantity did not change.
    unit : str, optional
        What the numbers are in; default: the SI unit.
    scale : float
        Multiplies them; negative where the sign is the other way round.
    zero : float
        The number that stands for nothing, as of a converter with an offset.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    column: str | Annotated[int, Field(ge=1, le=10_000)] | None = None
    constant: float | None = Field(default=None, allow_inf_nan=False)
    unit: str | None = None
    scale: float = Field(default=1.0, allow_inf_nan=False)
    zero: float = Field(default=0.0, allow_inf_nan=False)

    @model_validator(mode="after")
    def _check(self) -> Column:
        if (self.column is None) == (self.constant is None):
            raise ValueError("give either 'column' or 'constant'")
        if self.scale == 0.0:
            raise ValueError("'scale' is 0: nothing would be left of the column")
        return self


def _read(kind: str) -> BeforeValidator:
    """Reader of a column of a quantity: with a unit of it, or just its name."""

    def read(value: Any) -> Any:
        if isinstance(value, (str, int)) and not isinstance(value, bool):
            value = {"column": value}
        if isinstance(value, dict) and value.get("unit") is not None:
            unit = str(value["unit"])
            if unit not in UNITS[kind]:
                raise ValueError(unknown("unit", unit, UNITS[kind]))
            value = {**value, "scale": value.get("scale", 1.0) * UNITS[kind][unit]}
        return value

    return BeforeValidator(read)


Time = Annotated[Column, _read("time")]
Current = Annotated[Column, _read("current")]
Voltage = Annotated[Column, _read("voltage")]
Angle = Annotated[Column, _read("angle")]
Speed = Annotated[Column, _read("speed")]
Number = Annotated[Column, _read("number")]


class _Group(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    def columns(self) -> dict[str, Column]:
        """The columns that are given, by their keys."""
        return {
            name: value
            for name in type(self).model_fields
            if isinstance(value := getattr(self, name), Column)
        }


class Currents(_Group):
    """Phase currents, positive into the machine (A); the third follows from two."""

    a: Current | None = None
    b: Current | None = None
    c: Current | None = None

    @model_validator(mode="after")
    def _check(self) -> Currents:
        if len(self.columns()) < 2:
            raise ValueError("at least two of a, b, c are needed")
        return self


class Duties(_Group):
    """On-times of the upper switches; `full` is the number that stands for a whole period."""

    a: Number
    b: Number
    c: Number
    full: float = Field(default=1.0, gt=0, allow_inf_nan=False)


class Voltages(_Group):
    """Commanded phase voltages (V): of a, b, c, or of alpha, beta, or of d, q."""

    a: Voltage | None = None
    b: Voltage | None = None
    c: Voltage | None = None
    alpha: Voltage | None = None
    beta: Voltage | None = None
    d: Voltage | None = None
    q: Voltage | None = None

    @model_validator(mode="after")
    def _check(self) -> Voltages:
        if set(self.columns()) not in ({"a", "b", "c"}, {"alpha", "beta"}, {"d", "q"}):
            raise ValueError("a, b, c are needed, or alpha, beta, or d, q, and nothing else")
        return self


class Pair(_Group):
    """Two columns that belong together."""

    first: Number
    second: Number


class References(_Group):
    """References of the currents (A)."""

    d: Current
    q: Current


class Map(BaseModel):
    """
    What a measured file holds.

    Attributes
    ----------
    description, source : str
        For people.
    table : str
        In a ``.mat`` file: the structure that holds the columns.
    time, sample_time : Column, float
        One of them is needed: the time of a row (s), or the time between two rows.
    samples_per_period : int
        Rows per PWM period; the first of each is the sample.
    currents : Currents
    duties, voltages : Duties, Voltages
        What the inverter was told; one of them is needed.
    dc_voltage : Column
        (V)
    angle, electrical_angle, speed, electrical_speed : Column, optional
        Of the rotor (rad, rad/s). Without an angle it is integrated from the speed; without both
        the rotor counts as standing still.
    encoder_zero : float
        What the angle reads where the d axis lies on phase a (rad, of the same kind).
    pole_pairs : int, optional
        Default: the motor's.
    enable : Column, optional
        Whether the gates were on (not 0).
    references : References, optional
    vectors, dwell : Pair, optional
        The two active vectors and their shares of the period, as commands of this project hold
        them beside the duties.
    delay : int, optional
        Periods between the row in which a command stands and the period in which it acts; without
        it, it is estimated.
    sampling_lead : float
        How long before the row's period begins the currents are sampled, in periods.
    motor : str, optional
        Name or file of the motor.
    controller : dict
        Parameters of the controller that made the commands, if it was one of this project.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    description: str = ""
    source: str = ""
    table: str = ""
    time: Time | None = None
    sample_time: float | None = Field(default=None, gt=1e-7, lt=1.0)
    samples_per_period: int = Field(default=1, ge=1, le=10_000)
    currents: Currents
    duties: Duties | None = None
    voltages: Voltages | None = None
    dc_voltage: Voltage
    angle: Angle | None = None
    electrical_angle: Angle | None = None
    speed: Speed | None = None
    electrical_speed: Speed | None = None
    encoder_zero: float = Field(default=0.0, allow_inf_nan=False)
    pole_pairs: int | None = Field(default=None, ge=1, le=100)
    enable: Number | None = None
    references: References | None = None
    vectors: Pair | None = None
    dwell: Pair | None = None
    delay: int | None = Field(default=None, ge=-2, le=8)
    sampling_lead: float = Field(default=0.0, ge=0.0, le=1.0)
    motor: str | None = None
    controller: dict[str, Any] = {}

    @model_validator(mode="after")
    def _check(self) -> Map:
        for names, least in (
            (("time", "sample_time"), 1),
            (("duties", "voltages"), 1),
            (("angle", "electrical_angle"), 0),
            (("speed", "electrical_speed"), 0),
        ):
            given = [name for name in names if getattr(self, name) is not None]
            if not least <= len(given) <= 1:
                which = "one" if least else "at most one"
                raise ValueError(f"{which} of '{names[0]}' and '{names[1]}' is needed")
        if (self.vectors is None) != (self.dwell is None):
            raise ValueError("'vectors' and 'dwell' belong together")
        if self.vectors is not None and self.duties is None:
            raise ValueError("'vectors' and 'dwell' need 'duties'")
        if self.motor is not None:
            yaml_files.find("motors", self.motor)  # says what there is
        return self

    def columns(self) -> dict[str, Column]:
        """All columns by their quantity, such as `currents.a`."""
        found: dict[str, Column] = {}
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, Column):
                found[name] = value
            elif isinstance(value, _Group):
                found |= {f"{name}.{key}": column for key, column in value.columns().items()}
        return found


def load(name_or_path: str) -> Map:
    """
    Read the map of this name in `config/maps`, or of this file.

    Raises
    ------
    pwm_node.yaml_files.FileError
        If there is none, or its content is not a map: file, key, what is expected.
    """
    return yaml_files.load(yaml_files.find("maps", name_or_path), Map)

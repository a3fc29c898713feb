"""The parameter table of a node: names, types, limits, and how a change is checked.

One table says everything about a node's parameters. The node declares them from it, the ROS-free
engine takes its defaults from it, scenario files are checked against it, and the documentation is
generated from it. Nothing here imports rclpy, and nothing here has side effects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Union

import yaml

from pwm_node import names
from pwm_node.errors import ForPeople

Value = Union[bool, int, float, str, "list[str]", "list[float]"]

_KIND_NAMES = {
    "bool": "true or false",
    "int": "a whole number",
    "float": "a number",
    "str": "a text",
    "list[str]": "a list of texts",
    "list[float]": "a list of numbers",
}


class ParameterError(ForPeople, ValueError):
    """A parameter value that cannot be accepted; `reason` says why, for a person to read."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


@dataclass(frozen=True)
class Parameter:
    """One parameter of a node.

    Parameters
    ----------
    name : str
        Name as users type it, with dots between groups (``noise.current_rms``).
    default : Value
        Default value. It also fixes the type: bool, int, float, str, list[str] or list[float].
        An empty list is a list[str].
    description : str
        One sentence for people, without the unit.
    unit : str
        SI unit, or empty.
    minimum, maximum : float, optional
        Smallest and largest accepted value, both inclusive. For a list, of each element.
    choices : tuple of str
        The accepted texts, if only some are.
    read_only : bool
        True if the value is fixed at start.
    also : tuple of str
        Other names that people try, such as its symbol; a message then says the right one.
    """

    name: str
    default: Value
    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = False
    also: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """Name of the value type: bool, int, float, str, list[str] or list[float]."""
        if isinstance(self.default, list):
            numeric = bool(self.default) and not isinstance(self.default[0], str)
            return "list[float]" if numeric else "list[str]"
        return type(self.default).__name__

    @property
    def limits(self) -> str:
        """The accepted values as a phrase, or empty if there is no limit."""
        if self.choices:
            return f"one of: {', '.join(self.choices)}"
        unit = f" {self.unit}" if self.unit else ""
        if self.minimum is not None and self.maximum is not None:
            return f"{self.minimum:g} to {self.maximum:g}{unit}"
        if self.minimum is not None:
            return f"at least {self.minimum:g}{unit}"
        if self.maximum is not None:
            return f"at most {self.maximum:g}{unit}"
        return ""

    def validate(self, value: Any) -> Value:
        """Return `value` in the parameter's type, or raise `ParameterError`.

        An int is accepted where a float is meant, since people type ``5`` for ``5.0``.
        """
        kind = self.kind
        if kind.startswith("list"):
            return self._validate_list(value)
        if kind == "float":
            return self._number(value)
        if type(value).__name__ != kind:
            raise self._wrong_type(value)
        if kind == "int":
            self._check_range(value)
        if kind == "str" and self.choices and value not in self.choices:
            # Only the last part of the name: "unknown scheme 'mbpc'" reads better than a path.
            raise ParameterError(names.unknown(self.name, value, self.choices))
        return value  # type: ignore[no-any-return]

    def parse(self, text: str) -> Value:
        """Read the value from its text, as people write it in YAML or on a command line."""
        text = text.strip()
        try:
            if self.kind == "float":
                # YAML 1.1 takes 1e-3 for a text, since it has no decimal point.
                return self.validate(float(text))
            if self.kind == "str" and text[:1] not in ("'", '"'):
                return self.validate(text)
            return self.validate(yaml.safe_load(text))
        except ParameterError:
            raise
        except (ValueError, yaml.YAMLError):
            raise self._wrong_type(text) from None

    def _validate_list(self, value: Any) -> Value:
        # ROS hands numeric arrays over as array.array; texts must not pass as lists of characters.
        if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
            raise self._wrong_type(value)
        items = list(value)
        if self.kind == "list[float]":
            return [self._number(item) for item in items]
        for item in items:
            if not isinstance(item, str):
                raise self._wrong_type(value)
            if self.choices and item not in self.choices:
                raise ParameterError(names.unknown(self.name, item, self.choices))
        return items

    def _number(self, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self._wrong_type(value)
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise ParameterError(f"'{self.name}' must be a finite number, not {names.shown(value)}")
        self._check_range(value)
        return number

    def _check_range(self, value: float) -> None:
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        if not low <= value <= high:
            raise ParameterError(
                f"'{self.name}' = {names.shown(value)} is out of range: {self.limits}"
            )

    def _wrong_type(self, value: Any) -> ParameterError:
        expected = _KIND_NAMES[self.kind]
        if self.limits:
            expected += f" ({self.limits})"
        return ParameterError(
            f"'{self.name}' = {names.shown(value)} has the wrong type: {expected} is expected"
        )


class Table(Mapping[str, Parameter]):
    """All parameters of one node, in the order of declaration.

    Parameters
    ----------
    parameters : iterable of Parameter
        The parameters; their names must differ.
    check : callable, optional
        Rule across several parameters: gets the complete values and returns the reason for
        rejecting them, or None. It is called only with values that each are acceptable.
    follow : callable, optional
        Defaults that follow from other values: gets the complete values of a node that starts and
        returns those that stand in for parameters which were not given.
    """

    def __init__(
        self,
        parameters: Iterable[Parameter],
        check: Callable[[Mapping[str, Value]], str | None] | None = None,
        follow: Callable[[Mapping[str, Value]], Mapping[str, Value]] | None = None,
    ) -> None:
        self._parameters: dict[str, Parameter] = {}
        for parameter in parameters:
            if parameter.name in self._parameters:
                raise ValueError(f"parameter '{parameter.name}' is in the table twice")
            parameter.validate(parameter.default)
            self._parameters[parameter.name] = parameter
        self._check = check
        self._follow = follow

    def __getitem__(self, name: str) -> Parameter:
        try:
            return self._parameters[name]
        except KeyError:
            raise self.unknown(name) from None

    def __contains__(self, name: object) -> bool:
        return name in self._parameters

    def __iter__(self) -> Iterator[str]:
        return iter(self._parameters)

    def __len__(self) -> int:
        return len(self._parameters)

    def unknown(self, name: str) -> ParameterError:
        """The error that there is no such parameter, with the one that is probably meant."""
        return ParameterError(names.unknown("parameter", name, self, self.also))

    @property
    def also(self) -> dict[str, str]:
        """Other names that people try, and the parameters they mean by them."""
        return {other: p.name for p in self._parameters.values() for other in p.also}

    def defaults(self) -> dict[str, Value]:
        """Return a fresh dictionary of all default values."""
        return {
            name: list(parameter.default)  # type: ignore[misc]
            if isinstance(parameter.default, list)
            else parameter.default
            for name, parameter in self._parameters.items()
        }

    def validate(
        self, changes: Mapping[str, Any], current: Mapping[str, Value] | None = None
    ) -> dict[str, Value]:
        """Check changes together, without applying them.

        Parameters
        ----------
        changes : mapping
            New values by name.
        current : mapping, optional
            The complete values of a running node. Without them the changes are meant for a node
            that starts: they are checked against the defaults, and read-only parameters may be
            set.

        Returns
        -------
        dict
            The changes alone, each in its parameter's type.

        Raises
        ------
        ParameterError
            Nothing of the changes is acceptable then; `reason` says why.
        """
        accepted: dict[str, Value] = {}
        for name, value in changes.items():
            parameter = self[name]
            if parameter.read_only and current is not None:
                raise ParameterError(f"'{name}' is read-only: it can be set at start only")
            accepted[name] = parameter.validate(value)
        base = self.defaults() if current is None else current
        reason = self.rule({**base, **accepted})
        if reason is not None:
            raise ParameterError(reason)
        return accepted

    def rule(self, values: Mapping[str, Value]) -> str | None:
        """Return why complete values, each acceptable, are not so together; None if they are."""
        return None if self._check is None else self._check(values)

    def extended(self, *parameters: Parameter) -> Table:
        """Return a table with more parameters and the same rules across parameters."""
        return Table([*self._parameters.values(), *parameters], self._check, self._follow)

    def complete(self, changes: Mapping[str, Any]) -> dict[str, Value]:
        """Return all values of a node that starts with these changes to the defaults."""
        given = self.validate(changes)
        values = {**self.defaults(), **given}
        if self._follow is None:
            return values
        return {**values, **self._follow(values), **given}


def file_parameter(name: str, default: str, folder: str, what: str) -> Parameter:
    """Return a parameter that names a file of `config/<folder>`, to be read at start."""
    text = f"{what}: a name of config/{folder} or the path of a file"
    return Parameter(name, default, text, read_only=True)


# Parameters that nodes at PWM rate have in common

PWM_FREQUENCY = Parameter(
    "pwm_frequency",
    10_000.0,
    "PWM and control frequency",
    unit="Hz",
    minimum=1_000.0,
    maximum=100_000.0,
    read_only=True,
    also=("f_pwm", "f_s", "T_s"),
)

RECORDERS = Parameter(
    "recorders",
    0,
    "Number of recorders that the node waits for before the first period, so that they miss "
    "nothing",
    minimum=0,
    maximum=100,
    read_only=True,
)

SCHEDULE = Parameter(
    "schedule",
    [],
    "Parameter changes at given simulated times, each 'SECONDS NAME VALUE'",
    read_only=True,
)

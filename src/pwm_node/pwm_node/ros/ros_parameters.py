"""The parameter table in ROS's terms: descriptors, and values there and back."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.parameter import Parameter as RosParameter

from pwm_node.parameters import Parameter, Value

_TYPES = {
    "bool": RosParameter.Type.BOOL,
    "int": RosParameter.Type.INTEGER,
    "float": RosParameter.Type.DOUBLE,
    "str": RosParameter.Type.STRING,
    "list[str]": RosParameter.Type.STRING_ARRAY,
    "list[float]": RosParameter.Type.DOUBLE_ARRAY,
}


def descriptor(parameter: Parameter) -> ParameterDescriptor:
    """Return all that ``ros2 param describe`` can teach about a parameter."""
    text = parameter.description
    if parameter.unit:
        text += f" ({parameter.unit})"
    result = ParameterDescriptor(
        name=parameter.name, description=text, read_only=parameter.read_only
    )
    if parameter.minimum is not None and parameter.maximum is not None:
        if parameter.kind == "int":
            bounds = IntegerRange(
                from_value=int(parameter.minimum), to_value=int(parameter.maximum)
            )
            result.integer_range = [bounds]
        elif parameter.kind == "float":
            span = FloatingPointRange(
                from_value=float(parameter.minimum), to_value=float(parameter.maximum)
            )
            result.floating_point_range = [span]
        else:
            result.additional_constraints = f"each {parameter.limits}"
    elif parameter.limits:
        # A range with one end, and a choice, can be told in words only.
        result.additional_constraints = parameter.limits
    return result


def to_ros(parameter: Parameter, value: Value) -> RosParameter:
    """Return a value as ROS keeps it."""
    return RosParameter(parameter.name, _TYPES[parameter.kind], _ros_value(parameter, value))


def _ros_value(parameter: Parameter, value: Value) -> Value:
    # An empty list has no type in a parameter file: one blank text stands for no text.
    return [""] if parameter.kind == "list[str]" and not value else value


def from_ros(parameter: Parameter, value: Any) -> Any:
    """Return what the table shall validate, from a value that came through ROS."""
    if parameter.kind == "list[str]" and (value is None or isinstance(value, (list, tuple))):
        # An empty list in a parameter file has no type, and comes as None.
        return [text for text in value or () if text != ""]
    return value


def shared_names(arguments: Sequence[str]) -> dict[str, str]:
    """Return the parameters that a command line gives to whoever has them.

    Those are the ones in sections like ``/**`` of its parameter files.

    Parameters
    ----------
    arguments : sequence of str
        The command line.

    Returns
    -------
    dict
        The file of each name.
    """
    found: dict[str, str] = {}
    for option, path in itertools.pairwise(arguments):
        if option != "--params-file":
            continue
        with open(path, encoding="utf-8") as file:
            sections = yaml.safe_load(file)
        for nodes, section in _sections(sections):
            if "*" in nodes:
                found |= dict.fromkeys(_flat(section), path)
    return found


def _sections(content: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield name and parameters of each section; namespaces may be keys of their own."""
    if not isinstance(content, Mapping):
        return
    for key, value in content.items():
        if key == "ros__parameters":
            yield prefix, value
        else:
            yield from _sections(value, f"{prefix}/{key}")


def _flat(section: Any, prefix: str = "") -> Iterator[str]:
    if isinstance(section, Mapping):
        for key, value in section.items():
            if isinstance(value, Mapping):
                yield from _flat(value, f"{prefix}{key}.")
            else:
                yield f"{prefix}{key}"

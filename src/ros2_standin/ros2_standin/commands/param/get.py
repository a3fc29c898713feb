"""`ros2 param get`: prints the value of a parameter."""

from __future__ import annotations

import argparse

from rcl_interfaces.msg import ParameterType

from ros2_standin.node import add_remote_arguments, cli_node, wait_for_node
from ros2_standin.parameters import (
    TYPE_NAMES,
    RemoteParameters,
    add_parameter_argument,
    python_value,
)
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_remote_arguments(parser)
    add_parameter_argument(parser)
    parser.add_argument("--hide-type", action="store_true", help="Print the value alone")


def main(args: argparse.Namespace) -> Result:
    with cli_node(args) as node:
        name = wait_for_node(node, args)
        if name is None:
            return "Node not found"
        values = RemoteParameters(node, name).get([args.parameter_name])
    if not values:
        return "Parameter not set"
    value = python_value(values[0])
    if args.hide_type:
        print(value)
    elif values[0].type == ParameterType.PARAMETER_NOT_SET:
        print("Parameter not set.")
    else:
        kind = TYPE_NAMES[values[0].type]
        if kind.endswith(" array"):
            print(f"{kind.removesuffix(' array').capitalize()} values are:", value)
        else:
            print(f"{kind.capitalize()} value is:", value)
    return None

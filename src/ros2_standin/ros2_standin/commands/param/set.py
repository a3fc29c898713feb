"""`ros2 param set`: sets a parameter."""

from __future__ import annotations

import argparse
import sys

from rcl_interfaces.msg import Parameter
from rclpy.parameter import get_parameter_value

from ros2_standin.node import add_remote_arguments, cli_node, wait_for_node
from ros2_standin.parameters import RemoteParameters, add_parameter_argument
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_remote_arguments(parser)
    add_parameter_argument(parser)
    parser.add_argument("value", help="Value of the parameter, as YAML")


def main(args: argparse.Namespace) -> Result:
    parameter = Parameter(name=args.parameter_name, value=get_parameter_value(args.value))
    with cli_node(args) as node:
        name = wait_for_node(node, args)
        if name is None:
            return "Node not found"
        [result] = RemoteParameters(node, name).set([parameter])
    text = "Set parameter successful" if result.successful else "Setting parameter failed"
    if result.reason:
        text += f": {result.reason}"
    # A refusal ends with code 0, as it does in ROS 2 Jazzy.
    print(text, file=sys.stdout if result.successful else sys.stderr)
    return None

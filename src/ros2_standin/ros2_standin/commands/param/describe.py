"""`ros2 param describe`: prints what parameters mean and which values they take."""

from __future__ import annotations

import argparse

from rcl_interfaces.msg import ParameterDescriptor

from ros2_standin.node import add_remote_arguments, cli_node, wait_for_node
from ros2_standin.parameters import TYPE_NAMES, RemoteParameters
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_remote_arguments(parser)
    parser.add_argument("parameter_names", nargs="+", help="Names of the parameters")


def main(args: argparse.Namespace) -> Result:
    with cli_node(args) as node:
        name = wait_for_node(node, args)
        if name is None:
            return "Node not found"
        for descriptor in RemoteParameters(node, name).describe(args.parameter_names):
            _print(descriptor)
    return None


def _print(descriptor: ParameterDescriptor) -> None:
    print("Parameter name:", descriptor.name)
    print("  Type:", TYPE_NAMES[descriptor.type])
    if descriptor.description:
        print("  Description:", descriptor.description)
    print("  Constraints:")
    if descriptor.read_only:
        print("    Read only: true")
    for span in [*descriptor.floating_point_range, *descriptor.integer_range][:1]:
        print("    Min value:", span.from_value)
        print("    Max value:", span.to_value)
        if span.step:
            print("    Step:", span.step)
    if descriptor.additional_constraints:
        print("    Additional constraints:", descriptor.additional_constraints)

"""`ros2 param dump`: prints all parameters of a node as a parameter file."""

from __future__ import annotations

import argparse
from typing import Any

import yaml
from rclpy.parameter import PARAMETER_SEPARATOR_STRING

from ros2_standin.node import add_remote_arguments, cli_node, wait_for_node
from ros2_standin.parameters import RemoteParameters, python_value
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_remote_arguments(parser)


def main(args: argparse.Namespace) -> Result:
    with cli_node(args) as node:
        node_name = wait_for_node(node, args)
        if node_name is None:
            return "Node not found"
        remote = RemoteParameters(node, node_name)
        names = remote.names()
        values = [python_value(value) for value in remote.get(names)]
    tree: dict[str, Any] = {}
    for name, value in zip(names, values, strict=True):
        *groups, base = name.split(PARAMETER_SEPARATOR_STRING)
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        branch[base] = value
    print(yaml.dump({node_name: {"ros__parameters": tree}}, default_flow_style=False))
    return None

"""`ros2 param load`: sets the parameters of a node from a file."""

from __future__ import annotations

import argparse
import sys

import yaml
from rcl_interfaces.msg import Parameter
from rclpy.parameter import parameter_dict_from_yaml_file

from ros2_standin.node import add_remote_arguments, cli_node, wait_for_node
from ros2_standin.parameters import RemoteParameters
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_remote_arguments(parser)
    parser.add_argument("parameter_file", help="Parameter file (YAML)")
    parser.add_argument(
        "--no-use-wildcard", action="store_true", help="Leave out what the file has under /**"
    )


def main(args: argparse.Namespace) -> Result:
    with cli_node(args) as node:
        name = wait_for_node(node, args)
        if name is None:
            return "Node not found"
        try:
            parameters = _parameters(args.parameter_file, name, not args.no_use_wildcard)
        except (RuntimeError, ValueError, TypeError, AttributeError, yaml.YAMLError) as error:
            return f"{args.parameter_file}: no parameter file for this node: {error}"
        results = RemoteParameters(node, name).set(parameters)
    for parameter, result in zip(parameters, results, strict=True):
        text = f"Set parameter {parameter.name} {'successful' if result.successful else 'failed'}"
        if result.reason:
            text += f": {result.reason}"
        print(text, file=sys.stdout if result.successful else sys.stderr)
    return None


def _parameters(file: str, name: str, wildcard: bool) -> list[Parameter]:
    """Return what a file has for a node: under `/**`, and before that in its own section."""
    with open(file, encoding="utf-8") as stream:
        sections = yaml.safe_load(stream)
    if not isinstance(sections, dict):
        raise ValueError("it has no sections of nodes")
    own = [key for key in (name, name.lstrip("/")) if key in sections][:1]
    everyone = ["/**"] if wildcard and "/**" in sections else []
    if not own and not everyone:
        raise ValueError(f"it has nothing for {name}, only for {', '.join(map(str, sections))}")
    return list(parameter_dict_from_yaml_file(file, target_nodes=[*everyone, *own]).values())

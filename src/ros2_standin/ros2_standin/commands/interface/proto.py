"""`ros2 interface proto`: prints a prototype of an interface, as YAML."""

from __future__ import annotations

import argparse

from ros2_standin.messages import Style
from ros2_standin.types import interface_class
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("type", help="Interface type (e.g. 'std_msgs/msg/String')")
    parser.add_argument("--no-quotes", action="store_true", help="Leave out the outer quotes")


def main(args: argparse.Namespace) -> Result:
    try:
        kind = interface_class(args.type)
    except LookupError:
        return f"Unknown interface type '{args.type}'"
    # Of an action the goal, of a service the request: the part that one writes by hand.
    instance = getattr(kind, "Goal", getattr(kind, "Request", kind))()
    text = Style().yaml(instance)
    print(text if args.no_quotes else f'"{text}"')
    return None

"""`ros2 lifecycle set`: makes a node do a transition."""

from __future__ import annotations

import argparse
import sys

from ros2_standin.lifecycle import (
    add_managed_arguments,
    change,
    transitions,
    wait_for_managed_node,
)
from ros2_standin.node import cli_node
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_managed_arguments(parser)
    parser.add_argument("transition", help="Name or number of the transition")


def main(args: argparse.Namespace) -> Result:
    with cli_node(args) as node:
        name = wait_for_managed_node(node, args)
        if name is None:
            return "Node not found"
        possible = [found.transition for found in transitions(node, name)]
        by_name = {transition.label: transition for transition in possible}
        by_number = {str(transition.id): transition for transition in possible}
        transition = by_name.get(args.transition) or by_number.get(args.transition)
        if transition is None:
            return "Unknown transition requested, available ones are:" + "".join(
                f"\n- {t.label} [{t.id}]" for t in possible
            )
        done = change(node, name, transition)
    # A refusal ends with code 0, as it does in ROS 2 Jazzy.
    if done:
        print("Transitioning successful")
    else:
        print("Transitioning failed", file=sys.stderr)
    return None

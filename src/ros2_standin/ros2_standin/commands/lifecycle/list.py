"""`ros2 lifecycle list`: lists the transitions a node can make."""

from __future__ import annotations

import argparse

from ros2_standin.lifecycle import add_managed_arguments, transitions, wait_for_managed_node
from ros2_standin.node import cli_node
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_managed_arguments(parser)
    parser.add_argument("-a", "--all", action="store_true", help="Not only those possible now")


def main(args: argparse.Namespace) -> Result:
    service = "get_transition_graph" if args.all else "get_available_transitions"
    with cli_node(args) as node:
        name = wait_for_managed_node(node, args)
        if name is None:
            return "Node not found"
        for found in transitions(node, name, service):
            print(f"- {found.transition.label} [{found.transition.id}]")
            print(f"\tStart: {found.start_state.label}")
            print(f"\tGoal: {found.goal_state.label}")
    return None

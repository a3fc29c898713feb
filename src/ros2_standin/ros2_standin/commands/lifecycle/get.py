"""`ros2 lifecycle get`: prints the state of one or all managed nodes."""

from __future__ import annotations

import argparse
import sys

from ros2_standin.lifecycle import (
    add_managed_arguments,
    managed_nodes,
    state,
    wait_for_managed_node,
)
from ros2_standin.node import cli_node, graph_node
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_managed_arguments(parser, optional=True)


def main(args: argparse.Namespace) -> Result:
    if args.node_name is not None:
        with cli_node(args) as node:
            name = wait_for_managed_node(node, args)
            if name is None:
                return "Node not found"
            found = state(node, name)
            print(f"{found.label} [{found.id}]")
        return None
    with graph_node(args) as node:
        for name in managed_nodes(node, args.include_hidden_nodes):
            try:
                found = state(node, name)
            except RuntimeError as error:
                print(error, file=sys.stderr)
            else:
                print(f"{name}: {found.label} [{found.id}]")
    return None

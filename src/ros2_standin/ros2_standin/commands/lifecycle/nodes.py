"""`ros2 lifecycle nodes`: lists the managed nodes."""

from __future__ import annotations

import argparse

from ros2_standin.lifecycle import managed_nodes
from ros2_standin.node import add_graph_arguments, graph_node
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("-a", "--all", action="store_true", help="Include hidden nodes")
    parser.add_argument("-c", "--count-nodes", action="store_true", help="Print only how many")


def main(args: argparse.Namespace) -> Result:
    with graph_node(args) as node:
        names = managed_nodes(node, args.all)
    if args.count_nodes:
        print(len(names))
    else:
        for name in names:
            print(name)
    return None

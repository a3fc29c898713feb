"""`ros2 node list`: lists the nodes that run."""

from __future__ import annotations

import argparse
import sys

from ros2_standin.node import add_graph_arguments, graph_node, node_names
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("-a", "--all", action="store_true", help="Include hidden nodes")
    parser.add_argument("-c", "--count-nodes", action="store_true", help="Print only how many")


def main(args: argparse.Namespace) -> Result:
    with graph_node(args) as node:
        names = sorted(name.full for name in node_names(node, args.all))
    if args.count_nodes:
        print(len(names))
        return None
    if len(set(names)) < len(names):
        print(
            "WARNING: Be aware that there are nodes in the graph that share an exact name, "
            "which can have unintended side effects.",
            file=sys.stderr,
        )
    for name in names:
        print(name)
    return None

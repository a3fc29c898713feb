"""`ros2 param list`: lists the parameters of one or all nodes."""

from __future__ import annotations

import argparse
import re
import sys

from ros2_standin.node import absolute_name, add_graph_arguments, graph_node, node_names
from ros2_standin.parameters import TYPE_NAMES, RemoteParameters
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("node_name", nargs="?", help="Name of the node; all if not given")
    parser.add_argument("--filter", nargs=1, help="Regular expression for the names to list")
    parser.add_argument(
        "--include-hidden-nodes", action="store_true", help="Include those that begin with _"
    )
    parser.add_argument(
        "--param-prefixes", nargs="+", default=[], help="List names with these prefixes only"
    )
    parser.add_argument("--param-type", action="store_true", help="Print the types, too")


def main(args: argparse.Namespace) -> Result:
    try:
        pattern = re.compile(args.filter[0] if args.filter else "")
    except re.error as error:
        return f"--filter: not a regular expression: {error}"
    with graph_node(args) as node:
        nodes = sorted(name.full for name in node_names(node, args.include_hidden_nodes))
        if args.node_name is not None:
            wanted = absolute_name(args.node_name)
            if wanted not in nodes:
                return "Node not found"
            nodes = [wanted]
        for node_name in nodes:
            try:
                remote = RemoteParameters(node, node_name)
                names = [n for n in remote.names(args.param_prefixes) if pattern.match(n)]
                types = {}
                if args.param_type and names:
                    types = {
                        d.name: f" (type: {TYPE_NAMES[d.type]})" for d in remote.describe(names)
                    }
            except RuntimeError as error:
                print(error, file=sys.stderr)
                continue
            if args.node_name is None and names:
                print(f"{node_name}:")
            for name in names:
                print(f"  {name}{types.get(name, '')}")
    return None

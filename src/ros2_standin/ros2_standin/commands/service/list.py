"""`ros2 service list`: lists the services."""

from __future__ import annotations

import argparse

from ros2_standin.node import add_graph_arguments, graph_node, visible
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("-t", "--show-types", action="store_true", help="Print the types, too")
    parser.add_argument("-c", "--count-services", action="store_true", help="Print only how many")
    parser.add_argument(
        "--include-hidden-services", action="store_true", help="Include those that begin with _"
    )


def main(args: argparse.Namespace) -> Result:
    with graph_node(args) as node:
        services = visible(node.get_service_names_and_types(), args.include_hidden_services)
    if args.count_services:
        print(len(services))
    else:
        for name, types in services:
            print(f"{name} [{', '.join(types)}]" if args.show_types else name)
    return None

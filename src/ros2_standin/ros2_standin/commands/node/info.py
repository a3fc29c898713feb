"""`ros2 node info`: prints the topics, services and actions of a node."""

from __future__ import annotations

import argparse
import sys

from rclpy.action import (
    get_action_client_names_and_types_by_node,
    get_action_server_names_and_types_by_node,
)

from ros2_standin.node import (
    NamesAndTypes,
    add_graph_arguments,
    graph_node,
    node_names,
    split_name,
)
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("node_name", help="Name of the node")
    parser.add_argument(
        "--include-hidden", action="store_true", help="Include hidden topics, services and actions"
    )


def main(args: argparse.Namespace) -> Result:
    with graph_node(args) as node:
        names = [name.full for name in node_names(node, args.include_hidden)]
        count = names.count(args.node_name)
        if count == 0:
            return f"Unable to find node '{args.node_name}'"
        if count > 1:
            print(
                f"There are {count} nodes in the graph with the exact name "
                f'"{args.node_name}". You are seeing information about only one of them.',
                file=sys.stderr,
            )
        name = split_name(args.node_name)
        print(args.node_name)
        for title, names_and_types in (
            ("Subscribers", node.get_subscriber_names_and_types_by_node(*name)),
            ("Publishers", node.get_publisher_names_and_types_by_node(*name)),
            ("Service Servers", node.get_service_names_and_types_by_node(*name)),
            ("Service Clients", node.get_client_names_and_types_by_node(*name)),
            ("Action Servers", get_action_server_names_and_types_by_node(node, *name)),
            ("Action Clients", get_action_client_names_and_types_by_node(node, *name)),
        ):
            print(f"  {title}:")
            print(_lines(names_and_types, args.include_hidden))
    return None


def _lines(names_and_types: NamesAndTypes, include_hidden: bool) -> str:
    return "\n".join(
        f"    {name}: {', '.join(types)}"
        for name, types in names_and_types
        if include_hidden or not any(part.startswith("_") for part in name.split("/"))
    )

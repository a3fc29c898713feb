"""`ros2 topic find`: lists the topics of a type."""

from __future__ import annotations

import argparse

from ros2_standin.node import add_graph_arguments, graph_node, visible
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("topic_type", help="Type to look for (e.g. 'std_msgs/msg/String')")
    parser.add_argument("-c", "--count-topics", action="store_true", help="Print only how many")
    parser.add_argument(
        "--include-hidden-topics", action="store_true", help="Include those that begin with _"
    )


def main(args: argparse.Namespace) -> Result:
    with graph_node(args) as node:
        topics = visible(node.get_topic_names_and_types(), args.include_hidden_topics)
    names = [name for name, types in topics if args.topic_type in types]
    if args.count_topics:
        print(len(names))
    else:
        for name in names:
            print(name)
    return None

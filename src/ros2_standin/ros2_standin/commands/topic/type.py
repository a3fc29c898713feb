"""`ros2 topic type`: prints the type of a topic."""

from __future__ import annotations

import argparse

from ros2_standin.node import add_graph_arguments, graph_node, visible
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("topic_name", help="Name of the topic")


def main(args: argparse.Namespace) -> Result:
    with graph_node(args) as node:
        topics = dict(visible(node.get_topic_names_and_types(), args.include_hidden_topics))
    types = topics.get(args.topic_name)
    if types is None:
        return 1
    for name in types:
        print(name)
    return None

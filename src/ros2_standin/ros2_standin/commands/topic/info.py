"""`ros2 topic info`: prints who publishes and who listens."""

from __future__ import annotations

import argparse

from ros2_standin.node import add_graph_arguments, graph_node
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("topic_name", help="Name of the topic")
    parser.add_argument(
        "--verbose", "-v", action="store_true", help="Print nodes, hash of the type, and QoS, too"
    )


def main(args: argparse.Namespace) -> Result:
    topic = args.topic_name
    end = "\n\n" if args.verbose else "\n"
    with graph_node(args) as node:
        types = dict(node.get_topic_names_and_types()).get(topic)
        if types is None:
            return f"Unknown topic '{topic}'"
        print("Type:", types[0] if len(types) == 1 else types, end=end)
        print("Publisher count:", node.count_publishers(topic), end=end)
        if args.verbose:
            for info in node.get_publishers_info_by_topic(topic):
                print(info, end=end)
        print("Subscription count:", node.count_subscribers(topic), end=end)
        if args.verbose:
            for info in node.get_subscriptions_info_by_topic(topic):
                print(info, end=end)
    return None

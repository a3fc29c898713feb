"""`ros2 topic list`: lists the topics."""

from __future__ import annotations

import argparse

from ros2_standin.node import add_graph_arguments, graph_node, visible
from ros2_standin.verb import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("-t", "--show-types", action="store_true", help="Print the types, too")
    parser.add_argument("-c", "--count-topics", action="store_true", help="Print only how many")
    parser.add_argument(
        "--include-hidden-topics", action="store_true", help="Include those that begin with _"
    )
    parser.add_argument("-v", "--verbose", action="store_true", help="Print who uses them")


def main(args: argparse.Namespace) -> Result:
    with graph_node(args) as node:
        topics = visible(node.get_topic_names_and_types(), args.include_hidden_topics)
        publishers = {name: node.count_publishers(name) for name, _ in topics}
        subscribers = {name: node.count_subscribers(name) for name, _ in topics}
    if args.count_topics:
        print(len(topics))
    elif args.verbose and topics:
        for title, role, counts in (
            ("Published", "publisher", publishers),
            ("Subscribed", "subscriber", subscribers),
        ):
            print(f"{title} topics:")
            for name, types in topics:
                if count := counts[name]:
                    who = f"{count} {role}{'s' if count > 1 else ''}"
                    print(f" * {name} [{', '.join(types)}] {who}")
            print()
    else:
        for name, types in topics:
            print(f"{name} [{', '.join(types)}]" if args.show_types else name)
    return None

"""`ros2 topic echo`: prints the messages of a topic."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import rclpy
import yaml
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSPresetProfiles,
    QoSProfile,
    QoSReliabilityPolicy,
)
from rclpy.task import Future

from ros2_standin.arguments import non_negative_int, positive_float
from ros2_standin.listen import topic_class
from ros2_standin.messages import Style
from ros2_standin.node import LOOK_TIME, add_graph_arguments, cli_node, wait_until
from ros2_standin.qos import add_qos_arguments, chosen_profile, is_chosen
from ros2_standin.types import message_class
from ros2_standin.verb import Result

LENGTH = 128


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument("topic_name", help="Name of the topic")
    parser.add_argument("message_type", nargs="?", help="Type of its messages, if nobody is there")
    add_qos_arguments(parser, "sensor_data")
    parser.add_argument("--csv", action="store_true", help="Print all fields on one line")
    parser.add_argument("--field", help="Print this field only (e.g. pose.pose.position)")
    parser.add_argument(
        "--full-length", "-f", action="store_true", help="Print arrays and texts of any length"
    )
    parser.add_argument(
        "--truncate-length",
        "-l",
        type=non_negative_int,
        default=LENGTH,
        help="Longest array or text that is printed in full (default: %(default)s)",
    )
    parser.add_argument("--no-arr", action="store_true", help="Leave out what is in arrays")
    parser.add_argument("--no-str", action="store_true", help="Leave out what is in texts")
    parser.add_argument("--flow-style", action="store_true", help="Print each list on one line")
    parser.add_argument(
        "--no-lost-messages", action="store_true", help="Do not say when messages are lost"
    )
    parser.add_argument("--raw", action="store_true", help="Print the serialized messages")
    parser.add_argument(
        "--filter", dest="filter_expr", help="Print if this Python expression of m is true"
    )
    parser.add_argument("--once", action="store_true", help="End after the first message")
    parser.add_argument("--timeout", metavar="N", type=positive_float, help="End after N seconds")
    parser.add_argument(
        "--include-message-info", "-i", action="store_true", help="Print times and numbers, too"
    )


def main(args: argparse.Namespace) -> Result:
    fields: list[str] = []
    if args.field is not None:
        fields = [part for part in args.field.split(".") if part]
        if not fields:
            return f"Invalid field value '{args.field}'"
    with cli_node(args) as node:
        if args.message_type is None:
            kind = topic_class(node, args.topic_name, timeout=args.spin_time + LOOK_TIME)
            if kind is None:
                return "Could not determine the type for the passed topic"
        else:
            kind = message_class(args.message_type, "The passed message type is invalid")
        profile = chosen_profile(args) if is_chosen(args) else _offered(node, args)
        done = Future()
        show = _printer(args)

        def take(message: Any, info: dict[str, int]) -> None:
            if done.done():
                return
            for field in fields:
                try:
                    message = getattr(message, field)
                except AttributeError as error:
                    raise RuntimeError(f"Invalid field '{'.'.join(fields)}': {error}") from None
            # The expression is the user's own, from the user's own command line.
            if args.filter_expr and not eval(args.filter_expr, {"m": message}):
                return
            if args.once:
                done.set_result(None)
            show(message, info)

        lost = None
        if not args.no_lost_messages:
            lost = SubscriptionEventCallbacks(message_lost=_report_loss)
        node.create_subscription(
            kind, args.topic_name, take, profile, event_callbacks=lost, raw=args.raw
        )
        rclpy.spin_until_future_complete(node, done, timeout_sec=args.timeout)
    return None


def _offered(node: Node, args: argparse.Namespace) -> QoSProfile:
    """Return the strictest profile that all publishers of the topic offer."""
    profile = QoSPresetProfiles.get_from_short_key(args.qos_profile)
    # Endpoints may be seen a moment after the topic.
    wait_until(lambda: node.count_publishers(args.topic_name) > 0, args.spin_time)
    offers = [info.qos_profile for info in node.get_publishers_info_by_topic(args.topic_name)]
    if not offers:
        return profile
    for name, strict, loose in (
        ("reliability", QoSReliabilityPolicy.RELIABLE, QoSReliabilityPolicy.BEST_EFFORT),
        ("durability", QoSDurabilityPolicy.TRANSIENT_LOCAL, QoSDurabilityPolicy.VOLATILE),
    ):
        count = sum(getattr(offer, name) == strict for offer in offers)
        setattr(profile, name, strict if count == len(offers) else loose)
        if 0 < count < len(offers):
            policy = type(strict).__name__
            print(
                f"Some, but not all, publishers are offering QoS{policy}.{strict.name}. "
                f"Falling back to QoS{policy}.{loose.name} as it will connect to all publishers"
            )
    return profile


def _printer(args: argparse.Namespace) -> Callable[[Any, dict[str, int]], None]:
    """Return the function that prints a message (or a field of one) with its info."""
    style = Style(
        length=None if args.full_length else args.truncate_length,
        no_arr=args.no_arr,
        no_str=args.no_str,
    )

    def show(message: Any, info: dict[str, int]) -> None:
        if not hasattr(message, "SLOT_TYPES"):  # raw, or a field that is no message
            if args.include_message_info:
                print("---Got new message, message info:---")
                print(info)
                print("---Message data:---")
            print(message, end="\n---\n")
        elif args.csv:
            head = f"{','.join(map(str, info.values()))}," if args.include_message_info else ""
            print(head + style.csv(message))
        else:
            if args.include_message_info:
                print(yaml.dump(info), end="---\n")
            print(style.yaml(message, flow=args.flow_style), end="---\n")

    return show


def _report_loss(status: Any) -> None:
    print(
        f"A message was lost!!!\n\ttotal count change:{status.total_count_change}"
        f"\n\ttotal count: {status.total_count}",
        end="---\n",
    )

"""`ros2 topic pub`: publishes to a topic."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher

from ros2_standin.arguments import non_negative_int, positive_float
from ros2_standin.messages import fill, read_values
from ros2_standin.node import DISCOVERY_TIME, add_node_arguments, cli_node, wait_until
from ros2_standin.qos import add_qos_arguments, chosen_profile
from ros2_standin.types import message_class
from ros2_standin.verb import Result

#: Time between two looks for subscriptions (s).
LOOK_PERIOD = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("topic_name", help="Name of the topic")
    parser.add_argument("message_type", help="Type of the message (e.g. 'std_msgs/String')")
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "values", nargs="?", default="{}", help="Its fields, as YAML (e.g. 'data: Hello')"
    )
    what.add_argument("--stdin", action="store_true", help="Read the fields from standard input")
    parser.add_argument(
        "-r", "--rate", metavar="N", type=positive_float, default=1.0, help="Rate (Hz, default: 1)"
    )
    parser.add_argument(
        "-p", "--print", metavar="N", type=int, default=1, help="Print every N-th message only"
    )
    number = parser.add_mutually_exclusive_group()
    number.add_argument("-1", "--once", action="store_true", help="Publish once, and end")
    number.add_argument(
        "-t", "--times", type=non_negative_int, default=0, help="Publish this often, and end"
    )
    parser.add_argument(
        "-w",
        "--wait-matching-subscriptions",
        type=non_negative_int,
        help="Wait for this many subscriptions (default: 1 with --once or --times, else 0)",
    )
    parser.add_argument(
        "--max-wait-time-secs", type=positive_float, help="Give up waiting after this time (s)"
    )
    parser.add_argument(
        "--keep-alive",
        metavar="N",
        type=positive_float,
        default=0.1,
        help="Stay N seconds after the last message (default: %(default)s)",
    )
    parser.add_argument("-n", "--node-name", help="Name of the node that publishes")
    add_qos_arguments(parser, "default")
    add_node_arguments(parser)


def main(args: argparse.Namespace) -> Result:
    times = 1 if args.once else args.times
    wanted = args.wait_matching_subscriptions
    if wanted is None:
        wanted = int(times != 0)
    kind = message_class(args.message_type, "The passed message type is invalid")
    values = read_values(sys.stdin.buffer.read() if args.stdin else args.values)
    if wanted == 0 and args.max_wait_time_secs is not None:
        return (
            "--max-wait-time-secs option is only effective with "
            "--wait-matching-subscriptions, --once or --times"
        )
    with cli_node(args, args.node_name) as node:
        publisher = node.create_publisher(kind, args.topic_name, chosen_profile(args))
        error = _wait_for_subscriptions(publisher, wanted, args.max_wait_time_secs)
        if error:
            return error
        message = kind()
        try:
            setters = fill(message, values, times=True)
        except Exception as error:  # noqa: BLE001 (whatever the generated class says)
            return f"Failed to populate field: {error}"
        _publish(node, publisher, message, setters, times, args)
        # Some time for the messages to leave.
        time.sleep(args.keep_alive)
    return None


def _wait_for_subscriptions(publisher: Publisher, wanted: int, limit: float | None) -> Result:
    """Wait for subscriptions; return an error if the time is over."""
    wait_until(lambda: publisher.get_subscription_count() >= wanted, DISCOVERY_TIME)
    looks = 0
    while publisher.get_subscription_count() < wanted:
        if looks % 10 == 0:
            print(f"Waiting for at least {wanted} matching subscription(s)...")
        if limit is not None and looks * LOOK_PERIOD >= limit:
            return (
                f"Timed out waiting for subscribers: Expected {wanted} subcribers "
                f"but only got {publisher.get_subscription_count()} subscribers"
            )
        looks += 1
        time.sleep(LOOK_PERIOD)
    return None


def _publish(
    node: Node,
    publisher: Publisher,
    message: Any,
    setters: list[Any],
    times: int,
    args: argparse.Namespace,
) -> None:
    """Publish a message `times` times, or for ever."""
    count = 0

    def publish() -> None:
        nonlocal count
        now = node.get_clock().now().to_msg()
        for setter in setters:
            setter(now)
        count += 1
        if args.print and count % args.print == 0:
            print(f"publishing #{count}: {message!r}\n")
        publisher.publish(message)

    print("publisher: beginning loop")
    publish()
    timer = node.create_timer(1.0 / args.rate, publish)
    while times == 0 or count < times:
        rclpy.spin_once(node)
    node.destroy_timer(timer)

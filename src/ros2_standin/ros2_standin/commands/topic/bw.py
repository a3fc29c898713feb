"""`ros2 topic bw`: measures the bandwidth of a topic."""

from __future__ import annotations

import argparse
import time
from collections import deque

from ros2_standin.arguments import positive_int
from ros2_standin.listen import MEASURING_QOS, Spinner, topic_class
from ros2_standin.node import add_node_arguments, cli_node
from ros2_standin.verb import Result

WINDOW = 100


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("topic", help="Name of the topic")
    parser.add_argument(
        "--window",
        "-w",
        metavar="WINDOW",
        type=positive_int,
        default=WINDOW,
        help="Messages to calculate from, at most (default: %(default)s)",
    )
    add_node_arguments(parser)


def main(args: argparse.Namespace) -> Result:
    with cli_node(args) as node:
        kind = topic_class(node, args.topic, timeout=args.spin_time, blocking=True)
        taken: deque[tuple[float, int]] = deque(maxlen=args.window)  # time (s), size (bytes)

        def take(data: bytes) -> None:
            taken.append((time.monotonic(), len(data)))

        node.create_subscription(kind, args.topic, take, MEASURING_QOS, raw=True)
        print(f"Subscribed to [{args.topic}]")
        spinner = Spinner(node)
        while True:
            spinner.spin(1.0)
            if len(taken) > 1:
                print(bandwidth(time.monotonic() - taken[0][0], [size for _, size in taken]))


def bandwidth(seconds: float, sizes: list[int]) -> str:
    """
    Return the statistics of some messages.

    Parameters
    ----------
    seconds : float
        Time since the first of them (s).
    sizes : list of int
        Their sizes (bytes).
    """
    rate = sum(sizes) / seconds
    if rate < 1e3:
        unit, scale, digits = "B", 1.0, 0
    elif rate < 1e6:
        unit, scale, digits = "KB", 1e3, 2
    else:
        unit, scale, digits = "MB", 1e6, 2

    def text(value: float) -> str:
        return f"{value / scale:.{digits}f} {unit}"

    mean = sum(sizes) / len(sizes)
    return (
        f"{text(rate)}/s from {len(sizes)} messages\n"
        f"\tMessage size mean: {text(mean)} min: {text(min(sizes))} max: {text(max(sizes))}"
    )

"""`ros2 topic hz`: measures the rate of a topic."""

from __future__ import annotations

import argparse
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from ros2_standin.arguments import positive_int
from ros2_standin.listen import MEASURING_QOS, Spinner, topic_class
from ros2_standin.node import add_node_arguments, cli_node
from ros2_standin.verb import Result

WINDOW = 10000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("topic_name", help="Name of the topic")
    parser.add_argument(
        "--window",
        "-w",
        dest="window_size",
        metavar="WINDOW",
        type=positive_int,
        default=WINDOW,
        help="Messages to calculate the rate from, at most (default: %(default)s)",
    )
    parser.add_argument(
        "--filter",
        dest="filter_expr",
        metavar="EXPR",
        help="Count if this Python expression of m is true",
    )
    parser.add_argument(
        "--wall-time",
        dest="use_wtime",
        action="store_true",
        help="Measure in wall time, also with --use-sim-time",
    )
    add_node_arguments(parser)


def main(args: argparse.Namespace) -> Result:
    with cli_node(args) as node:
        kind = topic_class(node, args.topic_name, timeout=args.spin_time, blocking=True)
        clock = node.get_clock()
        simulated = args.use_sim_time and not args.use_wtime
        rate = Rate(
            args.window_size, lambda: clock.now().nanoseconds if simulated else time.time_ns()
        )

        def take(message: Any) -> None:
            # The expression is the user's own, from the user's own command line.
            if args.filter_expr is None or eval(args.filter_expr, {"m": message}):
                rate.count()

        # Unread messages suffice for counting.
        raw = args.filter_expr is None
        node.create_subscription(kind, args.topic_name, take, MEASURING_QOS, raw=raw)
        spinner = Spinner(node)
        while True:
            spinner.spin(1.0)
            if text := rate.text():
                print(text)


class Rate:
    """
    Statistics of the time between messages.

    Parameters
    ----------
    window : int
        Number of intervals, at most.
    now : callable
        The time (ns).
    """

    def __init__(self, window: int, now: Callable[[], int]) -> None:
        self._intervals: deque[int] = deque(maxlen=window)
        self._now = now
        self._last = 0
        self._news = False

    def count(self) -> None:
        """Take note of a message."""
        now = self._now()
        if now == 0 or now < self._last:  # the simulated time has begun again
            if self._intervals:
                print("time has reset, resetting counters")
            self._intervals.clear()
        elif self._last:
            self._intervals.append(now - self._last)
            self._news = True
        self._last = now

    def text(self) -> str:
        """Return the statistics, or nothing if there was no message since the last time."""
        if not self._news:
            return ""
        self._news = False
        seconds = np.array(self._intervals) * 1e-9
        mean = seconds.mean()
        return (
            f"average rate: {1.0 / mean if mean > 0.0 else 0.0:.3f}\n"
            f"\tmin: {seconds.min():.3f}s max: {seconds.max():.3f}s "
            f"std dev: {seconds.std():.5f}s window: {len(seconds)}"
        )

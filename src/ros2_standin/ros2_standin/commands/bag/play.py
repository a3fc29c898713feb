"""`ros2 bag play`: publishes the messages of a bag again."""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rosbags.rosbag2 import Reader
from rosgraph_msgs.msg import Clock

from ros2_standin.arguments import (
    add_missing,
    non_negative_float,
    non_negative_int,
    positive_float,
)
from ros2_standin.bags.reading import add_reader_arguments, open_bag
from ros2_standin.bags.recorded_qos import offer_of
from ros2_standin.log import info, warning
from ros2_standin.node import cli_node
from ros2_standin.types import interface_class
from ros2_standin.verb import Result, Terminated

RCLError = rclpy_implementation.RCLError

NAME = "rosbag2_player"
SECOND = 10**9  # ns
#: Longest time that the last messages get to arrive (ms).
LAST_MOMENT_MS = 5000
#: Longest time without a look whether to stop (s).
LOOK_PERIOD = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_reader_arguments(parser)
    parser.add_argument(
        "-r", "--rate", type=positive_float, default=1.0, help="Times as fast as recorded"
    )
    parser.add_argument("--topics", nargs="+", default=[], metavar="topic", help="Only these")
    parser.add_argument("-e", "--regex", default="", help="Only topics that this matches")
    parser.add_argument("-x", "--exclude-regex", default="", help="No topics that this matches")
    parser.add_argument(
        "--exclude-topics", nargs="+", default=[], metavar="topic", help="Not these"
    )
    parser.add_argument("-l", "--loop", action="store_true", help="Begin again at the end")
    parser.add_argument(
        "-m", "--remap", nargs="+", default=[], help="Rename topics ('old:=new old2:=new2')"
    )
    parser.add_argument(
        "--clock",
        type=positive_float,
        nargs="?",
        const=40.0,
        default=0.0,
        help="Publish the time of the bag on /clock, at this rate (Hz, default: %(const)g)",
    )
    parser.add_argument(
        "-d", "--delay", type=non_negative_float, default=0.0, help="Wait before playing (s)"
    )
    parser.add_argument(
        "--playback-duration", type=float, default=-1.0, help="End after this time of the bag (s)"
    )
    until = parser.add_mutually_exclusive_group()
    until.add_argument(
        "--playback-until-sec", type=float, default=-1.0, help="End at this time of the bag (s)"
    )
    until.add_argument(
        "--playback-until-nsec", type=int, default=-1, help="End at this time of the bag (ns)"
    )
    parser.add_argument(
        "--start-offset", type=non_negative_float, default=0.0, help="Begin this far in (s)"
    )
    parser.add_argument(
        "--wait-for-all-acked",
        type=non_negative_int,
        default=-1,
        metavar="TIMEOUT",
        help="At the end, wait until all was received, for this time (ms; 0: for ever)",
    )
    for ignored in ("--disable-keyboard-controls", "--disable-loan-message"):
        parser.add_argument(ignored, action="store_true", help="Accepted; there are none here")
    parser.add_argument(
        "--read-ahead-queue-size", type=int, help="Accepted; bags are read as they are played"
    )
    add_missing(parser, "-p", "--start-paused")
    add_missing(parser, "--services", "--exclude-services", "--publish-service-requests")
    add_missing(parser, "--service-requests-source", "--qos-profile-overrides-path")
    add_missing(parser, "--clock-topics", "--clock-topics-all")
    add_missing(parser, "--storage-config-file", "--log-level")


def main(args: argparse.Namespace) -> Result:
    try:
        chosen, refused = re.compile(args.regex), re.compile(args.exclude_regex or r"(?!)")
    except re.error as error:
        return f"not a regular expression: {error}"
    for rule in args.remap:
        if not re.fullmatch(r"[^:=\s]+:=[^:=\s]+", rule):
            return f"--remap: '{rule}' is not of the form old:=new"
    excluded = {*args.exclude_topics, *(["/clock"] if args.clock else [])}
    ros_args = [part for rule in args.remap for part in ("--remap", rule)]
    with open_bag(args.bag_path) as reader, cli_node(args, NAME, ros_args) as node:
        info(NAME, f"Set rate to {args.rate:g}")
        wanted = [
            connection
            for connection in reader.connections
            if (not args.topics or connection.topic in args.topics)
            and chosen.search(connection.topic)
            and not refused.search(connection.topic)
            and connection.topic not in excluded
        ]
        publishers = _publishers(node, wanted)
        start = reader.start_time + round(args.start_offset * SECOND)
        end = _end(args, start)
        info(NAME, f"Playback until timestamp: {-1 if end is None else end}")
        clock = _Ticks(node, args.clock) if args.clock else None
        player = _Player(publishers, args.rate, clock)
        try:
            while True:
                time.sleep(args.delay)
                if publishers:
                    player.play(_messages(reader, publishers, start, end), start)
                if not args.loop:
                    break
            _wait_for_acknowledgement(publishers, args.wait_for_all_acked)
        except KeyboardInterrupt:
            return None  # that is how one stops it
        said = sum(connection.msgcount for connection, _ in publishers.values())
        if said and not player.published and end is None and not args.start_offset:
            return f"{args.bag_path}: no message was found of the {said} that it should hold"
    return None


def _publishers(node: Node, connections: list[Any]) -> dict[int, tuple[Any, Publisher]]:
    """Make a publisher for each topic of the bag; leave out those of unknown types."""
    publishers = {}
    by_topic: dict[str, Publisher] = {}
    for connection in connections:
        topic = connection.topic
        if topic not in by_topic:
            try:
                kind = interface_class(connection.msgtype)
            except LookupError:
                reason = f"the type {connection.msgtype} is not installed"
                warning(NAME, f"Ignoring a topic '{topic}', reason: {reason}.")
                continue
            offer = offer_of(connection.ext.offered_qos_profiles)
            if offer is None:
                warning(
                    NAME,
                    f"Not all original publishers on topic {topic} offered the same QoS profiles. "
                    "Rosbag2 cannot yet choose an adapted profile to offer for this mixed case. "
                    "Falling back to the rosbag2_transport default publisher offer.",
                )
                offer = QoSProfile(depth=10)
            by_topic[topic] = node.create_publisher(kind, topic, offer)
        publishers[connection.id] = connection, by_topic[topic]
    return publishers


def _end(args: argparse.Namespace, start: int) -> int | None:
    """Return the time of the bag (ns) at which to end; None: at its end. The later limit holds."""
    limits = []
    if args.playback_duration >= 0.0:
        limits.append(start + round(args.playback_duration * SECOND))
    if args.playback_until_sec >= 0.0:
        limits.append(round(args.playback_until_sec * SECOND))
    if args.playback_until_nsec >= 0:
        limits.append(args.playback_until_nsec)
    return max(limits, default=None)


def _messages(
    reader: Reader, publishers: dict[int, tuple[Any, Publisher]], start: int, end: int | None
) -> Iterator[tuple[Publisher, int, bytes]]:
    connections = [connection for connection, _ in publishers.values()]
    stop = None if end is None else end + 1
    for connection, stamp, data in reader.messages(connections, start, stop):
        yield publishers[connection.id][1], stamp, data


class _Ticks:
    """Publishes the time of the bag on /clock."""

    def __init__(self, node: Node, rate: float) -> None:
        self._publisher = node.create_publisher(Clock, "/clock", 10)
        self.period = 1.0 / rate

    def tick(self, stamp: int) -> None:
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(stamp, SECOND)
        self._publisher.publish(message)


@dataclass
class _Player:
    """Publishes messages at the times that they had, seen from the first."""

    publishers: dict[int, tuple[Any, Publisher]]
    rate: float
    clock: _Ticks | None
    published: int = field(default=0, init=False)
    _begun: float = field(default=0.0, init=False)
    _next_tick: float = field(default=0.0, init=False)

    def play(self, messages: Iterator[tuple[Publisher, int, bytes]], start: int) -> None:
        """Publish `messages`; `start` is the time of the bag (ns) to begin at."""
        self._begun = self._next_tick = time.monotonic()
        scale = 1.0 / (SECOND * self.rate)
        for publisher, stamp, data in messages:
            due = self._begun + (stamp - start) * scale
            while (now := time.monotonic()) < due:
                self._wait(now, due, start)
            _publish(publisher, data)
            self.published += 1

    def _wait(self, now: float, due: float, start: int) -> None:
        """Sleep until `due`, or less."""
        if not rclpy.ok():
            raise Terminated
        if self.clock is not None:
            if now >= self._next_tick:
                self.clock.tick(start + round((now - self._begun) * self.rate * SECOND))
                self._next_tick += self.clock.period
            due = min(due, self._next_tick)
        time.sleep(max(0.0, min(due - now, LOOK_PERIOD)))


def _publish(publisher: Publisher, data: bytes) -> None:
    """Publish a message; where all are kept for a subscriber that cannot follow, wait for it."""
    while rclpy.ok():
        try:
            publisher.publish(data)
            return
        except RCLError:
            # The middleware itself has waited for a while. Anything else would fail again, too,
            # but bytes from a bag of a known type do not.
            continue
    raise Terminated


def _wait_for_acknowledgement(
    publishers: dict[int, tuple[Any, Publisher]], timeout_ms: int
) -> None:
    """
    Wait until what was published has been received.

    Parameters
    ----------
    publishers : dict
        With their connections.
    timeout_ms : int
        For how long (ms). 0: for ever. Negative: a moment, so that the last messages are not cut
        off, and without a word.
    """
    asked = timeout_ms >= 0
    if not asked:
        timeout_ms = LAST_MOMENT_MS
    timeout = Duration(nanoseconds=timeout_ms * 10**6 if timeout_ms else -1)
    for connection, publisher in publishers.values():
        reliable = publisher.qos_profile.reliability == QoSReliabilityPolicy.RELIABLE
        if reliable and not publisher.wait_for_all_acked(timeout) and asked:
            warning(
                NAME,
                "Timed out while waiting for all published messages to be acknowledged for topic "
                f"{connection.topic}",
            )

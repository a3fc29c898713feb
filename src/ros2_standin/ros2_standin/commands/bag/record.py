"""`ros2 bag record`: records messages to a bag."""

from __future__ import annotations

import argparse
import re
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.signals import uninstall_signal_handlers
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from ros2_standin.arguments import add_missing, positive_int
from ros2_standin.bags.definitions import definition
from ros2_standin.bags.reading import STORAGES
from ros2_standin.bags.recorded_qos import request_for, to_bag
from ros2_standin.listen import Spinner
from ros2_standin.log import error, info, warning
from ros2_standin.node import cli_node, visible
from ros2_standin.types import interface_class
from ros2_standin.verb import Result

# A signal is looked at so often (s).
_STOPS_WITHIN = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--output", help="Folder to make (default: named after the time)")
    parser.add_argument(
        "-s", "--storage", choices=STORAGES, default="mcap", help="Format (default: %(default)s)"
    )
    topics = parser.add_mutually_exclusive_group()
    topics.add_argument(
        "topics_positional", nargs="*", default=[], metavar="[Topic ...]", help="Topics to record"
    )
    topics.add_argument("--topics", nargs="+", default=[], metavar="Topic", help="The same")
    parser.add_argument(
        "--topic-types", nargs="+", default=[], metavar="TopicType", help="Topics of these types"
    )
    parser.add_argument("-a", "--all", action="store_true", help="All topics")
    parser.add_argument("--all-topics", action="store_true", help="The same")
    parser.add_argument("-e", "--regex", default="", help="Topics that this matches")
    parser.add_argument("--exclude-regex", default="", help="No topics that this matches")
    parser.add_argument(
        "--exclude-topic-types", nargs="+", default=[], metavar="TopicType", help="Not these types"
    )
    parser.add_argument(
        "--exclude-topics", nargs="+", default=[], metavar="Topic", help="Not these topics"
    )
    parser.add_argument(
        "--include-unpublished-topics", action="store_true", help="Also if nobody publishes yet"
    )
    parser.add_argument(
        "--include-hidden-topics", action="store_true", help="Include those that begin with _"
    )
    parser.add_argument(
        "--no-discovery", action="store_true", help="Record only what is there at the start"
    )
    parser.add_argument(
        "-p",
        "--polling-interval",
        type=positive_int,
        default=100,
        help="Time between two looks for new topics (ms, default: %(default)s)",
    )
    parser.add_argument(
        "--use-sim-time", action="store_true", help="Stamp messages with the time on /clock"
    )
    parser.add_argument(
        "--node-name", default="rosbag2_recorder", help="Name of the node (default: %(default)s)"
    )
    parser.add_argument(
        "--custom-data", nargs="*", default=[], metavar="KEY=VALUE", help="Notes to keep in the bag"
    )
    parser.add_argument(
        "--compression-mode",
        choices=("none", "file", "message"),
        default="none",
        help="What to compress (default: %(default)s)",
    )
    parser.add_argument("--compression-format", choices=("zstd",), help="How to compress it")
    parser.add_argument(
        "--max-cache-size", type=int, help="Accepted; messages are written as they come"
    )
    parser.add_argument(
        "--disable-keyboard-controls", action="store_true", help="Accepted; there are none here"
    )
    add_missing(parser, "--services", "--all-services", "--exclude-services", "--snapshot-mode")
    add_missing(parser, "--start-paused", "--ignore-leaf-topics", "--qos-profile-overrides-path")
    add_missing(parser, "-f", "--serialization-format", "--log-level", "--storage-config-file")
    add_missing(parser, "-b", "--max-bag-size", "-d", "--max-bag-duration")
    add_missing(parser, "--storage-preset-profile", "--compression-queue-size")
    add_missing(parser, "--compression-threads", "--compression-threads-priority")


def main(args: argparse.Namespace) -> Result:
    args.topics = args.topics_positional or args.topics
    args.all = args.all or args.all_topics
    folder = Path(args.output or datetime.now().strftime("rosbag2_%Y_%m_%d-%H_%M_%S"))
    refusal = _refusal(args, folder)
    if refusal:
        return f"[ERROR] [ros2bag]: {refusal}"
    try:
        writer = _writer(args, folder)
    except ValueError as problem:
        return f"[ERROR] [ros2bag]: {problem}"
    with cli_node(args, args.node_name) as node:
        recorder = _Recorder(node, writer, _Choice(args, node), args)
        # An exception out of a signal could come in the middle of a record, and leave a bag that
        # cannot be read; rclpy's own handlers take the graph away under the executor.
        uninstall_signal_handlers()
        for kind in (signal.SIGINT, signal.SIGTERM):
            signal.signal(kind, recorder.stop)
        try:
            writer.open()
            recorder.run()
        finally:
            recorder.close()
    return 1 if recorder.lost else None


def _refusal(args: argparse.Namespace, folder: Path) -> str:
    """Return what is wrong with the arguments, if anything is."""
    many = args.all or args.topic_types or args.regex
    if not (many or args.topics):
        return (
            "Need to specify at least one option out of --all, --all-topics, "
            "--all-services, --services, --topics, --topic-types or --regex"
        )
    for option, given in (
        ("--exclude-regex", args.exclude_regex),
        ("--exclude-topics", args.exclude_topics),
        ("--exclude-topic-types", args.exclude_topic_types),
    ):
        if given and not many:
            return (
                f"{option} argument requires either --all, --all-topics, --topic-types or --regex"
            )
    for option, pattern in (("--regex", args.regex), ("--exclude-regex", args.exclude_regex)):
        try:
            re.compile(pattern)
        except re.error as problem:
            return f"{option}: '{pattern}' is not a regular expression: {problem}"
    if folder.exists():
        return f"Output folder '{folder}' already exists."
    if args.use_sim_time and args.no_discovery:
        return (
            "--use-sim-time and --no-discovery both set, but are incompatible settings. "
            "The /clock topic needs to be discovered to record with sim time."
        )
    if args.compression_format and args.compression_mode == "none":
        return "Invalid choice: Cannot specify compression format without a compression mode."
    if args.compression_mode != "none" and not args.compression_format:
        return "Invalid choice: Cannot specify compression mode without a compression format."
    return ""


def _writer(args: argparse.Namespace, folder: Path) -> Writer:
    """Return the writer of the bag, not yet open."""
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin[args.storage.upper()])
    writer.set_compression(CompressionMode[args.compression_mode.upper()], CompressionFormat.ZSTD)
    for pair in args.custom_data:
        key, equals, value = pair.partition("=")
        if not equals:
            raise ValueError(f"--custom-data: '{pair}' is not of the form KEY=VALUE")
        writer.set_custom_data(key, value)
    return writer


@dataclass
class _Choice:
    """Decides which topics are recorded."""

    args: argparse.Namespace
    node: Node

    def __post_init__(self) -> None:
        self.topics = self._absolute(self.args.topics)
        self._excluded = self._absolute(self.args.exclude_topics)
        self._regex = re.compile(self.args.regex) if self.args.regex else None
        self._refused = re.compile(self.args.exclude_regex or r"(?!)")

    @property
    def is_open(self) -> bool:
        """Whether topics may be chosen that were not named."""
        return bool(self.args.all or self.args.topic_types or self.args.regex)

    def _absolute(self, names: list[str]) -> set[str]:
        node = self.node
        return {expand_topic_name(n, node.get_name(), node.get_namespace()) for n in names}

    def present(self) -> dict[str, str]:
        """Return the topics to record that are there, with their types."""
        hidden = self.args.include_hidden_topics
        return {
            name: types[0]
            for name, types in visible(self.node.get_topic_names_and_types(), hidden)
            if self._is_chosen(name, types)
            and (self.args.include_unpublished_topics or self.node.count_publishers(name))
        }

    def _is_chosen(self, name: str, types: list[str]) -> bool:
        args = self.args
        if name in self._excluded or self._refused.search(name):
            return False
        if len(types) > 1 or types[0] in args.exclude_topic_types:
            return False
        if args.all or name in self.topics or types[0] in args.topic_types:
            return True
        return self._regex is not None and self._regex.search(name) is not None


@dataclass
class _Recorder:
    """Subscribes to topics as they appear, and writes what comes."""

    node: Node
    writer: Writer
    choice: _Choice
    args: argparse.Namespace
    lost: int = field(default=0, init=False)
    _subscribed: set[str] = field(default_factory=set, init=False)
    _stopped: bool = field(default=False, init=False)

    def stop(self, *_: object) -> None:
        """End the recording soon; a handler of signals."""
        self._stopped = True

    def run(self) -> None:
        """Record until stopped."""
        name = self.args.node_name
        info(name, "Listening for topics...")
        look_period = self.args.polling_interval * 1e-3
        spinner = Spinner(self.node)
        if self.args.no_discovery:
            time.sleep(0.5)  # who is there at the start is not seen at once
        self._subscribe_to_new()
        info(name, "Recording...")
        looking = not self.args.no_discovery
        while not self._stopped:
            spinner.spin(min(look_period, _STOPS_WITHIN))
            if not looking:
                continue
            self._subscribe_to_new()
            if self._subscribed == self.choice.topics and not self.choice.is_open:
                info(name, "All requested topics are subscribed. Stopping discovery...")
                looking = False

    def close(self) -> None:
        """Finish the bag."""
        if not any(self.writer.counts.values()):
            self.writer.min_timestamp = 0  # otherwise the bag would begin in the year 2262
        self.writer.close()
        if self.lost:
            error(
                self.args.node_name,
                f"{self.lost} messages were lost: they came faster than they could be written",
            )
        info(self.args.node_name, "Recording stopped")

    def _subscribe_to_new(self) -> None:
        for topic, type_name in self.choice.present().items():
            if topic not in self._subscribed:
                self._subscribed.add(topic)
                self._subscribe(topic, type_name)

    def _subscribe(self, topic: str, type_name: str) -> None:
        """Begin to record a topic."""
        name = self.args.node_name
        try:
            kind = interface_class(type_name)
        except LookupError:
            warning(
                name,
                f"Topic '{topic}' has unknown type '{type_name}' . Only topics with "
                "known types are supported. Reason: 'the type is not installed'",
            )
            return
        publishers = self.node.get_publishers_info_by_topic(topic)
        offers = [publisher.qos_profile for publisher in publishers]
        endpoints = publishers or self.node.get_subscriptions_info_by_topic(topic)
        connection = self.writer.add_connection(
            topic,
            type_name,
            msgdef=definition(type_name),
            rihs01=str(endpoints[0].topic_type_hash) if endpoints else "unknown",
            offered_qos_profiles=[to_bag(offer) for offer in offers],
        )
        self.node.create_subscription(
            kind,
            topic,
            self._writing(connection),
            request_for(offers),
            event_callbacks=SubscriptionEventCallbacks(message_lost=self._count_loss),
            raw=True,
        )
        info(name, f"Subscribed to topic '{topic}'")

    def _writing(self, connection: Any) -> Callable[[bytes], None]:
        """Return what writes the messages of a topic."""
        write, clock = self.writer.write, self.node.get_clock()
        use_sim_time = self.args.use_sim_time

        def on_message(data: bytes) -> None:
            if self._stopped:
                return  # the executor comes back when no message is left: a flood must not hold it
            now = clock.now().nanoseconds if use_sim_time else time.time_ns()
            if now:  # there is no simulated time before the first message on /clock
                write(connection, now, data)

        return on_message

    def _count_loss(self, status: Any) -> None:
        self.lost += status.total_count_change

"""`ros2 bag info`: prints what is in a bag."""

from __future__ import annotations

import argparse
import time

from ros2_standin.arguments import add_missing
from ros2_standin.bags.reading import BagInfo, add_reader_arguments, bag_info
from ros2_standin.verb import Result

_INDENT = " " * 19


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_reader_arguments(parser)
    parser.add_argument("-t", "--topic-name", action="store_true", help="Print topic names only")
    add_missing(parser, "-v", "--verbose")


def main(args: argparse.Namespace) -> Result:
    info = bag_info(args.bag_path)
    if args.topic_name:
        for topic in info.topics:
            print(topic.name)
    else:
        print(_text(info))
    return None


def _text(info: BagInfo) -> str:
    """Return the table that ROS 2 prints."""
    topics = [
        f"Topic: {t.name} | Type: {t.type} | Count: {t.count} | Serialization Format: {t.format}"
        for t in info.topics
    ]
    return "\n".join(
        [
            "",
            "Files:             " + f"\n{_INDENT}".join(info.files),
            "Bag size:          " + _size(info.size),
            "Storage id:        " + info.storage,
            "ROS Distro:        " + info.distro,
            "Duration:          " + _seconds(info.duration) + "s",
            "Start:             " + _date(info.start),
            "End:               " + _date(info.start + info.duration),
            f"Messages:          {info.count}",
            "Topic information: " + f"\n{_INDENT}".join(topics),
            # Services are recorded by ROS 2's own recorder only.
            "Service:           0",
            "Service information: ",
        ]
    )


def _seconds(nanoseconds: int) -> str:
    return f"{nanoseconds // 10**9}.{nanoseconds % 10**9:09d}"


def _date(nanoseconds: int) -> str:
    moment = time.localtime(nanoseconds // 10**9)
    day, clock = time.strftime("%b %e %Y", moment), time.strftime("%H:%M:%S", moment)
    return f"{day} {clock}.{nanoseconds % 10**9:09d} ({_seconds(nanoseconds)})"


def _size(size: float) -> str:
    units = ["B", "KiB", "MiB", "GiB", "TiB"]
    while size >= 1024 and len(units) > 1:
        size /= 1024
        units.pop(0)
    return f"{size:.0f} B" if units[0] == "B" else f"{size:.1f} {units[0]}"

"""``metadata.yaml`` of a bag, as rosbag2 writes it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Channel, Schema

#: Name of the file.
METADATA = "metadata.yaml"

# Name of the file until all of the bag is there.
_UNFINISHED = ".metadata.yaml"

_FOREVER = {"sec": 9223372036, "nsec": 854775807}
#: QoS of the loop's topics, as rosbag2 writes it. A player offers it again.
QOS = {
    "history": "keep_all",
    "depth": 0,
    "reliability": "reliable",
    "durability": "volatile",
    "deadline": _FOREVER,
    "lifespan": _FOREVER,
    "liveliness": "automatic",
    "liveliness_lease_duration": _FOREVER,
    "avoid_ros_namespace_conventions": False,
}


def is_metadata(path: Path) -> bool:
    """Whether a file is a ``metadata.yaml``, finished or not."""
    return path.name in (METADATA, _UNFINISHED)


class _Dumper(yaml.SafeDumper):
    """YAML as rosbag2 writes it: no anchors for repeated values."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def to_yaml(data: Any) -> str:
    """Text of a value as rosbag2 writes it."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=10**6)
    return text


@dataclass(frozen=True)
class PartInfo:
    """What ``metadata.yaml`` tells of one file of a bag."""

    name: str
    channels: Mapping[int, Channel]
    schemas: Mapping[int, Schema]
    counts: Mapping[int, int]
    times: tuple[int, int]

    @property
    def message_count(self) -> int:
        """Messages of the file."""
        return sum(self.counts.values())

    @property
    def span(self) -> dict[str, Any]:
        """First log time and duration, as ``metadata.yaml`` has them."""
        first, last = self.times
        return {
            "starting_time": {"nanoseconds_since_epoch": first},
            "duration": {"nanoseconds": last - first},
        }


def bag_metadata(parts: Sequence[PartInfo], custom: Mapping[str, str]) -> dict[str, Any]:
    """
    Content of ``metadata.yaml`` (rosbag2, version 9).

    Parameters
    ----------
    parts : sequence of PartInfo
        The files of the bag.
    custom : mapping of str
        Free entries (``custom_data``).
    """
    topics: dict[tuple[str, str], dict[str, Any]] = {}
    for part in parts:
        for cid, channel in part.channels.items():
            schema = part.schemas.get(channel.schema_id)
            kind = "" if schema is None else schema.name
            entry = topics.setdefault(
                (channel.topic, kind),
                {
                    "topic_metadata": {
                        "name": channel.topic,
                        "type": kind,
                        "serialization_format": channel.message_encoding,
                        "offered_qos_profiles": _qos(channel),
                        "type_description_hash": channel.metadata.get("topic_type_hash", ""),
                    },
                    "message_count": 0,
                },
            )
            entry["message_count"] += part.counts.get(cid, 0)
    times = [part.times for part in parts if part.message_count] or [(0, 0)]
    first, last = min(begin for begin, _ in times), max(end for _, end in times)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": last - first},
        "starting_time": {"nanoseconds_since_epoch": first},
        "message_count": sum(part.message_count for part in parts),
        "topics_with_message_count": list(topics.values()),
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part.name for part in parts],
        "files": [
            {"path": part.name, **part.span, "message_count": part.message_count} for part in parts
        ],
        "custom_data": dict(custom),
        "ros_distro": os.environ.get("ROS_DISTRO") or "jazzy",
    }


def _qos(channel: Channel) -> list[Any]:
    """QoS profiles stored with a channel; a file to be repaired may hold anything there."""
    try:
        profiles = yaml.safe_load(channel.metadata.get("offered_qos_profiles", ""))
    except yaml.YAMLError:
        return []
    return profiles if isinstance(profiles, list) else []


def write_metadata(folder: Path, parts: Sequence[PartInfo], custom: Mapping[str, str]) -> Path:
    """
    Write what will be ``metadata.yaml`` under another name, and return that.

    Parameters
    ----------
    folder : Path
        Where to.
    parts, custom
        As of `bag_metadata`.
    """
    temporary = folder / _UNFINISHED
    try:
        with open(temporary, "w", encoding="utf-8") as file:
            file.write(to_yaml({"rosbag2_bagfile_information": bag_metadata(parts, custom)}))
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    return temporary

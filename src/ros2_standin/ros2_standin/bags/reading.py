"""Reading bags, and what is in one."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader, ReaderError

#: File formats of bags.
STORAGES = ("mcap", "sqlite3")


def bag_path(text: str) -> Path:
    """Read the path of a bag that must be there."""
    path = Path(text)
    if not path.exists():
        raise argparse.ArgumentTypeError(f"Bag path '{text}' does not exist!")
    return path


def add_reader_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of verbs that read a bag."""
    parser.add_argument("bag_path", type=bag_path, help="Folder or file of the bag")
    parser.add_argument(
        "-s", "--storage", choices=STORAGES, help="Accepted; the format is seen from the bag"
    )


@contextmanager
def open_bag(path: Path) -> Iterator[Reader]:
    """
    Open a bag for reading.

    Raises
    ------
    RuntimeError
        If it is none, or damaged.
    """
    if path.is_dir() and not (path / "metadata.yaml").exists():
        raise RuntimeError(
            f"{path}: no metadata.yaml: not a bag, or one whose recording was not finished"
        )
    try:
        with Reader(path) as reader:
            for storage in getattr(reader.storage, "storages", [reader.storage]):
                _read_unindexed(storage, path)
            yield reader
    except ReaderError as error:
        raise RuntimeError(f"{path}: {error}") from None


def _read_unindexed(storage: Any, path: Path) -> None:
    """
    Have an MCAP file without message indexes read from front to back.

    By its chunk index alone the reader would find no message in it. ROS 2 falls back to the order
    of the file.
    """
    chunks = getattr(storage, "chunks", None)
    if not chunks or all(chunk.message_index_offsets for chunk in chunks):
        return
    if not storage.metadata.message_count:
        raise RuntimeError(
            f"{path}: has neither message indexes nor statistics, so its messages are not found"
        )
    chunks.clear()


# --- What is in a bag --------------------------------------------------------------------------


@dataclass(frozen=True)
class TopicInfo:
    """Topic of a bag: its name, type, number of messages, and how these are serialized."""

    name: str
    type: str
    count: int
    format: str


@dataclass(frozen=True)
class BagInfo:
    """
    What is in a bag.

    Parameters
    ----------
    files : list of str
        Names of its files.
    size : int
        Of all of them (bytes).
    storage : str
        Format of the files.
    distro : str
        ROS distribution it was recorded with.
    start, duration : int
        Time of the first message, and from there to the last (ns).
    count : int
        Number of messages.
    topics : list of TopicInfo
    """

    files: list[str]
    size: int
    storage: str
    distro: str
    start: int
    duration: int
    count: int
    topics: list[TopicInfo]


def bag_info(path: Path) -> BagInfo:
    """
    Return what is in a bag.

    Raises
    ------
    RuntimeError
        If it is none, or damaged.
    """
    return _info_of_folder(path) if path.is_dir() else _info_of_file(path)


def _info_of_folder(path: Path) -> BagInfo:
    # `metadata.yaml` tells all: the files need not be opened, and may be missing.
    try:
        content = yaml.safe_load((path / "metadata.yaml").read_text(encoding="utf-8"))
        data = content["rosbag2_bagfile_information"]
        files = [str(name) for name in data["relative_file_paths"]]
        topics = [
            TopicInfo(
                name=entry["topic_metadata"]["name"],
                type=entry["topic_metadata"]["type"],
                count=entry["message_count"],
                format=entry["topic_metadata"]["serialization_format"],
            )
            for entry in data["topics_with_message_count"]
        ]
        return BagInfo(
            files=files,
            size=sum(f.stat().st_size for name in files if (f := path / name).exists()),
            storage=data["storage_identifier"],
            distro=data.get("ros_distro") or "unknown",
            start=int(data["starting_time"]["nanoseconds_since_epoch"]),
            duration=int(data["duration"]["nanoseconds"]),
            count=int(data["message_count"]),
            topics=topics,
        )
    except FileNotFoundError:
        raise RuntimeError(
            f"{path}: no metadata.yaml: not a bag, or one whose recording was not finished"
        ) from None
    except (KeyError, TypeError, ValueError, yaml.YAMLError) as error:
        raise RuntimeError(f"{path / 'metadata.yaml'}: damaged: {error!r}") from None


def _info_of_file(path: Path) -> BagInfo:
    with open_bag(path) as reader:
        count = reader.message_count
        return BagInfo(
            files=[path.name],
            size=path.stat().st_size,
            storage="mcap" if path.suffix == ".mcap" else "sqlite3",
            distro="unknown",
            start=reader.start_time if count else 0,
            duration=max(reader.duration - 1, 0),  # rosbags counts to after the last message
            count=count,
            topics=[
                TopicInfo(c.topic, c.msgtype, c.msgcount, _extension(c).serialization_format)
                for c in reader.connections
            ],
        )


def _extension(connection: Any) -> ConnectionExtRosbag2:
    extension: ConnectionExtRosbag2 = connection.ext
    return extension

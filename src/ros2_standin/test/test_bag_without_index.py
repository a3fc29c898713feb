"""An MCAP file without message indexes is read all the same, or refused: never played as empty."""

from pathlib import Path

import pytest
from mcap.writer import IndexType, Writer

from ros2_standin.bags.reading import open_bag

ALL_BUT_MESSAGES = IndexType.CHUNK | IndexType.METADATA


def write(path: Path, times: list[int], **options: object) -> Path:
    with open(path, "wb") as file:
        writer = Writer(file, chunk_size=200, index_types=ALL_BUT_MESSAGES, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/Header", "ros2msg", b"string frame_id")
        channel = writer.register_channel("/ticks", "cdr", schema)
        for time in times:
            writer.add_message(channel, time, b"\0\1\0\0" + bytes(40), time)
        writer.finish()
    return path


def test_all_messages_are_found(tmp_path: Path) -> None:
    path = write(tmp_path / "x.mcap", list(range(100)))
    with open_bag(path) as reader:
        assert [time for _, time, _ in reader.messages(reader.connections)] == list(range(100))


def test_messages_that_are_not_in_order(tmp_path: Path) -> None:
    path = write(tmp_path / "x.mcap", [3, 2, 1])
    with pytest.raises(RuntimeError, match="not in timestamp order"), open_bag(path) as reader:
        list(reader.messages(reader.connections))


def test_no_statistics_either(tmp_path: Path) -> None:
    path = write(tmp_path / "x.mcap", list(range(100)), use_statistics=False)
    with pytest.raises(RuntimeError, match="neither message indexes nor"), open_bag(path):
        pass

"""Recovering loses nothing: neither what can be copied nor the file that it was copied from."""

from __future__ import annotations

from pathlib import Path

import bag_kinds
import pytest
import yaml
from bag_kinds import Kind
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import Reader
from synthetic_drive import CONFIG, messages

from mfpcc_experiments.bags import LOOP_TOPICS, BagError, BagWriter, recording, recover
from mfpcc_experiments.bags.definitions import message_definition
from mfpcc_experiments.bags.disk.sink import McapSink
from mfpcc_experiments.bags.provenance import CONFIG_RECORD, json_record

MESSAGES = list(messages(200))


def write(path: Path, *, silent: bool = False, json_topic: bool = False) -> Path:
    """A file as others write it: with an attachment, metadata, a topic that says nothing."""
    path.parent.mkdir(exist_ok=True)
    with open(path, "wb") as file:
        writer = Writer(file, chunk_size=1 << 14, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        channels = {}
        for topic, type_name in LOOP_TOPICS.items():
            text = message_definition(type_name).encode()
            schema = writer.register_schema(type_name, "ros2msg", text)
            channels[topic] = writer.register_channel("/" + topic, "cdr", schema)
        if json_topic:
            channels["json"] = writer.register_channel("/json", "json", 0)
            writer.add_message(channels["json"], 0, b'{"a": 1}', 0)
        if silent:
            writer.register_channel("/silent", "cdr", schema)
        writer.add_metadata(CONFIG_RECORD, json_record(CONFIG | {"window_s": None}))
        writer.add_metadata("theirs", {"json": "[1, 2", "key": "value"})
        writer.add_attachment(1, 2, "photo.png", "image/png", b"picture" * 100)
        for topic, at, data in MESSAGES:
            writer.add_message(channels[topic], at, data, at)
        writer.finish()
    return path


def cut(path: Path, count: int) -> bytes:
    data = path.read_bytes()
    path.write_bytes(data[:-count])
    return data[:-count]


def check(path: Path) -> None:
    """What was recovered is what others find in it, too."""
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        (attachment,) = reader.iter_attachments()
        assert (attachment.name, attachment.data) == ("photo.png", b"picture" * 100)
        assert (attachment.create_time, attachment.log_time) == (1, 2)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        assert metadata["theirs"] == {"json": "[1, 2", "key": "value"}
        summary = reader.get_summary()
        assert summary.statistics.attachment_count == len(summary.attachment_indexes) == 1
        found = [(c.topic[1:], m.log_time, m.data) for _, c, m in reader.iter_messages()]
    assert sorted(m for m in found if m[0] in LOOP_TOPICS) == sorted(MESSAGES)


def test_a_whole_file_that_lacks_its_metadata_is_left_as_it_is(tmp_path: Path) -> None:
    path = write(tmp_path / "bag" / "bag_0.mcap", silent=True)
    before, status = path.read_bytes(), path.stat()
    assert "its metadata.yaml was missing and was written" in recover.recover(path.parent)
    assert path.read_bytes() == before and path.stat().st_mtime_ns == status.st_mtime_ns
    assert {x.name for x in path.parent.iterdir()} == {"bag_0.mcap", "metadata.yaml"}
    check(path)
    with Reader(path.parent) as reader:
        assert reader.message_count == len(MESSAGES)
        assert {c.topic: c.msgcount for c in reader.connections}["/silent"] == 0
    assert "nothing to repair" in recover.recover(path.parent)


@pytest.mark.parametrize("count", [1, 20, 500])
def test_attachments_and_metadata_survive(count: int, tmp_path: Path) -> None:
    path = write(tmp_path / "bag" / "bag_0.mcap", silent=True)
    old = cut(path, count)
    said = recover.recover(path.parent)
    assert f"saved {len(MESSAGES)} messages" in said
    check(path)
    kept = path.with_name("bag_0.mcap.damaged")
    assert kept.read_bytes() == old and kept.name in said
    with open(path, "rb") as file:
        assert "/silent" in {c.topic for c in make_reader(file).get_summary().channels.values()}
    assert recording.read(path.parent).lost_periods == 0


def test_a_first_chunk_without_messages(tmp_path: Path) -> None:
    """Only schemas and channels: the next chunk is of no use without them."""
    path = tmp_path / "bag" / "bag_0.mcap"
    path.parent.mkdir()
    with open(path, "wb") as file:
        writer = Writer(file, chunk_size=1 << 14)
        writer.start(profile="ros2")
        channels = {}
        for topic, type_name in LOOP_TOPICS.items():
            text = message_definition(type_name).encode()
            schema = writer.register_schema(type_name, "ros2msg", text)
            channels[topic] = writer.register_channel("/" + topic, "cdr", schema)
        writer._Writer__finalize_chunk()  # as rosbag2 does where the first messages are late
        for topic, at, data in MESSAGES:
            writer.add_message(channels[topic], at, data, at)
        writer.finish()
    cut(path, 20)
    assert f"saved {len(MESSAGES)} messages" in recover.recover(path.parent)
    assert len(recording.read(path.parent).feedback) == 200
    with Reader(path.parent) as reader:
        assert len(list(reader.messages())) == len(MESSAGES)


def test_a_channel_without_a_schema(tmp_path: Path) -> None:
    path = write(tmp_path / "bag" / "bag_0.mcap", json_topic=True)
    cut(path, 20)
    assert f"saved {len(MESSAGES) + 1} messages" in recover.recover(path.parent)
    check(path)
    content = yaml.safe_load((path.parent / "metadata.yaml").read_text())
    topics = content["rosbag2_bagfile_information"]["topics_with_message_count"]
    counts = {t["topic_metadata"]["name"]: t["message_count"] for t in topics}
    assert counts["/json"] == 1 and counts["/phase_feedback"] == 200
    assert len(recording.read(path.parent).feedback) == 200


def test_a_split_bag_is_recovered_as_a_whole(tmp_path: Path) -> None:
    path = bag_kinds.write(tmp_path / "bag", [MESSAGES[:400], MESSAGES[400:]], Kind())
    whole = (path / "run_0.mcap").read_bytes()
    cut(path / "run_1.mcap", 20)
    (path / "metadata.yaml").unlink()
    assert "saved" in recover.recover(path)
    assert (path / "run_0.mcap").read_bytes() == whole
    with Reader(path) as reader:
        assert reader.message_count == len(MESSAGES) == len(list(reader.messages()))
    assert recording.read(path).lost_periods == 0


def test_a_copy_that_is_not_what_it_should_be_replaces_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "bag" / "bag_0.mcap")
    old = cut(path, 20)
    real = McapSink.chunk

    def chunk(sink: McapSink, records: bytes, index: dict) -> None:
        real(sink, records[:-1] + bytes([records[-1] ^ 1]), index)  # a disk that lies

    monkeypatch.setattr(McapSink, "chunk", chunk)
    with pytest.raises(BagError, match="the repaired copy does not hold what was copied"):
        recover.recover(path.parent)
    assert {x.name: x.read_bytes() for x in path.parent.iterdir()} == {"bag_0.mcap": old}


def test_a_bag_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "live", config=CONFIG) as writer:
        for message in MESSAGES:
            writer.write(*message)
        with pytest.raises(BagError, match="is being written at this moment"):
            recover.recover(tmp_path / "live")
    assert len(recording.read(tmp_path / "live").feedback) == 200


def test_a_file_that_grows_meanwhile_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a writer that has no lock."""
    path = write(tmp_path / "bag" / "bag_0.mcap")
    old = cut(path, 20)
    real = recover._Copy.check

    def check(copy: recover._Copy) -> None:
        real(copy)
        with open(path, "ab") as file:
            file.write(b"more")

    monkeypatch.setattr(recover._Copy, "check", check)
    with pytest.raises(BagError, match="has changed meanwhile: is it being written"):
        recover.recover(path.parent)
    assert {x.name: x.read_bytes() for x in path.parent.iterdir()} == {"bag_0.mcap": old + b"more"}


def test_a_part_that_is_missing_is_not_passed_over(tmp_path: Path) -> None:
    third = len(MESSAGES) // 3
    parts = [MESSAGES[:third], MESSAGES[third : 2 * third], MESSAGES[2 * third :]]
    path = bag_kinds.write(tmp_path / "bag", parts, Kind())
    (path / "run_0.mcap").unlink()
    with pytest.raises(BagError, match=r"'run_0\.mcap', a part of the bag .* is missing"):
        recover.recover(path)
    cut(path / "run_2.mcap", 20)
    said = recover.recover(path)
    assert "saved" in said and "'run_0.mcap', a part of the bag" in said
    assert any("a part is missing" in note.text for note in recording.read(path).notes)


def chunked(path: Path, source: list, config: dict | None = None) -> Path:
    """A recording of others in one file, in the order of `source`, cut before its end."""
    path.parent.mkdir(exist_ok=True)
    with open(path, "wb") as file:
        writer = Writer(file, chunk_size=1 << 12, compression=CompressionType.LZ4)
        writer.start(profile="ros2")
        channels = {}
        for topic, type_name in LOOP_TOPICS.items():
            text = message_definition(type_name).encode()
            schema = writer.register_schema(type_name, "ros2msg", text)
            channels[topic] = writer.register_channel("/axis1/" + topic, "cdr", schema)
        if config is not None:
            writer.add_metadata(CONFIG_RECORD, json_record(config))
        for topic, at, data in source:
            writer.add_message(channels[topic], at, data, at)
        writer.finish()
    cut(path, 20)
    return path


@pytest.mark.parametrize("config", [None, CONFIG | {"window_s": None}])
@pytest.mark.parametrize("late", [*LOOP_TOPICS, None])
def test_a_ragged_end_is_cut_to_the_last_period_of_all(
    late: str | None, config: dict | None, tmp_path: Path
) -> None:
    """One topic ends 40 periods before the others, as where each is written by itself."""
    source, last = [], 199
    for message in MESSAGES:
        topic, at, _ = message
        if topic != late or at < MESSAGES[-1][1] - 40 * 100_000:
            source.append(message)
    path = chunked(tmp_path / "bag" / "bag_0.mcap", source, config)
    before = path.read_bytes()
    said = recover.recover(path)
    found = recording.read(path)
    rows = {
        "phase_feedback": found.feedback["period"],
        "duty_command": found.command["period"] - 1,
        "lut_diagnostics": found.lut["period"],
        "drive_state": found.state["period"],
    }
    ends = {int(period[-1]) for period in rows.values()}
    assert len(ends) == 1 and (last - 42 <= ends.pop() <= last - 38 if late else ends == {last})
    assert (found.lost_periods, found.notes[:1] if config else []) == (0, [])
    kept = path.with_name(path.name + ".damaged")
    assert ("behind the last period that all topics have left out" in said) == bool(late)
    assert not late or kept.read_bytes() == before  # all that there was


def test_a_topic_that_fell_silent_costs_no_other(tmp_path: Path) -> None:
    from mfpcc_experiments.bags import ragged

    count = ragged.LONGEST + 300
    source = [m for m in messages(count) if m[0] != "drive_state" or m[1] < 200 * 100_000]
    path = chunked(tmp_path / "bag" / "bag_0.mcap", source)
    assert "left out" not in recover.recover(path)
    with open(path, "rb") as file:
        assert sum(1 for _ in make_reader(file).iter_messages()) == len(source)


def test_a_drive_that_was_restarted_is_not_cut_before_it(tmp_path: Path) -> None:
    """What belongs to the end is told by the order of writing, not by period numbers alone."""
    later = MESSAGES[-1][1] + 1_000_000_000
    second = [(topic, at + later, data) for topic, at, data in MESSAGES[:101]]
    path = chunked(tmp_path / "bag" / "bag_0.mcap", [*MESSAGES, *second])
    recover.recover(path)
    found = recording.read(path)
    assert len(found.feedback) == 200

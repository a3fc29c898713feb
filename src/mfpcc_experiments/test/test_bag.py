"""Writing bags: as rosbag2 writes them, bounded loss, nothing overwritten."""

import json
import os
import resource
import signal
import subprocess
import sys
import tracemalloc
from array import array
from pathlib import Path

import numpy as np
import pytest
import synthetic_drive
import yaml
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mfpcc_experiments.bags import LOOP_TOPICS, BagError, BagWriter, recording, recover
from mfpcc_experiments.bags.definitions import message_definition
from mfpcc_experiments.bags.disk import mcap_file
from mfpcc_experiments.bags.disk.sink import McapSink

TOPICS = {"/" + name: type_name for name, type_name in LOOP_TOPICS.items()}


def test_rosbags_reads_it_with_the_types_stored_inside(make_bag):
    path = make_bag(periods=1200, oversampling=4)
    store = get_typestore(Stores.EMPTY)
    with Reader(path) as reader:
        assert {c.topic: c.msgtype for c in reader.connections} == TOPICS
        assert {c.msgcount for c in reader.connections} == {1200}
        assert reader.start_time == 0
        for connection in reader.connections:
            types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            store.register({k: v for k, v in types.items() if k not in store.fielddefs})
            assert store.hash_rihs01(connection.msgtype) == connection.digest
        periods = {topic: [] for topic in TOPICS}
        for connection, time, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            periods[connection.topic].append(message.period)
            assert time == message.period * 100_000
        assert periods["/phase_feedback"] == list(range(1200))
        assert periods["/duty_command"] == list(range(1, 1201))


def test_mcap_finds_no_fault(make_bag):
    (file,) = make_bag(periods=1200).glob("*.mcap")
    with open(file, "rb") as stream:
        for _ in StreamReader(stream, validate_crcs=True).records:
            pass
    with open(file, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary.statistics.message_count == 4800
        assert summary.statistics.channel_message_counts == dict.fromkeys(range(1, 5), 1200)
        # 120 ms in chunks of 40 ms, and the last command is for the period after.
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) == 3
        for channel in summary.channels.values():
            assert set(channel.metadata) == {"offered_qos_profiles", "topic_type_hash"}
        # The index finds messages in the middle of the file.
        times = [m.log_time for _, _, m in reader.iter_messages(starting_at=60_000_000)]
        assert min(times) == 60_000_000 and len(times) == 4 * 600 + 1
        records = {record.name: record.metadata for record in reader.iter_metadata()}
    assert json.loads(records["mfpcc_config"]["json"])["seed"] == 7
    assert json.loads(records["mfpcc_summary"]["json"])["step_time_us"]["p99"] == 9.0


def test_metadata_is_that_of_rosbag2(make_bag):
    path = make_bag("axis", periods=10)
    content = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert content["version"] == 9
    assert content["storage_identifier"] == "mcap"
    assert content["relative_file_paths"] == ["axis_0.mcap"]
    assert content["message_count"] == 40 == content["files"][0]["message_count"]
    assert content["duration"] == {"nanoseconds": 1_000_000}
    assert content["custom_data"]["scheme"] == "mls_mfpcc"
    topic = content["topics_with_message_count"][0]["topic_metadata"]
    assert topic["name"] == "/phase_feedback"
    assert topic["type_description_hash"].startswith("RIHS01_")
    assert topic["offered_qos_profiles"][0]["reliability"] == "reliable"


def test_definitions_contain_what_they_use():
    text = message_definition("mfpcc_msgs/msg/DriveStatus")
    assert text.count("=" * 80) == 2
    assert "MSG: mfpcc_msgs/DriveFault\n" in text
    assert "MSG: builtin_interfaces/Time\n" in text and "int32 sec" in text


def test_namespace_and_other_topics(tmp_path, drive_messages):
    with BagWriter(tmp_path / "b", config={}, namespace="axis1") as writer:
        writer.add_topic("/clock", "builtin_interfaces/msg/Time")
        for message in drive_messages(3):
            writer.write(*message)
        writer.write("/clock", 0, b"\0\1\0\0" + bytes(8))
        with pytest.raises(BagError, match="'rubbish' was not announced"):
            writer.write("rubbish", 0, b"")
    with Reader(tmp_path / "b") as reader:
        assert {c.topic for c in reader.connections} >= {"/clock", "/axis1/drive_state"}
    assert len(recording.read(tmp_path / "b").feedback) == 3


def test_the_same_messages_give_the_same_file(make_bag):
    one, other = make_bag("one", 600), make_bag("other", 600)
    data = [next(path.glob("*.mcap")).read_bytes() for path in (one, other)]
    assert data[0].replace(b"one_0.mcap", b"other_0.mcap")[:2000] == data[1][:2000]
    assert len(data[0]) - len(data[1]) == 2 * (len("one") - len("other"))  # the name, twice


def test_nothing_is_overwritten(make_bag, tmp_path):
    path = make_bag(periods=5)
    with pytest.raises(BagError, match="nothing is overwritten without --force"):
        make_bag(periods=5)
    make_bag(periods=7, force=True)
    assert len(recording.read(path).feedback) == 7
    (path / "thesis.tex").write_text("precious")
    with pytest.raises(BagError, match=r"'thesis\.tex'"):
        make_bag(periods=5, force=True)
    assert (path / "thesis.tex").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="is a file"):
        make_bag("file", periods=5, force=True)


def test_an_exception_in_the_run_leaves_a_valid_bag(tmp_path, drive_messages):
    def run() -> None:
        with BagWriter(tmp_path / "b", config={}) as writer:
            for message in drive_messages(100):
                writer.write(*message)
            raise ArithmeticError("the scheme diverged")

    with pytest.raises(ArithmeticError):
        run()
    found = recording.read(tmp_path / "b")
    assert len(found.feedback) == 100
    assert found.summary["incomplete"].startswith("ArithmeticError: the scheme")


WRITER = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
import synthetic_drive
from mfpcc_experiments.bags import BagError, BagWriter
bag = BagWriter(Path(sys.argv[2]), config=synthetic_drive.CONFIG, oversampling=4)
try:
    for n, message in enumerate(synthetic_drive.messages(10**6, oversampling=4)):
        bag.write(*message)
        if n % 4000 == 0:
            print(message[1], flush=True)
    bag.close()
except BagError as error:
    bag.close()
    print("BagError:", error, flush=True)
    sys.exit(3)
"""


def start_writer(path: Path, **options: object) -> subprocess.Popen:
    command = [sys.executable, "-c", WRITER, str(Path(synthetic_drive.__file__).parent), str(path)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **options)


def test_a_killed_writer_loses_at_most_200_ms(tmp_path):
    path = tmp_path / "killed"
    with start_writer(path) as process:
        for line in process.stdout:
            reached = int(line)
            if reached >= 500_000_000:
                process.send_signal(signal.SIGKILL)
                break
    assert not (path / "metadata.yaml").exists()
    with pytest.raises(BagError, match=f"'mfpcc recover .*{path.name}"):
        recording.read(path)
    assert "saved" in recover.recover(path)
    found = recording.read(path)
    assert found.lost_periods == 0
    assert found.feedback["period"][-1] * 100_000 >= reached - 200_000_000
    assert found.config["seed"] == 7
    assert "killed" in found.summary["incomplete"]
    with Reader(path) as reader:
        assert reader.message_count >= 4 * len(found.feedback) - 4
    assert "nothing to repair" in recover.recover(path)
    # What was being written when it was killed nobody can read; it is kept all the same.
    kept = {p.name for p in path.iterdir()} - {"killed_0.mcap.damaged"}
    assert kept == {"killed_0.mcap", "metadata.yaml"}


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="needs file size limits")
def test_a_full_disk_ends_with_a_clear_message_and_a_valid_bag(tmp_path):
    path = tmp_path / "full"

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, 600_000))

    with start_writer(path, preexec_fn=limit) as process:
        output = process.stdout.read()
    assert process.returncode == 3
    assert f"BagError: {path}: {os.strerror(27)}; the recording ends at" in output
    found = recording.read(path)
    assert len(found.feedback) > 500 and found.lost_periods == 0
    assert "incomplete" in found.summary
    with Reader(path) as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("LZ4 gave up"), SystemExit(3)])
def test_whatever_fails_in_the_writing_thread_ends_the_recording(
    error, tmp_path, drive_messages, monkeypatch
):
    real = McapSink.chunk

    def chunk(sink, *item):
        if len(sink.chunks) == 2:
            raise error
        real(sink, *item)

    monkeypatch.setattr(McapSink, "chunk", chunk)
    writer = BagWriter(tmp_path / "b", config={})

    def record():
        for message in drive_messages(4000):
            writer.write(*message)

    with pytest.raises(BagError, match=rf"{type(error).__name__}: .*; the recording ends at 0\.08"):
        record()
    writer.close()
    assert len(recording.read(tmp_path / "b").feedback) == 800


def test_a_chunk_holds_whole_periods(make_bag):
    """So a file that is cut off between two chunks ends at the same period in all topics."""
    (file,) = make_bag(periods=2000).glob("*.mcap")
    channels = mcap_file.Channels(file)
    chunks = [
        mcap_file.block(record, channels).messages.channel_id
        for record in mcap_file.blocks(file)
        if record.opcode == Opcode.CHUNK
    ]
    assert [np.bincount(ids).tolist() for ids in chunks] == [[0, 400, 400, 400, 400]] * 5


def test_room_for_the_end_is_made_on_a_full_disk(tmp_path, drive_messages, monkeypatch):
    real = McapSink.finish
    calls = []

    def finish(sink):
        calls.append(len(sink.chunks))
        if len(calls) < 3:
            raise OSError(28, os.strerror(28))
        real(sink)

    monkeypatch.setattr(McapSink, "finish", finish)
    writer = BagWriter(tmp_path / "b", config={})
    for message in drive_messages(3000):
        writer.write(*message)
    with pytest.raises(BagError, match="no space left for the end"):
        writer.close()
    assert calls == [8, 7, 6]
    assert len(recording.read(tmp_path / "b").feedback) == 2400


def test_an_hour_of_chunks_takes_little_memory(tmp_path):
    """All of them are kept until the file has its index: 90,000 an hour."""
    sink = McapSink(tmp_path / "b_0.mcap")

    def chunks(numbers):
        for n in numbers:
            sink.chunk(bytes(1000), {cid: array("Q", [40_000_000 * n, 0]) for cid in range(1, 5)})

    chunks(range(100))
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    chunks(range(100, 2100))
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (after - before) / 2000 < 200.0
    # and they are taken back as they were written
    sink.take_back()
    assert len(sink.chunks) == 2099 and sink.times == (0, 2098 * 40_000_000)
    sink.close()

"""Reading bags into arrays: completeness, and files of others, cut, damaged or foreign."""

import random
import shutil
import struct

import bag_kinds
import numpy as np
import pytest
from mfpcc_msgs.msg import DutyCommand
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mfpcc_experiments.bags import LOOP_TOPICS, BagError, BagWriter, recording, recover
from mfpcc_experiments.bags.definitions import message_definition
from mfpcc_experiments.bags.disk.mcap_format import MAGIC
from mfpcc_experiments.measuring import happened, metrics, window
from pwm_node import bits
from pwm_node.wire import Wire


def test_arrays_hold_what_was_written(make_bag):
    found = recording.read(make_bag(periods=1500, oversampling=5))
    assert found.T_s == 1e-4 and found.n_p == 4 and found.window_s == (0.1, 0.3)
    assert found.feedback["period"].tolist() == list(range(1500))
    assert found.command["period"].tolist() == list(range(1, 1501))
    assert found.command["duty"][7].tolist() == [0.4, 0.5, 0.6]
    assert found.lut["prediction_error"][3].tolist() == [0.05, -0.1]
    assert found.state["torque"][-1] == 2.5
    assert found.feedback["stamp"]["nanosec"][12] == 1_200_000
    assert set(found.scheme) == {"mls_mfpcc"} and len(found.scheme) == 1500
    assert found.oversampling == 5 and found.i_abc_oversampled.shape == (1500, 5, 3)
    first = [found.feedback[name] for name in ("i_a", "i_b", "i_c")]
    assert np.array_equal(found.i_abc_oversampled[:, 0], np.stack(first, axis=1))
    assert found.legs_oversampled[9].tolist() == [1] * 5
    assert found.lost_periods == 0 and found.notes == []
    assert found.summary["step_time_us"]["median"] == 3.0


def test_a_change_of_scheme_is_seen_row_by_row(make_bag, drive_messages):
    parts = [("mfpcc", 0, 40), ("mbpcc", 40, 60), ("mls_mfpcc", 100, 50)]
    source = (m for name, at, n in parts for m in drive_messages(n, first=at, scheme=name))
    found = recording.read(make_bag(source=source, config={}))
    assert found.scheme.tolist() == ["mfpcc"] * 40 + ["mbpcc"] * 60 + ["mls_mfpcc"] * 50
    assert found.notes == []
    assert happened.history(found).scheme_in(0, 150).split(" -> ")[-1] == "mls_mfpcc"


def test_metrics_of_a_known_drive(make_bag):
    row = metrics.evaluate(recording.read(make_bag(oversampling=5)))
    assert row["experiment"] == "synthetic" and row["engine"] == "inprocess" and row["seed"] == 7
    assert row["periods"] == 4000 and row["lost_periods"] == 0 and row["window_s"] == [0.1, 0.3]
    assert row["thd_percent"]["control"] == pytest.approx(2.0, rel=1e-3)
    assert row["thd_percent"]["oversampled"] == pytest.approx(2.0, rel=1e-3)
    # 2 % of 3.007 A, seen from the rotor as two rotating vectors.
    assert row["ripple_pp"]["d"] == pytest.approx(0.0, abs=1e-9)  # i_dq as the controller saw it
    assert row["ripple_pp"]["d_oversampled"] == pytest.approx(0.12, rel=0.02)
    assert row["lut_error_max"] == {"d": 0.05, "q": 0.1}
    assert row["lut_error_rms"]["q"] == pytest.approx(0.1 / np.sqrt(3), rel=1e-2)
    assert row["i_d_mean"] == pytest.approx(0.2)
    assert row["i_q_error_mean"] == pytest.approx(-0.1)
    assert row["speed_rpm_mean"] == pytest.approx(750.0, rel=1e-9)
    assert row["step_time_us"] == {"median": 3.0, "p99": 9.0}
    assert row["switching_frequency_hz"] == pytest.approx(10e3)
    assert row["copper_loss_w"] == pytest.approx(1.5 * 1.5 * (0.2**2 + 3**2) * (1 + 0.02**2))
    assert row["fundamental"]["frequency_hz"] == pytest.approx(50.0)


def test_a_bag_of_others_is_measured_without_configuration(make_bag):
    found = recording.read(make_bag(periods=2000, config={"oversampling": "?"}))
    assert found.T_s == pytest.approx(1e-4) and found.n_p == 4
    row = metrics.evaluate(found)
    assert row["window_s"] == [0.0, pytest.approx(0.2)]
    assert row["scheme"] == "mls_mfpcc" and row["experiment"] is None
    assert row["thd_percent"]["oversampled"] is None


def test_the_period_can_be_told_at_any_time(make_bag, drive_messages):
    """Nanoseconds of a stamp do not fit into 32 bits from 2.1 s on."""
    source = drive_messages(1000, first=69_500)
    assert recording.read(make_bag(source=source, config={})).T_s == pytest.approx(1e-4)


def test_a_window_outside_of_the_recording(make_bag):
    found = recording.read(make_bag(periods=500))
    with pytest.raises(window.MetricsError, match=r"0\.1 to 0\.3 s holds 0 samples.* to 0\.05 s"):
        metrics.evaluate(found)


# --- Completeness ---


def test_gaps_are_counted_and_named(make_bag, drive_messages):
    source = (m for n, m in enumerate(drive_messages(1000)) if n not in {400, 401, 404, 2002})
    found = recording.read(make_bag(source=source))
    assert found.lost_periods == 3  # 100 and 101, and 500, of which another topic is missing
    assert any("phase_feedback: 2 messages are missing, first after period 99" in n.text
               for n in found.notes)  # fmt: skip
    assert any(n.text.startswith("drive_state: 1 messages") for n in found.notes)
    assert not any(n.text.startswith("duty_command") for n in found.notes)


def test_a_fault_from_before_the_recording_is_the_cause_of_its_gates(tmp_path, drive_messages):
    """A recorder that joins late is told of it; the inverter has been at rest all the time."""

    def at_rest():
        command = Wire(DutyCommand)
        for topic, time, data in drive_messages(4000, first=5000):
            if topic == "duty_command":
                command.load(data)
                command.fixed["enable"] = False
                yield topic, time, command.to_bytes()
            elif topic != "drive_state":
                yield topic, time, data

    fault = {"node": "pmsm_sim", "code": "OVERSPEED", "period": 3120, "detail": "200 rad/s"}
    with BagWriter(tmp_path / "bag", config={"T_s": 1e-4, "n_p": 4}) as bag:
        for message in at_rest():
            bag.write(*message)
        bag.close({"faults": [fault]})
    row = metrics.evaluate(recording.read(tmp_path / "bag"))
    told = [note for note in row["notes"] if "OVERSPEED" in note["text"]]
    (note,) = told
    assert note["severity"] == "failure"
    assert note["text"] == (
        "gates off from 0.500 s: OVERSPEED, 200 rad/s (latched at 0.312 s, before the recording)"
    )


def test_every_second_period_missing_is_no_decimation(make_bag, drive_messages):
    def sample(message):
        return int.from_bytes(message[2][12:20], "little") - (message[0] == "duty_command")

    source = (m for m in drive_messages(4000) if sample(m) % 2 == 0)
    found = recording.read(make_bag(source=source))
    assert found.lost_periods >= 1999
    row = metrics.evaluate(found)
    assert row["thd_percent"]["control"] is None and row["i_d_mean"] is None
    for topic in ("phase_feedback", "duty_command"):
        text = f"1000 of the 2000 periods of the window are missing in {topic}"
        assert any(text in note["text"] for note in row["notes"])


def test_a_missing_end_is_a_gap(make_bag, drive_messages):
    source = (m for m in drive_messages(1000) if m[0] != "lut_diagnostics" or m[1] < 90_000_000)
    found = recording.read(make_bag(source=source))
    assert found.lost_periods == 99  # the very last period of a run may lack its diagnostics


def stop(command, *, answers: bool = False):
    """What a controller sends as it is made inactive: its last command, for the period after."""
    topic, time, data = command
    wire = Wire(DutyCommand)
    wire.load(data)
    wire.fixed["period"] += 1
    wire.fixed["enable"] = False
    if answers:  # with the gates off, but with a stamp of its own
        wire.fixed["stamp"]["nanosec"] += 100_000
    return topic, time + 1, wire.to_bytes()


def test_the_stop_after_the_end_answers_no_sample(make_bag, drive_messages):
    source = list(drive_messages(1000))
    for copies in (1, 2):
        ended = iter([*source, *[stop(source[-1])] * copies])
        found = recording.read(make_bag(f"{copies}", source=ended))
        assert (len(found.feedback), int(found.command["period"][-1])) == (1000, 1000)
        assert (found.lost_periods, found.notes) == (0, [])


def test_an_answer_with_the_gates_off_is_no_stop(make_bag, drive_messages):
    source = list(drive_messages(1000))
    found = recording.read(make_bag(source=iter([*source, stop(source[-1], answers=True)])))
    assert (len(found.feedback), int(found.command["period"][-1])) == (1000, 1001)
    assert found.lost_periods == 1  # the sample that it answers
    assert found.notes


def test_a_controller_that_is_made_inactive_for_a_while(make_bag, drive_messages):
    """The stop is for the period of the next answer, which is the one that counts."""
    source = list(drive_messages(1000))
    (at,) = [n for n, m in enumerate(source) if m[0] == "duty_command" and m[1] == 50_000_000]
    stopped = [*source[: at + 1], stop(source[at]), *source[at + 1 :]]
    found = recording.read(make_bag(source=iter(stopped)))
    assert found.command["period"].tolist() == list(range(1, 1001))
    assert found.command["enable"].all()
    assert (found.lost_periods, found.notes) == (0, [])


def test_decimated_topics_are_no_gaps(make_bag, drive_messages):
    source = (
        m for m in drive_messages(1000)
        if m[0] not in ("lut_diagnostics", "drive_state") or m[1] // 100_000 % 10 == 0
    )  # fmt: skip
    found = recording.read(make_bag(source=source))
    assert len(found.lut) == 100 and found.lost_periods == 0 and found.notes == []
    assert metrics.evaluate(found, (0.02, 0.08))["lut_error_max"]["d"] == 0.05


def test_repeats_are_dropped(make_bag, drive_messages):
    source = (m for n, m in enumerate(drive_messages(100)) for _ in range(2 if n == 40 else 1))
    found = recording.read(make_bag(source=source))
    assert len(found.feedback) == 100 and found.lost_periods == 0
    assert [note.text for note in found.notes] == [
        "phase_feedback: 1 period numbers come twice; the first counts"
    ]


def drives(drive_messages, *, wall_clock):
    """Three drives, 30, 200 and 10 periods long, of which each topic tells another scheme."""
    for n, (count, scheme) in enumerate([(30, "mbpcc"), (200, "mfpcc"), (10, "pi_foc")]):
        for topic, time, data in drive_messages(count, scheme=scheme):
            yield topic, time + wall_clock * n * 10**9, data


def test_of_several_runs_the_longest_counts(make_bag, drive_messages):
    found = recording.read(make_bag(source=drives(drive_messages, wall_clock=True)))
    assert len(found.feedback) == 200 and len(found.lut) == 200
    assert set(found.scheme) == {"mfpcc"}  # of all topics the same run
    assert "goes back 2 times" in found.notes[0].text
    assert "40 periods of the others are left out" in found.notes[0].text


def test_a_drive_that_is_restarted_while_it_is_recorded(make_bag, drive_messages):
    """Its simulated time begins anew, the log times go on."""
    path = make_bag(source=drives(drive_messages, wall_clock=False))
    found = recording.read(path)
    assert len(found.feedback) == 200 and set(found.scheme) == {"mfpcc"}
    assert "goes back 2 times" in found.notes[0].text
    with Reader(path) as reader:
        times = {}
        for connection, time, data in reader.messages():
            assert time > times.get(connection.topic, -1)
            times[connection.topic] = time
            sec, nanosec = struct.unpack_from("<iI", data, 4)
            assert sec == 0 and nanosec <= 20_000_000  # the stamps are those of the drive


def test_a_restart_that_the_topics_tell_one_after_the_other(make_bag, drive_messages):
    runs = [list(drive_messages(n, scheme=scheme)) for n, scheme in ((300, "mfpcc"), (90, "mbpcc"))]
    late = [m for m in runs[0] if m[0] != "phase_feedback" and m[1] > 25_000_000]
    first = [m for m in runs[0] if m not in late]
    begin = [m for m in runs[1] if m[0] == "phase_feedback"]
    rest = [m for m in runs[1] if m[0] != "phase_feedback"]
    found = recording.read(make_bag(source=[*first, *begin, *late, *rest]))
    assert len(found.feedback) == len(found.lut) == 300 and set(found.scheme) == {"mfpcc"}
    assert found.lost_periods == 0
    (note,) = found.notes
    assert "goes back once" in note.text and "90 periods of the others" in note.text


def test_drives_at_the_same_times_cannot_be_told_apart(tmp_path, drive_messages):
    messages = list(drives(drive_messages, wall_clock=False))
    path = bag_kinds.write(tmp_path / "bag", [messages], bag_kinds.Kind())
    with pytest.raises(BagError, match="lut_diagnostics holds period 0 more than once"):
        recording.read(path)


def test_a_late_recorder(make_bag, drive_messages):
    found = recording.read(make_bag(source=drive_messages(300, first=5000)))
    assert found.feedback["period"][0] == 5000 and found.lost_periods == 0


def test_a_late_recorder_finds_one_topic_after_the_other(make_bag, drive_messages):
    """As `ros2 bag record` does, which knows no configuration either."""
    begins = {"phase_feedback": 1100, "lut_diagnostics": 2500, "drive_state": 1000}
    source = [m for m in drive_messages(5000) if m[1] >= 100_000 * begins.get(m[0], 1200)]
    found = recording.read(make_bag(source=source))
    assert found.lost_periods == 0
    (note,) = found.notes
    assert "(phase_feedback 1100 to 4999," in note.text
    assert "4200 messages outside of the periods 2500 to 4999, which all topics" in note.text
    assert found.feedback["period"][[0, -1]].tolist() == [2500, 4999]
    row = metrics.evaluate(found, (0.25, 0.5))
    assert row["lut_error_max"] == {"d": 0.05, "q": 0.1}
    # of the window that is stored, three quarters were before the recorder
    row = metrics.evaluate(found)
    assert row["lut_error_max"] == {"d": None, "q": None}
    text = "1500 of the 2000 periods of the window are missing in phase_feedback"
    assert any(text in note["text"] for note in row["notes"])


# --- Files that are not as they should be ---


def test_nothing_there(tmp_path):
    with pytest.raises(BagError, match="there is no such file or folder"):
        recording.read(tmp_path / "nowhere")
    with pytest.raises(BagError, match="no recording here"):
        recording.read(tmp_path)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "empty"),
        (b"\x89MCA", "ends within"),
        (b"PK\3\4 something else", "no MCAP file"),
        (MAGIC, "not finished"),
        (MAGIC + struct.pack("<BQ", 6, 2**60), "not finished"),
    ],
)
def test_what_is_no_recording(tmp_path, content, text):
    file = tmp_path / "x.mcap"
    file.write_bytes(content)
    with pytest.raises(BagError, match=text):
        recording.read(file)
    with pytest.raises(BagError):
        recover.recover(file)
    assert file.read_bytes() == content


def test_a_bag_without_messages(tmp_path):
    with BagWriter(tmp_path / "b", config={}):
        pass
    with pytest.raises(BagError, match="no messages of topic phase_feedback and duty_command"):
        recording.read(tmp_path / "b")


def test_a_bag_with_other_topics(tmp_path):
    with BagWriter(tmp_path / "b", config={}) as writer:
        writer.add_topic("/scan", "builtin_interfaces/msg/Time")
        writer.write("/scan", 0, b"\0\1\0\0" + bytes(8))
    with pytest.raises(BagError, match="there are: /scan"):
        recording.read(tmp_path / "b")


def test_a_bag_with_other_messages_of_the_same_topic(tmp_path, monkeypatch, drive_messages):
    monkeypatch.setitem(LOOP_TOPICS, "phase_feedback", "builtin_interfaces/msg/Time")
    with BagWriter(tmp_path / "b", config={}) as writer:
        writer.write("phase_feedback", 0, b"\0\1\0\0" + bytes(8))
    monkeypatch.undo()
    with pytest.raises(BagError, match="is of type builtin_interfaces/msg/Time, not mfpcc"):
        recording.read(tmp_path / "b")


def test_a_definition_that_is_not_that_of_the_messages(make_bag, monkeypatch):
    text = message_definition("mfpcc_msgs/msg/PhaseFeedback").replace("float64", "float32")
    real = message_definition
    name = "mfpcc_experiments.bags.writer.message_definition"
    monkeypatch.setattr(name, lambda t: text if "Phase" in t else real(t))
    path = make_bag(periods=3)
    with pytest.raises(BagError, match="has not the layout of its definition"):
        recording.read(path)


def test_two_axes(tmp_path, drive_messages):
    with BagWriter(tmp_path / "b", config={}) as writer:
        for axis in ("/axis1/", "/axis2/"):
            for name, type_name in LOOP_TOPICS.items():
                writer.add_topic(axis + name, type_name)
        for topic, time, data in drive_messages(20):
            writer.write("/axis1/" + topic, time, data)
            writer.write("/axis2/" + topic, time, data)
    with pytest.raises(BagError, match="several axes: /axis1, /axis2; choose one with --namespace"):
        recording.read(tmp_path / "b")
    assert len(recording.read(tmp_path / "b", namespace="axis2").feedback) == 20


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_bags_written_by_others(tmp_path, drive_messages, plugin):
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / "other", version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, type_name in LOOP_TOPICS.items():
            types = get_types_from_msg(message_definition(type_name), type_name)
            store.register({k: v for k, v in types.items() if k not in store.fielddefs})
            connections[topic] = writer.add_connection("/" + topic, type_name, typestore=store)
        for topic, time, data in drive_messages(2000):
            writer.write(connections[topic], time, data)
    found = recording.read(tmp_path / "other")
    assert len(found.feedback) == 2000 and found.n_p == 4 and found.lost_periods == 0


def test_a_split_bag(make_bag, drive_messages, tmp_path):
    one = make_bag("one", source=drive_messages(500))
    two = make_bag("two", source=drive_messages(500, first=500))
    (tmp_path / "split").mkdir()
    shutil.copy(one / "one_0.mcap", tmp_path / "split" / "split_9.mcap")
    shutil.copy(two / "two_0.mcap", tmp_path / "split" / "split_10.mcap")
    found = recording.read(tmp_path / "split")
    assert len(found.feedback) == 1000 and found.notes == []


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_a_cut_file_is_said_to_be_cut_and_can_be_recovered(make_bag, share):
    path = make_bag(periods=3000)
    (file,) = path.glob("*.mcap")
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(BagError, match="not finished"):
        recording.read(path)
    if share > 0.3:
        recover.recover(path)
        found = recording.read(path)
        assert found.lost_periods == 0
        assert len(found.feedback) >= int((share - 0.2) * 3000)


def test_a_damaged_part_is_dropped_and_the_old_file_kept(make_bag):
    path = make_bag(periods=3000)
    (file,) = path.glob("*.mcap")
    data = bytearray(file.read_bytes())
    data[len(data) // 2 - 20_000] ^= 1  # in a chunk, not in its index
    file.write_bytes(data)
    with pytest.raises(BagError, match="damaged"):
        recording.read(path)
    assert "1 damaged part dropped" in recover.recover(path)
    found = recording.read(path)
    assert found.lost_periods == 401 and len(found.notes) > 0
    assert file.with_name(file.name + ".damaged").read_bytes() == data


def test_what_the_first_chunk_alone_said_of_the_topics_is_found_at_the_end(make_bag):
    path = make_bag(periods=3000)
    (file,) = path.glob("*.mcap")
    data = bytearray(file.read_bytes())
    data[data.index(b"lz4") + 1000] ^= 1
    file.write_bytes(data)
    assert "1 damaged part dropped" in recover.recover(path)
    found = recording.read(path)
    assert found.feedback["period"].tolist() == list(range(400, 3000))
    assert found.notes == []
    with Reader(path) as reader:
        assert len(list(reader.messages())) == 10_400


def test_random_mutations_never_give_wrong_numbers_silently(make_bag):
    """Each mutation gives a clear error, or exactly what was recorded."""
    path = make_bag(periods=60)
    (file,) = path.glob("*.mcap")
    original = file.read_bytes()
    expected = recording.read(path)
    rng = random.Random(1)
    messages = []
    for _ in range(400):
        data = bytearray(original)
        for _ in range(rng.choice((1, 1, 1, 4))):
            position = rng.randrange(len(data))
            kind = rng.randrange(3)
            if kind == 0:
                data[position] ^= 1 << rng.randrange(8)
            elif kind == 1:
                data[position] = rng.choice((0, 255))
            else:
                del data[position : position + rng.randrange(1, 9)]
        file.write_bytes(data)
        try:
            found = recording.read(path)
        except BagError as error:
            messages.append(str(error))
            continue
        assert found.config == expected.config
        for name in ("feedback", "command", "lut", "state", "scheme"):
            assert bits.of(getattr(found, name)) == bits.of(getattr(expected, name))
    assert len(messages) > 200
    assert all(str(path) in text and "\n" not in text for text in messages)

"""One recording in every form gives the same arrays; what cannot be told is refused, or noted."""

from __future__ import annotations

import json
import shutil
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bag_kinds
import numpy as np
import pytest
import yaml
from bag_kinds import Kind
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader
from synthetic_drive import CONFIG, messages

from mfpcc_experiments import cli, notes
from mfpcc_experiments.bags import BagError, BagWriter, bag_parts, recording, recover
from mfpcc_experiments.bags.disk.mcap_format import MAGIC
from mfpcc_experiments.bags.provenance import CONFIG_RECORD, json_record
from mfpcc_experiments.notes import Severity
from pwm_node import bits

ARRAYS = ("feedback", "command", "lut", "state", "scheme", "i_abc_oversampled", "legs_oversampled")
PERIODS = 60
MESSAGES = list(messages(PERIODS, oversampling=2))
METADATA = {CONFIG_RECORD: json_record(CONFIG | {"window_s": [0.001, 0.005]})}


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> recording.Recording:
    """What every form of the recording must give."""
    path = tmp_path_factory.mktemp("expected") / "bag"
    return recording.read(bag_kinds.write(path, [MESSAGES], Kind(), METADATA))


def same(found: recording.Recording, expected: recording.Recording) -> None:
    for name in ARRAYS:
        assert bits.of(getattr(found, name)) == bits.of(getattr(expected, name)), name
    assert found.T_s == pytest.approx(expected.T_s) and found.n_p == expected.n_p
    assert found.lost_periods == 0
    assert [n for n in found.notes if n.severity != Severity.INFO] == []


@st.composite
def kinds(draw: st.DrawFn) -> Kind:
    storage = draw(st.sampled_from(["mcap", "mcap", "sqlite3"]))
    return Kind(
        storage=storage,
        chunks=draw(st.sampled_from(["lz4", "zstd", "none", "unchunked"])),
        index=draw(st.sampled_from(sorted(bag_kinds.INDEXES))),
        summary=draw(st.booleans()),
        crcs=draw(st.booleans()),
        packed=draw(st.sampled_from(["none", "file", "message"])),
        listed=draw(st.sampled_from(["sorted", "reversed", "missing"])),
        name=draw(st.sampled_from(["run", "run_1.5", "run_7"])),
        namespace=draw(st.sampled_from(["/", "/axis1/", "/a/b/"])),
    )


@st.composite
def orders(draw: st.DrawFn) -> list[list[Any]]:
    """The messages in pieces, these in any order, some neighbours swapped, split into parts."""
    cuts = sorted(draw(st.sets(st.integers(1, len(MESSAGES) - 1), max_size=6)))
    pieces = [MESSAGES[a:b] for a, b in zip([0, *cuts], [*cuts, len(MESSAGES)], strict=True)]
    found = [message for piece in draw(st.permutations(pieces)) for message in piece]
    for at in draw(st.sets(st.integers(0, len(found) - 2), max_size=8)):
        found[at], found[at + 1] = found[at + 1], found[at]
    if draw(st.booleans()):  # one thread per topic, as it were
        found.sort(key=lambda message: message[0])
    splits = sorted(draw(st.sets(st.integers(0, len(found)), max_size=11)))
    return [found[a:b] for a, b in zip([0, *splits], [*splits, len(found)], strict=True)]


@settings(max_examples=60, deadline=None, derandomize=True)
@given(kind=kinds(), parts=orders())
def test_every_form_gives_the_same(
    kind: Kind,
    parts: list[list[Any]],
    expected: recording.Recording,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    path = tmp_path_factory.mktemp("form") / "bag"
    try:
        same(recording.read(bag_kinds.write(path, parts, kind, METADATA)), expected)
    finally:
        shutil.rmtree(path.parent)


def test_a_reader_that_is_not_ours_finds_the_same(tmp_path: Path) -> None:
    """The forms are those that rosbags reads, too."""
    for n, kind in enumerate(
        [Kind(), Kind(chunks="zstd"), Kind(storage="sqlite3"), Kind(packed="file"),
         Kind(packed="message"), Kind(storage="sqlite3", packed="message")]
    ):  # fmt: skip
        path = bag_kinds.write(tmp_path / str(n), [MESSAGES[:100], MESSAGES[100:]], kind, METADATA)
        with Reader(path) as reader:
            raw = [(c.topic[1:], t, bytes(d)) for c, t, d in reader.messages()]
        assert sorted(raw) == sorted(MESSAGES)


# --- Times that are of no use ---


def timed(time: Callable[[int, int], int]) -> Iterator[Any]:
    return ((topic, time(n, at), data) for n, (topic, at, data) in enumerate(MESSAGES))


@pytest.mark.parametrize(
    "time",
    [
        lambda n, at: 0,
        lambda n, at: 1_700_000_000_000_000_000 + 31 * n,
        lambda n, at: 1_700_000_000_000_000_000 + at + (-1) ** n * 150_000,
        lambda n, at: 1_700_000_000_000_000_000 + at - 3_000_000 * (n > 120),  # a clock set back
        lambda n, at: 2**64 - 1 - (n < 120),
    ],
    ids=["all 0", "wall clock", "jitter", "set back", "beyond rosbag2"],
)
@pytest.mark.parametrize("reverse", [False, True])
def test_log_times_that_are_not_those_of_the_drive(
    time: Callable[[int, int], int], reverse: bool, expected: recording.Recording, tmp_path: Path
) -> None:
    found = list(timed(time))[:: -1 if reverse else 1]
    same(recording.read(bag_kinds.write(tmp_path / "bag", [found], Kind(), METADATA)), expected)


def test_two_drives_one_after_the_other(tmp_path: Path) -> None:
    """By the wall clock; of all topics those of the longer drive."""
    start = 1_700_000_000_000_000_000
    first = [(t, start + at, d) for t, at, d in messages(50, scheme="mbpcc")]
    second = [(t, start + 10**9 + at, d) for t, at, d in messages(80, scheme="pi_foc")]
    found = []
    for n, parts in enumerate(([first, second], [second, first], [second[::-1] + first])):
        found.append(recording.read(bag_kinds.write(tmp_path / str(n), parts, Kind())))
        assert set(found[-1].scheme) == {"pi_foc"} and len(found[-1].feedback) == 80
        assert "50 periods of the others are left out" in str(found[-1].notes[-1])
        for name in ARRAYS[:5]:
            assert bits.of(getattr(found[-1], name)) == bits.of(getattr(found[0], name))


def test_two_drives_at_once_are_refused(tmp_path: Path) -> None:
    start = 1_700_000_000_000_000_000
    one = [(t, start - 398_000_000 + at, d) for t, at, d in messages(80, first=4000)]
    other = [(t, start + at + 10, d) for t, at, d in messages(80, first=20)]
    path = bag_kinds.write(tmp_path / "bag", [sorted(one + other, key=lambda m: m[1])], Kind())
    with pytest.raises(BagError, match="several drives were recorded at the same time"):
        recording.read(path)


def test_a_part_that_is_there_twice_changes_nothing(
    expected: recording.Recording, tmp_path: Path
) -> None:
    path = bag_kinds.write(tmp_path / "b", [MESSAGES, MESSAGES[40:80]], Kind(), METADATA)
    found = recording.read(path)
    for name in ARRAYS:
        assert bits.of(getattr(found, name)) == bits.of(getattr(expected, name))
    assert "phase_feedback: 10 period numbers come twice" in " ".join(map(str, found.notes))


def test_the_same_period_with_other_contents_is_refused(tmp_path: Path) -> None:
    topic, time, data = MESSAGES[40]
    other = (topic, time, data[:-1] + bytes([data[-1] ^ 1]))
    path = bag_kinds.write(tmp_path / "b", [[*MESSAGES, other]], Kind(), METADATA)
    with pytest.raises(BagError, match="phase_feedback holds period 10 more than once"):
        recording.read(path)


# --- Folders ---


def warnings(found: recording.Recording) -> list[str]:
    return [str(note) for note in found.notes if note.severity is Severity.WARNING]


def edit(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    content = yaml.safe_load((path / "metadata.yaml").read_text())
    change(content["rosbag2_bagfile_information"])
    (path / "metadata.yaml").write_text(yaml.safe_dump(content))


@pytest.fixture
def split(tmp_path: Path) -> Path:
    parts = [MESSAGES[n : n + 24] for n in range(0, len(MESSAGES), 24)]
    return bag_kinds.write(tmp_path / "split", parts, Kind(name="run_1.5"), METADATA)


def test_a_stray_file_is_left_out_and_told(
    split: Path, expected: recording.Recording, tmp_path: Path
) -> None:
    other = bag_kinds.write(tmp_path / "other", [messages(30, scheme="pi_foc")], Kind(name="x"))
    shutil.copy(other / "x_0.mcap", split / "run_1.5_3_copy.mcap")
    found = recording.read(split)
    assert bits.of(found.feedback) == bits.of(expected.feedback)
    (text,) = warnings(found)
    assert text.startswith("run_1.5_3_copy.mcap in the folder is not a part of the bag")


def test_a_missing_part_is_named(split: Path) -> None:
    (split / "run_1.5_4.mcap").unlink()
    with pytest.raises(BagError, match=r"'run_1\.5_4\.mcap', a part of the bag .* is missing"):
        recording.read(split)


def test_an_empty_part(tmp_path: Path, expected: recording.Recording) -> None:
    path = bag_kinds.write(tmp_path / "b", [MESSAGES, []], Kind(), METADATA)
    same(recording.read(path), expected)
    (path / "run_1.mcap").write_bytes(b"")
    with pytest.raises(BagError, match=r"run_1\.mcap: the file is empty"):
        recording.read(path)


def test_one_part_alone_says_so(split: Path) -> None:
    found = recording.read(split / "run_1.5_2.mcap")
    assert found.feedback["period"].tolist() == list(range(12, 18))
    assert "run_1.5_2.mcap is one of the 10 parts of a bag; the others are left out" in warnings(
        found
    )


@pytest.mark.parametrize("name", ["/elsewhere/run_1.5_{}.mcap", "split/run_1.5_{}.mcap"])
def test_paths_of_other_machines_and_versions(
    name: str, split: Path, expected: recording.Recording
) -> None:
    files = [name.format(n) for n in range(10)]
    edit(split, lambda information: information.update(relative_file_paths=files))
    same(recording.read(split), expected)


def test_counts_that_lie(split: Path) -> None:
    def lie(information: dict[str, Any]) -> None:
        information["topics_with_message_count"][0]["message_count"] = 61

    edit(split, lie)
    text = "topic /phase_feedback has 60 messages, not the 61 that metadata.yaml tells of"
    assert warnings(recording.read(split)) == [text]


def test_metadata_that_cannot_be_read(split: Path, expected: recording.Recording) -> None:
    (split / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    found = recording.read(split)
    assert bits.of(found.feedback) == bits.of(expected.feedback)
    assert warnings(found) == ["metadata.yaml cannot be read; all 10 files in the folder count"]


def test_a_chunk_that_is_not_there_is_seen_by_the_summary(tmp_path: Path) -> None:
    path = bag_kinds.write(tmp_path / "b", [MESSAGES], Kind(listed="missing", crcs=False), METADATA)
    (file,) = path.iterdir()
    data = file.read_bytes()
    at, chunks = len(MAGIC), []
    while data[at] != 0x0F:
        end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        chunks.append((data[at], at, end))
        at = end
    _, begin, _ = [chunk for chunk in chunks if chunk[0] == 6][2]
    file.write_bytes(data[:begin] + b"\x86" + data[begin + 1 :])  # a record of somebody else
    found = recording.read(path)
    assert found.lost_periods > 0
    assert "240 that its own summary tells of" in " ".join(warnings(found))


def test_parts_of_different_recordings(tmp_path: Path) -> None:
    other = {CONFIG_RECORD: json_record(CONFIG | {"n_p": 5})}
    one = bag_kinds.write(tmp_path / "one", [MESSAGES[:80]], Kind(listed="missing"), METADATA)
    two = bag_kinds.write(tmp_path / "two", [MESSAGES[80:]], Kind(listed="missing"), other)
    shutil.copy(two / "run_0.mcap", one / "run_1.mcap")
    with pytest.raises(BagError, match="parts of different recordings"):
        recording.read(one)


def test_a_name_that_is_no_text(tmp_path: Path, expected: recording.Recording) -> None:
    folder = tmp_path / "b\udcff\n"
    bag_kinds.write(folder, [MESSAGES], Kind(), METADATA)
    same(recording.read(folder), expected)
    next(folder.glob("*.mcap")).write_bytes(b"")
    with pytest.raises(BagError) as caught:
        recording.read(folder)
    assert str(caught.value).isprintable() and r"b\xff\n" in str(caught.value)


def test_links(split: Path, expected: recording.Recording, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(split)
    same(recording.read(tmp_path / "link"), expected)
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(BagError, match="loop"):
        recording.read(tmp_path / "loop")


@pytest.mark.parametrize("kind", [Kind(), Kind(storage="sqlite3"), Kind(packed="file")])
def test_cut_at_every_byte_of_the_tail(
    kind: Kind, tmp_path: Path, expected: recording.Recording
) -> None:
    """A cut file is refused; only of a whole one there are figures."""
    kind = Kind(**{**vars(kind), "listed": "missing"})
    path = bag_kinds.write(tmp_path / "b", [MESSAGES], kind, METADATA)
    (file,) = path.iterdir()
    data = file.read_bytes()
    for length in [
        *range(len(data) - 300, len(data), 7),
        *range(len(data) - 40, len(data)),
        200,
        10,
        1,
    ]:
        file.write_bytes(data[:length])
        with pytest.raises(BagError):
            recording.read(path)
    file.write_bytes(data)
    same(recording.read(path), expected)


def test_a_database_with_open_changes(tmp_path: Path) -> None:
    path = bag_kinds.write(tmp_path / "b", [MESSAGES], Kind(storage="sqlite3"))
    (path / "run_0.db3-wal").write_bytes(b"x")
    with pytest.raises(BagError, match=r"not finished, in run_0\.db3-wal"):
        recording.read(path)


def test_a_bag_that_is_being_written(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "live", config=CONFIG) as writer:
        for message in MESSAGES:
            writer.write(*message)
        with pytest.raises(BagError, match="is being written at this moment"):
            recording.read(tmp_path / "live")
    assert len(recording.read(tmp_path / "live").feedback) == PERIODS


def test_a_folder_of_results_with_bags_of_all_kinds(split: Path, tmp_path: Path) -> None:
    kinds = [Kind(storage="sqlite3", listed="missing"), Kind(packed="file", listed="missing")]
    made = [bag_kinds.write(tmp_path / str(n), [MESSAGES], kind) for n, kind in enumerate(kinds)]
    (tmp_path / "figures").mkdir()
    assert bag_parts.bags_in(tmp_path) == [*made, split]
    assert bag_parts.bags_in(split) == [split]
    assert bag_parts.bags_in(tmp_path / "figures") == [tmp_path / "figures"]


# --- Completeness ---


def test_every_second_period_missing_from_all_topics_is_lost(tmp_path: Path) -> None:
    def period(message: Any) -> int:
        return int(np.frombuffer(message[2][12:20], "<u8")[0])

    half = [message for message in MESSAGES if period(message) % 2 == 0]
    found = recording.read(bag_kinds.write(tmp_path / "b", [half], Kind(), METADATA))
    assert found.lost_periods == 30  # 1, 3, ..., 59


def test_what_is_left_out_is_an_error_if_one_is_strict(
    split: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The figures are not of interest here, so none are drawn."""
    from mfpcc_experiments.reporting import figures, report

    monkeypatch.setattr(figures, "draw", lambda runs, folder: [])
    monkeypatch.setattr(report, "render", lambda runs, drawn: "")
    shutil.copy(split / "run_1.5_3.mcap", split / "stray.mcap")
    line = f"compare {split} --window 0.001 0.005 --out {tmp_path / 'out'} --force"
    text = "warning: MLS-MFPCC: stray.mcap in the folder is not a part of the bag"
    plain = cli.run(line.split())
    assert text in capsys.readouterr().out
    (row,) = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert text.split(": ", 2)[2] in str(row["notes"])
    assert (plain, cli.run([*line.split(), "--strict"])) == (0, notes.NOT_AS_ASKED)


@pytest.mark.parametrize("metadata", [METADATA, {}])
def test_a_ragged_end_is_lost_and_told(metadata: dict[str, Any], tmp_path: Path) -> None:
    ends = {"phase_feedback": 59, "duty_command": 55, "lut_diagnostics": 40, "drive_state": 50}
    ragged = [m for m in MESSAGES if m[1] <= ends[m[0]] * 100_000]
    found = recording.read(bag_kinds.write(tmp_path / "b", [ragged], Kind(), metadata))
    assert found.lost_periods >= 18  # 41 to 58: a run may end before the last diagnostics
    assert "lut_diagnostics" in " ".join(warnings(found))


@pytest.mark.parametrize("between", [b"", b"another recording"])
def test_what_was_joined_to_a_recording_is_not_passed_over(between: bytes, tmp_path: Path) -> None:
    half = len(MESSAGES) // 2
    one = bag_kinds.write(tmp_path / "a", [MESSAGES[:half]], Kind(), METADATA) / "run_0.mcap"
    two = bag_kinds.write(tmp_path / "b", [MESSAGES[half:]], Kind(), METADATA) / "run_0.mcap"
    alone = len(recording.read(one).feedback)
    joined = one.read_bytes() + between + two.read_bytes()
    one.write_bytes(joined)
    with pytest.raises(BagError, match="were files joined"):
        recording.read(one.parent)
    said = recover.recover(one.parent)
    assert f"saved {half} messages" in said and "run_0.mcap.damaged" in said
    assert one.with_name("run_0.mcap.damaged").read_bytes() == joined
    assert len(recording.read(one.parent).feedback) == alone


@pytest.mark.parametrize("missing", [0, 1])
@pytest.mark.parametrize("listed", [True, False])
def test_a_number_that_the_parts_leave_out(missing: int, listed: bool, tmp_path: Path) -> None:
    """Without the first one nothing else tells, if metadata.yaml is not there or not honest."""
    third = len(MESSAGES) // 3
    parts = [MESSAGES[:third], MESSAGES[third : 2 * third], MESSAGES[2 * third :]]
    path = bag_kinds.write(tmp_path / "b", parts, Kind(), METADATA)
    assert not warnings(recording.read(path))
    (path / f"run_{missing}.mcap").unlink()
    metadata = path / "metadata.yaml"
    if listed:
        metadata.write_text(metadata.read_text().replace(f"  - run_{missing}.mcap\n", ""))
    else:
        metadata.unlink()
    assert "a part is missing" in " ".join(warnings(recording.read(path)))


def test_time_stamps_that_contradict_the_configuration(tmp_path: Path) -> None:
    other = {CONFIG_RECORD: json_record(CONFIG | {"T_s": 2.0 * CONFIG["T_s"]})}
    found = recording.read(bag_kinds.write(tmp_path / "b", [MESSAGES], Kind(), other))
    assert "200 us, and the time stamps say 100 us" in " ".join(warnings(found))


@pytest.mark.parametrize("gone", ["lut_diagnostics", "drive_state"])
@pytest.mark.parametrize("step", [0, 1])
def test_a_topic_that_the_run_recorded_is_not_there(gone: str, step: int, tmp_path: Path) -> None:
    parameters = {
        "mfpcc_controller": {"diagnostics_decimation": step},
        "pmsm_sim": {"state_decimation": step},
    }
    config = {CONFIG_RECORD: json_record(CONFIG | {"parameters": parameters})}
    others = [m for m in MESSAGES if m[0] != gone]
    path = bag_kinds.write(tmp_path / "b", [others], Kind(listed="missing"), config)
    told = f"topic {gone} has no messages" in " ".join(warnings(recording.read(path)))
    assert told == bool(step)


@pytest.mark.parametrize("where", [0, -1])
def test_a_single_time_stamp_that_is_wrong(where: int, tmp_path: Path) -> None:
    """At the begin or the end of a bag without configuration: the others tell the PWM period."""
    changed = list(MESSAGES)
    at = [n for n, message in enumerate(MESSAGES) if message[0] == "phase_feedback"][where]
    topic, time, data = changed[at]
    other = (0, 900_000) if where == 0 else (7, 0)
    changed[at] = (topic, time, data[:4] + struct.pack("<iI", *other) + data[12:])
    found = recording.read(bag_kinds.write(tmp_path / "b", [changed], Kind()))
    assert found.T_s == pytest.approx(1e-4)
    assert "time stamps of phase_feedback are uneven" in " ".join(warnings(found))


def test_an_axis_that_is_not_there(tmp_path: Path) -> None:
    path = bag_kinds.write(tmp_path / "b", [MESSAGES], Kind(namespace="/axis1/"))
    with pytest.raises(BagError, match="has no axis /axis7; there are: /axis1"):
        recording.read(path, namespace="axis7")


def test_one_of_several_axes_is_chosen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is mixed: without a choice it is asked for, in every verb that reads a bag."""
    first = bag_kinds.write(tmp_path / "a", [MESSAGES], Kind(namespace="/axis1/"))
    alone = recording.read(first).command
    other = [(topic, at, data) for topic, at, data in MESSAGES if int(at) > MESSAGES[-1][1] // 2]
    bag_kinds.write(tmp_path / "b", [other], Kind(namespace="/axis2/", name="b"))
    both = tmp_path / "both"
    both.mkdir()
    for folder in ("a", "b"):
        for file in (tmp_path / folder).glob("*.mcap"):
            shutil.copy(file, both / f"both_{'ab'.index(folder)}.mcap")
    sentence = "holds several axes: /axis1, /axis2; choose one with --namespace"
    for line in (f"compare {both}", f"replay {both}", f"export {both} --format csv"):
        out = ["--out", str(tmp_path / "out")]
        assert cli.run([*line.split(), *out]) == 1
        assert sentence in capsys.readouterr().err
    assert np.array_equal(recording.read(both, namespace="/axis1").command, alone)
    line = ["compare", str(both), "--namespace", "axis1", "--out", str(tmp_path / "out")]
    assert cli.run(line) == 0
    (row,) = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert row["periods"] == len(alone)


def test_time_stamps_of_a_coarse_clock(tmp_path: Path) -> None:
    coarse = [
        (topic, time, data[:4] + struct.pack("<iI", 0, time // 160_000 * 160_000) + data[12:])
        for topic, time, data in MESSAGES
    ]
    found = recording.read(bag_kinds.write(tmp_path / "b", [coarse], Kind()))
    assert found.T_s == pytest.approx(1e-4, rel=0.02)

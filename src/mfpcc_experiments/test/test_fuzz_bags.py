"""Bags with other bytes, cut, with sizes that lie: data, or a defined error; never much memory."""

from __future__ import annotations

import shutil
import struct
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import fuzz
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mfpcc_experiments import cli
from mfpcc_experiments.bags import LOOP_TOPICS, BagError, recording, recover
from mfpcc_experiments.bags.definitions import message_definition
from mfpcc_experiments.bags.disk import mcap_format
from mfpcc_experiments.bags.disk.mcap_format import MAGIC
from mfpcc_experiments.measuring import metrics, window

#: More than the little bag of these tests needs by far (bytes).
MEMORY = 16 << 20

_HEAD = struct.Struct("<BQ")


def read_all(path: Path) -> object:
    """A bag into arrays and figures of merit."""
    found = recording.read(path)
    fuzz.outcome(window.MetricsError, metrics.evaluate, found)
    return found


def flipped(rng: np.random.Generator, data: bytearray) -> None:
    for _ in range(rng.integers(1, 6)):
        data[rng.integers(len(data))] = rng.choice([0, 255, rng.integers(256)])


def cut(rng: np.random.Generator, data: bytearray) -> None:
    begin, end = sorted(rng.integers(len(data), size=2))
    del data[begin : end if rng.random() < 0.5 else len(data)]


def record_starts(data: bytes) -> Iterator[int]:
    """Offsets of the records outside of chunks."""
    at = len(MAGIC)
    while at + _HEAD.size <= len(data) - len(MAGIC):
        yield at
        at += _HEAD.size + _HEAD.unpack_from(data, at)[1]


def lie(rng: np.random.Generator, data: bytearray) -> None:
    """Another size in the head of a record, or where a record keeps sizes of its own."""
    starts = list(record_starts(data))
    at = starts[rng.integers(len(starts))]
    size = fuzz.any_integer(rng)
    if rng.random() < 0.4:
        data[at + 1 : at + 9] = size.to_bytes(8, "little")
    else:
        inside = at + 9 + int(rng.integers(0, 60))
        data[inside : inside + 4] = size.to_bytes(8, "little")[:4]


def chunk_that_lies(rng: np.random.Generator, data: bytearray) -> None:
    """A chunk whose unpacked size, name length or packed size is another one."""
    chunks = [at for at in record_starts(data) if data[at] == 6]
    at = chunks[rng.integers(len(chunks))] + 9
    offset, length = ((16, 8), (24, 4), (28, 4), (35, 8))[rng.integers(4)]
    lying = int(
        rng.choice([0, 1, 1 << 20, mcap_format.MAX_CHUNK, mcap_format.MAX_CHUNK + 1, 2**32 - 1])
    )
    if rng.random() < 0.3:
        lying = fuzz.any_integer(rng)
    data[at + offset : at + offset + length] = lying.to_bytes(8, "little")[:length]


MUTATIONS: tuple[Callable[[np.random.Generator, bytearray], None], ...] = (
    flipped,
    cut,
    lie,
    chunk_that_lies,
)


@pytest.mark.parametrize("mutate", MUTATIONS)
def test_a_spoilt_mcap_file(
    mutate: Callable[[np.random.Generator, bytearray], None],
    make_bag: Callable[..., Path],
    tmp_path: Path,
) -> None:
    whole = make_bag(periods=1100)
    (file,) = whole.glob("*.mcap")
    original = file.read_bytes()
    read_all(whole)  # what is imported and compiled is no memory of a case
    for rng in fuzz.cases(20):
        data = bytearray(original)
        mutate(rng, data)
        path = tmp_path / "spoilt"
        shutil.rmtree(path, ignore_errors=True)
        shutil.copytree(whole, path)
        (path / file.name).write_bytes(data)
        tracemalloc.start()
        _, refusal = fuzz.outcome(BagError, read_all, path)
        _, lost = fuzz.outcome(BagError, recover.recover, path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < MEMORY, f"{peak >> 20} MiB"
        for text in (refusal, lost):
            assert "\n" not in text and (not text or str(path) in text), text
        if not lost:  # what was repaired is whole, and can be read where it holds the needed topics
            assert "nothing to repair" in recover.recover(path)
            _, refusal = fuzz.outcome(BagError, recording.read, path)
            assert not refusal or "no messages of topic" in refusal, refusal


def test_a_spoilt_bag_of_others(drive_messages: Callable, tmp_path: Path) -> None:
    """sqlite3, whose reader is not ours."""
    whole = tmp_path / "whole"
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(whole, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {}
        for topic, type_name in LOOP_TOPICS.items():
            types = get_types_from_msg(message_definition(type_name), type_name)
            store.register({k: v for k, v in types.items() if k not in store.fielddefs})
            connections[topic] = writer.add_connection("/" + topic, type_name, typestore=store)
        for topic, time, data in drive_messages(300):
            writer.write(connections[topic], time, data)
    for rng in fuzz.cases(20):
        path = tmp_path / "spoilt"
        shutil.rmtree(path, ignore_errors=True)
        shutil.copytree(whole, path)
        files = [file for file in path.iterdir() if file.stat().st_size]
        file = files[rng.integers(len(files))]
        spoilt = bytearray(file.read_bytes())
        (flipped, cut)[rng.integers(2)](rng, spoilt)
        file.write_bytes(spoilt)
        _, refusal = fuzz.outcome(BagError, recording.read, path)
        assert not refusal or str(path) in refusal
        _, refusal = fuzz.outcome(BagError, recover.recover, path)
        assert "only MCAP recordings can be repaired" in refusal or "no recording here" in refusal


@pytest.mark.parametrize(
    "verb", ["compare {bag} --out {out}", "replay {bag} --scheme mbpcc", "recover {bag}"]
)
def test_the_command_says_so_in_a_line(
    verb: str, make_bag: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = make_bag(periods=1100)
    (file,) = path.glob("*.mcap")
    original = file.read_bytes()
    for rng in fuzz.cases(2):
        data = bytearray(original)
        MUTATIONS[rng.integers(len(MUTATIONS))](rng, data)
        file.write_bytes(data)
        code = cli.run(verb.format(bag=path, out=tmp_path / "out").split())
        said = capsys.readouterr().err
        assert code in (0, 1)
        assert code == 0 or "mfpcc: " in said
        assert "Traceback" not in said and "this is a bug" not in said, said
        assert code == 0 or not (tmp_path / "out").exists()
        shutil.rmtree(tmp_path / "out", ignore_errors=True)

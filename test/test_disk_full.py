"""A disk that is full: a clear message, what was recorded is whole, and the drive goes on."""

from __future__ import annotations

import resource
import shlex
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from harness import PATIENCE, Process
from outside import Outside
from rosbags.rosbag2 import Reader

from mfpcc_experiments.bags import recording

pytestmark = pytest.mark.skipif(
    not hasattr(resource, "RLIMIT_FSIZE"), reason="needs file size limits"
)

#: Largest file (bytes): the nearest thing to a full disk that a process can have for itself.
LIMIT = 1_000_000

Start = Callable[..., Process]


@pytest.fixture
def outside(domain: int) -> Iterator[Outside]:
    it = Outside()
    yield it
    it.close()


def check(path: Path) -> None:
    """Read a bag; it must be readable by others too, and without gaps until its end."""
    found = recording.read(path)
    # one topic may end a little later than another
    ends = ("at its begin or end", "do not begin and end at the same period")
    assert all(any(end in note.text for end in ends) for note in found.notes), found.notes
    assert len(found.feedback) > 500
    assert "File too large" in found.summary["incomplete"]
    with Reader(path) as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count


def test_the_drive_goes_on_when_the_recorder_has_to_stop(
    start: Start, outside: Outside, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    recorder = start("mfpcc_experiments", "record", "--out", str(bag))
    recorder.wait_for("recording into")
    # now that the files of the middleware's shared memory are made
    recorder.limit(resource.RLIMIT_FSIZE, LIMIT)
    start("mfpcc_controller", "controller")
    start("pmsm_sim", "pmsm_sim")
    assert recorder.wait() == 1
    assert f"error: {bag}: File too large; the recording ends at" in recorder.output
    assert "Traceback" not in recorder.output
    outside.until_beyond(outside.period + 1000, "the drive goes on")
    assert not outside.codes("pmsm_sim")
    check(bag)


def test_a_run_says_so_and_keeps_what_it_has(tmp_path: Path) -> None:
    arguments = ("run", "steady_750_2", "--scheme", "mbpcc", "--out", str(tmp_path / "out"))
    done = subprocess.run(
        ["bash", "-c", f"ulimit -f {LIMIT // 1024}; exec mfpcc {shlex.join(arguments)}"],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 1
    assert "File too large; the recording ends at" in done.stderr
    assert "Traceback" not in done.stderr and "this is a bug" not in done.stderr
    assert not (tmp_path / "out").exists()
    (kept,) = tmp_path.glob("out.partial-*")
    assert f"what was recorded until then is kept in {kept}" in done.stderr
    check(kept / "mbpcc")

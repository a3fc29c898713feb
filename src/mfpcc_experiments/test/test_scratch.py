"""What a process that was killed has left: nothing blocks the next one, nothing grows for ever."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mfpcc_experiments.files import ResultFolderError, result_folder
from mfpcc_experiments.graph.archive import Archive
from mfpcc_experiments.scratch import held, left_over, scratch

RECORDING = bytes(100_000)

WORK = """
import sys, time
from pathlib import Path
from mfpcc_experiments.files import result_folder
from mfpcc_experiments.scratch import scratch

with scratch("work-", Path(sys.argv[1])), result_folder(Path(sys.argv[1], "here")) as folder:
    (folder / "some.txt").write_text("")
    print("working", flush=True)
    time.sleep(600)
"""


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def old(folder: Path) -> Path:
    """A folder that nobody has touched for an hour."""
    folder.mkdir(parents=True, exist_ok=True)
    os.utime(folder, (0, 0))
    return folder


def test_what_a_killed_process_leaves_is_removed_by_the_next_one(tmp_path: Path) -> None:
    command = [sys.executable, "-c", WORK, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "working\n"
        left = [old(folder) for folder in tmp_path.iterdir()]
        assert len(left) == 2
        assert left_over(tmp_path, "*") == [], "somebody works there"
        process.send_signal(signal.SIGKILL)
    assert left_over(tmp_path, "*") == sorted(left)
    with scratch("work-", tmp_path), result_folder(tmp_path / "here") as folder:
        assert not any(one.exists() for one in left)
        (folder / "metrics.json").write_text("[]")
    assert names(tmp_path) == ["here"]


def test_one_that_has_just_begun_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "work-1").mkdir()  # not held yet
    with scratch("work-", tmp_path):
        assert (tmp_path / "work-1").exists()
    assert names(tmp_path) == ["work-1"]


def test_recordings_of_a_killed_run_stay_and_are_told_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    partial = tmp_path / "here.partial-7"
    (partial / "mbpcc").mkdir(parents=True)
    (partial / "mbpcc" / "mbpcc_0.mcap").write_bytes(RECORDING)
    old(partial)
    with result_folder(tmp_path / "here") as folder:
        (folder / "metrics.json").write_text("[]")
    assert names(tmp_path) == ["here", partial.name]
    assert str(partial) in capsys.readouterr().err


def test_results_that_were_about_to_be_replaced_come_back(tmp_path: Path) -> None:
    """It was killed between the two renames."""
    replaced = tmp_path / "here.replaced-7"
    replaced.mkdir()
    (replaced / "metrics.json").write_text("[1]")
    old(replaced)
    with pytest.raises(ResultFolderError, match="exists"), result_folder(tmp_path / "here"):
        pass
    assert (tmp_path / "here" / "metrics.json").read_text() == "[1]"
    # and go where there are newer ones
    old(replaced)
    with result_folder(tmp_path / "here", force=True) as folder:
        (folder / "metrics.json").write_text("[2]")
    assert names(tmp_path) == ["here"]


def test_results_are_held_while_they_are_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def make() -> None:
        with result_folder(tmp_path / "here", force=True) as folder:
            (folder / "metrics.json").write_text("[]")

    make()
    old(tmp_path / "here")
    rename, seen = Path.rename, []

    def watched(path: Path, target: Path) -> Path:
        moved = rename(path, target)
        seen.append(left_over(tmp_path, "here.replaced-*"))
        return moved

    monkeypatch.setattr(Path, "rename", watched)
    make()
    assert seen == [[], []] and names(tmp_path) == ["here"]


def test_a_folder_that_others_may_not_have_is_none_of_ours(tmp_path: Path) -> None:
    """A file or a link of that name is nobody's work."""
    (tmp_path / "work-file").write_text("")
    (tmp_path / "work-link").symlink_to(old(tmp_path / "elsewhere"))
    assert left_over(tmp_path, "work-*") == []
    with held(tmp_path / "elsewhere"):
        assert left_over(tmp_path, "elsewhere") == []


def test_a_black_box_clears_up_too(tmp_path: Path) -> None:
    (old(tmp_path / ".partial-abc") / "half.mcap").write_bytes(RECORDING)
    old(tmp_path / ".partial-abc")
    with Archive(tmp_path).new("2026-01-01T00-00-00.000_ENCODER") as folder:
        folder.mkdir()
        (folder / "trip.yaml").write_text("")
    assert ".partial-abc" not in names(tmp_path)

"""What a process that was killed leaves in shared memory, and what is another user's."""

import fcntl
import os
import signal
from pathlib import Path

import pytest

from pwm_node.process import shared_memory

LONG_AGO = 1e9  # s since 1970


def segment(folder, number, *, at=LONG_AGO):
    """A segment with its lock, as Fast DDS makes them."""
    data = folder / f"fastrtps_{number:016x}"
    lock = folder / f"{data.name}_el"
    data.write_bytes(bytes(100))
    lock.touch()
    if at is not None:
        os.utime(lock, (at, at))
    return data, lock


def test_what_nobody_holds_is_removed_and_nothing_else(tmp_path):
    dead = segment(tmp_path, 1)
    living = segment(tmp_path, 2)
    starting = segment(tmp_path, 3, at=None)
    others = [tmp_path / name for name in ("fastrtps_port7000", "fastrtps_port7000_el", "x_el")]
    for other in others:
        other.touch()
        os.utime(other, (LONG_AGO, LONG_AGO))
    with living[1].open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert shared_memory.clean(tmp_path) == [dead[0]]
    assert not any(path.exists() for path in dead)
    assert all(path.exists() for path in (*living, *starting, *others))
    assert shared_memory.clean(tmp_path / "nowhere") == []


def test_the_segment_of_a_killed_node_is_found_and_that_of_a_living_one_is_not(start):
    if not shared_memory.FOLDER.is_dir():
        pytest.skip("no shared memory here")
    nodes = [start("pong"), start("pong", "--ros-args", "-r", "__ns:=/axis2")]
    segments = []
    for node in nodes:
        node.wait_for("pong ready")
        maps = Path(f"/proc/{node.pid}/maps").read_text().split()
        own = {part for part in maps if part.startswith(f"{shared_memory.FOLDER}/fastrtps_")}
        own = {part for part in own if "port" not in part}
        if not own:
            pytest.skip("this middleware does not use it")
        segments.append({Path(part) for part in own})
    only = [own - other for own, other in (segments, segments[::-1])]
    nodes[0].kill()
    for path in only[0] | only[1]:
        os.utime(f"{path}_el", (LONG_AGO, LONG_AGO))  # they started long ago
    # a node of another test that starts just now may be faster with those of the killed one
    assert not only[1] & set(shared_memory.clean())
    assert not any(path.exists() for path in only[0])
    assert all(path.exists() for path in only[1])
    assert nodes[1].end(signal.SIGINT) == 0


def test_other_users_are_named(tmp_path, monkeypatch):
    port = tmp_path / "fastrtps_port7410"
    port.touch()
    assert shared_memory.strangers(tmp_path) == []
    monkeypatch.setattr(os, "geteuid", lambda: port.stat().st_uid + 4711)
    assert len(shared_memory.strangers(tmp_path)) == 1
    assert shared_memory.strangers(tmp_path / "nowhere") == []

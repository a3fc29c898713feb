"""The scheduler, cores and memory that a node may ask for."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from pwm_node.process import real_time

OFF = {parameter.name: parameter.default for parameter in real_time.PARAMETERS}


def test_all_of_it_is_off_by_default(monkeypatch):
    def never(*arguments):
        raise AssertionError("it was not asked for")

    for name in ("sched_setscheduler", "sched_setaffinity"):
        monkeypatch.setattr(os, name, never)
    monkeypatch.setattr(real_time, "_lock_memory", never)
    real_time.apply(OFF)


# In a process of its own, which a user's limits or another thread may concern.
PROGRAM = """
import os, resource, sys, threading
from pwm_node.process import real_time
done = threading.Event()
threading.Thread(target=done.wait).start()
try:
    {before}
    real_time.apply({values})
    for thread in os.listdir("/proc/self/task"):
        print(os.sched_getscheduler(int(thread)), os.sched_getparam(int(thread)).sched_priority,
              sorted(os.sched_getaffinity(int(thread))))
    print(next(line for line in open("/proc/self/status") if line.startswith("VmLck")).split()[1])
except real_time.RealTimeError as error:
    print(error)
finally:
    done.set()
"""


def outcome(before="pass", **asked):
    values = {**OFF, **{f"real_time.{name}": value for name, value in asked.items()}}
    program = PROGRAM.format(before=before, values=values)
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    return found.stdout.splitlines()


def test_cores_are_for_all_threads():
    core = max(os.sched_getaffinity(0))
    lines = outcome(core_mask=1 << core)
    assert lines[:2] == [f"{os.SCHED_OTHER} 0 [{core}]"] * 2


def test_a_core_that_is_not_there_is_refused():
    (line,) = outcome(core_mask=1 << 60)
    there = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
    assert line == (
        f"'real_time.core_mask' = {1 << 60}: this process may not run on core 60, but on {there}"
    )


def test_a_priority_is_for_all_threads_or_refused():
    lines = outcome(priority=3)
    if len(lines) == 1:
        pytest.skip(f"not permitted here: {lines[0]}")
    assert [line.split()[:2] for line in lines[:2]] == [[str(os.SCHED_FIFO), "3"]] * 2


NOBODY = "os.setgid(65534); os.setuid(65534)"
root = pytest.mark.skipif(os.getuid() != 0, reason="only root can be another user")


@root
def test_a_priority_that_is_not_permitted_is_refused_in_one_sentence():
    limit = "resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))"
    (line,) = outcome(f"{limit}; {NOBODY}", priority=50)
    assert line == (
        "'real_time.priority' = 50: this user may have SCHED_FIFO up to priority 0; allow more by "
        "'rtprio' in /etc/security/limits.conf and log in again, or leave the parameter at 0"
    )


@root
def test_memory_that_may_not_be_locked_is_refused_in_one_sentence():
    limit = "resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))"
    (line,) = outcome(f"{limit}; {NOBODY}", lock_memory=True)
    assert line.startswith("'real_time.lock_memory': the system refuses it (")
    assert "this user may lock 64 KiB); allow more by 'memlock' in" in line


def test_memory_is_locked():
    allowed, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    lines = outcome(lock_memory=True)
    if len(lines) == 1:
        pytest.skip(f"not permitted here: {lines[0]}")
    assert allowed and int(lines[-1]) > 1000  # KiB


def test_a_node_that_is_refused_does_not_start(start):
    toy = start("ping", "--ros-args", "-p", f"real_time.core_mask:={1 << 60}")
    assert toy.wait() == 1
    assert toy.output.startswith("error: 'real_time.core_mask' = ")
    assert Path(toy.command[1]).name == "toy.py" and "Traceback" not in toy.output

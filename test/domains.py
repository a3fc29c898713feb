"""ROS domains for tests: one each, and never one that another test run on this machine has."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

# Domains above 101 collide with ephemeral ports on Linux; 0 is where a user's own drive runs.
_NUMBERS = range(1, 102)


@contextmanager
def own_domain() -> Iterator[int]:
    """Choose a domain that nobody has, for this process and those it starts.

    A lock file per domain says who has it; the lock ends with the process that holds it, however
    that ends. Of those that are free it is the one left longest ago, by whatever test run: who was
    killed is still seen for 20 s.
    """
    for number in sorted(_NUMBERS, key=_last_used):
        path = _lock(number)
        try:
            file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except PermissionError:
            continue  # another user's
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            continue
        try:
            os.utime(file)
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv("ROS_DOMAIN_ID", str(number))
                patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
                yield number
        finally:
            os.utime(file)
            os.close(file)
        return
    pytest.fail(f"all {len(_NUMBERS)} ROS domains are taken by other test runs on this machine")


def _lock(number: int) -> Path:
    return Path(tempfile.gettempdir(), f"mfpcc_test_domain_{number}.lock")


def _last_used(number: int) -> int:
    try:
        return _lock(number).stat().st_mtime_ns
    except OSError:
        return 0

"""ROS domains for tests: one each, and never one that another test run on this machine has."""

from __future__ import annotations

import fcntl
import itertools
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

# Domains above 101 collide with ephemeral ports on Linux; 0 is where a user's own drive runs.
_FIRST, _COUNT = 1, 101
# Each begins somewhere else, and goes round: who has just left a domain may still be seen there.
_numbers = (_FIRST + n % _COUNT for n in itertools.count(os.getpid()))


@contextmanager
def own_domain() -> Iterator[int]:
    """Choose a domain that nobody has, for this process and those it starts.

    A lock file per domain says who has it; the lock ends with the process that holds it, however
    that ends.
    """
    for number in itertools.islice(_numbers, _COUNT):
        path = Path(tempfile.gettempdir(), f"mfpcc_test_domain_{number}.lock")
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
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv("ROS_DOMAIN_ID", str(number))
                patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
                yield number
        finally:
            os.close(file)
        return
    pytest.fail(f"all {_COUNT} ROS domains are taken by other test runs on this machine")

"""What the middleware leaves in shared memory, and what it cannot reach there.

Fast DDS gives each process a segment of half a MiB in ``/dev/shm``, and beside it a file that the
process locks as long as it lives. After a `kill -9` the segment stays for ever; what else is left
is small, and taken over by who comes next.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pwd
import re
import time
from pathlib import Path

FOLDER = Path("/dev/shm")
_LOCK = re.compile(r"fastrtps_[0-9a-f]{16}_el")
_PORT = "fastrtps_port*[0-9]"
# A process that starts makes its file and then locks it.
_STARTING = 10.0  # s


def clean(folder: Path = FOLDER) -> list[Path]:
    """Remove the segments of processes that have ended without removing them.

    Parameters
    ----------
    folder : Path
        Where shared memory is.

    Returns
    -------
    list of Path
        The segments that were removed.
    """
    removed = []
    with contextlib.suppress(OSError):
        for lock in folder.iterdir():
            if _LOCK.fullmatch(lock.name) and _abandoned(lock):
                segment = lock.with_name(lock.name.removesuffix("_el"))
                with contextlib.suppress(OSError):  # another user's, or somebody else was faster
                    segment.unlink(missing_ok=True)
                    lock.unlink()
                    removed.append(segment)
    return removed


def _abandoned(lock: Path) -> bool:
    """Whether nobody holds a lock who lives."""
    try:
        if time.time() - lock.stat().st_mtime < _STARTING:
            return False
        file = os.open(lock, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    finally:
        os.close(file)
    return True


def strangers(folder: Path = FOLDER) -> list[str]:
    """Return the other users who have nodes here: they and this one do not get their messages.

    A segment can only be opened by who may write to it, and that is its owner.

    Parameters
    ----------
    folder : Path
        Where shared memory is.
    """
    found = set()
    with contextlib.suppress(OSError):
        for port in folder.glob(_PORT):
            with contextlib.suppress(OSError):
                found.add(port.stat().st_uid)
    return sorted(_name(user) for user in found - {os.geteuid()})


def _name(user: int) -> str:
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return str(user)

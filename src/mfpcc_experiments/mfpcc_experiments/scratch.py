"""Folders of work in progress, and what is left of those whose process was killed.

Whoever works in such a folder holds a lock on it, which ends with the process, however that ends.
So the next one to work beside it knows what nobody needs any more, whatever process numbers say:
they come again, and containers that share a disk have the same ones.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

# A folder younger than this may be made but not held yet (s).
_YOUNG = 60.0


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold a folder: it is no left-over, also where it is renamed meanwhile."""
    descriptor = None
    try:
        with suppress(OSError):  # not every file system has locks
            descriptor = os.open(folder, os.O_RDONLY)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)


def left_over(parent: Path, pattern: str) -> list[Path]:
    """
    Find what processes that were killed have left.

    Parameters
    ----------
    parent : Path
        Where they worked.
    pattern : str
        Of the names of their folders.

    Returns
    -------
    list of Path
        Folders that nobody holds; none where that cannot be told.
    """
    return [folder for folder in sorted(parent.glob(pattern)) if _is_left_over(folder)]


def _is_left_over(folder: Path) -> bool:
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return time.time() - os.fstat(descriptor).st_mtime > _YOUNG
    except OSError:
        return False
    finally:
        os.close(descriptor)


@contextmanager
def scratch(prefix: str, parent: Path | None = None) -> Iterator[Path]:
    """
    Have a folder for as long as it is needed, and remove those like it that are left over.

    Parameters
    ----------
    prefix : str
        Of its name; nobody else's folders may begin with it.
    parent : Path, optional
        Where; among the temporary files unless given.
    """
    parent = Path(tempfile.gettempdir()) if parent is None else parent
    for folder in left_over(parent, f"{prefix}*"):
        shutil.rmtree(folder, ignore_errors=True)
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
    with held(folder):
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

"""One node of a name on a machine: two that answer the same messages would spoil each other's run.

ROS itself lets any number of nodes have the same name, and shows one that was killed for another
20 s. A lock on a file tells at once whether the other one lives, and ends with its process however
that ends. It is for this machine only: who comes from another one is not seen.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
from pathlib import Path

from pwm_node.errors import ForPeople


class TakenError(ForPeople, ValueError):
    """A node of this name is running; the text says where, and what to do."""


def claim(name: str, domain: int) -> int | None:
    """Claim a node's name on this machine.

    Parameters
    ----------
    name : str
        Fully qualified name of the node.
    domain : int
        ROS domain.

    Returns
    -------
    int or None
        A file descriptor; the claim ends when it is closed. None where no file can be locked.

    Raises
    ------
    TakenError
        If another process has it, or another node of this one.
    """
    path = Path(tempfile.gettempdir(), f"mfpcc_node_{domain}{name.replace('/', '.')}.lock")
    try:
        file = _open(path)
    except OSError:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.ftruncate(file, 0)
        os.write(file, str(os.getpid()).encode())
    except BlockingIOError:
        process = os.read(file, 20).decode("ascii", "replace")
        os.close(file)
        if process == str(os.getpid()):
            raise TakenError(
                f"two nodes of this process would be named {name}: a new name for one of them "
                "needs the old one in front of it ('-r pmsm_sim:__node:=plant')"
            ) from None
        raise TakenError(
            f"a node {name} is running already on this machine (process {process}, "
            f"ROS_DOMAIN_ID={domain}): stop it, or give this one another namespace "
            "('-r __ns:=/axis2') or domain"
        ) from None
    return file


def _open(path: Path) -> int:
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        return os.open(path, flags)  # also another user's, who must be seen too
    except FileNotFoundError:
        file = os.open(path, flags | os.O_CREAT, 0o666)
        os.fchmod(file, 0o666)
        return file

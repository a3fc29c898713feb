"""What a real-time kernel can give a process: the first place, cores, memory that stays.

All of it is off by default. It is asked for when a node starts, for all threads of its process,
since a message also passes those of the middleware. What the system does not permit ends the start.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
from collections.abc import Mapping, Sequence
from typing import Any

from pwm_node.errors import ForPeople
from pwm_node.parameters import Parameter

_MCL_CURRENT, _MCL_FUTURE = 1, 2

PARAMETERS = (
    Parameter(
        "real_time.priority",
        0,
        "Priority under SCHED_FIFO, of all threads of the process; 0: the ordinary scheduler",
        minimum=0,
        maximum=99,
        read_only=True,
        also=("sched_priority", "rt_priority"),
    ),
    Parameter(
        "real_time.core_mask",
        0,
        "Cores on which the process may run, a bit for each, as of taskset: 2 is core 1, 12 are "
        "cores 2 and 3; 0: on all",
        minimum=0,
        read_only=True,
        also=("affinity", "cpu_affinity"),
    ),
    Parameter(
        "real_time.lock_memory",
        False,
        "Whether the memory of the process is locked, so that it is never paged out",
        read_only=True,
        also=("mlock", "mlockall"),
    ),
)


class RealTimeError(ForPeople, ValueError):
    """The system does not permit what was asked for; the text says what, and what to do."""


def apply(values: Mapping[str, Any]) -> None:
    """Give this process what `PARAMETERS` ask for.

    Parameters
    ----------
    values : mapping
        Values of the parameters.

    Raises
    ------
    RealTimeError
        If the system does not permit it, or a core is not there.
    """
    cores = _cores(values["real_time.core_mask"])
    if cores:
        for thread in _threads():
            _give(thread, lambda thread: os.sched_setaffinity(thread, cores))
    if values["real_time.lock_memory"]:
        _lock_memory()
    priority = values["real_time.priority"]
    if priority:
        _set_priority(priority)


def _cores(mask: int) -> set[int]:
    cores = {core for core in range(mask.bit_length()) if mask >> core & 1}
    there = os.sched_getaffinity(0)
    missing = sorted(cores - there)
    if missing:
        raise RealTimeError(
            f"'real_time.core_mask' = {mask}: this process may not run on core "
            f"{', '.join(map(str, missing))}, but on {', '.join(map(str, sorted(there)))}"
        )
    return cores


def _set_priority(priority: int) -> None:
    try:
        for thread in _threads():
            _give(
                thread,
                lambda thread: os.sched_setscheduler(
                    thread, os.SCHED_FIFO, os.sched_param(priority)
                ),
            )
    except PermissionError:
        allowed, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
        raise RealTimeError(
            f"'real_time.priority' = {priority}: this user may have SCHED_FIFO up to priority "
            f"{allowed}; allow more by 'rtprio' in /etc/security/limits.conf and log in again, or "
            "leave the parameter at 0"
        ) from None


def _lock_memory() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0:
        return
    allowed, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    size = "no limit" if allowed == resource.RLIM_INFINITY else f"{allowed >> 10} KiB"
    raise RealTimeError(
        f"'real_time.lock_memory': the system refuses it ({os.strerror(ctypes.get_errno())}; this "
        f"user may lock {size}); allow more by 'memlock' in /etc/security/limits.conf and log in "
        "again, or leave the parameter off"
    )


def _threads() -> Sequence[int]:
    return [int(name) for name in os.listdir("/proc/self/task")]


def _give(thread: int, what: Any) -> None:
    with contextlib.suppress(ProcessLookupError):  # it may have ended meanwhile
        what(thread)

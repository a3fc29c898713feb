"""Before ROS starts: what is wrong in its environment or its arguments, said in plain words.

Some of it ends a process on the spot, from within a library: an unknown middleware as soon as rclpy
is imported, a domain without ports, a full shared memory. So it is looked at first.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pwm_node.errors import ForPeople
from pwm_node.process import shared_memory

if TYPE_CHECKING:
    from rclpy.context import Context

_LAST_DOMAIN = 232  # beyond it there are no ports
_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")
_MIDDLEWARES = "rmw_typesupport"  # their kind in the index of packages
_SHARED_MEMORY = shared_memory.FOLDER
_NEEDED = 4 << 20  # bytes; Fast DDS takes half a MiB for a process, and crashes where there is none

_FORMS = {
    "remap rule": "FROM:=TO",
    "parameter override rule": "NAME:=VALUE, with VALUE in YAML",
    "log level": "debug, info, warn, error or fatal",
}


class RosError(ForPeople, ValueError):
    """ROS cannot start; the text says why, and what to do."""


def check(*, processes: int = 1) -> None:
    """Look at the environment before ROS is imported.

    Parameters
    ----------
    processes : int
        How many have to find each other.

    Raises
    ------
    RosError
        If ROS would not start.
    """
    given = os.environ.get
    domain = given("ROS_DOMAIN_ID", "")
    if domain and not (re.fullmatch(r"\d{1,9}", domain) and int(domain) <= _LAST_DOMAIN):
        raise RosError(f"ROS_DOMAIN_ID={domain}: a whole number from 0 to {_LAST_DOMAIN} is needed")
    _check_middleware(given("RMW_IMPLEMENTATION", ""))
    scope = given("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if scope and scope not in _RANGES:
        raise RosError(
            f"ROS_AUTOMATIC_DISCOVERY_RANGE={scope}: there are only {', '.join(_RANGES)}"
        )
    if scope == "OFF" and processes > 1:
        raise RosError(
            f"ROS_AUTOMATIC_DISCOVERY_RANGE=OFF: {processes} processes would never find each "
            "other; LOCALHOST is for one machine"
        )
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        file = given(name, "")
        if file and not os.access(file, os.R_OK):
            raise RosError(f"{name}={file}: no such file that could be read; or unset {name}")
    _check_shared_memory()
    _find_room_for_logs()


def _check_middleware(wanted: str) -> None:
    if not wanted:
        return
    from ament_index_python import get_resources

    there = sorted(set(get_resources(_MIDDLEWARES)) - {"rmw_implementation"})
    if there and wanted not in there:
        raise RosError(
            f"RMW_IMPLEMENTATION={wanted}: there is no such middleware here, but "
            f"{', '.join(there)}; or unset RMW_IMPLEMENTATION"
        )


def _check_shared_memory() -> None:
    try:
        memory = os.statvfs(_SHARED_MEMORY)
    except OSError:
        return  # a system without it, where the middleware does without, too
    free = memory.f_bavail * memory.f_frsize
    if memory.f_blocks and free < _NEEDED:
        raise RosError(
            f"{_SHARED_MEMORY} is full ({free >> 10} KiB free, {_NEEDED >> 20} MiB needed): "
            "nodes talk through it; remove what nobody uses there"
        )


def _find_room_for_logs() -> None:
    """Let ROS's logs go to a temporary folder where there is no home that can be written to."""
    if os.environ.get("ROS_LOG_DIR"):
        return  # who chose a folder is told if it is no good
    home = os.environ.get("ROS_HOME")
    folder = (Path(home) if home else Path.home() / ".ros") / "log"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return
    except OSError:
        instead = os.path.join(tempfile.gettempdir(), f"ros-logs-{os.getuid()}")
    os.environ["ROS_LOG_DIR"] = instead  # of the processes that this one starts, too
    print(
        f"{folder} cannot be written to: ROS's logs go to {instead} (ROS_LOG_DIR names another "
        "folder)",
        file=sys.stderr,
    )


def init(args: Sequence[str] | None, context: Context) -> None:
    """Start ROS; the signals are left alone.

    Parameters
    ----------
    args : sequence of str, optional
        The command line; without it, that of the process.
    context : Context
        What is started.

    Raises
    ------
    RosError
        If it does not start.
    """
    shared_memory.clean()
    check()
    import rclpy
    from rclpy.impl.implementation_singleton import rclpy_implementation
    from rclpy.signals import SignalHandlerOptions

    try:
        rclpy.init(
            args=None if args is None else list(args),
            context=context,
            # rclpy's would shut the context down at once, and then a node could not publish any
            # more that its gates go off
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except rclpy_implementation.UnknownROSArgsError as error:
        unknown = " ".join(str(error).strip("[]").replace("'", "").split(", "))
        raise RosError(f"unknown arguments after --ros-args: {unknown}") from None
    except rclpy_implementation.RCLError as error:
        raise RosError(plain(str(error))) from None


def plain(text: str) -> str:
    """Return an error of rcl without the places in its sources, and with what would be right.

    >>> plain("failed to initialize rcl: Couldn't parse remap rule: '-r x'. Error: e, at /a.c:3")
    "'-r x': not a remap rule (FROM:=TO)"
    """
    text = " ".join(re.sub(r", at /\S+:\d+", "", text).split())
    found = re.search(r"Couldn't parse ([a-z ]+): '(.*?)'\. Error: (.*)", text)
    if found is not None:
        kind, given, why = found.groups()
        if kind in _FORMS:
            return f"'{given}': not a {kind} ({_FORMS[kind]})"
        return f"'{given}': {why[:1].lower()}{why[1:]}"
    found = re.search(r"Failed to create log directory '(.*?)'", text)
    if found is not None:
        return (
            f"{found[1]}: the folder of ROS's logs cannot be made; let ROS_LOG_DIR (or HOME) be "
            "one that can be written to"
        )
    return text

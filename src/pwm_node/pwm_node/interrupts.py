"""An executable from its first moment to its last: Ctrl-C is answered in each of them.

While Python starts it answers Ctrl-C with a traceback, and what it imports may take the exception
for its own. So the executables, in `bin/`, start with SIGINT blocked (`env --block-signal`), and
`run` lets it through when somebody is there to answer. From then on Ctrl-C, SIGTERM and the closing
of the terminal (SIGHUP) end the process on the spot, which leaves nothing behind as long as nothing
was begun. What would be left behind is made within `undone`, what has to be finished within
`finished`.

In a process that was not started by `run` (a test, a program of the user) nothing here touches the
signals.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import signal
import stat
import sys
import time
from collections.abc import Iterator
from types import FrameType
from typing import Any, NoReturn

KINDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_PARENT = "PWM_NODE_ENDS_WITH"
_PR_SET_PDEATHSIG = 1

#: Somebody who asks again after so long (s) does not want to wait for what is being tidied up.
IMPATIENT_AFTER = 2.0


class _State:
    """Of this process."""

    def __init__(self) -> None:
        self.watching = False  # since `run`
        self.mode = "end"  # what a signal does: end, raise, or wait
        self.came = 0  # the first signal, and when
        self.came_at = 0.0
        self.line = ""
        self.code: int | None = None


_state = _State()


def run(target: str, *, line: str = "", code: int | None = None, node: bool = False) -> NoReturn:
    """Import a function and end the process with what it returns.

    Parameters
    ----------
    target : str
        `module:function`. The function takes nothing, and returns the exit code.
    line : str
        What is said where a signal ends the process.
    code : int, optional
        Exit code of such an end; without it, that by which shells know it: 130 for Ctrl-C.
    node : bool
        Whether it is a node. What keeps ROS from starting is said before anything imports rclpy,
        which ends the process from within.
    """
    _state.watching, _state.line, _state.code = True, line, code
    for kind in KINDS:
        if signal.getsignal(kind) != signal.SIG_IGN:  # which is how `nohup` asks not to be told
            signal.signal(kind, _handle)
    sys.unraisablehook = _not_lost
    parent = os.environ.pop(_PARENT, "")
    if parent:
        _end_with(int(parent))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    module, _, name = target.partition(":")
    try:
        if node:
            _check_ros()
        result = getattr(importlib.import_module(module), name)()
    except KeyboardInterrupt:
        _end()
    for kind in KINDS:
        signal.signal(kind, signal.SIG_IGN)  # all is done; it only takes Python a while to leave
    sys.exit(result)


def _check_ros() -> None:
    """End here, with one plain line, if ROS cannot start."""
    from pwm_node.ros import ros_environment

    try:
        ros_environment.check()
    except ros_environment.RosError as error:
        sys.exit(f"error: {error}")


@contextlib.contextmanager
def undone() -> Iterator[None]:
    """Within this, a signal raises `KeyboardInterrupt`: what was begun is undone on its way."""
    with _mode("raise"):
        yield


@contextlib.contextmanager
def finished() -> Iterator[None]:
    """Within this, a signal is only taken note of: what was begun is finished."""
    with _mode("wait"):
        yield


@contextlib.contextmanager
def _mode(mode: str) -> Iterator[None]:
    before, _state.mode = _state.mode, mode
    try:
        yield
    finally:
        _state.mode = before


def check() -> None:
    """End here if a signal came: somebody may have taken the exception for his own."""
    if _state.came and _state.mode != "wait":
        _act()


def ending_with_this_process() -> dict[str, str]:
    """Environment for an executable that shall stop when this process ends, however that ends."""
    return {**os.environ, _PARENT: str(os.getpid())}


def _end_with(parent: int) -> None:
    """Get SIGINT when the parent ends."""
    # The process itself asks for it: between fork and exec, with threads around, nobody could.
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGINT)
    if os.getppid() != parent:
        _end()  # it was faster


def came() -> bool:
    """Whether a signal has come that ends the process."""
    return bool(_state.came)


def exit_code() -> int | None:
    """Exit code of a process that was interrupted, None if it was not."""
    if not _state.came:
        return None
    return 128 + _state.came if _state.code is None else _state.code


def note(number: int) -> None:
    """Take note of a signal that somebody else handles."""
    if not _state.watching:
        return
    if not _state.came:
        _state.came, _state.came_at = number, time.monotonic()
    if number == signal.SIGHUP:
        _leave_the_terminal()


def _handle(number: int, frame: FrameType | None) -> None:
    again = bool(_state.came)
    note(number)
    if again and time.monotonic() - _state.came_at > IMPATIENT_AFTER:
        _end()
    if not again and _state.mode != "wait":
        _act()


def _act() -> None:
    if _state.mode == "raise":
        raise KeyboardInterrupt
    _end()


def _end() -> NoReturn:
    """End on the spot: nothing has been begun, so there is nothing to undo."""
    note(signal.SIGINT)
    if _state.line:
        with contextlib.suppress(OSError):
            os.write(2, f"{_state.line}\n".encode())
    os._exit(exit_code() or 0)


def _not_lost(unraisable: Any) -> None:
    """An interrupt that came where no exception can be raised, in a destructor: raise it again."""
    if unraisable.exc_type is KeyboardInterrupt:
        _state.came, number = 0, _state.came
        signal.raise_signal(number or signal.SIGINT)
    else:
        sys.__unraisablehook__(unraisable)


def _leave_the_terminal() -> None:
    """It is gone: what is said from now on would fail."""
    with open(os.devnull, "r+b") as nowhere:
        for file in range(3):
            with contextlib.suppress(OSError):
                if stat.S_ISCHR(os.fstat(file).st_mode):
                    os.dup2(nowhere.fileno(), file)

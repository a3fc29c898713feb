"""Calling code that others wrote, in the thread of the loop: it may fail, but only for itself.

Whatever it raises, `SystemExit` and `GeneratorExit` included, becomes a `ForeignError`. A call that
does not return is interrupted in the main thread: a thread of our own looks at it now and then,
and sends a signal whose handler raises. Looks are counted, not seconds, so that a process that was
stopped or starved blames nobody. Code that swallows even that, or that never comes back from
compiled code, cannot be helped; what it is called is said, and a stop ends the process on the spot.
"""

from __future__ import annotations

import dis
import os
import signal
import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

from pwm_node import interrupts

_T = TypeVar("_T")

_LOOK_EVERY = 0.1  # s
_HURRIED = 0.3  # s: what is left to a call once the process was asked to end
_IDLE_LOOKS = 3  # without a call, then the thread ends
_GIVEN_UP_AFTER = 3  # interrupts without effect
_LONGEST_TEXT = 300  # characters of what an exception says

_SIGNAL = signal.SIGRTMIN  # nobody's, and it ends a wait


class ForeignError(Exception):
    """Foreign code failed; the text says how, in a line."""


class _TooLongError(BaseException):
    """Raised in the middle of a call that does not return."""


class _Call:
    """The call that the main thread is in, and what the looks at it have found."""

    def __init__(self) -> None:
        self.number = 0  # 0: in none
        self.made = 0
        self.what = ""
        self.seconds = 0.0
        self.overdue = 0  # number of a call that shall end
        self.interrupts = 0  # how often it was told so
        self.watched = False
        self.lock = threading.Lock()

    def stand_back(self) -> None:
        """Forget the watch: a forked process has none of the threads."""
        self.watched = False
        self.lock = threading.Lock()


_call = _Call()
os.register_at_fork(after_in_child=_call.stand_back)


def call(function: Callable[..., _T], *arguments: Any, what: str, seconds: float) -> _T:
    """Call a function that others wrote.

    Parameters
    ----------
    function : callable
    *arguments
        What it is given.
    what : str
        What to call it where it does not return.
    seconds : float
        How long it may take (s), in the main thread.

    Returns
    -------
    What it returns.

    Raises
    ------
    ForeignError
        If it raises anything, or takes too long.
    KeyboardInterrupt
        If that came from outside.
    """
    outer = _call.number
    try:
        if threading.current_thread() is threading.main_thread():
            _call.made += 1
            _call.what, _call.seconds = what, seconds
            _call.number = _call.made
            if not _call.watched:
                _watch()
        try:
            return function(*arguments)
        finally:
            _call.number = outer
    except _TooLongError:
        _call.number = outer  # it may have come just before that was done
        raise ForeignError("did not return") from None
    except KeyboardInterrupt as error:
        if _from_outside(error):
            raise
        raise ForeignError("KeyboardInterrupt") from None
    except BaseException as error:  # noqa: BLE001 (foreign code may raise anything)
        raise ForeignError(_describe(error)) from None


def _describe(error: BaseException) -> str:
    """An exception in one line of bounded length, although its text is foreign code, too."""
    try:
        text = " ".join(str(error).split())
    except BaseException:  # noqa: BLE001
        text = "an exception whose text cannot be had"
    if len(text) > _LONGEST_TEXT:
        text = text[:_LONGEST_TEXT] + " ..."
    name = type(error).__name__[:_LONGEST_TEXT]
    return f"{name}: {text}" if text else name


def _from_outside(error: KeyboardInterrupt) -> bool:
    """Whether a signal raised it, and not a `raise` in the foreign code.

    Our own handlers take note. Python's is not written in Python, so that the innermost frame is
    the one that was interrupted, at any instruction but a `raise`.
    """
    trace = error.__traceback__
    if interrupts.came() or trace is None:
        return True
    while trace.tb_next is not None:
        trace = trace.tb_next
    operation = dis.opname[trace.tb_frame.f_code.co_code[trace.tb_lasti]]
    return operation not in ("RAISE_VARARGS", "RERAISE")


def _watch() -> None:
    """Have a thread look at the calls."""
    with _call.lock:
        if not _call.watched:
            _call.watched = True
            signal.signal(_SIGNAL, _interrupt)
            threading.Thread(target=_look, name="foreign", daemon=True).start()


def _nothing_to_watch(made: int) -> bool:
    """Whether the thread may end. A call says that it is there first, and then looks for it."""
    with _call.lock:
        _call.watched = False
        if _call.made != made:
            _call.watched = True
        return not _call.watched


def _look() -> None:
    main = threading.main_thread().ident
    assert main is not None
    seen = made = looks = idle = 0
    while True:
        time.sleep(_LOOK_EVERY)
        idle = 0 if _call.number or _call.made != made else idle + 1
        made = _call.made
        if idle >= _IDLE_LOOKS and _nothing_to_watch(made):
            return
        number = _call.number
        if number != seen or not number:
            seen, looks = number, 0
            _call.interrupts = 0
            continue
        looks += 1
        limit = min(_call.seconds, _HURRIED) if interrupts.came() else _call.seconds
        if looks * _LOOK_EVERY >= limit:
            _call.overdue = number
            _call.interrupts += 1
            signal.pthread_kill(main, _SIGNAL)
            if _call.interrupts == _GIVEN_UP_AFTER:
                line = f"error: {_call.what} does not return and cannot be interrupted\n"
                os.write(2, line.encode())
            if _call.interrupts >= _GIVEN_UP_AFTER and interrupts.came():
                os._exit(interrupts.exit_code() or 1)


def _interrupt(number: int, frame: Any) -> None:
    """Raise in the call that is overdue; it may have returned in the meantime."""
    if _call.number and _call.number == _call.overdue:
        raise _TooLongError

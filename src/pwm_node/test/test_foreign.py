"""Whatever foreign code does in a call, one kind of error comes out of it, and it comes out."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import pytest

from pwm_node import foreign

PATIENCE = 120.0


class Evil(Exception):
    def __str__(self) -> str:
        raise SystemExit(3)


def raising(error: BaseException) -> Callable[[], None]:
    def function() -> None:
        raise error

    return function


def endless() -> None:
    while True:
        pass


def asleep() -> None:
    time.sleep(1e6)


def waits() -> None:
    lock = threading.Lock()
    lock.acquire()
    lock.acquire()


def swallows_once() -> None:
    try:
        endless()
    except BaseException:  # noqa: BLE001
        endless()


def deep() -> None:
    deep()


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ValueError("two\nlines"), "ValueError: two lines"),
        (SystemExit(7), "SystemExit: 7"),
        (GeneratorExit(), "GeneratorExit"),
        (KeyboardInterrupt(), "KeyboardInterrupt"),
        (MemoryError(), "MemoryError"),
        (Evil(), "Evil: an exception whose text cannot be had"),
        (RuntimeError("x" * 1_000_000), "RuntimeError: " + "x" * 300 + " ..."),
    ],
)
def test_what_is_raised(error: BaseException, said: str) -> None:
    with pytest.raises(foreign.ForeignError) as caught:
        foreign.call(raising(error), what="it", seconds=60.0)
    assert str(caught.value) == said


def test_deep_recursion() -> None:
    with pytest.raises(foreign.ForeignError, match="RecursionError"):
        foreign.call(deep, what="it", seconds=60.0)


@pytest.mark.parametrize("function", [endless, asleep, waits, swallows_once])
def test_a_call_that_does_not_return(function: Callable[[], None]) -> None:
    for _ in range(2):
        with pytest.raises(foreign.ForeignError, match="did not return"):
            foreign.call(function, what="it", seconds=0.2)
    # and nothing is interrupted afterwards
    assert foreign.call(lambda: sum(range(1000)), what="it", seconds=60.0) == 499_500
    time.sleep(3 * foreign._LOOK_EVERY)


def test_ctrl_c_is_no_failure_of_the_code() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            foreign.call(signal.raise_signal, signal.SIGINT, what="it", seconds=60.0)
    finally:
        signal.signal(signal.SIGINT, before)


STUBBORN = """
import sys
from pwm_node import foreign, interrupts

def stubborn():
    print("begun", flush=True)
    while True:
        try:
            while True:
                pass
        except BaseException:
            pass

sys.modules["stubborn"] = sys.modules["__main__"]
def main():
    with interrupts.finished():  # a signal is only taken note of, as in a node
        foreign.call(stubborn, what="scheme 'mine'", seconds=float(sys.argv[1]))
interrupts.run("stubborn:main")
"""


@pytest.mark.parametrize("seconds", [0.2, 600.0])
def test_code_that_cannot_be_interrupted_is_named_and_ended_by_ctrl_c(seconds: float) -> None:
    command = [sys.executable, "-c", STUBBORN, str(seconds)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == "begun\n"
        if seconds < 1.0:
            assert "scheme 'mine' does not return" in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 130
        assert seconds < 1.0 or "scheme 'mine' does not return" in process.stderr.readline()

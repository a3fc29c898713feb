"""What holds for every test of this repository: what it has started ends with it."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

#: For what ends by itself: generous, for a slow and busy machine.
_PATIENCE = 20.0  # s


def pytest_configure() -> None:
    """Have the signals that whoever started this ignored: a shell in the background, nohup.

    Processes inherit that, and what a test interrupts or hangs up would go on.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGHUP, signal.SIGTERM):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest, those with a time limit of their own: at the end one waits alone."""
    items.sort(key=lambda item: item.get_closest_marker("timeout") is None)


@pytest.fixture(autouse=True)
def _leaves_nothing_behind() -> Iterator[None]:
    """Fail a test after which a thread or a process goes on that was not there before."""
    before = _running()
    yield
    deadline = time.monotonic() + _PATIENCE
    while left := _running() - before:
        if time.monotonic() > deadline:
            pytest.fail(f"the test has ended and left behind: {', '.join(sorted(left))}")
        time.sleep(0.05)


def _running() -> set[str]:
    """Threads of this process, and processes it has started, up to those not waited for."""
    found = {f"thread {thread.name} ({thread.ident})" for thread in threading.enumerate()}
    for file in Path("/proc/self/task").glob("*/children"):
        try:
            children = file.read_text().split()
        except OSError:
            continue  # the thread has just ended
        found |= {f"process {pid} ({_command(pid)})" for pid in children}
    return found


def _command(pid: str) -> str:
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return "ended"
    return " ".join(word.decode(errors="replace") for word in words).strip()[:200] or "ended"

"""Programs whose output can be waited for, and bounded waits."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest

#: Bound on whatever is waited for: enough for a start on a slow and busy machine that has no
#: kernels compiled yet. Nothing may be concluded from how much of it was needed.
PATIENCE = 300.0


class Process:
    """A program whose output can be waited for.

    Parameters
    ----------
    command : sequence of str
        Program and arguments.
    **options
        As of `subprocess.Popen`: `cwd`, `env`.
    """

    def __init__(self, command: Sequence[str | Path], **options: Any) -> None:
        self.command = [str(part) for part in command]
        self._popen = subprocess.Popen(
            self.command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            # whoever runs the tests in the background has SIGINT ignored
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
            **options,
        )
        self._lines: list[str] = []
        self._news = threading.Condition()
        self._ended = False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._popen.stdout is not None
        for line in self._popen.stdout:
            with self._news:
                self._lines.append(line)
                self._news.notify_all()
        with self._news:
            self._ended = True
            self._news.notify_all()

    @property
    def pid(self) -> int:
        """Number of the process, and of its group."""
        return self._popen.pid

    @property
    def ended(self) -> bool:
        """Whether nothing more will be printed."""
        with self._news:
            return self._ended

    @property
    def output(self) -> str:
        """All it has printed."""
        with self._news:
            return "".join(self._lines)

    def wait_for(self, text: str, seconds: float = PATIENCE) -> None:
        """Wait until it has printed a text."""
        with self._news:
            found = self._news.wait_for(
                lambda: self._ended or text in "".join(self._lines), seconds
            )
        assert found and text in self.output, f"no '{text}' from {self.command}:\n{self.output}"

    def wait(self, seconds: float = PATIENCE) -> int:
        """Wait until it has ended; returns its exit code."""
        try:
            code = self._popen.wait(seconds)
        except subprocess.TimeoutExpired:
            pytest.fail(f"{self.command} goes on after {seconds:.0f} s:\n{self.output}")
        self._reader.join(5.0)
        return code

    def signal(self, number: signal.Signals) -> None:
        """Send a signal."""
        self._popen.send_signal(number)

    def end(self, *numbers: signal.Signals) -> int:
        """Send signals, and wait until it has ended; returns its exit code."""
        for number in numbers:
            self.signal(number)
        return self.wait()

    def limit(self, what: int, value: int) -> None:
        """Set a limit of `resource` while it runs."""
        resource.prlimit(self._popen.pid, what, (value, value))

    def interrupt(self) -> None:
        """Send SIGINT to it and to all that it started, as Ctrl-C does."""
        os.killpg(self._popen.pid, signal.SIGINT)

    def kill(self) -> None:
        """End it at once, as `kill -9` does."""
        self._popen.kill()
        self._popen.wait()

    def __enter__(self) -> Process:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._popen.poll() is None:
            self._popen.terminate()
            try:
                self._popen.wait(10.0)
            except subprocess.TimeoutExpired:
                self.kill()
        # what it had started and left, if anything, goes with it
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._popen.pid, signal.SIGKILL)
        self._reader.join(PATIENCE)


def until(condition: Callable[[], bool], what: str, seconds: float = PATIENCE) -> None:
    """Wait until a condition holds, and fail by name where it does not."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            pytest.fail(f"not within {seconds:.0f} s: {what}")
        time.sleep(0.01)


def reached(bag: Path) -> int:
    """Period at which the last whole chunk of a file ends that is being written; 0 without one."""
    data = next(bag.glob("*.mcap"), Path("/dev/null")).read_bytes()
    at, end = 8, 0
    while at + 9 <= len(data):
        following = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        if following > len(data):
            break
        if data[at] == 6:  # a chunk: first and last log time
            end = int.from_bytes(data[at + 17 : at + 25], "little") // 100_000
        at = following
    return end

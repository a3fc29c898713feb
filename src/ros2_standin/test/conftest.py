"""What the tests of the stand-in share: calls of it, a graph of its own for each test file."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from domains import own_domain
from harness import PATIENCE

from ros2_standin.main import execute, parse

COMMAND = Path(__file__).parents[1] / "path/ros2"
REMOTE = Path(__file__).with_name("remote.py")
SLOW_SERVER = Path(__file__).with_name("slow_server.py")


class Outcome(NamedTuple):
    """What a command has returned and printed."""

    code: int
    out: str
    err: str


class Process:
    """A program that runs, and what it has printed so far."""

    def __init__(self, *command: object) -> None:
        self.popen = subprocess.Popen(
            [sys.executable, *map(str, command)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            # Whoever runs the tests in the background has SIGINT ignored.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )
        self.out = ""
        self._news = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.popen.stdout:
            with self._news:
                self.out += line
                self._news.notify_all()
        with self._news:
            self._news.notify_all()

    def wait_for(self, text: str) -> None:
        """Wait until it has printed something."""
        with self._news:
            self._news.wait_for(
                lambda: text in self.out or not self._reader.is_alive(), timeout=PATIENCE
            )
        assert text in self.out

    def end(self, *signals: int) -> int:
        """Send signals, and return the exit code."""
        for number in signals:
            self.popen.send_signal(number)
        code = self.popen.wait(PATIENCE)
        self._reader.join(PATIENCE)
        return code


@pytest.fixture
def ros2(capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """Call the stand-in in this process."""

    def call(*arguments: object) -> Outcome:
        capsys.readouterr()
        try:
            code = execute(parse([str(argument) for argument in arguments]))
        except SystemExit as end:
            code = end.code
        if isinstance(code, str):
            print(code, file=sys.stderr)
            code = 1
        return Outcome(int(code or 0), *capsys.readouterr())

    return call


@pytest.fixture
def eventually(ros2: Callable[..., Outcome]) -> Callable[..., Outcome]:
    """Call the stand-in until a condition holds of the outcome: others are seen one by one."""

    def call(*arguments: object, until: Callable[[Outcome], bool]) -> Outcome:
        deadline = time.monotonic() + PATIENCE
        while not until(outcome := ros2(*arguments)):
            assert time.monotonic() < deadline, outcome
        return outcome

    return call


@pytest.fixture(scope="module")
def domain() -> Iterator[int]:
    """A ROS domain for one test file, on this machine only."""
    with own_domain() as number:
        yield number


@pytest.fixture(scope="module")
def remote(domain: int) -> Iterator[Process]:
    """Another process with nodes to look at."""
    process = Process(REMOTE)
    process.wait_for("ready")
    yield process
    process.end(signal.SIGKILL)


@pytest.fixture
def slow_server(domain: int) -> Iterator[Process]:
    """Another process with a service, /slow, that never answers."""
    process = Process(SLOW_SERVER)
    process.wait_for("ready")
    yield process
    process.end(signal.SIGKILL)


@pytest.fixture(scope="module")
def start(domain: int) -> Iterator[Callable[..., Process]]:
    """Start the stand-in as a process; what is left of it is killed after the test file."""
    processes: list[Process] = []

    def run(*arguments: object) -> Process:
        processes.append(Process(COMMAND, *arguments))
        return processes[-1]

    yield run
    for process in processes:
        if process.popen.poll() is None:
            process.end(signal.SIGKILL)

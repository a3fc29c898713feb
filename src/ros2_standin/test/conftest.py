"""What the tests of the stand-in share: calls of it, a graph of its own for each test file."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from domains import own_domain
from harness import PATIENCE, Process

from ros2_standin.main import execute, parse

COMMAND = Path(__file__).parents[1] / "path/ros2"
REMOTE = Path(__file__).with_name("remote.py")
SLOW_SERVER = Path(__file__).with_name("slow_server.py")


class Outcome(NamedTuple):
    """What a command has returned and printed."""

    code: int
    out: str
    err: str


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
    with Process([sys.executable, REMOTE]) as process:
        process.wait_for("ready")
        yield process


@pytest.fixture
def slow_server(domain: int) -> Iterator[Process]:
    """Another process with a service, /slow, that never answers."""
    with Process([sys.executable, SLOW_SERVER]) as process:
        process.wait_for("ready")
        yield process


@pytest.fixture(scope="module")
def start(domain: int) -> Iterator[Callable[..., Process]]:
    """Start the stand-in as a process; what is left of it is killed after the test file."""
    with contextlib.ExitStack() as stack:

        def run(*arguments: object) -> Process:
            command = [sys.executable, COMMAND, *map(str, arguments)]
            return stack.enter_context(Process(command))

        yield run

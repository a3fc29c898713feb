"""What the end-to-end tests share: a graph of their own each, and processes that end with them."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from harness import Process

# Domains above 101 collide with ephemeral ports on Linux; 0 is where a user's own drive runs.
_DOMAINS = itertools.cycle(range(2, 100))
_FIRST = os.getpid() % 97


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A ROS domain that no other test of this run has."""
    number = 2 + (next(_DOMAINS) + _FIRST) % 98
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return number


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    """Start an executable of a package, as `ros2 run PACKAGE EXECUTABLE ARGUMENTS` does."""
    running: list[Process] = []

    def launch(package: str, executable: str, *arguments: str) -> Process:
        program = Path(get_package_prefix(package), "lib", package, executable)
        process = Process([program, *arguments])
        running.append(process)
        return process

    yield launch
    for process in reversed(running):
        with process:
            pass

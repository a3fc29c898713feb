"""What the end-to-end tests share: a graph of their own each, and processes that end with them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from ament_index_python.packages import get_package_prefix
from domains import own_domain
from harness import Process


@pytest.fixture(autouse=True)
def domain() -> Iterator[int]:
    """A ROS domain that no other test on this machine has."""
    with own_domain() as number:
        yield number


@pytest.fixture
def context(domain: int) -> Iterator[rclpy.Context]:
    """For nodes in this process: they leave the graph with the test, even with one that fails."""
    it = rclpy.Context()
    rclpy.init(args=[], context=it)
    yield it
    rclpy.try_shutdown(context=it)


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

"""What the tests of this package share: a graph of its own for each test."""

import importlib.util
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from domains import own_domain

TOY = Path(__file__).with_name("toy.py")


@pytest.fixture
def domain():
    """A ROS domain for this test alone, on this machine only."""
    with own_domain() as number:
        yield number


@pytest.fixture
def context(domain):
    rclpy = pytest.importorskip("rclpy")
    context = rclpy.Context()
    context.init(args=[], domain_id=domain)
    yield context
    context.try_shutdown()


@pytest.fixture(scope="session")
def toy():
    """The module with the two toy nodes."""
    pytest.importorskip("mfpcc_msgs.msg")
    spec = importlib.util.spec_from_file_location("toy", TOY)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Process:
    """A toy program, and what it has said so far."""

    def __init__(self, *arguments):
        self.popen = subprocess.Popen(
            [sys.executable, str(TOY), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.said = ""
        self._new = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        for line in self.popen.stdout:
            with self._new:
                self.said += line
                self._new.notify_all()
        with self._new:
            self._new.notify_all()

    def wait_for(self, text, seconds=40.0):
        """Wait until the program has said something."""
        with self._new:
            came = self._new.wait_for(
                lambda: text in self.said or not self._reader.is_alive(), seconds
            )
        assert came and text in self.said, f"no '{text}' within {seconds} s in:\n{self.said}"

    def end(self, *signals, seconds=20.0):
        """Send signals, and return the exit code."""
        for number in signals:
            self.popen.send_signal(number)
        code = self.popen.wait(seconds)
        self._reader.join(seconds)
        return code


@pytest.fixture
def start(domain, toy):
    """Start toy programs; what is left of them is killed at the end of the test."""
    processes = []

    def _start(*arguments):
        processes.append(Process(*arguments))
        return processes[-1]

    yield _start
    for process in processes:
        if process.popen.poll() is None:
            process.end(signal.SIGKILL)


def wait_until(condition, seconds=40.0):
    """Look until a condition holds, in bounded time."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"still not after {seconds} s"
        time.sleep(0.005)


@pytest.fixture(name="wait_until")
def _wait_until():
    return wait_until

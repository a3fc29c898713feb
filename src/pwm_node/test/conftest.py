"""What the tests of this package share: a graph of its own for each test."""

import importlib.util
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from domains import own_domain
from harness import Process

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


@pytest.fixture
def start(domain):
    """Start toy programs; they end with the test."""
    pytest.importorskip("mfpcc_msgs.msg")
    with ExitStack() as stack:
        yield lambda *arguments: stack.enter_context(Process([sys.executable, TOY, *arguments]))

"""The command's own node, and what it sees of the graph."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import HIDDEN_NODE_PREFIX, Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden

from pwm_node.ros import ros_environment
from ros2_standin.verb import Terminated

#: Time it takes to see who is there (s), unless told otherwise.
DISCOVERY_TIME = 0.5
#: Time without news after which everybody is taken to have been seen (s), and the longest wait
#: for that beyond the discovery time.
QUIET_TIME = 0.25
LONGEST_UNREST = 3.0
#: Time to wait beyond the discovery time for something that was asked for by name (s).
LOOK_TIME = 1.0
#: Time between two looks at the graph (s).
LOOK_PERIOD = 0.01
#: Time a service may take to appear, and then to answer (s). A node on a busy machine may compile.
SERVICE_TIMEOUT = 5.0
ANSWER_TIMEOUT = 30.0

#: Names with their types, as rclpy returns them.
NamesAndTypes = list[tuple[str, list[str]]]


def add_graph_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of verbs that look at the graph."""
    add_node_arguments(parser)
    parser.add_argument(
        "--no-daemon", action="store_true", help="Accepted; this stand-in has no daemon"
    )


def add_node_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of verbs that start a node."""
    parser.add_argument(
        "--spin-time",
        type=float,
        default=DISCOVERY_TIME,
        help="Time to wait for discovery (s, default: %(default)s)",
    )
    parser.add_argument(
        "-s", "--use-sim-time", action="store_true", help="Take the time from /clock"
    )


@contextmanager
def cli_node(
    args: argparse.Namespace, name: str | None = None, ros_args: Sequence[str] = ()
) -> Iterator[Node]:
    """
    Start a node for one command.

    Parameters
    ----------
    args : Namespace
        With ``use_sim_time``, if the verb has that.
    name : str, optional
        Name of the node. If not given, one that lists leave out.
    ros_args : sequence of str
        As after ``--ros-args``.
    """
    ros_environment.check()
    rclpy.init(args=["--ros-args", *ros_args] if ros_args else [])
    try:
        node = rclpy.create_node(
            name or f"_ros2cli_{os.getpid()}",
            start_parameter_services=False,
            parameter_overrides=[
                Parameter("use_sim_time", value=getattr(args, "use_sim_time", False))
            ],
        )
        try:
            yield node
        finally:
            node.destroy_node()
    except ExternalShutdownException:
        raise Terminated from None
    finally:
        rclpy.try_shutdown()


@contextmanager
def graph_node(args: argparse.Namespace) -> Iterator[Node]:
    """Start a node that has seen who is there."""
    with cli_node(args) as node:
        # Discovery goes on in threads of the middleware.
        time.sleep(args.spin_time)
        _wait_for_quiet(node)
        yield node


def _wait_for_quiet(node: Node) -> None:
    """Wait while there is news: on a busy machine, others are not seen whole at once."""
    deadline = time.monotonic() + LONGEST_UNREST
    seen: object = None
    last_news = time.monotonic()
    while (now := time.monotonic()) < deadline and now - last_news < QUIET_TIME:
        nodes = node.get_node_names_and_namespaces()
        graph = nodes, node.get_topic_names_and_types(), node.get_service_names_and_types()
        if graph != seen:
            seen, last_news = graph, now
        time.sleep(LOOK_PERIOD)


def wait_until(condition: Callable[[], bool], timeout: float) -> bool:
    """Wait until a condition holds, for at most `timeout` seconds; return whether it does."""
    deadline = time.monotonic() + timeout
    while not condition():
        if not rclpy.ok():
            raise Terminated
        if time.monotonic() > deadline:
            return condition()
        time.sleep(LOOK_PERIOD)
    return True


def result_of(node: Node, future: Future, what: str) -> object:
    """
    Wait for the answer of a service.

    Raises
    ------
    RuntimeError
        If there is none; the text begins with `what`.
    """
    rclpy.spin_until_future_complete(node, future, timeout_sec=ANSWER_TIMEOUT)
    if not rclpy.ok():
        raise Terminated
    if not future.done():
        raise RuntimeError(f"{what}: no answer within {ANSWER_TIMEOUT:g} s")
    if future.exception() is not None:
        raise RuntimeError(f"{what}: {future.exception()}")
    return future.result()


# --- Nodes -------------------------------------------------------------------------------------


class NodeName(NamedTuple):
    """Name of a node that runs."""

    name: str
    namespace: str

    @property
    def full(self) -> str:
        """Namespace and name."""
        return f"{self.namespace.rstrip('/')}/{self.name}"


def absolute_name(name: str) -> str:
    """Return the name of a node with the leading slash that people leave out."""
    return name if name.startswith("/") else f"/{name}"


def split_name(name: str) -> NodeName:
    """Split the absolute name of a node."""
    namespace, _, base = name.rpartition("/")
    return NodeName(base, namespace or "/")


def node_names(node: Node, include_hidden: bool = False) -> list[NodeName]:
    """Return the nodes that are there."""
    return [
        NodeName(name, namespace)
        for name, namespace in node.get_node_names_and_namespaces()
        if include_hidden or not name.startswith(HIDDEN_NODE_PREFIX)
    ]


def add_remote_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of verbs that talk to one node."""
    add_graph_arguments(parser)
    parser.add_argument("node_name", help="Name of the node")
    parser.add_argument(
        "--include-hidden-nodes", action="store_true", help="Include those that begin with _"
    )
    parser.add_argument(
        "--timeout",
        metavar="N",
        type=int,
        default=1,
        help="Wait N seconds for the node to appear (default: %(default)s)",
    )


def wait_for_node(node: Node, args: argparse.Namespace) -> str | None:
    """Wait until the node ``args.node_name`` is there; return its absolute name, or None."""
    name = absolute_name(args.node_name)

    def there() -> bool:
        return name in (n.full for n in node_names(node, args.include_hidden_nodes))

    timeout = args.spin_time + args.timeout
    return name if wait_until(there, timeout) else None


# --- Topics and services -----------------------------------------------------------------------


def visible(names_and_types: NamesAndTypes, include_hidden: bool) -> NamesAndTypes:
    """Leave out the hidden names, unless told to keep them."""
    return [
        (name, types)
        for name, types in names_and_types
        if include_hidden or not topic_or_service_is_hidden(name)
    ]

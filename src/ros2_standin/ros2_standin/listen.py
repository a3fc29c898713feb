"""Listening to a topic: finding its type, and taking messages at any rate."""

from __future__ import annotations

import time
from typing import Any

import rclpy
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import ExternalShutdownException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.validate_full_topic_name import validate_full_topic_name

from ros2_standin.node import wait_until
from ros2_standin.types import message_class

#: For measuring: takes from any publisher, slows none down, and loses only if this process
#: stands still for a tenth of a second at 10 kHz.
MEASURING_QOS = QoSProfile(
    history=QoSHistoryPolicy.KEEP_LAST, depth=1000, reliability=QoSReliabilityPolicy.BEST_EFFORT
)


def topic_class(
    node: Node, topic: str, *, timeout: float, blocking: bool = False
) -> type[Any] | None:
    """
    Return the class of a topic's messages.

    Parameters
    ----------
    node : Node
    topic : str
        Name, absolute or relative.
    timeout : float
        Time to wait for someone who knows (s) before a warning is printed.
    blocking : bool
        Wait on after that for as long as it takes, rather than return None.

    Raises
    ------
    RuntimeError
        If the name is none, or the topic has several types, or one that is not installed.
    """
    try:
        name = expand_topic_name(topic, node.get_name(), node.get_namespace())
        validate_full_topic_name(name)
    except (ValueError, InvalidTopicNameException) as error:
        raise RuntimeError(str(error)) from None

    def types() -> list[str]:
        return dict(node.get_topic_names_and_types()).get(name, [])

    if not wait_until(lambda: bool(types()), timeout):
        print(f"WARNING: topic [{topic}] does not appear to be published yet")
        if not blocking:
            return None
        wait_until(lambda: bool(types()), float("inf"))
    found = types()
    if len(found) > 1:
        raise RuntimeError(
            f"Cannot echo topic '{topic}', as it contains more than one type: [{', '.join(found)}]"
        )
    return message_class(found[0], f"The message type '{found[0]}' is invalid")


class Spinner:
    """
    Serves a node's callbacks at 10 kHz and more, which the usual executors do not.

    Parameters
    ----------
    node : Node

    Notes
    -----
    ``EventsExecutor.spin()`` does not work in rclpy 7.1.6 (it calls nothing at full load);
    ``spin_once`` does.
    """

    def __init__(self, node: Node) -> None:
        self._executor = EventsExecutor()
        self._executor.add_node(node)

    def spin(self, seconds: float) -> None:
        """Serve callbacks for `seconds`."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)
            if not rclpy.ok():
                raise ExternalShutdownException

    def close(self) -> None:
        """Let go of the node."""
        self._executor.shutdown()

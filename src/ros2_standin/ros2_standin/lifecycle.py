"""The state services of managed nodes."""

from __future__ import annotations

import argparse
from typing import Any

from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rclpy.node import Node

from ros2_standin.node import (
    LOOK_TIME,
    SERVICE_TIMEOUT,
    absolute_name,
    add_graph_arguments,
    node_names,
    result_of,
    wait_until,
)


def add_managed_arguments(parser: argparse.ArgumentParser, *, optional: bool = False) -> None:
    """Add the arguments of verbs that talk to a managed node."""
    add_graph_arguments(parser)
    parser.add_argument(
        "node_name",
        nargs="?" if optional else None,
        help="Name of the node" + ("; all if not given" if optional else ""),
    )
    parser.add_argument(
        "--include-hidden-nodes", action="store_true", help="Include those that begin with _"
    )


def managed_nodes(node: Node, include_hidden: bool) -> list[str]:
    """Return the names of the managed nodes that are there, sorted."""
    services = dict(node.get_service_names_and_types())
    return sorted(
        {
            name.full
            for name in node_names(node, include_hidden)
            if "lifecycle_msgs/srv/GetState" in services.get(f"{name.full}/get_state", ())
        }
    )


def wait_for_managed_node(node: Node, args: argparse.Namespace) -> str | None:
    """Wait until ``args.node_name`` is there; return its absolute name, or None."""
    name = absolute_name(args.node_name)
    found = wait_until(
        lambda: name in managed_nodes(node, args.include_hidden_nodes), args.spin_time + LOOK_TIME
    )
    return name if found else None


def state(node: Node, name: str) -> Any:
    """Return the state of a node."""
    return _call(node, name, GetState, "get_state", GetState.Request()).current_state


def transitions(node: Node, name: str, service: str = "get_available_transitions") -> list[Any]:
    """Return the transitions of a node: those it can make now, or (transition graph) all."""
    kind = GetAvailableTransitions
    return list(_call(node, name, kind, service, kind.Request()).available_transitions)


def change(node: Node, name: str, transition: Any) -> bool:
    """Make a node do a transition; return whether it did."""
    request = ChangeState.Request(transition=transition)
    return bool(_call(node, name, ChangeState, "change_state", request).success)


def _call(node: Node, name: str, kind: Any, service: str, request: Any) -> Any:
    """Call one of the node's services."""
    client = node.create_client(kind, f"{name}/{service}")
    what = f"Exception while calling service of node '{name}'"
    if not wait_until(client.service_is_ready, SERVICE_TIMEOUT):
        raise RuntimeError(f"{what}: {service} is not there")
    return result_of(node, client.call_async(request), what)

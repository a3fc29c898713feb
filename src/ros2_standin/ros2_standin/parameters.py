"""The parameter services of another node."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterType, ParameterValue
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

from ros2_standin.node import SERVICE_TIMEOUT, result_of, wait_until

_ATTEMPTS = 4
_AGAIN_AFTER = 5.0  # s

TYPE_NAMES = {
    ParameterType.PARAMETER_BOOL: "boolean",
    ParameterType.PARAMETER_INTEGER: "integer",
    ParameterType.PARAMETER_DOUBLE: "double",
    ParameterType.PARAMETER_STRING: "string",
    ParameterType.PARAMETER_BYTE_ARRAY: "byte array",
    ParameterType.PARAMETER_BOOL_ARRAY: "boolean array",
    ParameterType.PARAMETER_INTEGER_ARRAY: "integer array",
    ParameterType.PARAMETER_DOUBLE_ARRAY: "double array",
    ParameterType.PARAMETER_STRING_ARRAY: "string array",
    ParameterType.PARAMETER_NOT_SET: "not set",
}


def python_value(value: ParameterValue) -> Any:
    """Return the value of a parameter as Python sees it."""
    result = parameter_value_to_python(value)
    return result.tolist() if hasattr(result, "tolist") else result


class RemoteParameters:
    """
    The parameters of another node.

    Parameters
    ----------
    node : Node
        The command's own node.
    name : str
        Absolute name of the other one.

    Raises
    ------
    RuntimeError
        If that node has no parameter services.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node = node
        self._name = name
        self._client = AsyncParameterClient(node, name)
        if not wait_until(self._client.services_are_ready, SERVICE_TIMEOUT):
            raise RuntimeError(
                f"Wait for service timed out waiting for parameter services for node {name}"
            )

    def names(self, prefixes: list[str] | None = None) -> list[str]:
        """Return the names of the parameters, sorted."""
        response = self._answer(lambda: self._client.list_parameters(prefixes=prefixes))
        return sorted(response.result.names)

    def get(self, names: list[str]) -> list[ParameterValue]:
        """Return values."""
        return list(self._answer(lambda: self._client.get_parameters(names)).values)

    def set(self, parameters: list[Any]) -> list[Any]:
        """Set values, and return the node's answer to each."""
        return list(self._answer(lambda: self._client.set_parameters(parameters)).results)

    def describe(self, names: list[str]) -> list[Any]:
        """Return descriptors."""
        return list(self._answer(lambda: self._client.describe_parameters(names)).descriptors)

    def _answer(self, ask: Callable[[], Future]) -> Any:
        """Ask, and again if no answer comes: a server loses those to a client not seen yet.

        All of these requests may be made twice.
        """
        what = f"Exception while calling service of node {self._name}"
        for _ in range(_ATTEMPTS - 1):
            future = ask()
            rclpy.spin_until_future_complete(self._node, future, timeout_sec=_AGAIN_AFTER)
            if future.done() or not rclpy.ok():
                break
        else:
            future = ask()
        return result_of(self._node, future, what)


def add_parameter_argument(parser: argparse.ArgumentParser) -> None:
    """Add the name of the parameter."""
    parser.add_argument("parameter_name", help="Name of the parameter")

"""What somebody outside sees of a running drive, and sets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from harness import PATIENCE, until
from mfpcc_msgs.msg import DriveState, DriveStatus, LutDiagnostics, PhaseFeedback
from rcl_interfaces.msg import ParameterType, SetParametersResult
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

#: A reader that is overrun must not be one that asks for what it missed: with late samples Fast
#: DDS 2.14 loses the memory they were to be put into, and a reader without any left takes nothing
#: for ever (see `pwm_node.ros.loop_topics`).
_LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class Outside:
    """A node of another process: listens to a drive, and sets its parameters.

    Attributes
    ----------
    period : int
        Period of the last sample seen, -1 before the first.
    sample : PhaseFeedback, optional
        That sample.
    state : DriveState, optional
        The last one seen.
    gates : list of (int, bool)
        Period, and whether the gates were on, of the drive states seen.
    scheme : str
        Who controls, by the last `lut_diagnostics` seen.
    status : dict of DriveStatus
        The latest of each node.
    """

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context)
        self.node = Node("outside", context=self.context)
        self.period = -1
        self.sample: PhaseFeedback | None = None
        self.state: DriveState | None = None
        self.gates: list[tuple[int, bool]] = []
        self.scheme = ""
        self.status: dict[str, DriveStatus] = {}
        self._parts: dict[str, dict[str, str]] = {}
        self._levels: dict[str, int] = {}
        subscribe = self.node.create_subscription
        subscribe(PhaseFeedback, "phase_feedback", self._on_feedback, _LATEST)
        subscribe(DriveState, "drive_state", self._on_state, _LATEST)
        subscribe(LutDiagnostics, "lut_diagnostics", self._on_lut, _LATEST)
        subscribe(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        latest = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        subscribe(DriveStatus, "drive_status", self._on_status, latest)
        self._clients: dict[str, AsyncParameterClient] = {}
        self._services: dict[str, Any] = {}
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def _on_feedback(self, message: PhaseFeedback) -> None:
        self.sample, self.period = message, message.period

    def _on_state(self, message: DriveState) -> None:
        self.state = message
        self.gates.append((message.period, message.gates_on))

    def _on_status(self, message: DriveStatus) -> None:
        self.status[message.node] = message

    def codes(self, node: str) -> list[str]:
        """Faults that a node has latched."""
        return [fault.code for fault in self.status[node].faults] if node in self.status else []

    def enabled(self, node: str) -> bool:
        """Whether a node says that its gates are on."""
        return node in self.status and self.status[node].enabled

    def _on_lut(self, message: LutDiagnostics) -> None:
        self.scheme = message.scheme

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for part in message.status:
            self._parts[part.name] = {item.key: item.value for item in part.values}
            self._levels[part.name] = part.level[0]

    def look(self) -> None:
        """Take in what came; returns after 20 ms if nothing does."""
        self.executor.spin_once(timeout_sec=0.02)

    def diagnostic(self, part: str, key: str) -> float:
        """A value of the latest `/diagnostics`, NaN before the first."""
        return float(self._parts.get(part, {}).get(key, "nan"))

    def level(self, part: str) -> int:
        """Level of a part of the latest `/diagnostics`, -1 before the first."""
        return self._levels.get(part, -1)

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Look until a condition holds."""

        def holds() -> bool:
            self.look()
            return condition()

        until(holds, what)

    def until_beyond(self, period: int, what: str) -> None:
        """Wait for a sample after a period."""
        self.until(lambda: self.period > period, what)

    def set(self, node: str, **values: Any) -> list[SetParametersResult]:
        """Set parameters of a node (a dot in a name is written as two underscores)."""
        parameters = [
            Parameter(name.replace("__", "."), value=value) for name, value in values.items()
        ]
        return self._answer(self._client(node).set_parameters(parameters)).results

    def ask(self, service: str, kind: Any, request: Any) -> Any:
        """Call a service, given its whole name and its type, and return the response."""
        if service not in self._services:
            self._services[service] = self.node.create_client(kind, service)
        client = self._services[service]
        assert client.wait_for_service(PATIENCE), f"{service} is not there"
        answers: list[Any] = []

        def answered() -> bool:
            # what a server answers before it has seen the client is lost
            future = client.call_async(request)
            self.executor.spin_until_future_complete(future, timeout_sec=5.0)
            if future.done():
                answers.append(future.result())
            return bool(answers)

        until(answered, f"{service} answers")
        return answers[0]

    def call(self, node: str, service: str) -> Trigger.Response:
        """Call one of a node's services without arguments."""
        client = self.node.create_client(Trigger, f"/{node}/{service}")
        answers: list[Trigger.Response] = []

        def answered() -> bool:
            # a server that was killed is seen for a while, and takes requests to its grave
            future = client.call_async(Trigger.Request())
            self.executor.spin_until_future_complete(future, timeout_sec=2.0)
            if future.done():
                answers.append(future.result())
            return bool(answers)

        until(answered, f"/{node}/{service} answers")
        self.node.destroy_client(client)
        return answers[0]

    def get(self, node: str, name: str) -> Any:
        """Value of a parameter of a node."""
        values = self._answer(self._client(node).get_parameters([name])).values
        assert values[0].type != ParameterType.PARAMETER_NOT_SET, name
        return parameter_value_to_python(values[0])

    def _client(self, node: str) -> AsyncParameterClient:
        if node not in self._clients:
            self._clients[node] = AsyncParameterClient(self.node, node)
            assert self._clients[node].wait_for_services(PATIENCE), f"/{node} is not there"
        return self._clients[node]

    def _answer(self, future: Any) -> Any:
        self.executor.spin_until_future_complete(future, timeout_sec=PATIENCE)
        assert future.done(), f"no answer within {PATIENCE:.0f} s"
        return future.result()

    def close(self) -> None:
        """Leave the graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

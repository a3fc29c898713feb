"""Safe stops and latched faults of a node: its services, and one log line per fault.

The names are those of IEC 61800-5-2, in function only: a simulation carries no safety rating.
"""

from __future__ import annotations

from typing import Any, Protocol

from rclpy.node import Node
from std_srvs.srv import Trigger

#: A latched fault: code, period of its first occurrence, what was seen.
Fault = tuple[str, int, str]


class Guarded(Protocol):
    """A core that can be stopped and that latches faults."""

    @property
    def tripped(self) -> bool:
        """Whether the gates are off until `clear_faults`."""

    def stop(self) -> None:
        """Safe torque off."""

    def slow_down(self) -> None:
        """Safe stop 1, or what comes nearest to it."""

    def faults(self) -> list[Fault]:
        """Latched faults, oldest first."""

    def clear_faults(self) -> list[str]:
        """Forget the faults, or return the codes of those whose cause lasts."""


class Stops:
    """The services `~/sto`, `~/ss1` and `~/clear_faults` of a node.

    Parameters
    ----------
    node : Node
        It has the core, which may be replaced at any time, in `core`; `tell_status()`, which is
        called after each request; and the list `latched`, to which each new fault is added.
    returns_after : str
        What brings the power back after the faults were cleared, for people.
    """

    def __init__(self, node: Any, returns_after: str) -> None:
        self._node = node
        self._returns_after = returns_after
        self._known: set[tuple[str, int]] = set()
        self._services = [
            node.create_service(Trigger, f"~/{name}", answer)
            for name, answer in (
                ("sto", self._stop),
                ("ss1", self._slow_down),
                ("clear_faults", self._clear),
            )
        ]

    @property
    def _core(self) -> Guarded:
        return self._node.core  # type: ignore[no-any-return]

    def destroy(self) -> None:
        """Remove the services."""
        node: Node = self._node
        for service in self._services:
            node.destroy_service(service)

    def log(self) -> None:
        """Say what is new among the latched faults: one line each."""
        faults = self._core.faults()
        for code, period, detail in faults:
            if (code, period) not in self._known:
                self._node.latched.append((code, period, detail))
                then = self._consequence()
                self._node.get_logger().error(f"{code} in period {period}: {detail}; {then}")
        self._known = {(code, period) for code, period, _ in faults}

    def _consequence(self) -> str:
        if not self._core.tripped:
            return "it goes on"
        name = self._node.get_fully_qualified_name()
        return f"gates off until 'ros2 service call {name}/clear_faults std_srvs/srv/Trigger'"

    def _stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._core.stop()
        return self._answer(response, True, "gates off (STO)")

    def _slow_down(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._core.slow_down()
        text = "gates off (STO)" if self._core.tripped else "ramping down (SS1)"
        return self._answer(response, True, text)

    def _clear(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        lasting = self._core.clear_faults()
        if lasting:
            text = f"refused: the cause lasts of {', '.join(lasting)}"
            return self._answer(response, False, text)
        return self._answer(response, True, f"cleared; power returns after {self._returns_after}")

    def _answer(self, response: Trigger.Response, done: bool, text: str) -> Trigger.Response:
        self._node.get_logger().info(text)
        self._node.tell_status()
        response.success, response.message = done, text
        return response

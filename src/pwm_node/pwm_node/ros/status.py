"""`drive_status` of a node: its state and its latched faults, published when they change."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from pwm_node import stamps
from pwm_node.ros.stops import Fault

#: Who comes later gets the state that is, not those that were.
STATUS_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class StatusPublisher:
    """
    Publishes `drive_status`.

    Parameters
    ----------
    node : Node
        The node it speaks for.
    status, fault : type
        Classes of the message and of the faults in it.
    """

    def __init__(self, node: Node, status: type[Any], fault: type[Any]) -> None:
        self._node = node
        self._status, self._fault = status, fault
        self._publisher = node.create_publisher(status, "drive_status", STATUS_QOS)
        self._published: tuple[Any, ...] = ()

    def tell(
        self,
        *,
        state: str,
        enabled: bool,
        faults: list[Fault],
        period: int,
        pwm_frequency: float,
        scheme: str = "",
    ) -> bool:
        """
        Publish what is, if it is something new.

        Parameters
        ----------
        state : str
            ready, running, stopping or tripped.
        enabled : bool
            Whether the gates may be on.
        faults : list of Fault
            Latched faults, oldest first.
        period : int
            The period in which it is so; before the first, any negative number.
        pwm_frequency : float
            PWM frequency (Hz), for the stamps.
        scheme : str
            The scheme in control, where there is one.

        Returns
        -------
        bool
            Whether it was published.
        """
        now = (state, enabled, scheme, faults)
        if now == self._published:
            return False
        self._published = now
        status = self._status(
            period=max(period, 0),
            node=self._node.get_name(),
            state=state,
            enabled=enabled,
            scheme=scheme,
            faults=[
                _stamped(self._fault(code=code, detail=detail, period=at), at, pwm_frequency)
                for code, at, detail in faults
            ],
        )
        self._publisher.publish(_stamped(status, status.period, pwm_frequency))
        return True

    def destroy(self) -> None:
        """Take the publisher down, so that nobody who comes later gets its last word."""
        self._node.destroy_publisher(self._publisher)


def _stamped(message: Any, period: int, pwm_frequency: float) -> Any:
    """Give a message the simulated time at which its period begins, or the last that it can hold.

    Period numbers come from others, and a wrong one is no reason to say nothing.
    """
    period = min(period, int(stamps.LAST_SECOND * pwm_frequency))
    message.stamp.sec, message.stamp.nanosec = stamps.begin(period, pwm_frequency)
    return message

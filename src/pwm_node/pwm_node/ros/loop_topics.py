"""Publishers and subscriptions of the messages that travel every period.

They carry serialized messages (see `pwm_node.wire`), reliably. In lock-step, publishers keep all
that somebody has not got yet, so that a recorder loses nothing: one that is slow slows the loop
down instead. By the wall clock there is no waiting: who is slow loses messages.

A subscriber may take nothing any more, for ever. In Fast DDS 2.14, a reliable one that keeps the
last few messages loses memory with each message that comes late, after a newer one, and there are
5000 places: who looks on at full speed with such a subscription on a busy machine has used them up
in seconds. (`DataReaderHistory::received_change_keep_last` says of such a message that it was
received and keeps nothing of it, and so nobody gives its place back.) Nobody who only looks on may
end a drive, so a publisher that has waited in vain goes on without waiting. On the side of the
subscriber, best effort or "keep all" avoids it.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import QoSPublisherEventType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

PUBLISH = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
# By the wall clock, nobody is waited for: who is slow may lag behind by half a second at 10 kHz.
# The promise of a sign of life tells others that this one goes on by itself. Of what can be seen of
# an endpoint's QoS from outside, it is what costs nothing with each message.
PUBLISH_PACED = QoSProfile(
    depth=5000,
    reliability=ReliabilityPolicy.RELIABLE,
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=Duration(seconds=20.0),
)
_NO_LEASE = 1 << 62  # ns: beyond it, there is none
SUBSCRIBE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)

# The executor is served at this interval (s) while the loop runs. Messages that follow each other
# faster are looked for: so many of them, since a few may come together after a delay.
SERVE_EVERY = 0.004
_FAST_IN_A_ROW = 10

# An executor may have a message to deliver from before, and does not hold what it refers to.
_REMOVED: deque[Any] = deque(maxlen=16)

# A subscriber that was killed holds a publisher up until the middleware declares it dead (20 s).
_PATIENCE = 30.0  # s
_FLUSH = 4.0  # s


class LoopPublisher:
    """Publisher of one message per period.

    Parameters
    ----------
    node : Node
        The node that publishes.
    msg_class : type
        Message class.
    topic : str
        Topic name, relative.
    stopping : callable
        Tells whether the node is about to end: nobody is waited for then.
    """

    def __init__(
        self, node: Node, msg_class: Any, topic: str, *, stopping: Callable[[], bool]
    ) -> None:
        self._node = node
        self._stopping = stopping
        self._msg_class = msg_class
        self._name = topic
        self._matches = 0
        self._sent_at_match: int | None = None  # None: nothing was sent yet
        self._settled_match = 0
        self._known: set[bytes] = set()
        self._profile = PUBLISH
        self._successor: Publisher | None = None
        self._create()

    @property
    def waits(self) -> bool:
        """Whether it waits for subscribers that are slow; when that changes, `settle` sees to it.

        The publisher of the other kind takes over when all know of it, so that nothing is lost.
        """
        return self._profile is PUBLISH

    @waits.setter
    def waits(self, wait: bool) -> None:
        if wait == self.waits:
            return
        self._profile = PUBLISH if wait else PUBLISH_PACED
        if self._successor is not None:
            self._node.destroy_publisher(self._successor)
            self._successor = None
        elif self._sent_at_match is None:
            self.destroy()
            self._create()
        else:
            self._successor = self._new_publisher()

    def _new_publisher(self) -> Publisher:
        return self._node.create_publisher(self._msg_class, self._name, self._profile)

    def _create(self) -> None:
        self._use(self._new_publisher())

    def _use(self, publisher: Publisher) -> None:
        self._total = 0
        self._publisher = publisher
        # Looked at now and then, and no business of the executor. That one must not have an event
        # of a publisher that goes: it raises InvalidHandle, or the process crashes, since rclpy
        # 7.1.6 then gives up the last hold on a Python object without the interpreter's lock.
        self._matched = rclpy_implementation.EventHandle(
            self._publisher.handle, QoSPublisherEventType.RCL_PUBLISHER_MATCHED
        )
        self.topic: str = self._publisher.topic_name
        # The method around it would cost as much again as the publishing itself.
        self._publish_raw = self._publisher.handle.publish_raw

    @property
    def listeners(self) -> int:
        """Number of subscribers that are matched, and so get what is published."""
        count: int = self._publisher.get_subscription_count()
        return count

    def copy_to(self, sink: Callable[[bytes], None]) -> None:
        """Hand each message that is published to `sink` too: the in-line recording."""
        publish = self.publish

        def publish_and_copy(data: bytes) -> None:
            publish(data)
            sink(data)

        self.publish = publish_and_copy  # type: ignore[method-assign]

    def publish_aside(self, data: bytes) -> None:
        """Publish what no in-line recording shall have: a repetition, or the stop after the end."""
        LoopPublisher.publish(self, data)

    def publish(self, data: bytes) -> None:
        """Publish a serialized message."""
        self._sent_at_match = self._matches
        try:
            self._publish_raw(data)
        except rclpy_implementation.RCLError:
            self._publish_patiently(data)

    @property
    def new_listener(self) -> bool:
        """True if a subscriber came since the last message was sent, and so has not got it.

        As `settle` last saw it.
        """
        return self._sent_at_match is not None and self._matches != self._sent_at_match

    def settle(self) -> None:
        """Take notice of subscribers that came; called now and then, off the per-period path.

        Within one process, Fast DDS 2.14 may never deliver to a subscriber that comes when the
        publisher's history is full of messages that others have got (5000 of them): unless
        something is published within 70 ms, it waits for those, and publishing fails after the
        next 5000. In another process it gets on well. So for a newcomer in this process a
        publisher that was used begins anew, with an empty history.
        """
        if self._successor is not None:
            if self._successor.get_subscription_count() < self.listeners:
                return
            successor, self._successor = self._successor, None
            self.destroy()
            self._use(successor)
            # whoever listens now knew of both
            self._total = self._matched.take_event().total_count
            return
        total = self._matched.take_event().total_count
        if total > self._total:
            self._total = total
            self._matches += 1
        if self._settled_match == self._matches:
            return
        self._settled_match = self._matches
        here, elsewhere = self._subscribers()
        newcomers = here - self._known
        self._known = here
        if newcomers and self._sent_at_match is not None:
            if elsewhere:
                self.flush(_FLUSH)
            self.destroy()
            self._create()

    def flush(self, seconds: float) -> bool:
        """Wait until each subscriber has got all; return whether that is so.

        Subscribers in other processes may say so every 3 s only, so this is for the end of a run.
        """
        return bool(self._publisher.wait_for_all_acked(Duration(seconds=seconds)))

    def destroy(self) -> None:
        """Remove the publisher from its node."""
        if self._successor is not None:
            self._node.destroy_publisher(self._successor)
            self._successor = None
        self._matched.destroy_when_not_in_use()
        self._node.destroy_publisher(self._publisher)

    def _subscribers(self) -> tuple[set[bytes], set[bytes]]:
        """Return the identifiers of the subscribers in this process, and of those elsewhere."""
        # The first 8 bytes of a Fast DDS identifier name vendor, host and process.
        node = (self._node.get_name(), self._node.get_namespace())
        own = {
            bytes(info.endpoint_gid)[:8]
            for info in self._node.get_publishers_info_by_topic(self.topic)
            if (info.node_name, info.node_namespace) == node
        }
        gids = {
            bytes(info.endpoint_gid)
            for info in self._node.get_subscriptions_info_by_topic(self.topic)
        }
        here = {gid for gid in gids if gid[:8] in own}
        return here, gids - here

    def _publish_patiently(self, data: bytes) -> None:
        """Publish where it just failed since somebody takes nothing; each attempt lasts 0.1 s."""
        began = time.monotonic()
        reported = False
        while self._node.context.ok() and not self._stopping():
            try:
                self._publish_raw(data)
            except rclpy_implementation.RCLError:
                pass  # still no room
            else:
                if reported:
                    self._node.get_logger().info(f"{self.topic}: goes on")
                return
            waited = time.monotonic() - began
            if waited > _PATIENCE:
                self.destroy()
                self._profile = PUBLISH_PACED
                self._create()
                self._publish_raw(data)
                self._node.get_logger().error(
                    f"{self.topic}: a subscriber has taken nothing for {waited:.0f} s, and nobody "
                    "is waited for on this topic any more: who is slow loses messages from now on "
                    f"(stop it: 'ros2 topic info -v {self.topic}' names it)"
                )
                return
            if waited > 1.0 and not reported:
                reported = True
                self._node.get_logger().warning(
                    f"{self.topic}: a subscriber takes no more messages; waiting for it, since "
                    "nothing may be lost (one that was killed is given up after 20 s)"
                )


class LoopSubscription:
    """Subscription of one message per period.

    Parameters
    ----------
    node : Node
        The node that subscribes.
    msg_class : type
        Message class.
    topic : str
        Topic name, relative.
    callback : callable
        Gets each serialized message.
    start : str
        What a user types to start who publishes it.

    Attributes
    ----------
    direct : bool
        Whether messages are taken off the executor, by who spins.
    lively : bool
        Whether they follow each other so fast that it is better to look for the next one than to
        sleep. Set here when that begins, and taken back by who looks in vain.
    """

    def __init__(
        self,
        node: Node,
        msg_class: Any,
        topic: str,
        callback: Callable[[bytes], None],
        start: str,
    ) -> None:
        self._node = node
        self.msg_class = msg_class
        self.callback = callback
        self.start = start
        self.name = topic
        self.subscription = node.create_subscription(
            msg_class, topic, self._serve, SUBSCRIBE, raw=True
        )
        self.topic: str = self.subscription.topic_name
        # Taken without an executor: ``take(msg_class, True)`` returns (bytes, info) or None.
        self.take: Callable[[Any, bool], Any] = self.subscription.handle.take_message
        self.direct = False
        self.lively = False
        self._served_at = -math.inf
        self._fast = 0

    def _serve(self, data: bytes) -> None:
        """Handle a message that the executor has taken."""
        now = time.monotonic()
        self._fast = self._fast + 1 if 0.0 <= now - self._served_at < SERVE_EVERY else 0
        self.lively |= self._fast >= _FAST_IN_A_ROW
        self._served_at = max(now, self._served_at)
        self.callback(data)

    def look(self) -> None:
        """Handle a message that has come, if there is one."""
        message = self.take(self.msg_class, True)
        if message is not None:
            self.callback(message[0])

    def sleep(self, until: float) -> None:
        """Leave the next messages to the executor, and those that come before a time (s)."""
        self.lively = False
        self._fast = 0
        self._served_at = until

    def destroy(self) -> None:
        """Remove the subscription from its node; what has come and was not handled is dropped."""
        self.callback = self.subscription.callback = _drop
        self._node.destroy_subscription(self.subscription)
        _REMOVED.append(self.subscription)


def goes_by_itself(node: Node, topic: str) -> bool:
    """Whether somebody publishes a topic who waits for nobody: one that is paced, or unreliable."""
    return any(
        info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
        or 0 < info.qos_profile.liveliness_lease_duration.nanoseconds < _NO_LEASE
        for info in node.get_publishers_info_by_topic(topic)
    )


def _drop(data: bytes) -> None:
    """Take a message for which it is too late."""

"""A managed node at PWM rate: parameters from a table, life cycle, a watch, diagnostics.

All here happens off the per-period path. On it, a subclass takes a message, calls its core and
publishes; it counts in `period`, so that the watch can see that the loop goes on.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.task import Future

from pwm_node.parameters import Parameter, Table
from pwm_node.process import real_time, shared_memory
from pwm_node.ros import guard, only_one
from pwm_node.ros.diagnostics import Level, Part, StepTimes
from pwm_node.ros.loop_topics import LoopPublisher, LoopSubscription
from pwm_node.ros.pace import Pace
from pwm_node.ros.table_node import CHANGES_KEPT, TableNode

AUTOSTART = Parameter(
    "autostart",
    True,
    "Whether the node configures and activates itself when it starts",
    read_only=True,
)

#: What every node has besides its own parameters.
EVERY_NODE = (AUTOSTART, *real_time.PARAMETERS)

_WATCH_PERIOD = 0.05  # s
_STALL_STEP = 0.5  # s
_SILENT_AFTER = 4.0  # s: reported well within 5
_FLUSH = 4.0  # s: subscribers in other processes confirm every 3 s


class PwmNode(TableNode):
    """Base of the nodes on the loop.

    Subclasses override `configure`, `activate`, `deactivate` and `cleanup`, which may raise to
    refuse; `on_stall`; and `diagnostics`.

    Parameters
    ----------
    name : str
        Name of the node.
    table : Table
        Its parameters. If it has a `schedule`, it has a `pwm_frequency` too.
    also_known : iterable of str
        Names of parameters that may be set at start although they are another node's: those of a
        node in the same process, which shares the command line.
    **options
        Passed to `LifecycleNode`: context, namespace, parameter_overrides, ...

    Attributes
    ----------
    active : bool
        True between activation and deactivation.
    stopping : bool
        True once the process was asked to end.
    late : bool
        True while requests are served that have waited for too long, since more is asked than can
        be served beside the loop. Who spins the node sees to it; parameters are not set then.
    awaited : LoopSubscription, optional
        The message that lets the loop go on: the first loop subscription, unless set otherwise.
        None while nothing is due, after the end of a run for instance.
    latched : deque of (str, int, str)
        The latest faults since the start, cleared ones too: code, period, what was seen.
    missed_periods, lost_periods : int
        Totals for the diagnostics; the subclass counts.
    paces : list of Pace
        Those whose ticks who spins the node looks for; the subclass adds.
    finished : Future
        Done when the node has done what it was there for, which ends the run.
    step_times : StepTimes
        Durations of steps for the diagnostics; the subclass adds.
    tap : callable, optional
        Given a loop topic, returns what is handed each message that is published on it: the
        in-line recording. To be set before the node is configured.
    """

    tap: Callable[[str], Callable[[bytes], None]] | None = None
    hardware_id = ""
    late = False  # asked for by services that there are before the rest of the node

    def __init__(
        self, name: str, table: Table, *, also_known: Iterable[str] = (), **options: Any
    ) -> None:
        super().__init__(name, **options)
        for service in self.services:
            if service.srv_type.__module__.startswith("lifecycle_msgs."):
                # rclpy makes these in a way of its own
                service.callback = guard.service(
                    service.callback, service.srv_type, service.srv_name, self.get_logger()
                )
        self._claim: int | None = None
        self.active = False
        self.stopping = False
        self.finished = Future()
        self.awaited: LoopSubscription | None = None
        self.latched: deque[tuple[str, int, str]] = deque(maxlen=CHANGES_KEPT)
        self.missed_periods = 0
        self.lost_periods = 0
        self.step_times = StepTimes()
        self.loop_publishers: list[LoopPublisher] = []
        self.loop_subscriptions: list[LoopSubscription] = []
        self.paces: list[Pace] = []
        self._paced = False
        try:
            self._claim = only_one.claim(
                self.get_fully_qualified_name(), self.context.get_domain_id()
            )
            own = [each for each in EVERY_NODE if each.name not in table]
            self.declare(table.extended(*own), also_known)
            real_time.apply(self.values)
        except ValueError:
            self.destroy_node()
            raise

        self._seen_period = self.period
        self._progress_at = time.monotonic()
        self._next_stall = _STALL_STEP
        self._reported: LoopSubscription | None = None
        self._diagnosed_at = self._progress_at
        self._diagnosed_period = self.period
        self._diagnosed_faults = 0
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(_WATCH_PERIOD, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))

    # Off the loop ---------------------------------------------------------------------------

    def create_service(  # type: ignore[override]
        self, srv_type: Any, srv_name: str, callback: guard.Service, **options: Any
    ) -> Any:
        """Create a service; a request that its callback raises at is refused."""
        guarded = guard.service(callback, srv_type, srv_name, self.get_logger())
        guarded = guard.in_time(guarded, srv_type, late=lambda: self.late)
        return super().create_service(srv_type, srv_name, guarded, **options)

    def create_subscription(  # type: ignore[override]
        self, msg_type: Any, topic: str, callback: Callable[..., None], *rest: Any, **options: Any
    ) -> Any:
        """Create a subscription; a message that its callback raises at is dropped.

        Those of the loop, which are `raw`, are not guarded: a period that cannot be handled ends
        the run, with the gates off.
        """
        if not options.get("raw"):
            callback = guard.callback(callback, f"{topic}: message dropped", self.get_logger())
        return super().create_subscription(msg_type, topic, callback, *rest, **options)

    # Topics of the loop ---------------------------------------------------------------------

    def create_loop_publisher(self, msg_class: Any, topic: str) -> LoopPublisher:
        """Create a publisher of serialized messages at PWM rate; `cleanup` removes it."""
        publisher = LoopPublisher(self, msg_class, topic, stopping=lambda: self.stopping)
        if self.tap is not None:
            publisher.copy_to(self.tap(topic))
        self.loop_publishers.append(publisher)
        return publisher

    def create_loop_subscription(
        self, msg_class: Any, topic: str, callback: Callable[[bytes], None], *, start: str
    ) -> LoopSubscription:
        """Create a subscription of serialized messages at PWM rate; `cleanup` removes it.

        Parameters
        ----------
        msg_class : type
            Message class.
        topic : str
            Topic name, relative.
        callback : callable
            Gets each serialized message.
        start : str
            What a user types to start who publishes it, for the report that it is silent.
        """
        subscription = LoopSubscription(self, msg_class, topic, callback, start)
        self.loop_subscriptions.append(subscription)
        if self.awaited is None:
            self.awaited = subscription
        return subscription

    @property
    def paced(self) -> bool:
        """Whether periods follow the wall clock: then nobody is waited for who only listens."""
        return self._paced

    @paced.setter
    def paced(self, paced: bool) -> None:
        self._paced = paced
        for publisher in self.loop_publishers:
            publisher.waits = not paced

    @property
    def subscriptions(self) -> Iterator[Any]:
        """The subscriptions an executor shall serve: not those that are taken directly."""
        direct = [loop.subscription for loop in self.loop_subscriptions if loop.direct]
        return (each for each in super().subscriptions if each not in direct)

    def _destroy_loop_topics(self) -> None:
        for publisher in self.loop_publishers:
            publisher.destroy()
        for subscription in self.loop_subscriptions:
            subscription.destroy()
        self.loop_publishers.clear()
        self.loop_subscriptions.clear()
        self.awaited = None

    # Life cycle -----------------------------------------------------------------------------

    def configure(self) -> None:
        """Get ready: make the core and the topics. Raise to refuse."""

    def activate(self) -> None:
        """Begin. Raise to refuse."""

    def deactivate(self) -> None:
        """Come to a safe rest."""

    def cleanup(self) -> None:
        """Give back what `configure` made; the topics of the loop are removed afterwards."""

    def finish(self) -> None:
        """End the run of this process: what the node was there for is done."""
        if not self.finished.done():
            self.finished.set_result(None)

    def stop(self) -> None:
        """Come to a safe rest before the process ends."""
        self.stopping = True
        if self.active and self.context.ok():
            try:
                self.trigger_deactivate()
            except rclpy_implementation.RCLError:
                # it was stopped on its way to being active, where there is no way back by ROS
                self._transition("deactivate", self.deactivate)
                self.active = False
        deadline = time.monotonic() + _FLUSH
        for publisher in self.loop_publishers:
            if self.context.ok():
                publisher.flush(max(0.0, deadline - time.monotonic()))

    def destroy_node(self) -> None:
        """Remove the node and all that it made."""
        self.active = False
        self._destroy_loop_topics()
        super().destroy_node()
        if self._claim is not None:
            os.close(self._claim)
            self._claim = None

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `configure` in the transition of the same name."""
        result = self._transition("configure", self.configure)
        if result != TransitionCallbackReturn.SUCCESS:
            self._destroy_loop_topics()
            return result
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `activate` in the transition of the same name."""
        self._progress_at = time.monotonic()
        self.active = True
        result = self._transition("activate", self.activate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        return super().on_activate(state) if self.active else result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `deactivate` in the transition of the same name."""
        result = self._transition("deactivate", self.deactivate)
        self.active = False
        return super().on_deactivate(state) if result else result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `cleanup` in the transition of the same name."""
        result = self._transition("clean up", self.cleanup)
        self._destroy_loop_topics()
        return super().on_cleanup(state) if result else result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Come to a safe rest first, if it was active."""
        if self.active:
            self._transition("deactivate", self.deactivate)
            self.active = False
        return super().on_shutdown(state)

    def _transition(self, name: str, hook: Callable[[], None]) -> TransitionCallbackReturn:
        # rclpy drops what a transition raises without a word, so it is said here.
        try:
            hook()
        except Exception as error:  # noqa: BLE001 (whatever it is, it must be said)
            if not self.stopping:
                self.get_logger().error(f"cannot {name}: {guard.describe(error)}")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    # Watch ----------------------------------------------------------------------------------

    def on_stall(self, seconds: float) -> None:
        """Get the loop going again; called every 0.5 s while `period` does not change.

        A message that was sent before its receiver was there is lost, so a node sends its last
        message again; receivers know it by its period. If a new subscriber came since that
        message was sent, this is called at once.
        """

    def _watch(self) -> None:
        for publisher in self.loop_publishers:
            publisher.settle()
        now = time.monotonic()
        stalled = now - self._progress_at
        if self.period != self._seen_period or not self.active or self.awaited is None:
            if self._reported is not None and self.active:
                self.get_logger().info(f"{self._reported.topic}: goes on after {stalled:.1f} s")
            self._reported = None
            self._seen_period = self.period
            self._progress_at = now
            self._next_stall = _STALL_STEP
        else:
            if stalled >= _SILENT_AFTER and self._reported is None:
                self._reported = self.awaited
                self.get_logger().warning(self._silence(self.awaited, stalled))
            if stalled >= self._next_stall or any(p.new_listener for p in self.loop_publishers):
                self._next_stall = stalled + _STALL_STEP
                self.on_stall(stalled)
        if now - self._diagnosed_at >= 1.0:
            guard.callback(self._publish_diagnostics, "/diagnostics", self.get_logger())(now)

    def _silence(self, awaited: LoopSubscription, seconds: float) -> str:
        if self.count_publishers(awaited.topic):
            # One that was killed counts as there for 20 s.
            why = f"who publishes it is silent; if it has died, start it with '{awaited.start}'"
            others = shared_memory.strangers()
            if others:
                why += (
                    f"; if it is one of user {', '.join(others)}, who has nodes here: those of "
                    "different users cannot read each other's shared memory, so start both as one"
                )
        else:
            why = f"nobody publishes it; start it with '{awaited.start}'"
        return f"{awaited.topic}: nothing came for {seconds:.0f} s, waiting: {why}"

    # Diagnostics ----------------------------------------------------------------------------

    def diagnostics(self) -> Iterable[Part]:
        """Return what else there is to tell on ``/diagnostics``; called once a second."""
        return ()

    def _publish_diagnostics(self, now: float) -> None:
        rate = (self.period - self._diagnosed_period) / (now - self._diagnosed_at)
        self._diagnosed_at, self._diagnosed_period = now, self.period
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        name = self.get_fully_qualified_name().lstrip("/")
        message.status = [
            DiagnosticStatus(
                level=bytes([part.level]),
                name=f"{name}: {part.name}",
                message=part.message,
                hardware_id=self.hardware_id or name,
                values=[KeyValue(key=key, value=_text(v)) for key, v in part.values.items()],
            )
            for part in (self._loop_part(rate), *self.diagnostics())
        ]
        self._diagnostics.publish(message)

    def _loop_part(self, rate: float) -> Part:
        median, p99, longest = self.step_times.percentiles(50, 99, 100)
        faults = self.missed_periods + self.lost_periods
        new_faults, self._diagnosed_faults = faults - self._diagnosed_faults, faults
        level, text = Level.OK, "running"
        if not self.active:
            text = "inactive"
        elif self._reported is not None:
            level, text = Level.ERROR, f"{self._reported.topic} is silent"
        elif new_faults > 0:
            level, text = Level.WARN, f"{new_faults} periods missed or lost in the last second"
        elif self.awaited is None:
            text = "nothing to do"
        elif rate == 0.0:
            level, text = Level.WARN, f"waiting for {self.awaited.topic}"
        return Part(
            "loop",
            text,
            level,
            {
                "period": self.period,
                "loop rate (Hz)": rate,
                "missed periods": self.missed_periods,
                "lost periods": self.lost_periods,
                "step time median (us)": median,
                "step time 99 % (us)": p99,
                "step time maximum (us)": longest,
            },
        )


def _text(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)

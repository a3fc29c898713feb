"""Running nodes at PWM rate, in one process, from start to a clean stop.

rclpy's `EventsExecutor` serves them: it takes 1 to 2 us per event, where the others take 80 to 200.
Messages of the loop do without it while it runs (see `pwm_node.ros.look`). The executor, with its
parameters, services and timers, is then served every few milliseconds.
"""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from rclpy.task import Future
from rclpy.utilities import get_default_context

from pwm_node import interrupts
from pwm_node.process.garbage import NoGarbageCollector
from pwm_node.ros import ros_environment
from pwm_node.ros.guard import describe
from pwm_node.ros.look import Look
from pwm_node.ros.loop_topics import SERVE_EVERY, LoopSubscription
from pwm_node.ros.node import AUTOSTART, PwmNode

_SERVED_AT_ONCE = 100  # callbacks: far more than are ever due
# Of the loop's time, what others may take who ask for more than that, as a storm of parameters
# does; what is left waits for the next turn, and so long (s) before nodes refuse what they can.
_SHARE = 0.1
_LATE = 0.5


class _Stop:
    """Whether the process was asked to end."""

    def __init__(self, nodes: Sequence[Node]) -> None:
        self.requested = False
        self.starting = False
        self._nodes = nodes

    def request(self) -> None:
        # In a signal handler nothing may wait for a lock, so no Future here. The spin loop looks.
        self.requested = True
        for node in self._nodes:
            if isinstance(node, PwmNode):
                node.stopping = True


def main(*factories: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Make nodes, run them until they are stopped, and take them down.

    Parameters
    ----------
    *factories : callable
        Each makes one node.
    args : sequence of str, optional
        The command line; without it, that of the process.

    Returns
    -------
    int
        Exit code: 0 after a stop that was asked for, 1 after an error, which has been reported.
    """
    nodes: list[Node] = []
    stop = _Stop(nodes)
    context: Context = get_default_context()
    with _signals(stop):
        try:
            ros_environment.init(args, context)
            for factory in factories:
                if stop.requested:
                    return 0
                nodes.append(factory())
            return _run(nodes, Future(), stop)
        except Exception as error:  # noqa: BLE001 (the last resort: one line instead of a trace)
            print(f"error: {describe(error)}", file=sys.stderr, flush=True)
            return 1
        finally:
            for node in nodes:
                node.destroy_node()
            context.try_shutdown()


def run(nodes: Sequence[Node], *, until: Future | None = None) -> int:
    """Start nodes and serve them until they are stopped.

    SIGINT, SIGTERM and SIGHUP stop, also when they come twice, and so does the Future `finished` of
    a node that has one. A `PwmNode` is deactivated at the end.

    Parameters
    ----------
    nodes : sequence of Node
        The nodes, of one context.
    until : Future, optional
        Ends the run when it is done.

    Returns
    -------
    int
        Exit code: 0 after a stop that was asked for, 1 after an error, which has been reported.
    """
    stop = _Stop(nodes)
    with _signals(stop):
        return _run(nodes, Future() if until is None else until, stop)


def _run(nodes: Sequence[Node], until: Future, stop: _Stop) -> int:
    executor = EventsExecutor(context=nodes[0].context)
    try:
        for node in nodes:
            executor.add_node(node)
            finished = getattr(node, "finished", None)
            if finished is not None:
                finished.add_done_callback(lambda _: _complete(until))
        if not _start(nodes, stop):
            return 1
        _spin(executor, until, stop)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception as error:  # noqa: BLE001 (from any callback)
        if nodes[0].context.ok():
            nodes[0].get_logger().error(describe(error))
            return 1
        # Somebody shut the context down while a callback was about to publish: a stop like others.
    finally:
        for node in executor.get_nodes():
            if isinstance(node, PwmNode):
                node.stop()
        executor.shutdown()
    return 0


def _complete(future: Future) -> None:
    if not future.done():
        future.set_result(None)


def _start(nodes: Sequence[Node], stop: _Stop) -> bool:
    """Configure and activate the managed nodes, unless their `autostart` is off.

    All are configured before one is activated, and the last is activated first, so that who answers
    is ready before who begins. Kernels may have to be compiled for it, which a stop does not wait
    for: it raises `KeyboardInterrupt`.
    """
    success = TransitionCallbackReturn.SUCCESS
    starting = [n for n in nodes if isinstance(n, PwmNode) and n.values[AUTOSTART.name]]
    stop.starting = True
    try:
        if stop.requested:
            return True
        started = all(node.trigger_configure() == success for node in starting) and all(
            node.trigger_activate() == success for node in reversed(starting)
        )
        # what is compiling may have taken the interrupt for an error of its own
        return started or stop.requested
    finally:
        stop.starting = False


def _spin(executor: Any, until: Future, stop: _Stop) -> None:
    """Serve the executor's nodes, which may come and go, until the end."""
    look, due = Look(), _Due(executor)
    with NoGarbageCollector() as garbage:
        while not (stop.requested or until.done()):
            direct = _direct_subscriptions(executor)
            nodes, begin = _nodes(executor), time.monotonic()
            all_of_them = [each for node in nodes for each in node.loop_subscriptions]
            rest = look.on(
                all_of_them if due.behind else direct,
                [pace for node in nodes for pace in node.paces],
                paced=any(node.paced for node in nodes),
                behind=due.behind,
            )
            if rest > 0.0:
                _serve_one(executor, rest)
            due.serve(_SHARE * max(time.monotonic() - begin, SERVE_EVERY))
            garbage.look()


def _serve_one(executor: Any, seconds: float) -> None:
    """Serve what is due, up to one callback; wait for it so long.

    `spin_until_future_complete` looks at its timeout only when nothing is queued. With a loop in
    this process, or messages that come faster than they are handled, it never returns. `spin()`
    waits until "the end of time". Where the C library of the build has no clock for that, as in the
    wheels, this overflows: the wait then fails at once, for ever, with the queue locked, and
    nothing is served at 100 % load.
    """
    try:
        executor.spin_once(timeout_sec=seconds)
    except (InvalidHandle, rclpy_implementation.RCLError) as error:
        # The executor may still have an event of something that has just been removed. It says so,
        # where rclpy's other executors go on. What a callback raises comes through its frame.
        if error.__traceback__ is None or error.__traceback__.tb_next is not None:
            raise


def _nodes(executor: Any) -> list[PwmNode]:
    return [node for node in executor.get_nodes() if isinstance(node, PwmNode)]


def _direct_subscriptions(executor: Any) -> list[LoopSubscription]:
    """Return the loop's subscriptions that are taken from off the executor.

    These are those whose publisher is here too, those on which messages follow each other fast, and
    all of a node that looks for the time at which its next period begins.
    """
    nodes = _nodes(executor)
    looking = [node for node in nodes if any(pace.due < math.inf for pace in node.paces)]
    looked_for = {each for node in looking for each in node.loop_subscriptions}
    published = {publisher.topic for node in nodes for publisher in node.loop_publishers}
    subscriptions = [each for node in nodes for each in node.loop_subscriptions]
    changed = []
    for subscription in subscriptions:
        direct = subscription.lively or subscription.topic in published
        direct |= subscription in looked_for
        if subscription.direct != direct:
            changed.append(subscription)
        subscription.direct = direct
    if changed:
        executor.wake()  # look again at what there is to serve
        _Due(executor).serve(math.inf)
        for subscription in changed:
            if not subscription.direct:
                subscription.look()  # what came before is not announced again
        return _direct_subscriptions(executor)  # a callback may have removed some
    return [subscription for subscription in subscriptions if subscription.direct]


class _Due:
    """What is queued: the last of it is a task of our own, which says so.

    A `spin_once` that finds nothing costs three times as much as that task, so it is not for trying
    whether there is more. `spin_until_future_complete` without a future would do the same, but each
    call of it leaks 32 bytes: at 250 a second some 30 MB an hour.
    """

    def __init__(self, executor: Any) -> None:
        self._executor = executor
        self._served: list[bool] | None = None  # by the task that is on its way
        self._since = 0.0

    @property
    def behind(self) -> bool:
        """Whether there was more than the time allowed."""
        return self._served is not None

    def serve(self, seconds: float) -> None:
        """Serve all that is queued, or so much of it as this time (s) allows: one at least.

        What is in front of a task that has been on its way for too long has waited even longer:
        nodes are told so.
        """
        now = time.monotonic()
        if self._served is None:
            self._served, self._since = [], now
            self._executor.create_task(self._served.append, True)
        deadline = now + seconds
        for _ in range(_SERVED_AT_ONCE):
            if not self._executor.context.ok():
                return
            late = now - self._since > _LATE
            for node in _nodes(self._executor):
                node.late = late
            _serve_one(self._executor, 0.0)
            if self._served:
                self._served = None
                return
            now = time.monotonic()
            if now >= deadline:
                return


@contextmanager
def _signals(stop: _Stop) -> Iterator[None]:
    """Let SIGINT, SIGTERM and SIGHUP (the terminal was closed) request the stop.

    Ctrl-C reaches a node twice under ``ros2 launch``, so a second signal soon after the first is
    not one more. Somebody who still asks after two seconds gets the default action.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # signals belong to the main thread
        return
    first: float | None = None

    def handle(number: int, frame: Any) -> None:
        nonlocal first
        now = time.monotonic()
        if first is None:
            first = now
            interrupts.note(number)
            stop.request()
            if stop.starting:
                raise KeyboardInterrupt
        elif now - first > interrupts.IMPATIENT_AFTER:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)

    kinds = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # as of `nohup`
        kinds.append(signal.SIGHUP)
    before = [signal.signal(kind, handle) for kind in kinds]
    try:
        yield
    finally:
        for kind, handler in zip(kinds, before, strict=True):
            signal.signal(kind, handler)

"""When periods begin: once everybody listens who must not miss the first, and by the wall clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.timer import Timer

from pwm_node.lags import Lags
from pwm_node.ros.loop_topics import LoopPublisher
from pwm_node.ros.table_node import TableNode

_LOOK_EVERY = 0.01  # s
# A timer wakes the process, some 0.1 ms late. Ticks closer than this (s) are looked for instead.
_BY_TIMER_FROM = 0.002


class SteadyTimer:
    """A timer of a node by the steady clock, which can be started and stopped.

    Parameters
    ----------
    node : TableNode
        Whose executor calls.
    callback : callable
        Called each time.
    """

    def __init__(self, node: TableNode, callback: Callable[[], None]) -> None:
        self._node = node
        self._callback = callback
        self.timer: Timer | None = None

    @property
    def running(self) -> bool:
        """Whether it is started."""
        return self.timer is not None

    def start(self, seconds: float) -> None:
        """Call every so many seconds from now on."""
        self.stop()
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.timer = self._node.create_timer(seconds, self._callback, clock=clock)

    def stop(self) -> None:
        """Call no more."""
        if self.timer is not None:
            self._node.destroy_timer(self.timer)
            self.timer = None


class Pace(SteadyTimer):
    """Ticks of the wall clock, each for a period.

    Whole ticks that went by while the process did not run are left out, with no catching up: the
    next one keeps phase. Where ticks follow each other fast, who spins a node that has this among
    its `paces` looks for the time at which one is `due`, and calls `on_tick`; otherwise a timer
    does.

    Parameters
    ----------
    node : TableNode
        As of `SteadyTimer`.
    tick : callable
        Called for each period.

    Attributes
    ----------
    left_out : int
        Periods left out since the start of the node.
    lags : Lags
        How late each tick came, since the pace was set.
    ticked_at : float
        Time of the latest tick, or of the start (s, steady clock).
    due : float
        When `on_tick` is to be called (s, steady clock); infinite if a timer does that, or nobody.
    next : float
        When the next tick is to come, also if a timer sees to it; infinite if none is.
    """

    def __init__(self, node: TableNode, tick: Callable[[], None]) -> None:
        super().__init__(node, self._on_timer)
        self._tick = tick
        self.left_out = 0
        self.lags = Lags()
        self.ticked_at = 0.0
        self.due = self.next = math.inf
        self._seconds = 0.0

    @property
    def running(self) -> bool:
        """Whether it is started."""
        return super().running or self.due < math.inf

    def start(self, seconds: float) -> None:
        """Tick every so many seconds from now on."""
        self.stop()
        self.lags = Lags()
        self.ticked_at = time.monotonic()
        self._seconds = seconds
        if not self.looks(seconds):
            super().start(seconds)
        self.next = self.ticked_at + seconds
        if self.looks(seconds):
            self.due = self.next

    @staticmethod
    def looks(seconds: float) -> bool:
        """Whether ticks that are so far apart are looked for, by who spins the node."""
        return seconds < _BY_TIMER_FROM

    def stop(self) -> None:
        """Tick no more."""
        super().stop()
        self.due = self.next = math.inf

    def _on_timer(self) -> None:
        if time.monotonic() >= self.next:  # else somebody who looked was faster
            self.on_tick()

    def on_tick(self) -> None:
        """Begin a period."""
        self.ticked_at = time.monotonic()
        late = self.ticked_at - self.next
        self.lags.add(int(late * 1e9))
        self.next += self._seconds
        if late > self._seconds:
            lost = int(late / self._seconds)
            self.left_out += lost
            self.next += lost * self._seconds
        if self.due < math.inf:
            self.due = self.next
        self._tick()


class Listeners:
    """Who must not miss the first message of a node's topics.

    These are so many recorders as the parameter `recorders` says on each topic, and on the first
    one somebody besides: who answers.

    Parameters
    ----------
    node : TableNode
        The node that publishes.
    first, *others : LoopPublisher
        Its topics of the loop.
    """

    def __init__(self, node: TableNode, first: LoopPublisher, *others: LoopPublisher) -> None:
        self._node = node
        self._first = first
        self._others = others
        self._then: Callable[[], None] = lambda: None
        self._timer = SteadyTimer(node, self._look)

    @property
    def there(self) -> bool:
        """Whether all are there."""
        recorders = self._node.values["recorders"]
        assert isinstance(recorders, int)
        return self._first.listeners > recorders and all(
            publisher.listeners >= recorders for publisher in self._others
        )

    @property
    def awaited(self) -> bool:
        """Whether somebody is waited for."""
        return self._timer.running

    def wait(self, then: Callable[[], None]) -> None:
        """Call `then` once, when all are there."""
        if not self.awaited:
            self._then = then
            self._timer.start(_LOOK_EVERY)

    def stop(self) -> None:
        """Wait no more."""
        self._timer.stop()

    def _look(self) -> None:
        if self.there:
            self.stop()
            self._then()

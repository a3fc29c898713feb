"""When the loop looks for what comes next, and when it sleeps."""

import math

import pytest
from harness import until

pytest.importorskip("rclpy")
pytest.importorskip("mfpcc_msgs.msg")

from mfpcc_msgs.msg import PhaseFeedback
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter as RosParameter

from pwm_node.ros import look, loop_topics, spin
from pwm_node.ros.look import Look
from pwm_node.ros.loop_topics import SERVE_EVERY, LoopSubscription
from pwm_node.ros.pace import Pace

STEP = 1e-5  # s: what a look takes


class Machine:
    """A clock, and what happens to a thread that gives its core away."""

    def __init__(self, monkeypatch):
        self.now = 1000.0
        self.yields = 0
        self.away = 0.0
        self.naps = 0
        for module in (look, loop_topics):
            monkeypatch.setattr(module.time, "monotonic", self.read)
        monkeypatch.setattr(look.os, "sched_yield", lambda: self.give_away())
        monkeypatch.setattr(look.time, "sleep", self.sleep)

    def read(self):
        self.now += STEP
        return self.now

    def sleep(self, seconds):
        self.naps += 1
        self.now += seconds

    def give_away(self):
        self.yields += 1
        self.now += self.away


@pytest.fixture
def machine(monkeypatch):
    return Machine(monkeypatch)


class Incoming:
    """A subscription to which messages come at given times."""

    direct = True
    msg_class = PhaseFeedback

    def __init__(self, machine, *times):
        self._machine = machine
        self._times = list(times)
        self.lively = True
        self.handled = []
        self.callback = lambda data: self.handled.append((machine.now, data))
        self.asleep_until = None

    def take(self, msg_class, raw):
        if self._times and self._times[0] <= self._machine.now:
            return (self._times.pop(0), {})
        return None

    def sleep(self, until):
        self.lively = False
        self.asleep_until = until


class Ticks:
    """A pace whose periods are due at given times."""

    def __init__(self, machine, *times):
        self._machine = machine
        self._times = [*times, math.inf]
        self.begun = []

    @property
    def due(self):
        return self._times[0]

    next = due

    def on_tick(self):
        self.begun.append((self._machine.now, self._times.pop(0)))


def test_it_looks_on_while_messages_come_and_sleeps_when_none_did(machine):
    messages = Incoming(machine, 1000.001, 1000.002, 1000.0035)
    looking = Look()
    assert looking.on([messages], []) == 0.0
    assert [data for _, data in messages.handled] == [1000.001, 1000.002, 1000.0035]
    assert all(at - data < 4 * STEP for at, data in messages.handled)
    assert messages.lively and machine.yields > 50
    assert looking.on([messages], []) == 0.0  # a turn in which nothing comes is the last one
    assert not messages.lively and messages.asleep_until < machine.now


def test_with_nothing_to_look_for_it_leaves_the_rest_to_the_executor(machine):
    own = Incoming(machine)
    own.lively = False  # published in this process: only a callback can make something come
    for subscriptions in ([], [own]):
        assert Look().on(subscriptions, [Ticks(machine)]) == pytest.approx(0.2)
    assert machine.yields == 0


def test_a_period_begins_when_it_is_due_and_a_command_goes_first(machine):
    order = []
    commands = Incoming(machine, 1000.001)
    commands.callback = lambda data: order.append("command")
    ticks = Ticks(machine, 1000.001, 1000.002)
    tick = ticks.on_tick
    ticks.on_tick = lambda: (order.append("period"), tick())
    assert Look().on([commands], [ticks]) == 0.0
    assert order == ["command", "period", "period"]
    assert all(at - due < 5 * STEP for at, due in ticks.begun)


def test_on_a_core_that_others_want_it_sleeps_and_tries_again_less_and_less_often(machine):
    messages = Incoming(machine)
    looking = Look()
    machine.away = 0.002  # somebody else had the core
    sleeps = []
    for _ in range(7):
        messages.lively = True
        assert looking.on([messages], []) == 0.0
        assert not messages.lively
        sleeps.append(messages.asleep_until - machine.now)
        # meanwhile a period that is due is slept for
        ticks = Ticks(machine, machine.now + 0.0005)
        yields = machine.yields
        assert 0.0 < looking.on([], [ticks]) <= 0.0005
        assert machine.yields == yields
        machine.now = messages.asleep_until
    assert sleeps == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0], abs=4 * STEP)
    # one tick of the scheduler is no sign of others
    machine.away, messages.lively = 0.0009, True
    messages._times = [machine.now + SERVE_EVERY]
    give_away = machine.give_away

    def once():
        give_away()
        machine.away = 0.0

    machine.give_away = once
    looking.on([messages], [])
    assert messages.lively


def test_what_the_executor_is_behind_with_does_not_keep_the_loop_waiting(machine):
    messages = Incoming(machine, 1000.0, 1000.002, 1000.003)
    messages.lively = False  # they would be the executor's

    class ByTimer(Ticks):
        due = math.inf

    ticks = ByTimer(machine, 1000.0025, 1001.0)
    looking = Look()
    assert looking.on([messages], [ticks], behind=True) == 0.0
    assert [data for _, data in messages.handled] == [1000.0, 1000.002, 1000.003]
    assert all(at - data < 5 * STEP for at, data in messages.handled)
    assert [due for _, due in ticks.begun] == [1000.0025]
    assert machine.now == pytest.approx(1000.0 + SERVE_EVERY, abs=4 * STEP)

    # on a core that others want, without taking it from them all the time
    machine.away, messages.lively = 0.002, True
    looking.on([messages], [])
    messages._times = [machine.now + 0.001]
    yields = machine.yields
    assert looking.on([messages], [], behind=True) == 0.0
    assert machine.yields == yields and 10 < machine.naps < 100
    assert len(messages.handled) == 4

    # and a loop that does not run has no advantage of it
    machine.now += 1.0
    begin = machine.now
    assert looking.on([messages], [], behind=True) == 0.0
    assert machine.now - begin < 5 * STEP


def test_messages_that_follow_each_other_fast_are_looked_for(toy, context, machine):
    node = toy.Pong(context=context)
    node.trigger_configure()
    executor = EventsExecutor(context=context)
    executor.add_node(node)
    (subscription,) = node.loop_subscriptions
    data = node.sample.to_bytes()
    assert isinstance(subscription, LoopSubscription)

    def after(*pauses):
        for pause in pauses:
            machine.now += pause
            subscription.subscription.callback(data)
        return subscription.lively

    fast = [0.5 * SERVE_EVERY] * 10
    assert not after(0.0, SERVE_EVERY, 10.0, 2.0 * SERVE_EVERY)
    assert not after(1.0, *fast[1:], SERVE_EVERY), "a few that come together are none"
    assert spin._direct_subscriptions(executor) == []
    assert after(*fast)
    assert spin._direct_subscriptions(executor) == [subscription]
    assert subscription.subscription not in list(node.subscriptions)
    subscription.sleep(machine.now + 0.1)
    assert spin._direct_subscriptions(executor) == []
    assert subscription.subscription in list(node.subscriptions)
    assert not after(0.01, *fast), "it was to sleep for so long"
    assert after(0.1, *fast)
    executor.shutdown()
    node.destroy_node()


@pytest.mark.parametrize(("seconds", "by_timer"), [(1e-4, False), (5e-3, True)])
def test_a_fast_pace_is_looked_for_and_a_slow_one_has_a_timer(toy, context, seconds, by_timer):
    executor = EventsExecutor(context=context)
    node = toy.Pong(context=context, parameter_overrides=[RosParameter("autostart", value=False)])
    ticks = []
    pace = Pace(node, lambda: ticks.append(pace.due))
    node.paces.append(pace)
    assert not pace.running and pace.due == math.inf
    pace.start(seconds)
    assert pace.running
    assert (pace.timer is not None) == by_timer
    assert (pace.due == math.inf) == by_timer
    assert pace.next == pace.ticked_at + seconds
    if by_timer:
        executor.add_node(node)
        until(lambda: spin._serve_one(executor, 0.01) or len(ticks) >= 3, "the timer ticks")
        pace.on_tick()  # somebody who looked was faster
        begun, pace.next = len(ticks), math.inf
        pace.timer.callback()
        assert len(ticks) == begun
    else:
        begun = pace.due
        pace.on_tick()
        assert ticks[0] > begun
    pace.stop()
    assert not pace.running and pace.due == math.inf and pace.timer is None
    executor.shutdown()
    node.destroy_node()


class Storm:
    """An executor with more to serve than it ever can, each of which takes its time."""

    def __init__(self, machine, takes):
        self.context = self
        self.served = 0
        self._machine = machine
        self._takes = takes

    def ok(self):
        return True

    def get_nodes(self):
        return []

    def create_task(self, callback, *arguments):
        """Stand behind all the others, for ever."""

    def spin_once(self, timeout_sec):
        self.served += 1
        self._machine.now += self._takes


@pytest.mark.parametrize("takes", [5e-5, 3e-4, 2e-3])
def test_requests_in_a_storm_get_a_tenth_of_the_loop(machine, takes):
    executor = Storm(machine, takes)
    due = spin._Due(executor)
    turns = 50
    for _ in range(turns):
        due.serve(0.1 * SERVE_EVERY)
    # one at least, so that nobody waits for ever
    allowed = max(1.0, 0.1 * SERVE_EVERY / takes)
    assert turns <= executor.served <= turns * (allowed + 1.0)

"""The garbage collector is out of the loop, and memory stays bounded all the same."""

import gc
import weakref

import pytest

from pwm_node.process.garbage import NoGarbageCollector


class Circle:
    """An object that only the collector can free."""

    def __init__(self):
        self.me = self


@pytest.fixture
def collected():
    """The collections that Python itself begins or is asked for."""
    seen = []
    note = lambda phase, info: seen.append(info["generation"]) if phase == "start" else None  # noqa: E731
    gc.callbacks.append(note)
    yield seen
    gc.callbacks.remove(note)


def test_python_collects_nothing_by_itself(collected):
    with NoGarbageCollector():
        collected.clear()
        kept = [Circle() for _ in range(50_000)]
        assert collected == [] and not gc.isenabled()
    assert gc.isenabled() and gc.get_freeze_count() == 0
    assert len(kept) == 50_000


def test_circles_do_not_gather(collected):
    with NoGarbageCollector() as garbage:
        collected.clear()
        alive = weakref.WeakSet()
        most = 0
        for _ in range(200):
            for _ in range(100):
                alive.add(Circle())
            garbage.look()
            most = max(most, len(alive))
        assert most < 3000 < 20_000
        assert 1 <= len(collected) == garbage.collections <= 100


def test_who_keeps_many_objects_has_them_looked_through_seldom():
    with NoGarbageCollector() as garbage:
        kept = []
        for _ in range(1000):
            kept += [[n] for n in range(200)]
            garbage.look()
        # each time a quarter more than was there
        assert garbage.collections < 60


def test_what_was_there_before_is_left_out():
    kept = [[n] for n in range(10_000)]
    with NoGarbageCollector():
        assert gc.get_freeze_count() > len(kept)


def test_who_had_it_off_keeps_it_off():
    gc.disable()
    try:
        with NoGarbageCollector():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_a_loop_that_leaves_circles_keeps_its_memory(toy, context, collected):
    from rclpy.parameter import Parameter as RosParameter

    from pwm_node.ros import spin

    alive, most, took_part = weakref.WeakSet(), [], []

    class Leaky(toy.Ping):
        def on_command(self, data):
            alive.add(Circle())
            most.append(len(alive))
            took_part.append(gc.isenabled())
            super().on_command(data)
            if self.awaited is None:
                self.finish()

    ping = Leaky(context=context, parameter_overrides=[RosParameter("periods", value=20_000)])
    pong = toy.Pong(context=context)
    assert spin.run([ping, pong]) == 0
    assert ping.period == 19_999 and len(most) >= 20_000
    assert max(most) < 5000 and not any(took_part)
    assert gc.isenabled()
    for node in (ping, pong):
        node.destroy_node()

"""Two shells, two nodes: they find each other, and what happens when one is stopped or killed."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator

import pytest
import rclpy
from harness import Process, until
from mfpcc_msgs.msg import DutyCommand, PhaseFeedback
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data

CONTROLLER = ("mfpcc_controller", "controller", "--ros-args", "-p", "speed_ref_rpm:=500.0")
PLANT = ("pmsm_sim", "pmsm_sim", "--ros-args", "-p", "load_torque:=1.0")
# slow enough for a listener in Python on a busy machine
SLOWLY = ("-p", "real_time_factor:=0.02")


class Listener:
    """Follows the loop from outside."""

    def __init__(self, qos: QoSProfile | int = 10) -> None:
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context)
        self.node = Node("listener", context=self.context)
        self.samples: list[int] = []
        self.commands: list[tuple[int, bool]] = []
        self.node.create_subscription(
            PhaseFeedback, "phase_feedback", lambda m: self.samples.append(m.period), qos
        )
        self.node.create_subscription(
            DutyCommand, "duty_command", lambda m: self.commands.append((m.period, m.enable)), qos
        )
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def latest(self) -> int:
        """Period of the last sample seen, -1 before the first."""
        self.executor.spin_once(timeout_sec=0.05)
        return self.samples[-1] if self.samples else -1

    def until_beyond(self, period: int, what: str) -> None:
        """Wait for a sample after a period."""
        until(lambda: self.latest() > period, what)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def listener(domain: int) -> Iterator[Listener]:
    it = Listener()
    yield it
    it.close()


@pytest.fixture
def onlooker(domain: int) -> Iterator[Listener]:
    """A listener that a loop in lock-step does not wait for."""
    it = Listener(qos_profile_sensor_data)
    yield it
    it.close()


Start = Callable[..., Process]


@pytest.mark.parametrize("order", [(PLANT, CONTROLLER), (CONTROLLER, PLANT)])
def test_the_nodes_find_each_other_in_any_order(
    start: Start, listener: Listener, order: tuple[tuple[str, ...], ...]
) -> None:
    for command in order:
        start(*command)
    listener.until_beyond(50, "the loop runs")


def test_a_killed_controller_is_named_and_a_new_one_takes_over(
    start: Start, listener: Listener
) -> None:
    plant = start(*PLANT)
    first = start(*CONTROLLER)
    listener.until_beyond(50, "the loop runs")
    first.kill()
    plant.wait_for("duty_command")
    assert "ros2 run mfpcc_controller controller" in plant.output
    stopped_at = listener.latest()
    listener.samples.clear()
    start(*CONTROLLER)
    listener.until_beyond(stopped_at + 50, "the loop goes on")
    assert min(listener.samples) >= stopped_at, "the plant has begun anew"


def test_a_killed_plant_is_named_and_a_new_one_begins_anew(
    start: Start, listener: Listener
) -> None:
    controller = start(*CONTROLLER)
    first = start(*PLANT)
    listener.until_beyond(200, "the loop runs")
    first.kill()
    controller.wait_for("phase_feedback")
    assert "ros2 run pmsm_sim pmsm_sim" in controller.output
    listener.samples.clear()
    start(*PLANT, *SLOWLY)
    controller.wait_for("began anew")
    listener.until_beyond(20, "the loop runs again")


def test_a_stopped_controller_blocks_the_gates(start: Start, listener: Listener) -> None:
    start(*PLANT, *SLOWLY)
    controller = start(*CONTROLLER)
    listener.until_beyond(20, "the loop runs")
    controller.signal(signal.SIGINT)
    controller.signal(signal.SIGINT)  # as under `ros2 launch`
    assert controller.wait() == 0
    until(
        lambda: listener.latest() >= 0 and bool(listener.commands) and not listener.commands[-1][1],
        "the last command blocks the gates",
    )


def test_a_second_node_of_the_same_name_is_refused(start: Start, onlooker: Listener) -> None:
    plant = start(*PLANT)  # in lock-step: by the wall clock, a busy machine could trip it
    # however long the machine keeps one of them from its core
    controller = start(*CONTROLLER, "-p", "fault.feedback_timeout:=0.0")
    onlooker.until_beyond(20, "the loop runs")
    seconds = [start(*PLANT), start(*CONTROLLER), start("mfpcc_experiments", "drive")]
    for second in seconds:
        assert second.wait() == 1
        assert "is running already on this machine (process " in second.output
        assert "Traceback" not in second.output
    onlooker.until_beyond(onlooker.latest() + 20, "the loop goes on")
    assert all(enabled for _, enabled in onlooker.commands), plant.output + controller.output


def test_a_run_of_given_length_ends_by_itself(start: Start) -> None:
    start(*CONTROLLER)
    plant = start(*PLANT, "-p", "periods:=300")
    assert plant.wait() == 0


def test_an_unknown_parameter_is_told_with_the_nearest(start: Start) -> None:
    plant = start("pmsm_sim", "pmsm_sim", "--ros-args", "-p", "load_torqe:=1.0")
    assert plant.wait() == 1
    assert "load_torque" in plant.output
    assert "Traceback" not in plant.output

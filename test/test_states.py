"""The states of the drive in any order, against a model of twenty lines: are the gates as it says?

Both nodes are the real ones, wired to each other without a middleware in between, period by period.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import pytest
import rclpy
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test
from mfpcc_msgs.msg import PhaseFeedback
from rclpy.logging import LoggingSeverity
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from mfpcc_controller.node import MfpccController
from mfpcc_controller.parameters import SCHEMES
from pmsm_sim.node import PmsmSim
from pwm_node.wire import Wire

RAMP = 1e-2  # s: safe stop 1 takes twice as long at most
RAMP_PERIODS = 200


class Model:
    """When the gates are on: all that a user has to know of it."""

    def __init__(self) -> None:
        self.speed_ref = 0.0
        self.new_inverter()
        self.new_controller()

    def new_inverter(self) -> None:
        self.inverter_tripped = self.inverter_cause = self.blocked = self.awaits_off = False
        self.enable = True  # in period 0, for which there is no command: the zero vector

    def new_controller(self) -> None:
        self.tripped = self.cause = self.awaits_zero = self.slowing = False
        self.active, self.bad_in_row = True, 0

    def answer(self, bad_sample: bool) -> None:
        """The controller: does the command for the next period have the gates on?"""
        self.bad_in_row = self.bad_in_row + 1 if bad_sample else 0
        self.cause = self.bad_in_row >= 2 if bad_sample else self.gates_blocked
        self.tripped |= self.cause
        if not self.tripped and self.speed_ref == 0.0:
            self.awaits_zero = False
        self.enable = self.active and not self.tripped and not self.awaits_zero

    def apply(self, overvoltage: bool) -> bool:
        """The inverter: are the gates on in the period that begins?"""
        self.inverter_cause = overvoltage
        self.inverter_tripped |= overvoltage
        self.awaits_off &= self.enable
        self.gates_blocked = self.inverter_tripped or self.blocked or self.awaits_off
        return self.enable and not self.gates_blocked

    def clear_inverter(self) -> bool:
        if not self.inverter_cause:
            self.awaits_off |= self.inverter_tripped
            self.inverter_tripped = False
        return not self.inverter_cause

    def clear_controller(self) -> bool:
        if not self.cause:
            self.tripped, self.slowing, self.awaits_zero = False, False, True
        return not self.cause

    def slow_down(self) -> None:
        if self.awaits_zero:
            self.tripped = True  # the gates are off, and a ramp would bring the power back
        self.slowing |= not self.tripped

    def begin_anew(self) -> None:
        """What the controller makes of samples that begin with period 0 again."""
        self.tripped |= self.slowing  # what was to stop does not start again
        self.slowing, self.bad_in_row = False, 0


class Wire_:
    """In place of a publisher of the loop: what is published waits here for the other node."""

    listeners = 1

    def __init__(self) -> None:
        self.sent: deque[bytes] = deque()
        self.publish = self.publish_aside = self.sent.append

    def destroy(self) -> None:
        """Nothing to remove."""


class Wired:
    """A node whose loop goes by wires."""

    def create_loop_publisher(self, msg_class: Any, topic: str) -> Any:
        wire = self.__dict__.setdefault("wires", {})
        return wire.setdefault(topic, Wire_())


class Plant(Wired, PmsmSim):
    """The real one."""


class Controller(Wired, MfpccController):
    """The real one; nobody else has to hear its first answer."""

    def _heard(self) -> bool:
        return True


REQUESTS = ("stop_inverter", "stop_controller", "slow_down", "clear_inverter", "clear_controller")


class Drive(RuleBasedStateMachine):
    """Both nodes and the model, side by side."""

    context: rclpy.Context

    def __init__(self) -> None:
        super().__init__()
        self.model = Model()
        self.overvoltage = False
        self.slowed = 0
        self.plant = self.new_plant()  # period 0 has begun
        self.controller = self.new_controller()

    def new(self, kind: Callable[..., Any], **values: Any) -> Any:
        wishes = [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]
        node = kind(context=self.context, parameter_overrides=wishes, enable_rosout=False)
        node.get_logger().set_level(LoggingSeverity.FATAL)
        node.trigger_configure()
        node.trigger_activate()
        return node

    def new_plant(self) -> Plant:
        plant = self.new(Plant, dc_voltage=420.0 if self.overvoltage else 311.0)
        plant._listeners.stop()
        plant._begin()
        self.compare(plant)
        return plant

    def new_controller(self) -> Controller:
        values = {"speed_ref_rpm": self.model.speed_ref, "stop__ramp_time": RAMP}
        return self.new(Controller, **values)

    # What passes in a period

    @rule(periods=st.integers(1, 5))
    def run(self, periods: int) -> None:
        for _ in range(periods):
            self.period()

    @rule(samples=st.integers(1, 3))
    def bad_samples(self, samples: int) -> None:
        for _ in range(samples):
            self.period(bad_sample=True)

    @rule()
    def ramp(self) -> None:
        for _ in range(RAMP_PERIODS + 1):
            self.period()

    def period(self, bad_sample: bool = False) -> None:
        """Let the controller answer the sample, and the inverter begin the next period."""
        (sample,) = self.plant.wires["phase_feedback"].sent
        self.plant.wires["phase_feedback"].sent.clear()
        if bad_sample:
            wire = Wire(PhaseFeedback)
            wire.load(sample)
            wire.fixed["i_a"] = math.nan
            sample = wire.to_bytes()
        if self.plant.period < self.controller.period:
            self.model.begin_anew()
        self.controller._on_feedback(sample)
        self.model.answer(bad_sample)
        self.follow_ramp()
        (command,) = self.controller.wires["duty_command"].sent
        self.controller.wires["duty_command"].sent.clear()
        self.plant._on_command(command)
        self.compare(self.plant)

    def compare(self, plant: Plant) -> None:
        gates = bool(plant._state.fixed["gates_on"][0])
        assert gates == self.model.apply(self.overvoltage), f"period {plant.period}"

    def follow_ramp(self) -> None:
        """When the ramp is over the drive says, within its time."""
        self.slowed = self.slowed + 1 if self.model.slowing else 0
        assert self.slowed <= RAMP_PERIODS + 1
        if self.model.slowing and not self.controller.core.slowing:
            self.model.slowing, self.model.tripped, self.model.enable = False, True, False

    # What comes from outside

    @rule(speed=st.sampled_from([0.0, 0.0, 200.0, -300.0]))
    def reference(self, speed: float) -> None:
        answer = self.controller.set_parameters([Parameter("speed_ref_rpm", value=speed)])
        assert answer[0].successful
        self.model.speed_ref = speed

    @rule(scheme=st.sampled_from(SCHEMES))
    def scheme(self, scheme: str) -> None:
        assert self.controller.set_parameters([Parameter("scheme", value=scheme)])[0].successful

    @rule(on=st.booleans())
    def voltage(self, on: bool) -> None:
        volts = 420.0 if on else 311.0
        assert self.plant.set_parameters([Parameter("dc_voltage", value=volts)])[0].successful
        self.overvoltage = on

    @rule()
    def stop_inverter(self) -> None:
        assert self.ask(self.plant._stops._stop)
        self.model.inverter_tripped = True

    @rule()
    def stop_controller(self) -> None:
        assert self.ask(self.controller._stops._stop)
        self.model.tripped, self.model.slowing = True, False

    @rule()
    def slow_down(self) -> None:
        assert self.ask(self.controller._stops._slow_down)
        self.model.slow_down()

    @rule()
    def clear_inverter(self) -> None:
        assert self.ask(self.plant._stops._clear) == self.model.clear_inverter()

    @rule()
    def clear_controller(self) -> None:
        assert self.ask(self.controller._stops._clear) == self.model.clear_controller()

    def ask(self, service: Callable[..., Trigger.Response]) -> bool:
        return bool(service(Trigger.Request(), Trigger.Response()).success)

    @rule(speed=st.sampled_from([200.0, -300.0]))
    def start(self, speed: float) -> None:
        """What a user does to get it going; most of what can happen to it happens from there."""
        self.voltage(False)
        self.inverter_active(True)
        self.controller_active(True)
        self.run(2)
        self.clear_inverter()
        self.reference(0.0)
        self.run(2)
        self.clear_controller()
        self.run(2)
        assert self.model.enable or self.model.cause
        self.reference(speed)
        self.run(3)

    @rule(
        running=st.booleans(),
        wishes=st.lists(st.sampled_from(REQUESTS), min_size=2, max_size=4),
        to_zero=st.booleans(),
    )
    def requests(self, running: bool, wishes: list[str], to_zero: bool) -> None:
        """Several before the next period: the second may meet what the first has left."""
        if running:
            self.start(200.0)
        for wish in wishes:
            getattr(self, wish)()
        if to_zero:
            self.run(1)
            self.reference(0.0)
        self.run(2)

    # Life cycle

    @rule(active=st.booleans())
    def inverter_active(self, active: bool) -> None:
        self.change(self.plant, active)
        self.model.blocked = not active
        self.model.awaits_off |= not active

    @rule(active=st.booleans())
    def controller_active(self, active: bool) -> None:
        self.change(self.controller, active)
        self.controller.wires["duty_command"].sent.clear()  # the sample at hand will be answered
        self.model.active = active

    def change(self, node: Any, active: bool) -> None:
        if node.active != active:
            (node.trigger_activate if active else node.trigger_deactivate)()
        assert node.active == active

    @rule()
    @precondition(lambda self: self.controller.period != 0)  # or it is the same sample again
    def restart_plant(self) -> None:
        self.plant.destroy_node()
        self.model.new_inverter()
        self.plant = self.new_plant()

    @rule()
    def restart_controller(self) -> None:
        self.controller.destroy_node()
        self.controller = self.new_controller()
        self.model.new_controller()

    def teardown(self) -> None:
        for node in (self.plant, self.controller):
            node.destroy_node()


@pytest.fixture
def drives(context: rclpy.Context) -> type[Drive]:
    """The machine, with a context for its nodes."""
    Drive.context = context
    return Drive


def test_the_gates_are_as_the_model_says(drives: type[Drive]) -> None:
    run_state_machine_as_test(
        drives,
        settings=settings(
            max_examples=25,
            stateful_step_count=40,
            deadline=None,
            derandomize=True,
            phases=[Phase.generate],  # a short example is not worth minutes
            database=None,
            suppress_health_check=list(HealthCheck),
        ),
    )


def test_a_stop_of_the_inverter_that_is_cleared_at_once_keeps_the_power_off(
    drives: type[Drive],
) -> None:
    drive = drives()
    drive.start(200.0)
    drive.stop_inverter()
    drive.clear_inverter()
    drive.run(3)
    assert drive.model.awaits_off is False and drive.model.tripped, "the controller has seen it"
    drive.teardown()


def test_a_stop_that_is_on_its_way_is_not_forgotten_for_a_plant_that_begins_anew(
    drives: type[Drive],
) -> None:
    drive = drives()
    drive.start(200.0)
    drive.slow_down()
    drive.run(2)
    assert drive.model.slowing
    drive.restart_plant()
    drive.run(5)
    assert drive.model.tripped
    drive.teardown()


def test_a_new_scheme_does_not_bring_the_power_back_after_the_fallback_has_failed(
    drives: type[Drive],
) -> None:
    drive = drives()
    drive.start(200.0)
    drive.scheme("pi_foc")  # which is its own fallback
    drive.run(1)
    drive.controller.core.mem["pi_foc"]["integral"] = math.nan
    drive.model.tripped = True
    drive.run(3)
    assert drive.controller.core.failed
    drive.scheme("mbpcc")
    drive.run(3)
    drive.teardown()

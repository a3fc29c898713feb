"""Faults on the graph: seen, told, latched, cleared."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from harness import Process, until
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from mfpcc_msgs.msg import DriveStatus, DutyCommand, PhaseFeedback
from mfpcc_msgs.srv import InjectFault
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.rosbag2 import Reader
from std_srvs.srv import Trigger

from mfpcc_controller.node import MfpccController
from mfpcc_experiments.proofs import fault_cases, faults
from mfpcc_experiments.running import run
from mfpcc_experiments.running.scenario import Scenario
from pwm_node.wire import Wire

Start = Callable[..., Process]

# By the wall clock, and however long a busy machine keeps the controller from answering.
SLOWLY = (
    "--ros-args",
    *("-p", "real_time_factor:=0.02"),
    *("-p", "inverter.command_loss_limit:=1000000"),
)


class Operator:
    """Watches the drive's status, calls its services and sets its parameters."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context)
        self.node = Node("operator", context=self.context)
        self.status: dict[str, DriveStatus] = {}
        self.enabled: bool | None = None
        self.commanded = -1
        latest = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(DriveStatus, "drive_status", self._on_status, latest)
        self.node.create_subscription(DutyCommand, "duty_command", self._on_command, 10)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def _on_status(self, message: DriveStatus) -> None:
        self.status[message.node] = message

    def _on_command(self, message: DutyCommand) -> None:
        self.enabled = message.enable
        self.commanded = message.period

    def until(self, condition: Callable[[], bool], what: str) -> None:
        def holds() -> bool:
            self.executor.spin_once(timeout_sec=0.05)
            return condition()

        until(holds, what)

    def codes(self, node: str) -> list[str]:
        status = self.status.get(node)
        return [fault.code for fault in status.faults] if status else []

    def state(self, node: str) -> str:
        return self.status[node].state if node in self.status else ""

    def ask(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        future = client.call_async(request) if client.wait_for_service(60.0) else None
        assert future is not None, f"no service {name}"
        self.until(future.done, f"{name} answers")
        return future.result()

    def call(self, node: str, name: str) -> Trigger.Response:
        return self.ask(Trigger, f"/{node}/{name}", Trigger.Request())

    def change(self, node: str, transition: int) -> None:
        request = ChangeState.Request(transition=Transition(id=transition))
        assert self.ask(ChangeState, f"/{node}/change_state", request).success

    def set(self, node: str, name: str, value: object) -> None:
        service = SetParametersAtomically
        client = self.node.create_client(service, f"/{node}/set_parameters_atomically")
        assert client.wait_for_service(60.0)
        wish: ParameterMessage = Parameter(name, value=value).to_parameter_msg()
        future = client.call_async(service.Request(parameters=[wish]))
        self.until(future.done, f"{name} is set")
        assert future.result().result.successful

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def operator(domain: int) -> Iterator[Operator]:
    it = Operator()
    yield it
    it.close()


def test_a_fault_is_told_and_power_returns_only_by_request_and_from_zero(
    start: Start, operator: Operator
) -> None:
    plant = start("pmsm_sim", "pmsm_sim", *SLOWLY)
    start("mfpcc_controller", "controller", "--ros-args", "-p", "speed_ref_rpm:=200.0")
    operator.until(lambda: operator.enabled is True, "the drive is enabled")

    operator.set("pmsm_sim", "dc_voltage", 420.0)
    operator.until(lambda: operator.codes("pmsm_sim") == ["DC_OVERVOLTAGE"], "the fault is told")
    assert operator.state("pmsm_sim") == "tripped"
    plant.wait_for("DC_OVERVOLTAGE in period")
    answer = operator.call("pmsm_sim", "clear_faults")
    assert not answer.success and "DC_OVERVOLTAGE" in answer.message
    operator.set("pmsm_sim", "dc_voltage", 311.0)
    operator.until(lambda: operator.call("pmsm_sim", "clear_faults").success, "it is cleared")
    assert operator.codes("pmsm_sim") == []

    assert operator.call("mfpcc_controller", "sto").success
    operator.until(lambda: operator.enabled is False, "the controller is disabled")
    assert operator.call("mfpcc_controller", "clear_faults").success
    operator.enabled = None
    operator.until(lambda: operator.enabled is not None, "the loop goes on")
    assert operator.enabled is False, "the reference has not been at zero"
    operator.set("mfpcc_controller", "speed_ref_rpm", 0.0)
    operator.until(lambda: operator.enabled is True, "power returns")
    operator.until(lambda: operator.status["pmsm_sim"].enabled, "and reaches the gates")
    assert plant.output.count("DC_OVERVOLTAGE in period") == 1

    operator.change("pmsm_sim", Transition.TRANSITION_DEACTIVATE)
    operator.until(lambda: operator.codes("mfpcc_controller") == ["INVERTER"], "it is noticed")
    operator.change("pmsm_sim", Transition.TRANSITION_ACTIVATE)
    operator.until(lambda: operator.call("mfpcc_controller", "clear_faults").success, "cleared")
    operator.until(lambda: operator.enabled is True, "power returns")


def test_a_killed_plant_disables_until_there_are_samples_again_and_it_is_cleared(
    start: Start, operator: Operator
) -> None:
    controller = start("mfpcc_controller", "controller", "--ros-args", "-p", "speed_ref_rpm:=200.0")
    plant = start("pmsm_sim", "pmsm_sim", *SLOWLY)
    operator.until(lambda: operator.commanded > 20, "the loop runs")
    assert operator.enabled is True
    plant.kill()
    operator.until(lambda: operator.codes("mfpcc_controller") == ["FEEDBACK_LOST"], "it is told")
    operator.until(lambda: operator.enabled is False, "the disable is sent")
    controller.wait_for("clear_faults std_srvs/srv/Trigger")
    answer = operator.call("mfpcc_controller", "clear_faults")
    assert not answer.success and "FEEDBACK_LOST" in answer.message

    another = start("pmsm_sim", "pmsm_sim", *SLOWLY)
    controller.wait_for("the plant began anew")
    assert "gates off until the faults are cleared" in controller.output
    operator.until(lambda: operator.call("mfpcc_controller", "clear_faults").success, "cleared")
    operator.set("mfpcc_controller", "speed_ref_rpm", 0.0)
    operator.until(lambda: operator.enabled is True, "power returns")
    for process in (controller, another):
        process.kill()  # or they would wait for the first plant to take the last messages


@pytest.mark.parametrize(
    ("unit", "kind"),
    [
        ("temperature", "slow"),
        ("dc_sensor", "off"),
        ("duty_link", "intermittent"),
        ("feedback_link", "delayed"),
        ("feedback_link", "duplicated"),
    ],
)
def test_the_graph_survives_a_fault_with_the_same_verdict_as_in_process(
    domain: int, unit: str, kind: str
) -> None:
    """`mfpcc faults --engine ros` shows it for all of them."""
    matrix = fault_cases.cases(fault_cases.POINTS[1:2])
    chosen = [case for case in matrix if (case.unit, case.kind) == (unit, kind)]
    on_graph = faults.judge_all(chosen, engine="ros")
    in_process = faults.judge_all(chosen)
    assert [verdict.failures for verdict in on_graph] == [()] * len(chosen)
    assert [verdict.codes for verdict in on_graph] == [verdict.codes for verdict in in_process]
    assert [verdict.current for verdict in on_graph] == [v.current for v in in_process]


def test_faults_are_injected_by_a_service_where_that_is_allowed(
    start: Start, operator: Operator
) -> None:
    plant = start("pmsm_sim", "pmsm_sim", "--ros-args", "-p", "fault_injection:=true")
    fault = "{unit: encoder, type: stuck, start: 0.5, duration: 0.1}"
    command = ["service", "call", "/pmsm_sim/inject_fault", "mfpcc_msgs/srv/InjectFault", fault]
    with Process([str(shutil.which("ros2")), *command]) as call:
        assert call.wait() == 0
    assert "success=True" in call.output
    assert "injections=['0.5 0.1 encoder stuck 0.5']" in call.output
    plant.wait_for("fault injected: 0.5 0.1 encoder stuck 0.5")

    wrong = InjectFault.Request(unit="encoder", type="stack", duration=0.1)
    answer = operator.ask(InjectFault, "/pmsm_sim/inject_fault", wrong)
    assert not answer.success and "did you mean 'stuck'" in answer.message
    answer = operator.ask(InjectFault, "/pmsm_sim/inject_fault", InjectFault.Request())
    assert answer.success and answer.injections == ["0.5 0.1 encoder stuck 0.5"]


class Controller(MfpccController):
    """A controller that is shown samples, and told that a tenth of a second has gone by."""

    def show(self, periods: int) -> None:
        sample = Wire(PhaseFeedback)
        sample.fixed["dc_voltage"], sample.fixed["derating"] = 311.0, 1.0
        for _ in range(periods):
            sample.fixed["period"] = self.period + 1
            self._on_feedback(sample.to_bytes())

    def wait(self, tenths: int) -> None:
        for _ in range(tenths):
            self._look_for_samples()

    @property
    def codes(self) -> list[str]:
        return [code for code, _, _ in self.core.faults()]


@pytest.fixture
def controller(operator: Operator) -> Iterator[Controller]:
    node = Controller(context=operator.context)
    assert node.trigger_configure() == node.trigger_activate()
    operator.until(lambda: node._command_out.listeners > 0, "the operator listens")
    yield node
    node.destroy_node()


def test_samples_are_missed_while_the_drive_is_enabled_and_by_who_was_there_to_see_it(
    controller: Controller,
) -> None:
    controller.wait(50)
    assert controller.codes == [], "nothing has run yet"
    for _ in range(5):
        controller.show(1)
        controller.wait(9)
    assert controller.codes == [], "samples come, if slowly"
    at_rest = DriveStatus(node="pmsm_sim", state="ready")
    controller._on_status(at_rest)
    controller.wait(50)
    assert controller.codes == [], "the inverter has said that it rests"
    at_rest.state = "running"
    controller._on_status(at_rest)
    controller.wait(10)
    assert controller.codes == ["FEEDBACK_LOST"]
    controller.show(2)
    assert not controller._command.fixed["enable"][0], "latched"
    assert controller.core.clear_faults() == []
    controller.wait(50)
    assert controller.codes == [], "nothing is enabled"


def test_a_scheme_that_takes_too_long_is_replaced_and_then_the_fallback_stopped(
    controller: Controller,
) -> None:
    budget = [Parameter("fault.step_budget", value=1e-3)]  # us: no step can be so short
    controller.show(50)
    assert controller.core.scheme == "mls_mfpcc"
    assert controller.set_parameters(budget)[0].successful
    controller.show(10)
    assert controller.codes == [] and controller.core.scheme == "mls_mfpcc"
    controller.show(10)
    assert controller.codes == ["SCHEME"] and controller.core.scheme == "pi_foc"
    assert "fault.step_budget" in controller.core.faults()[0][2]
    assert not controller.core.tripped and controller._command.fixed["enable"][0]
    controller.show(1)
    assert controller.core.tripped and not controller._command.fixed["enable"][0]


@pytest.mark.parametrize(
    "injection",
    [
        "0.01 0.01 encoder stuck",
        "0.01 0.01 duty_link dropped",
        "0.01 0.01 duty_link garbage",
        "0.01 0.01 feedback_link delayed",
        "0.01 0.01 feedback_link intermittent",
        "0.01 0.01 leg_b off",
    ],
)
def test_an_injected_fault_does_the_same_on_the_graph_as_in_process(
    injection: str, tmp_path: Path
) -> None:
    """The truth of every period is the same, bit for bit, and the run comes to its end."""
    scenario = Scenario.model_validate(
        {
            "name": "injected",
            "motor": "seed_750",
            "speed_rpm": 500.0,
            "duration": 0.03,
            "window_s": [0.0, 0.03],
            "plant": {
                "load_torque": 2.0,
                "fault_injection": True,
                "injections": [injection],
            },
        }
    )
    truth = []
    for engine in ("inprocess", "ros"):
        folder = tmp_path / engine
        run.run(scenario, "mls_mfpcc", engine, folder, 3, lambda done: None)
        with Reader(folder / "mls_mfpcc") as reader:
            truth.append(
                [
                    bytes(data).rstrip(b"\x00")
                    for connection, _, data in reader.messages()
                    if connection.topic == "/drive_state"
                ]
            )
    assert len(truth[0]) == 300
    assert truth[0] == truth[1]

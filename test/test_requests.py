"""Whatever is asked of the running nodes, and whatever comes on their topics off the loop: it is
answered or refused, one line is said, and the drive goes on."""

from __future__ import annotations

import array
import importlib
from collections.abc import Callable, Iterator
from typing import Any

import fuzz
import numpy as np
import pytest
from harness import Process
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from outside import Outside
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import ListParameters, SetParameters, SetParametersAtomically
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message

NODES = ("pmsm_sim", "mfpcc_controller")
TEXTS = ("", "x", "a/b", "..", "\0", "\u20ac" * 100, "y" * 2_000, "load_torque", "use_sim_time")
#: What these do when they are asked for it is tested elsewhere: the drive would not go on.
STOPS = ("sto", "ss1", "clear_faults")


@pytest.fixture
def outside(domain: int) -> Iterator[Outside]:
    it = Outside()
    yield it
    it.close()


def anything(rng: np.random.Generator, kind: str) -> Any:
    """A value for a field of this type, as the generated classes name types."""
    if kind.startswith("sequence<"):
        inner = kind.removeprefix("sequence<").removesuffix(">").split(",")[0]
        return [anything(rng, inner) for _ in range(rng.integers(4))]
    if "[" in kind:
        inner, size = kind.rstrip("]").split("[")
        return [anything(rng, inner) for _ in range(int(size))]
    if kind.startswith("string"):
        return TEXTS[rng.integers(len(TEXTS))]
    if kind == "boolean":
        return bool(rng.integers(2))
    if kind == "octet":
        return bytes([rng.integers(256)])
    if kind in ("float", "double"):
        value = fuzz.any_float(rng)
        return float(np.float32(value)) if kind == "float" else value
    if kind.startswith(("int", "uint")):
        bits = int(kind.lstrip("uint"))
        value = fuzz.any_integer(rng) % 2**bits
        return value if kind.startswith("uint") else value - 2 ** (bits - 1)
    package, name = kind.split("/")
    return filled(rng, getattr(importlib.import_module(f"{package}.msg"), name))


@pytest.mark.filterwarnings("ignore:overflow")
def filled(rng: np.random.Generator, kind: type) -> Any:
    """A message with anything in it."""
    message: Any = kind()
    for name, field in message.get_fields_and_field_types().items():
        value = anything(rng, field)
        if isinstance(getattr(message, name), array.array):
            value = array.array(getattr(message, name).typecode, value)
        setattr(message, name, value)
    return message


def interface(name: str) -> Any:
    package, kind, base = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), base)


def spoil(rng: np.random.Generator, request: Any, names: list[str]) -> None:
    """Make sure that a request that could do what it says does not."""
    if isinstance(request, ChangeState.Request) and request.transition.id in range(1, 10):
        request.transition.id = Transition.TRANSITION_CONFIGURE  # both are active
    if isinstance(request, (SetParameters.Request, SetParametersAtomically.Request)):
        for parameter in request.parameters:
            if rng.random() < 0.8:
                parameter.name = names[rng.integers(len(names))]
            value = parameter.value
            if rng.random() < 0.5 or value.type in range(1, 10):
                # no parameter is one of these
                value.type = int(rng.choice([0, 5, 6, 7, 10, 11, 77, 255]))


@pytest.mark.filterwarnings("ignore:overflow")
def test_any_request_and_any_message(start: Callable[..., Process], outside: Outside) -> None:
    # paced, so that this process can follow however busy the machine is
    slow = ("--ros-args", "-p", "real_time_factor:=0.05")
    drive = start("mfpcc_experiments", "drive", *slow)
    outside.until(lambda: outside.period > 10 or drive.ended, "the drive runs")
    ask = outside.ask

    # what was seen to end it
    impossible = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))
    odd = [
        Parameter(name="load_torque", value=ParameterValue(type=77)),
        Parameter(name="nope", value=ParameterValue(type=ParameterType.PARAMETER_STRING)),
        Parameter(
            name="load_torque",
            value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=0.5),
        ),
    ]
    for node in NODES:
        assert not ask(f"/{node}/change_state", ChangeState, impossible).success
        together = SetParametersAtomically.Request(parameters=odd)
        answer = ask(f"/{node}/set_parameters_atomically", SetParametersAtomically, together)
        assert not answer.result.successful and answer.result.reason
    answers = ask("/pmsm_sim/set_parameters", SetParameters, SetParameters.Request(parameters=odd))
    assert [result.successful for result in answers.results] == [False, False, True]
    assert "77" in answers.results[0].reason and "nope" in answers.results[1].reason
    assert outside.get("pmsm_sim", "load_torque") == 0.5

    services = {
        name: interface(kinds[0])
        for node in NODES
        for name, kinds in outside.node.get_service_names_and_types_by_node(node, "/")
        if name.rpartition("/")[2] not in STOPS
    }
    assert len(services) > 20
    topics = {
        name: interface(kinds[0])
        for node in NODES
        for name, kinds in outside.node.get_subscriber_names_and_types_by_node(node, "/")
        if name not in ("/phase_feedback", "/duty_command")
    }
    assert {"/reference", "/drive_status"} <= set(topics)
    latest = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publishers = {
        name: outside.node.create_publisher(kind, name, latest) for name, kind in topics.items()
    }
    names = {
        node: list(
            ask(f"/{node}/list_parameters", ListParameters, ListParameters.Request()).result.names
        )
        for node in NODES
    }
    for rng in fuzz.cases(2):
        for name, kind in services.items():
            request = filled(rng, kind.Request)
            spoil(rng, request, names[name.split("/")[1]])
            ask(name, kind, request)
        for name, kind in topics.items():
            publishers[name].publish(filled(rng, kind))
            garbage = bytearray(serialize_message(kind()))
            garbage[4:] = rng.bytes(len(garbage) - 4)
            publishers[name].publish(bytes(garbage))
        beyond = outside.period + 10
        outside.until(
            lambda beyond=beyond: outside.period > beyond or drive.ended,  # type: ignore[misc]
            "the drive goes on",
        )
        assert not drive.ended, drive.output
    assert "Traceback" not in drive.output and "Error occurred" not in drive.output, drive.output
    assert "change_state: request refused: " in drive.output

"""The security policy allows each node what it has on the graph, and nothing else.

That it is enforced cannot be tested here: the ROS 2 wheels are built without DDS-Security.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from harness import Process, until
from outside import Outside

POLICY = Path(__file__).parents[1] / "config" / "security" / "policy.xml"
RULES = ("publish", "subscribe", "reply", "request")

Start = Callable[..., Process]
Rights = dict[str, set[str]]


def allowed(enclave: str) -> dict[str, Rights]:
    """What the policy allows each node of an enclave, names in full."""
    found: dict[str, Rights] = {}
    for profile in ET.parse(POLICY).iterfind(f".//enclave[@path='{enclave}']/profiles/profile"):
        node = profile.attrib["node"]
        rights: Rights = {rule: set() for rule in RULES}
        for group in profile:
            for rule in RULES:
                if group.get(rule) == "ALLOW":
                    rights[rule] |= {full(entry.text or "", node) for entry in group}
        found[node] = rights
    return found


def full(name: str, node: str) -> str:
    if name.startswith("~"):
        return f"/{node}{name[1:]}"
    return name if name.startswith("/") else f"/{name}"


@pytest.fixture
def outside(domain: int) -> Iterator[Outside]:
    it = Outside()
    yield it
    it.close()


def has(outside: Outside, node: str) -> Rights:
    """What a node has on the graph."""
    look = outside.node
    answers = {
        "publish": look.get_publisher_names_and_types_by_node(node, "/"),
        "subscribe": look.get_subscriber_names_and_types_by_node(node, "/"),
        "reply": look.get_service_names_and_types_by_node(node, "/"),
        "request": look.get_client_names_and_types_by_node(node, "/"),
    }
    return {rule: {name for name, _ in found} for rule, found in answers.items()}


def check(outside: Outside, node: str, rights: Rights) -> None:
    """Hold a node against the graph."""

    def same() -> bool:
        return node in outside.node.get_node_names() and has(outside, node) == rights

    until(same, f"{node} has what it may have, {rights}", 30.0)


def test_each_node_may_do_what_it_does_and_no_more(
    start: Start, outside: Outside, tmp_path: Path
) -> None:
    start("mfpcc_controller", "controller")
    start("pmsm_sim", "pmsm_sim")
    recorder = start("mfpcc_experiments", "record", "--out", str(tmp_path / "bag"))
    outside.until_beyond(50, "the loop runs")
    recorder.wait_for("recording into")
    for node in ("pmsm_sim", "mfpcc_controller", "recorder"):
        check(outside, node, allowed(f"/{node}")[node])


def test_one_process_with_both_nodes_may_do_what_both_may_and_the_black_box(
    start: Start, outside: Outside, tmp_path: Path
) -> None:
    rights = allowed("/drive")
    start("mfpcc_experiments", "drive", "--ros-args", "-p", f"black_box:={tmp_path}")
    check(outside, "black_box", rights.pop("black_box"))
    assert rights == {**allowed("/pmsm_sim"), **allowed("/mfpcc_controller")}


def test_the_operator_reaches_every_service_and_no_command() -> None:
    rights = allowed("/operator")["operator"]
    nodes = {**allowed("/pmsm_sim"), **allowed("/mfpcc_controller")}
    assert rights["request"] == set().union(*(each["reply"] for each in nodes.values()))
    assert not rights["publish"] & {"/duty_command", "/phase_feedback"}

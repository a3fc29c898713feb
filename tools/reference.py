"""Write docs/reference.md: parameters, topics, services, metrics, commands, as the code has them.

`make docs` runs it. Nodes are made and asked what they publish, parameters come from the nodes'
tables, message fields from the comments of the .msg files, commands from their own help, so the
page cannot say what the code does not do. A test holds the committed page against what this gives.

Give the path of another file to write it there.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import click
import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from mfpcc_controller import protection as controller_protection
from mfpcc_controller.node import MfpccController
from mfpcc_controller.parameters import SCHEMES
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.bags import BagWriter, recording
from mfpcc_experiments.cli import cli
from mfpcc_experiments.graph import Recorder, Replayer
from mfpcc_experiments.graph.black_box import DIRECTORY, PARAMETER, BlackBoxNode
from mfpcc_experiments.graph.replayer import TABLE as REPLAYER
from mfpcc_experiments.measuring import METRICS, Need
from mfpcc_experiments.running import scenario
from pmsm_sim import motor
from pmsm_sim.node import PmsmSim
from pmsm_sim.parameters import TABLE as PLANT
from pmsm_sim.parts import protection as plant_protection
from pmsm_sim.parts.injection import MAGNITUDES, UNITS
from pwm_node import yaml_files
from pwm_node.parameters import Parameter, Table
from pwm_node.ros.node import EVERY_NODE

ROOT = Path(__file__).resolve().parent.parent

# What no node can tell: how often it publishes.
RATES = {
    "phase_feedback": "PWM",
    "duty_command": "PWM",
    "drive_state": "PWM / `state_decimation`",
    "lut_diagnostics": "PWM / `diagnostics_decimation`",
    "drive_status": "on change",
    "reference": "any",
    "joint_states": "100 Hz, simulated",
    "clock": "100 Hz, simulated",
    "diagnostics": "1 Hz, wall clock",
}

# What the message types of others mean here; ours say so in their .msg files.
MEANINGS = {
    "joint_states": "Angle (rad), speed (rad/s) and torque (N m) of the rotor, joint `rotor`.",
    "clock": "Simulated time, for nodes with `use_sim_time`; nothing on the loop needs it.",
    "diagnostics": "Rate, missed and lost periods, step times and faults, for people and monitors.",
}

SERVICES = {
    "sto": "Safe torque off: gates off at once.",
    "ss1": "Safe stop 1: ramp down, then gates off; the plant alone cannot ramp.",
    "inject_fault": "Inject a fault, where the plant was started with `fault_injection:=true`.",
    "clear_faults": "Forget latched faults; refused while a cause lasts.",
}

# Of what an injected fault acts on.
MAGNITUDE_UNITS = {
    **dict.fromkeys(("current_a", "current_b", "current_c"), "A"),
    **dict.fromkeys(("dc_sensor", "dc_link"), "V"),
    **dict.fromkeys(("leg_a", "leg_b", "leg_c", "duty_link"), "of the duty"),
    "encoder": "rad",
    "feedback_link": "periods",
    "load": "N m",
    "temperature": "K",
}

# Every ROS node has these, so they say nothing about one.
EVERYWHERE = ("parameter_events", "rosout", "transition_event")
OF_EVERY_NODE = ("lifecycle_msgs", "rcl_interfaces", "type_description_interfaces")

EXECUTABLES = (
    ("pmsm_sim", "pmsm_sim", "/pmsm_sim", "the simulated inverter and motor"),
    ("mfpcc_controller", "controller", "/mfpcc_controller", "the drive controller"),
    ("mfpcc_experiments", "drive", "both, and `/black_box`", "both in one process: the fast way"),
    ("mfpcc_experiments", "record", "/recorder", "everything on the loop into a bag"),
    ("mfpcc_experiments", "replay", "/replayer", "a bag's samples to a live controller"),
)

HEAD = """\
<!-- Written by `make docs` from the code: change it there. -->
# Reference

All that can be typed: nodes, topics, services, parameters, messages, commands. Written by
`make docs` from the code, and held against it by a test. What is behind the words:
[first steps](first_steps.md), [experiments](experiments.md), [reliability](reliability.md).

"""


# --- Markdown -------------------------------------------------------------------------------------


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Lines of a table."""
    yield "| " + " | ".join(heads) + " |"
    yield "|" + "---|" * len(heads)
    for row in rows:
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
    yield ""


def block(text: str) -> Iterator[str]:
    """Lines of a literal block."""
    yield "```text"
    yield from (line.rstrip() for line in text.strip("\n").splitlines())
    yield "```"
    yield ""


# --- Nodes ----------------------------------------------------------------------------------------


@contextlib.contextmanager
def all_nodes() -> Iterator[list[Node]]:
    """Every node there is, with its topics; nothing runs."""
    bag = recording.read(ROOT / "bags/reference/mls_mfpcc")
    with contextlib.ExitStack() as stack:
        context = rclpy.Context()
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        stack.callback(rclpy.try_shutdown, context=context)
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        writer = stack.enter_context(BagWriter(Path(folder, "bag"), config={}))
        drive = [PmsmSim(context=context), MfpccController(context=context)]
        place = rclpy.Parameter(PARAMETER, value=folder)
        managed = [*drive, Replayer(bag, context=context)]
        for node in managed:
            stack.callback(node.destroy_node)
            node.trigger_configure()
        others: list[Node] = [
            Recorder(writer, context=context),  # subscribes to what has a publisher by now
            BlackBoxNode(drive, context=context, parameter_overrides=[place]),
        ]
        for other in others:
            stack.callback(other.destroy_node)
        yield [*managed, *others]


def of_nodes(nodes: Sequence[Node]) -> Iterator[str]:
    """Executables, topics and services."""
    yield "## Nodes"
    yield ""
    rows = [
        (f"`ros2 run {package} {executable}`", f"`{node}`" if node[0] == "/" else node, what)
        for package, executable, node, what in EXECUTABLES
    ]
    yield from table(("executable", "node", "it is"), rows)
    yield (
        "All are managed nodes but recorder and black box: `ros2 lifecycle set NODE deactivate` "
        "stops the drive safely, `activate` lets it go on. With `autostart:=false` they wait to be "
        "told."
    )
    yield ""
    yield "## Topics"
    yield ""
    yield (
        "Names are relative (`-r __ns:=/axis1` makes a second axis), but for `/clock` and "
        "`/diagnostics`. The PWM rate is `pwm_frequency` of simulated time. In lock-step a "
        "publisher of a loop topic keeps all that a reliable subscriber has not got yet: who is "
        "slow slows the loop down, and nothing is lost. By the wall clock nobody is waited for, "
        "and who is slow loses messages."
    )
    yield ""
    publishers = by_topic(nodes, "publishers")
    subscribers = by_topic(nodes, "subscriptions")
    topics = []
    for name in sorted({*publishers, *subscribers}, key=list(RATES).index):
        ends = publishers.get(name) or subscribers[name]
        end = next(iter(ends.values()))
        topics.append(
            (
                f"`{name}`",
                linked(end.msg_type),
                ", ".join(publishers.get(name, ["you"])),
                ", ".join(subscribers.get(name, ["–"])),
                RATES[name],
                quality(end.qos_profile),
            )
        )
    yield from table(("topic", "type", "from", "to", "rate", "quality of service"), topics)
    yield from (f"- `{name}`: {meaning}" for name, meaning in MEANINGS.items())
    yield ""
    yield "## Services"
    yield ""
    yield (
        "Besides those of every managed node (parameters, life cycle); see "
        "[reliability](reliability.md)."
    )
    yield ""
    offered: dict[str, dict[str, Any]] = {}
    for node in nodes:
        for service in node.services:
            if service.srv_type.__module__.split(".")[0] not in OF_EVERY_NODE:
                name = service.srv_name.rpartition("/")[2]
                offered.setdefault(name, {})[node.get_name()] = service
    yield from table(
        ("service", "type", "of", "does"),
        [
            (
                f"`~/{name}`",
                linked(next(iter(offered[name].values())).srv_type),
                ", ".join(offered[name]),
                SERVICES[name],
            )
            for name in sorted(offered)
        ],
    )


def by_topic(nodes: Sequence[Node], ends: str) -> dict[str, dict[str, Any]]:
    """Publishers or subscriptions of each topic, by the name of their node."""
    found: dict[str, dict[str, Any]] = {}
    for node in nodes:
        # of the base class, which knows also those that no executor serves
        for end in getattr(Node, ends).fget(node):
            topic = end.topic_name.rpartition("/")[2]
            if topic not in EVERYWHERE:
                found.setdefault(topic, {})[node.get_name()] = end
    return found


def linked(kind: Any) -> str:
    """Name of an interface type, such as `std_msgs/msg/Header`; ours with a link to its fields."""
    package, folder = kind.__module__.split(".")[:2]
    name = f"`{package}/{folder}/{kind.__name__}`"
    return f"[{name}](#{kind.__name__.lower()})" if package == "mfpcc_msgs" else name


def quality(qos: QoSProfile) -> str:
    """Quality of service in a few words."""
    words = ["reliable" if qos.reliability == ReliabilityPolicy.RELIABLE else "best effort"]
    words.append("keep all" if qos.history == HistoryPolicy.KEEP_ALL else f"keep last {qos.depth}")
    if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        words.append("transient local")
    return ", ".join(words)


# --- Messages -------------------------------------------------------------------------------------


def of_messages() -> Iterator[str]:
    """The fields of our messages, by their comments."""
    yield "## Messages"
    yield ""
    yield "The type of a field is as ROS spells it: `float64[2]` holds two numbers. `stamp` is"
    yield "simulated time, `period` the number of the PWM period; no message holds wall-clock time."
    yield ""
    for file in sorted((ROOT / "src/mfpcc_msgs").glob("*/*.[ms][sr][gv]")):
        yield f"### {file.stem}"
        yield ""
        above: list[str] = []
        fields: list[tuple[str, str, str]] = []
        for line in file.read_text().splitlines():
            declaration, _, comment = (part.strip() for part in line.partition("#"))
            if not declaration:
                if not fields and comment:
                    above.append(comment)
            elif declaration == "---":
                fields.append(("`---`", "", "the answer:"))
            else:
                kind, name = declaration.split(maxsplit=1)
                fields.append((f"`{name}`", f"`{kind}`", comment))
        yield " ".join(above)
        yield ""
        yield from table(("field", "type", "meaning"), fields)


# --- Parameters -----------------------------------------------------------------------------------


def of_parameters(box: ParameterDescriptor) -> Iterator[str]:
    """The parameter tables."""
    yield "## Parameters"
    yield ""
    yield (
        "Those marked *start* are fixed at start: `--ros-args -p NAME:=VALUE`, a parameter file, "
        "or the scenario. All others can be changed at any time (`ros2 param set NODE NAME "
        "VALUE`) and act from the next period on. A value that is refused changes nothing, and the "
        "answer says why. `ros2 param describe NODE NAME` prints what stands here."
    )
    yield ""
    for node, parameters in (
        ("/pmsm_sim", PLANT),
        ("/mfpcc_controller", CONTROLLER),
        ("/replayer", REPLAYER),
    ):
        yield f"### Parameters of {node}"
        yield ""
        yield from parameter_table(parameters.extended(*EVERY_NODE))
    yield "### Parameters of /black_box"
    yield ""
    yield from table(
        ("name", "type", "default", "", "meaning"),
        [(f"`{PARAMETER}`", "str", f"`{DIRECTORY}`", "start", box.description)],
    )
    yield "The recorder has no parameters of its own; its options are [below](#record)."
    yield ""


def parameter_table(parameters: Table) -> Iterator[str]:
    """One node's parameters."""
    rows = [
        (
            f"`{parameter.name}`",
            parameter.kind,
            f"`{default(parameter)}`",
            parameter.unit,
            accepted(parameter),
            "start" if parameter.read_only else "",
            parameter.description,
        )
        for parameter in parameters.values()
    ]
    yield from table(("name", "type", "default", "unit", "accepted", "", "meaning"), rows)


def default(parameter: Parameter) -> str:
    """The default as people type it."""
    value = parameter.default
    if isinstance(value, bool):
        return str(value).lower()
    return '""' if value == "" else str(value)


def accepted(parameter: Parameter) -> str:
    """The accepted values, without the unit, which has a column of its own."""
    if parameter.choices:
        # schemes of other packages are nothing the project knows of
        ours = [c for c in parameter.choices if parameter.name != "scheme" or c in SCHEMES]
        return ", ".join(f"`{choice}`" for choice in ours)
    return parameter.limits.removesuffix(f" {parameter.unit}")


# --- Faults, schemes, files -----------------------------------------------------------------------


def of_faults() -> Iterator[str]:
    """Fault codes and injections."""
    yield "## Fault codes"
    yield ""
    yield "As in `drive_status`, `/diagnostics` and the log. When each comes, and what follows:"
    yield "[reliability](reliability.md)."
    yield ""
    rows = []
    sources = (("pmsm_sim", plant_protection), ("mfpcc_controller", controller_protection))
    for node, protection in sources:
        for fault in protection.FAULTS.rows:
            threshold = f"`{fault.threshold.name}`" if fault.threshold is not None else ""
            says = " or: ".join(filter(None, (fault.text, fault.text_of_value)))
            rows.append(
                (f"`{fault.code}`", node, threshold, fault.reaction, re.sub(r"\{.*?\}", "…", says))
            )
    yield from table(("code", "seen by", "threshold", "what follows", "it says"), rows)
    yield "## Injected faults"
    yield ""
    yield (
        "Units and types of the parameter `injections`; see [reliability](reliability.md). The "
        "magnitude holds where none is given."
    )
    yield ""
    yield from table(
        ("unit", "types", "magnitude"),
        [
            (
                f"`{unit}`",
                ", ".join(f"`{t}`" for t in types),
                f"{MAGNITUDES[unit]:g} {MAGNITUDE_UNITS[unit]}".strip(),
            )
            for unit, types in UNITS.items()
        ],
    )


def of_metrics() -> Iterator[str]:
    """The figures of merit, from their entries."""
    yield "## Figures of merit"
    yield ""
    yield (
        "These are the figures in `metrics.json`; a dot goes into a group. A figure is null where "
        "the evaluation window does not offer what it needs, and `notes` then says why. Less is "
        "better where the last column says so; the lowest is then marked in tables. What else "
        "stands in the file is explained in [experiments](experiments.md#figures-of-merit)."
    )
    yield ""
    yield from table(
        ("Key", "Name", "Unit", "Meaning", "Needs", "Better"),
        (
            (
                f"`{metric.key}`",
                metric.title,
                metric.unit,
                metric.meaning,
                ", ".join(need.value for need in Need if need in metric.needs),
                "less" if metric.less_is_better else "",
            )
            for metric in METRICS
        ),
    )
    yield ""


def first_sentence(text: str) -> str:
    """The first sentence of a docstring."""
    flat = " ".join(text.split("\n\n")[0].split())
    return re.split(r"(?<=[a-z)])\.(?:\s|$)", flat)[0]


def of_files() -> Iterator[str]:
    """Schemes, experiments and motors."""
    yield "## Schemes"
    yield ""
    yield "Values of `scheme`, besides those of [packages of your own](own_scheme.md)."
    yield ""
    rows = []
    for name in SCHEMES:
        module = importlib.import_module(f"mfpcc_controller.schemes.{name}")
        rows.append((f"`{name}`", first_sentence(module.__doc__ or "")))
    yield from table(("scheme", "it is"), rows)
    yield "## Experiments"
    yield ""
    plans = [scenario.load(path) for path in yaml_files.available("experiments").values()]
    yield from table(
        ("experiment", "motor", "duration (s)", "evaluated (s)", "what happens"),
        [
            (
                f"`{plan.name}`",
                f"`{plan.motor}`",
                f"{plan.duration:g}",
                "{:g} to {:g}".format(*plan.window_s),
                plan.description,
            )
            for plan in plans
        ],
    )
    yield "## Motors"
    yield ""
    machines = [motor.load(name) for name in yaml_files.available("motors")]
    yield from table(
        ("motor", "it is", "where its values come from"),
        [(f"`{machine.name}`", machine.description, machine.source) for machine in machines],
    )


# --- Commands -------------------------------------------------------------------------------------


def of_commands() -> Iterator[str]:
    """The help of every command."""
    yield "## The command mfpcc"
    yield ""
    top = click.Context(cli, info_name="mfpcc", terminal_width=90, **cli.context_settings)
    verbs = cast(click.Group, cli)
    for name in verbs.list_commands(top):
        command = verbs.get_command(top, name)
        assert command is not None
        yield f"### mfpcc {name}"
        yield ""
        context = click.Context(command, parent=top, info_name=name, terminal_width=90)
        yield from block(command.get_help(context))
    yield "## Executables with options of their own"
    yield ""
    for name in ("record", "replay"):
        yield f"### {name}"
        yield ""
        yield from block(output_of("ros2", "run", "mfpcc_experiments", name, "--help"))
    yield "## Launch files"
    yield ""
    for file in sorted((ROOT / "src/mfpcc_experiments/launch").iterdir()):
        if file.suffix == ".py":
            yield f"### {file.name}"
            yield ""
            shown = output_of("ros2", "launch", "mfpcc_experiments", file.name, "--show-args")
            yield from block(shown)


def output_of(*command: str) -> str:
    """What a command prints."""
    environment = {**os.environ, "COLUMNS": "90"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return done.stdout


def main() -> None:
    """Write the page."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs/reference.md"
    with all_nodes() as nodes:
        lines = [
            *of_nodes(nodes),
            *of_messages(),
            *of_parameters(nodes[-1].describe_parameter(PARAMETER)),
            *of_faults(),
            *of_metrics(),
            *of_files(),
            *of_commands(),
        ]
    path.write_text(HEAD + "\n".join(lines).rstrip() + "\n")


if __name__ == "__main__":
    main()

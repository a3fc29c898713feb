"""The composed drive for an hour of simulated time, without rest: `make soak`.

References, load, DC-link voltage, noise, scheme and the controller's model change all the time, at
random from a seed, through the checks that a change from outside goes through. Lost periods, a
fault, or memory that grows beyond chance make the exit code 1. Ctrl-C ends it early, with the
report so far.

`--record` records all of it as `mfpcc run` does, and counts the messages of the bag at the end.
`--separate` has the controller in a process of its own, and no black box.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import drives
import numpy as np
import yaml
from mfpcc_msgs.msg import DriveStatus
from numpy.typing import NDArray
from rcl_interfaces.msg import Log
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from rich.console import Console
from rich.table import Table

from mfpcc_controller.node import MfpccController
from mfpcc_controller.parameters import SCHEMES
from mfpcc_experiments.bags import LOOP_TOPICS, BagWriter
from mfpcc_experiments.graph import BlackBoxNode, session
from mfpcc_experiments.graph.recorder import Recorder
from pmsm_sim.node import PmsmSim
from pwm_node import interrupts
from pwm_node.ros import spin
from pwm_node.ros.node import PwmNode

#: Changes of either node come at random, so many a second on average.
CHANGES_PER_SECOND = 5.0

#: Reversals at the current limit of the motor would add to the ripple of a scheme that applies one
#: vector per period, and trip the drive rightly.
CONTROLLER = {"torque_limit": 7.0}

#: Of a controller in a process of its own: how fast the machine is must not decide.
PATIENT = {"fault.feedback_timeout": 0.0}

#: Share of the run after which memory counts: until then tables, rings and histories fill.
WARM_UP = 0.1
#: The rest is divided into so many blocks, whose means are the points of the regression: memory is
#: taken in pieces, so neighbouring samples are no independent ones.
BLOCKS = 20
#: Growth below this is one piece that the allocator has taken (MB).
PIECE = 1.0
#: What a bag's index takes until the bag is finished (MB/h): 150 bytes for each chunk of 40 ms.
INDEX = 13.5

_SAMPLES = 2000  # of the memory, over the whole run
_LOOK_EVERY = 0.25  # s
_LAST_WITHIN = 10.0  # s
_PAGE = os.sysconf("SC_PAGE_SIZE")

Change = Callable[[np.random.Generator], Mapping[str, Any]]


# --- Changes -------------------------------------------------------------------------------------


def plant_change(rng: np.random.Generator) -> Mapping[str, Any]:
    """Something else for the plant, within what the drive has to stand."""
    return (
        {"load_torque": rng.uniform(-4.0, 4.0)},
        {"dc_voltage": rng.uniform(280.0, 340.0)},
        {"noise.current_rms": rng.uniform(0.0, 0.05)},
    )[rng.integers(3)]


def controller_change(rng: np.random.Generator) -> Mapping[str, Any]:
    """A new reference, scheme, or model of the motor."""

    def ratio(most: float) -> float:
        return math.exp(rng.uniform(-math.log(most), math.log(most)))

    return (
        {"speed_ref_rpm": rng.uniform(-1000.0, 1000.0)},
        {"scheme": str(rng.choice(SCHEMES))},
        {
            "mismatch.inductance": ratio(2.0),
            "mismatch.resistance": ratio(4.0),
            "mismatch.flux": ratio(1.3),
        },
    )[rng.integers(3)]


class Restless(PwmNode):
    """A node that changes its own parameters, in periods and to values that follow from a seed."""

    _change: Change
    _rng: np.random.Generator

    def begin_changes(self, change: Change, seed: int, number: int) -> None:
        """Begin with period 0; `number` tells nodes of the same seed apart."""
        self._change, self._rng = change, np.random.default_rng([seed, number])
        self.next_change = 0
        # Their history is bounded, and filling it is no growth: full from the start.
        self.changes.extend(
            {"period": -1000 - n, "name": "load_torque", "value": float(n), "was": 0.0}
            for n in range(self.changes.maxlen or 0)
        )

    def apply_due(self, period: int) -> None:
        """Change something, and choose when to do so again."""
        wish = [Parameter(name, value=value) for name, value in self._change(self._rng).items()]
        answer = self.set_parameters_atomically(wish)
        if not answer.successful:
            raise RuntimeError(f"period {period}: {answer.reason}")
        mean = self.values["pwm_frequency"] / CHANGES_PER_SECOND
        self.next_change = period + int(self._rng.integers(1, 2 * mean))


class Plant(Restless, PmsmSim):
    """The plant, restless."""


class Controller(Restless, MfpccController):
    """The controller, restless."""


def make_controller(seed: int, more: Mapping[str, Any], **options: Any) -> Controller:
    """A controller that changes by this seed."""
    node = Controller(parameter_overrides=session.overrides({**CONTROLLER, **more}), **options)
    node.begin_changes(controller_change, seed, 1)
    return node


def controller_process() -> int:
    """Run the controller in this process until it is stopped; then tell its parent."""
    seed, more = json.loads(sys.argv[2])
    made: list[Controller] = []
    code = spin.main(lambda: made.append(make_controller(seed, more)) or made[0], args=[])
    print(json.dumps({"lost_periods": made[0].lost_periods if made else None}))
    return code


# --- Watching ------------------------------------------------------------------------------------


class PeriodTimes:
    """Wall-clock times of all periods, in classes 1 % wide: the memory does not grow with them."""

    def __init__(self) -> None:
        self.counts = np.zeros(2000, np.int64)  # from 1 us on, to 400 s
        self.longest = 0.0
        self.began = math.nan  # by the monotonic clock (s)
        self._before = 0

    def tick(self) -> None:
        """A period begins."""
        now = time.perf_counter_ns()
        if not self._before:
            self.began, self._before = time.monotonic(), now
            return
        us = (now - self._before) * 1e-3
        self._before = now
        if us > self.longest:
            self.longest = us
        self.counts[min(int(100.0 * math.log(us)), 1999) if us > 1.0 else 0] += 1

    def percentile(self, share: float) -> float:
        """Time within which this share of the periods was done (us)."""
        ordered = np.cumsum(self.counts)
        return math.exp((int(np.searchsorted(ordered, share * ordered[-1])) + 0.5) / 100.0)


@dataclass
class Soak:
    """What is seen of the drive while it runs.

    Attributes
    ----------
    periods : int
        To be run.
    times : PeriodTimes
    memory : ndarray, shape (samples, 2)
        Simulated time (h) and resident memory (MB); there from the start, so that it does not grow.
    samples : int
        How many there are.
    faults : dict of str
        What was latched, by node and code.
    log_lines, log_bytes : int
        What came on ``/rosout``.
    controller : Popen, optional
        Of the controller, if it is a process of its own.
    """

    periods: int
    times: PeriodTimes = field(default_factory=PeriodTimes)
    memory: NDArray[np.float64] = field(default_factory=lambda: np.ones((_SAMPLES + 1, 2)))
    samples: int = 0
    faults: dict[tuple[str, str], str] = field(default_factory=dict)
    log_lines: int = 0
    log_bytes: int = 0
    over: Future = field(default_factory=Future)
    controller: subprocess.Popen[str] | None = None

    def on_log(self, message: Log) -> None:
        """Count a line of log."""
        self.log_lines += 1
        self.log_bytes += len(message.msg)

    def on_status(self, message: DriveStatus) -> None:
        """A fault ends the run: nothing here should lead to one."""
        for fault in message.faults:
            self.faults[message.node, fault.code] = f"in period {fault.period}: {fault.detail}"
        if message.faults:
            self._end()

    def _end(self) -> None:
        if not self.over.done():
            self.over.set_result(None)

    def look(self, plant: PwmNode) -> None:
        """Sample the memory, and say how far it is."""
        if self.controller is not None and self.controller.poll() is not None:
            self._end()
        hours = max(plant.period, 0) / plant.values["pwm_frequency"] / 3600.0
        if plant.period < self.samples * self.periods / _SAMPLES:
            return
        megabytes = resident()
        if self.controller is not None:
            megabytes += resident(self.controller.pid)
        self.memory[self.samples] = hours, megabytes
        self.samples += 1
        if sys.stderr.isatty():
            wall = time.monotonic() - self.times.began
            print(
                f"\r{60.0 * hours:.1f} of {self.periods / 6e5:g} min simulated, "
                f"{3600.0 * hours / wall:.2f} times real time, {megabytes:.0f} MB ",
                end="",
                file=sys.stderr,
                flush=True,
            )


def resident(process: int | str = "self") -> float:
    """Memory of a process that is in use (MB)."""
    try:
        return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * _PAGE / 1e6
    except OSError:
        return 0.0  # it has ended


# --- The report ----------------------------------------------------------------------------------


@dataclass
class Slope:
    """Growth of the memory by simulated time, with its standard error (MB/h), and in all (MB).

    `expected` is what of it a recording needs (MB/h).
    """

    value: float
    error: float
    growth: float
    expected: float = 0.0

    @property
    def significant(self) -> bool:
        """Whether it is more than needed by more than chance (3 standard errors) and a piece."""
        unexpected = self.value - self.expected
        hours = self.growth / self.value if self.value else 0.0
        return unexpected > 3.0 * self.error and unexpected * hours > PIECE

    @property
    def in_all(self) -> str:
        """Growth over the run, and what that means."""
        index = f", and {self.expected:g} MB/h for the index" if self.expected else ""
        verdict = "it grows" if self.significant else f"0 within noise{index}"
        return f"{self.growth:+.2f} MB: {verdict}"

    def __str__(self) -> str:
        return f"{self.value:+.2f} +- {self.error:.2f} MB/h"


def slope(memory: NDArray[np.float64], expected: float) -> Slope | None:
    """Regression over the means of blocks after the warm-up; None where there are too few."""
    samples = memory[int(WARM_UP * len(memory)) :]
    if len(samples) < 2 * BLOCKS:
        return None
    t, y = np.array([block.mean(axis=0) for block in np.array_split(samples, BLOCKS)]).T
    (value, _), covariance = np.polyfit(t, y, 1, cov=True)
    return Slope(
        value, math.sqrt(covariance[0, 0]), value * (samples[-1, 0] - samples[0, 0]), expected
    )


def report(soak: Soak, plant: Plant, lost: int, wall: float, bag: Path | None) -> int:
    """Print what was seen; returns the exit code."""
    # stopped early, the period at hand is one of them
    done = plant.period + (not plant.finished.done())
    simulated = done / plant.values["pwm_frequency"]
    lost += int(plant.core.st["missed"][0])
    memory = soak.memory[: soak.samples]
    growth = slope(memory, 0.0 if bag is None else INDEX)
    percentile = soak.times.percentile
    rows = [
        ("simulated", f"{simulated / 60.0:.1f} of {soak.periods / 6e5:g} min", ""),
        ("real-time factor", f"{simulated / wall:.2f}", ""),
        ("periods lost or missed", str(lost), "0"),
        ("faults", ", ".join(f"{n} {c}" for n, c in soak.faults) or "none", "none"),
        (
            "memory at the end, largest",
            f"{memory[-1, 1]:.1f}, {memory[:, 1].max():.1f} MB",
            "",
        ),
        ("slope of the memory", str(growth or "run too short to tell"), "0 within noise"),
        ("growth of the memory in all", growth.in_all if growth else "", ""),
        ("period, 50 %", f"{percentile(0.5):.1f} us", ""),
        ("period, 99 %", f"{percentile(0.99):.1f} us", ""),
        ("period, 99.9 %", f"{percentile(0.999):.0f} us", ""),
        ("period, longest", f"{soak.times.longest / 1e3:.1f} ms", ""),
        ("log", f"{soak.log_lines} lines, {soak.log_bytes} bytes", ""),
    ]
    missing = 0
    if bag is not None:
        counts, size = recorded(bag)
        missing = sum(abs(done - counts.get(topic, 0)) for topic in LOOP_TOPICS)
        rows += [
            ("recorded, of each topic", f"{min(counts.values()):,}", f"{done:,}"),
            ("recording", f"{size / 1e9:.2f} GB, {size / done:.0f} B per period", ""),
        ]
    table = Table()
    table.add_column("soak")
    table.add_column("measured", justify="right")
    table.add_column("asked for")
    for row in rows:
        table.add_row(*row)
    Console().print(table)
    for (node, code), what in soak.faults.items():
        print(f"{node}: {code} {what}")
    grows = growth is not None and growth.significant
    return int(bool(lost or missing or soak.faults or grows))


def recorded(bag: Path) -> tuple[dict[str, int], int]:
    """Messages of a bag by topic, and its size (bytes)."""
    info = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    counts = {
        topic["topic_metadata"]["name"].lstrip("/"): int(topic["message_count"])
        for topic in info["topics_with_message_count"]
    }
    return counts, sum(file.stat().st_size for file in bag.iterdir())


# --- The run -------------------------------------------------------------------------------------


def main() -> int:
    """Run the drive, and report."""
    arguments = _arguments()
    # A graph of its own, unless one is given: a drive that somebody runs here is not to be met.
    os.environ.setdefault("ROS_DOMAIN_ID", drives.own_domain())
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    soak = Soak(periods=round(arguments.minutes * 60e4))
    bag: Path | None = arguments.out / "recording" if arguments.record else None
    with contextlib.ExitStack() as stack:
        context = stack.enter_context(drives.graph())
        wishes = {"periods": soak.periods, "seed": arguments.seed}
        plant = Plant(context=context, parameter_overrides=session.overrides(wishes))
        stack.callback(plant.destroy_node)
        plant.begin_changes(plant_change, arguments.seed, 0)
        nodes: list[Node] = [plant]
        writer = None
        if bag is not None:
            writer = stack.enter_context(BagWriter(bag, config={"engine": "ros"}, force=True))
        if arguments.separate:
            watch = Node("watch", context=context)
            if writer is not None:
                answers = ("duty_command", "lut_diagnostics")
                nodes.append(Recorder(writer, topics=answers, context=context))
            soak.controller = stack.enter_context(
                _process(arguments.seed, recorders=len(nodes) - 1, **PATIENT)
            )
        else:
            nodes.append(make_controller(arguments.seed, {}, context=context))
            out = {"black_box": str(arguments.out)}
            watch = BlackBoxNode(nodes, context=context, parameter_overrides=session.overrides(out))
        nodes.append(watch)
        for node in nodes[1:]:
            stack.callback(node.destroy_node)
        _tap(nodes, soak.times, writer)
        latest = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        watch.create_subscription(DriveStatus, "drive_status", soak.on_status, latest)
        watch.create_subscription(Log, "/rosout", soak.on_log, 1000)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        watch.create_timer(_LOOK_EVERY, lambda: soak.look(plant), clock=steady)
        code = spin.run(nodes, until=soak.over)
        wall = time.monotonic() - soak.times.began
        print(file=sys.stderr)
        if not soak.samples:
            return code or 1  # it has not begun; why was said
        if soak.controller is None:
            lost = nodes[1].lost_periods
        else:
            soak.controller.terminate()
            lost = json.loads(soak.controller.communicate()[0])["lost_periods"]
        for node in nodes:
            if isinstance(node, Recorder):
                _take_the_rest(node, plant.period)
        if writer is not None:
            writer.close()
        return code or report(soak, plant, lost, wall, bag)


def _take_the_rest(recorder: Recorder, periods: int) -> None:
    """Take what the controller has published last: it may come after the end of the run."""
    deadline = time.monotonic() + _LAST_WITHIN
    last = recorder.last_period
    while last["duty_command"] < periods or last["lut_diagnostics"] < periods - 1:
        if time.monotonic() > deadline:
            return  # the count of the messages will tell
        recorder.take_all()
        time.sleep(0.001)


@contextlib.contextmanager
def _process(seed: int, **values: Any) -> Iterator[subprocess.Popen[str]]:
    """The controller in a process of its own."""
    command = [sys.executable, __file__, "--controller", json.dumps([seed, values])]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=interrupts.ending_with_this_process(),
    ) as process:
        try:
            yield process
        finally:
            process.terminate()


def _tap(nodes: Sequence[Node], times: PeriodTimes, writer: BagWriter | None) -> None:
    """Look at the clock with each sample, and hand every message to the recording."""

    def tapped(node: PwmNode) -> Callable[[str], Callable[[bytes], None]]:
        keep = node.tap

        def tap(topic: str) -> Callable[[bytes], None]:
            sinks = [] if keep is None else [keep(topic)]
            if writer is not None:
                sinks.append(session.sink(writer, topic))
            tick = times.tick if topic == "phase_feedback" else None

            def take(data: bytes) -> None:
                if tick is not None:
                    tick()
                for sink in sinks:
                    sink(data)

            return take

        return tap

    for node in nodes:
        if isinstance(node, PwmNode):
            node.tap = tapped(node)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="simulated time (60)")
    parser.add_argument("--seed", type=int, default=0, help="of all that is random (0)")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/soak"),
        help="where a fault, which should not be, leaves its bag, and the recording is (out/soak)",
    )
    parser.add_argument("--record", action="store_true", help="record every message")
    parser.add_argument(
        "--separate", action="store_true", help="the controller in a process of its own"
    )
    return parser.parse_args()


if __name__ == "__main__":
    if sys.argv[1:2] == ["--controller"]:
        interrupts.run("soak:controller_process", node=True)
    sys.exit(main())

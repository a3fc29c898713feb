"""The drive against every fault there is, judged by what truly happens in the plant.

Each case injects one fault into a running closed loop and asks, of the truth and not of what the
drive believes:

- was the fault really there: does the run differ from the same run without it;
- did the current stay below the trip limit and what one period can add to it;
- were the gates off in the period of the trip (the inverter's), or in the next (the controller's);
- did nothing restart by itself after the fault had gone;
- did the drive find what has to be found, and call it by a name that fits;
- did the current fall, and the gates stay on, where less current is all that is needed;
- was every command that left the controller a valid one.

The negative control runs the same cases with the reaction switched off, and has to see damage.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mfpcc_msgs.msg import DriveState, DutyCommand, PhaseFeedback
from numpy.typing import NDArray

from mfpcc_controller.controller import Controller
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.running import Engine
from pmsm_sim.parameters import TABLE as PLANT
from pmsm_sim.parts.injection import UNITS
from pmsm_sim.parts.protection import OVERCURRENT
from pmsm_sim.plant import Plant
from pwm_node import bits
from pwm_node.ros import ros_environment
from pwm_node.wire import fixed_dtype, fixed_size

#: Current amplitude (A) that only a drive without protection reaches: the trip limit of seed_750,
#: and what one period adds.
DAMAGE = 22.0

_START, _DURATION = 0.05, 0.1  # s
_PERIODS = 2500
_WARM = 95.0  # K: 115 degC, at which less current is allowed, but some
_CONTROLLED = 1.0  # A: so far may the current be off its reference
_NOISE = 0.0245  # A


@dataclass(frozen=True)
class Point:
    """An operating point: scheme, speed (r/min) and load (N m)."""

    scheme: str
    speed_rpm: float
    load: float

    def __str__(self) -> str:
        return f"{self.scheme} {self.speed_rpm:g} r/min {self.load:g} N m"


POINTS = (
    Point("mls_mfpcc", 750.0, 2.0),
    Point("mbpcc", 1200.0, 5.0),
    Point("pi_foc", -300.0, 3.0),
    Point("mfpcc", 1500.0, 8.0),
)


@dataclass(frozen=True)
class Case:
    """One fault at one operating point; without a magnitude, with that of its unit."""

    unit: str
    kind: str
    point: Point
    magnitude: float | None = None

    @property
    def injection(self) -> str:
        """As the plant's parameter wants it."""
        magnitude = "" if self.magnitude is None else f" {self.magnitude:g}"
        return f"{_START} {_DURATION} {self.unit} {self.kind}{magnitude}"


@dataclass(frozen=True)
class Verdict:
    """What a case showed.

    Attributes
    ----------
    case : Case
    codes : tuple of str
        What was latched, in the order of time.
    tripped_after : float
        From the start of the fault to gates off (s); NaN without a trip.
    current : float
        Largest true current amplitude (A).
    failures : tuple of str
        Why the drive has not survived; empty if it has.
    """

    case: Case
    codes: tuple[str, ...]
    tripped_after: float
    current: float
    failures: tuple[str, ...]

    @property
    def survived(self) -> bool:
        """Whether all was as it must be."""
        return not self.failures


# Names that fit the first thing found. What follows from a fault (a current that runs away) may
# be seen before the fault itself.
_LOOP = {"OVERCURRENT", "PREDICTION", "SPINOUT", "SCHEME"}
_FITTING: dict[str, set[str]] = {
    "current": {"CURRENT_SUM", "FEEDBACK_INVALID", *_LOOP},
    "encoder": {"ENCODER", "FEEDBACK_INVALID", "OVERSPEED", *_LOOP},
    "dc_sensor": {"FEEDBACK_INVALID", *_LOOP},
    "dc_link": {"DC_OVERVOLTAGE", "DC_UNDERVOLTAGE", *_LOOP},
    "leg": {*_LOOP},
    "duty_link": {"COMMAND_LOST", "ENCODER", "OVERSPEED", *_LOOP},
    "feedback_link": {
        "COMMAND_LOST",
        "FEEDBACK_LOST",
        "FEEDBACK_INVALID",
        "ENCODER",
        *_LOOP,
    },
    "load": {"OVERSPEED", "ENCODER", *_LOOP},
    "temperature": {"OVERTEMPERATURE"},
}
# What has to be found, whatever the operating point.
_REQUIRED: dict[tuple[str, str], str] = {
    ("dc_sensor", "off"): "FEEDBACK_INVALID",
    ("dc_link", "off"): "DC_UNDERVOLTAGE",
    ("dc_link", "wrong"): "DC_OVERVOLTAGE",
    ("dc_link", "slow"): "DC_OVERVOLTAGE",
    ("duty_link", "off"): "COMMAND_LOST",
    ("duty_link", "dropped"): "COMMAND_LOST",
    ("duty_link", "garbage"): "COMMAND_LOST",
    ("duty_link", "delayed"): "COMMAND_LOST",
    ("feedback_link", "off"): "COMMAND_LOST",
    ("feedback_link", "dropped"): "COMMAND_LOST",
    ("feedback_link", "garbage"): "FEEDBACK_INVALID",
    ("feedback_link", "delayed"): "FEEDBACK_INVALID",
    ("feedback_link", "stuck"): "ENCODER",
    ("temperature", "wrong"): "OVERTEMPERATURE",
    ("encoder", "stuck"): "ENCODER",
    ("encoder", "wrong"): "ENCODER",
    ("encoder", "off"): "ENCODER",
    ("encoder", "intermittent"): "ENCODER",
    ("temperature", "slow"): "OVERTEMPERATURE",
    **{(f"current_{x}", "garbage"): "" for x in "abc"},  # found, under one name or another
    **{(f"current_{x}", "wrong"): "CURRENT_SUM" for x in "abc"},
    **{(f"current_{x}", "off"): "CURRENT_SUM" for x in "abc"},
}


def cases(points: Sequence[Point] = POINTS) -> list[Case]:
    """The whole matrix: every unit with every type it has, at every operating point.

    And a temperature that does not trip yet, at each of them.
    """
    return [
        case
        for point in points
        for case in (
            *(Case(unit, kind, point) for unit, kinds in UNITS.items() for kind in kinds),
            Case("temperature", "slow", point, _WARM),
        )
    ]


def judge_all(
    chosen: Sequence[Case],
    *,
    engine: str = "inprocess",
    react: bool = True,
    tell: Callable[[int], None] = lambda n: None,
) -> list[Verdict]:
    """
    Run cases one after the other.

    Parameters
    ----------
    chosen : sequence of Case
        The cases.
    engine : str
        `inprocess`, or `ros`: both nodes over real topics.
    react : bool
        False: without any protection.
    tell : callable
        Called with the number of cases done.

    Raises
    ------
    mfpcc_experiments.graph.session.DriveError
        If the graph cannot be used (engine `ros`).
    """
    if engine == "inprocess":
        return list(_judged(chosen, _run_in_process, react, tell))
    # rclpy is needed for this engine only
    ros_environment.check()
    from mfpcc_experiments.graph import composed

    with composed.runs() as run:

        def run_on_graph(plant: dict[str, Any], controller: dict[str, Any]) -> _Run:
            found = run(plant, controller)
            return _Run(
                found.plant,
                found.controller,
                state=_fixed(DriveState, found.messages.get("drive_state", [])),
                feedback=_fixed(PhaseFeedback, found.messages.get("phase_feedback", [])),
                command=_fixed(DutyCommand, found.messages.get("duty_command", [])),
            )

        return list(_judged(chosen, run_on_graph, react, tell))


@dataclass(frozen=True)
class _Run:
    """What truly happened, and what was latched: plant and controller as they were at the end."""

    plant: Plant
    controller: Controller
    state: NDArray[np.void]
    feedback: NDArray[np.void]
    command: NDArray[np.void]

    @property
    def T_s(self) -> float:
        """PWM period (s)."""
        return float(self.plant.par["T_s"][0])

    @property
    def current(self) -> NDArray[np.float64]:
        """True current amplitude (A)."""
        return np.hypot(self.state["i_dq"][:, 0], self.state["i_dq"][:, 1])

    @property
    def limit(self) -> float:
        """Current (A) that trips the inverter, and what a period at full voltage can add to it."""
        par = self.plant.par[0]
        # back-EMF added
        rise = 1.5 * par["dc_voltage"] / min(par["L_d"], par["L_q"]) * par["T_s"]
        return float(par["limit"][OVERCURRENT] + rise)

    @property
    def counted(self) -> tuple[int, int]:
        """Commands and samples that were refused."""
        refused, invalid = self.plant.st["refused"], self.controller.mem["guard"]["invalid"]
        return int(refused[0]), int(invalid[0])


_Runner = Callable[[dict[str, Any], dict[str, Any]], _Run]


def _run_in_process(plant: dict[str, Any], controller: dict[str, Any]) -> _Run:
    engine = Engine(plant, controller)
    traces = list(engine.run(plant["periods"]))
    return _Run(
        engine.plant,
        engine.controller,
        state=np.concatenate([trace.state for trace in traces]),
        feedback=np.concatenate([trace.feedback for trace in traces]),
        command=np.concatenate([trace.command for trace in traces]),
    )


def _fixed(msg_class: Any, messages: Sequence[bytes]) -> NDArray[np.void]:
    """The fields of fixed size of serialized messages, one row each."""
    size = fixed_size(msg_class)
    rows = np.zeros(len(messages), fixed_dtype(msg_class))
    data = b"".join(message[4 : 4 + size] for message in messages)
    rows.view(np.uint8).reshape(len(rows), -1)[:, :size] = np.frombuffer(data, np.uint8).reshape(
        len(rows), size
    )
    return rows


def _judged(
    chosen: Sequence[Case], run: _Runner, react: bool, tell: Callable[[int], None]
) -> Iterator[Verdict]:
    unharmed: dict[tuple[Point, str], _Run] = {}
    for number, case in enumerate(chosen, start=1):
        # a sensor that is slow or stuck shows the truth where the truth is constant
        supply = "rectifier" if case.unit == "dc_sensor" else "stiff"
        same = case.point, supply
        if same not in unharmed:
            unharmed[same] = run(*_values(case.point, supply, [], react))
        harmed = run(*_values(case.point, supply, [case.injection], react))
        yield _judge(case, harmed, unharmed[same])
        tell(number)


def _values(
    point: Point, supply: str, injections: list[str], react: bool
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Parameters of plant and controller."""
    plant = {
        "initial_speed_rpm": point.speed_rpm,
        "load_torque": point.load,
        "noise.current_rms": _NOISE,
        "dc_link.kind": supply,
        "fault_injection": True,
        "injections": injections,
        "fault.react": react,
        "periods": _PERIODS,
    }
    controller = {
        "scheme": point.scheme,
        "speed_ref_rpm": point.speed_rpm,
        "fault.react": react,
        "fault.feedback_timeout": 0.0,  # the verdict must not depend on how fast the machine is
    }
    return PLANT.complete(plant), CONTROLLER.complete(controller)


def _judge(case: Case, run: _Run, unharmed: _Run) -> Verdict:
    state, T_s = run.state, run.T_s
    begin = round(_START / T_s)
    current = float(np.max(run.current))
    found = sorted(run.plant.faults() + run.controller.faults(), key=lambda fault: fault[1])
    codes = tuple(code for code, _, _ in found)
    failures = []

    if len(state) < _PERIODS:
        failures.append(f"the loop stood still after {len(state)} periods")
    if not _was_there(run, unharmed, begin):
        failures.append("the fault was not there")
    if not current <= run.limit:
        failures.append(f"{current:.1f} A, limit {run.limit:.1f} A")
    if not np.all(abs(run.command["duty"] - 0.5) <= 0.5):  # NaN is not
        failures.append("a command that is not valid left the controller")

    off = np.flatnonzero(~state["gates_on"])
    tripped = run.plant.tripped or run.controller.tripped
    if tripped:
        first_off = int(off[0]) if len(off) else len(state)
        stops = [period for code, period, _ in found if code not in _NO_STOP]
        latched_at = min(stops, default=first_off)
        # The command that disables is computed in a period, and acts from the next; if the link
        # is what fails, the inverter's own limit of missing commands does it.
        allowed = 11 if case.unit.endswith("_link") else 1
        if first_off > latched_at + allowed:
            failures.append(f"gates off {first_off - latched_at} periods after the trip")
        if state["gates_on"][first_off:].any():
            failures.append("power returned by itself")
    elif len(off):
        failures.append("gates off without a trip")
    if case.magnitude is not None:
        failures += _not_derated(run, codes)

    fitting = _FITTING[case.unit.rsplit("_", 1)[0] if case.unit[-2] == "_" else case.unit]
    if codes and codes[0] not in fitting:
        failures.append(f"{codes[0]} does not fit")
    required = _REQUIRED.get((case.unit, case.kind)) if case.magnitude is None else None
    if required is not None and not (required in codes if required else codes):
        failures.append(f"{required or 'it'} was not found")
    after = (off[0] - begin) * T_s if tripped and len(off) else float("nan")
    return Verdict(case, codes, after, current, tuple(failures))


def _not_derated(run: _Run, codes: Sequence[str]) -> Iterator[str]:
    """What is wrong where the drive should have gone on with less current."""
    if codes:
        yield f"{codes[0]} where less current is enough"
    begin, middle = round(_START / run.T_s), round((_START + 0.5 * _DURATION) / run.T_s)
    derated = slice(middle, 2 * middle - begin)
    i_max = run.plant.motor.i_max
    allowed = run.feedback["derating"][derated] * i_max + _CONTROLLED
    if not np.all(run.current[derated] <= allowed):
        yield "more current than the inverter allows"
    if not np.min(allowed) < 0.5 * i_max:
        yield "no less current was allowed"


# Faults that bring the fallback scheme, and stop only if that fails too.
_NO_STOP = {"PREDICTION", "SCHEME"}


def _was_there(run: _Run, unharmed: _Run, begin: int) -> bool:
    same = all(
        bits.of(getattr(run, name)[begin - 2 :]) == bits.of(getattr(unharmed, name)[begin - 2 :])
        for name in ("state", "feedback")
    )
    return run.counted != unharmed.counted or not same

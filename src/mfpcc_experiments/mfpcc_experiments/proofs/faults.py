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
from mfpcc_experiments.proofs.fault_cases import DURATION, REQUIRED, START, Case
from mfpcc_experiments.running import Engine
from pmsm_sim.parameters import TABLE as PLANT
from pmsm_sim.parts.protection import OVERCURRENT
from pmsm_sim.plant import Plant
from pwm_node import bits
from pwm_node.ros import ros_environment
from pwm_node.wire import fixed_dtype, fixed_size

#: Current amplitude (A) that only a drive without protection reaches: the trip limit of seed_750,
#: and what one period adds.
DAMAGE = 22.0

_PERIODS = 2500
_CONTROLLED = 1.0  # A: so far may the current be off its reference
_NOISE = 0.0245  # A


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
    "load": {"OVERSPEED", "ENCODER", "STALL", *_LOOP},
    "temperature": {"OVERTEMPERATURE"},
}


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
        return list(judged(chosen, _run_in_process, react, tell))
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
                found=_latched(found.plant, found.controller),
                tripped=found.plant.tripped or found.controller.tripped,
            )

        return list(judged(chosen, run_on_graph, react, tell))


@dataclass(frozen=True)
class _Run:
    """What truly happened, and what was latched: plant and controller as they were at the end.

    `found` are code, period and node of what was latched; `returned` is what was wrong with the
    way in which the power returned afterwards.
    """

    plant: Plant
    controller: Controller
    state: NDArray[np.void]
    feedback: NDArray[np.void]
    command: NDArray[np.void]
    found: tuple[tuple[str, int, str], ...]
    tripped: bool
    returned: tuple[str, ...] = ()

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


Runner = Callable[[dict[str, Any], dict[str, Any]], _Run]


def _latched(plant: Plant, controller: Controller) -> tuple[tuple[str, int, str], ...]:
    """Code, period and node of what was latched, in the order of time."""
    return tuple(
        sorted(
            (
                (code, period, name)
                for name, part in (("inverter", plant), ("controller", controller))
                for code, period, _ in part.faults()
            ),
            key=lambda fault: fault[1],
        )
    )


def _run_in_process(plant: dict[str, Any], controller: dict[str, Any]) -> _Run:
    return run_engine(Engine(plant, controller), plant["periods"])


def run_engine(engine: Engine, periods: int) -> _Run:
    """Run a drive, and then see how its power returns."""
    traces = list(engine.run(periods))
    found = _latched(engine.plant, engine.controller)
    tripped = engine.plant.tripped or engine.controller.tripped
    return _Run(
        engine.plant,
        engine.controller,
        state=np.concatenate([trace.state for trace in traces]),
        feedback=np.concatenate([trace.feedback for trace in traces]),
        command=np.concatenate([trace.command for trace in traces]),
        found=found,
        tripped=tripped,
        returned=tuple(_return(engine)) if tripped else (),
    )


def _return(engine: Engine) -> Iterator[str]:
    """What is wrong with the way in which the power returns once the faults are cleared.

    The speed's reference is still where it was, and has to be at zero first.
    """
    plant, controller = engine.plant, engine.controller
    speed_ref = controller.values["speed_ref_rpm"]

    def gates(periods: int) -> NDArray[np.bool_]:
        traces = list(engine.run(periods))
        return np.concatenate([trace.state["gates_on"] for trace in traces])

    lasting = plant.clear_faults()
    if gates(3).any():
        yield "power returned when the inverter was cleared"
    lasting += controller.clear_faults()
    if gates(20).any():
        yield "power returned into a running set-point"
    if lasting:
        return  # a load that drives the motor while it is off, say
    controller.apply({"speed_ref_rpm": 0.0})
    if not gates(10)[-1]:
        yield "power does not return from a reference at zero"
    controller.apply({"speed_ref_rpm": speed_ref})
    plant.stop()
    plant.clear_faults()
    if gates(1).any():
        yield "power returned at once after a stop of the inverter"


def _fixed(msg_class: Any, messages: Sequence[bytes]) -> NDArray[np.void]:
    """The fields of fixed size of serialized messages, one row each."""
    size = fixed_size(msg_class)
    rows = np.zeros(len(messages), fixed_dtype(msg_class))
    data = b"".join(message[4 : 4 + size] for message in messages)
    rows.view(np.uint8).reshape(len(rows), -1)[:, :size] = np.frombuffer(data, np.uint8).reshape(
        len(rows), size
    )
    return rows


def judged(
    chosen: Sequence[Case], run: Runner, react: bool, tell: Callable[[int], None]
) -> Iterator[Verdict]:
    """As `judge_all`, with what runs a drive of the parameters of plant and controller."""
    unharmed: dict[Any, _Run] = {}
    for number, case in enumerate(chosen, start=1):
        # a sensor that is slow or stuck shows the truth where the truth is constant
        supply = "rectifier" if case.unit == "dc_sensor" else "stiff"
        same = case.point, supply, case.plant, case.controller
        if same not in unharmed:
            unharmed[same] = run(*_values(case, supply, [], react))
        harmed = run(*_values(case, supply, case.injections, react))
        yield _judge(case, harmed, unharmed[same])
        tell(number)


def _values(
    case: Case, supply: str, injections: list[str], react: bool
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Parameters of plant and controller."""
    point = case.point
    plant = {
        "initial_speed_rpm": point.speed_rpm,
        "load_torque": point.load,
        "noise.current_rms": _NOISE,
        "dc_link.kind": supply,
        "fault_injection": True,
        "injections": injections,
        "fault.react": react,
        "periods": _PERIODS,
        **dict(case.plant),
    }
    controller = {
        "scheme": point.scheme,
        "speed_ref_rpm": point.speed_rpm,
        "fault.react": react,
        "fault.feedback_timeout": 0.0,  # the verdict must not depend on how fast the machine is
        **dict(case.controller),
    }
    return PLANT.complete(plant), CONTROLLER.complete(controller)


def _judge(case: Case, run: _Run, unharmed: _Run) -> Verdict:
    state, T_s = run.state, run.T_s
    begin = round(START / T_s)
    current = float(np.max(run.current))
    found = run.found
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
    if run.tripped:
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
    if case.less_current:
        failures += _not_derated(run, codes)
    failures += run.returned

    fitting = _FITTING[case.unit.rsplit("_", 1)[0] if case.unit[-2] == "_" else case.unit]
    if codes and codes[0] not in fitting:
        failures.append(f"{codes[0]} does not fit")
    failures += _not_found(case, run, begin)
    after = (off[0] - begin) * T_s if run.tripped and len(off) else float("nan")
    return Verdict(case, codes, after, current, tuple(failures))


def _not_found(case: Case, run: _Run, begin: int) -> Iterator[str]:
    """What should have been found while the fault was there, and was not."""
    # what the link withholds is missed as soon as a sample comes again
    end = begin + round(DURATION / run.T_s) + 1
    first = begin - 10  # a sample that is late counts for the period whose number it has
    there = [(code, node) for code, period, node in run.found if first <= period <= end]
    names = {name for code, node in there for name in (code, f"{node} {code}")}
    required = REQUIRED.get((case.unit, case.kind)) if case.magnitude is None else None
    if required == "" and not names:
        yield "it was not found"
    for name in (*case.finds, *([required] if required else [])):
        if name not in names:
            yield f"{name} was not found"


def _not_derated(run: _Run, codes: Sequence[str]) -> Iterator[str]:
    """What is wrong where the drive should have gone on with less current."""
    if codes:
        yield f"{codes[0]} where less current is enough"
    begin, middle = round(START / run.T_s), round((START + 0.5 * DURATION) / run.T_s)
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

"""One experiment with one scheme, on either engine, into one recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mfpcc_msgs.msg import DriveState, DutyCommand, LutDiagnostics, PhaseFeedback
from numpy.typing import NDArray

from mfpcc_controller.controller import Controller
from mfpcc_experiments.bags import BagWriter, versions
from mfpcc_experiments.measuring.happened import latched
from mfpcc_experiments.progress import Tell
from mfpcc_experiments.running.engine import Engine, Trace, step_time
from mfpcc_experiments.running.scenario import Scenario
from pmsm_sim import motor
from pwm_node import ros_environment, stamps
from pwm_node.wire import Wire


def configuration(scenario: Scenario, scheme: str, engine: str, seed: int) -> dict[str, Any]:
    """All that a run can be repeated from: it is stored inside the recording."""
    plant, controller = scenario.node_parameters(scheme, seed)
    machine = motor.load(scenario.motor)
    return {
        "experiment": scenario.name,
        "scheme": scheme,
        "motor": machine.name,
        "engine": engine,
        "seed": seed,
        "T_s": 1.0 / scenario.pwm_frequency,
        "window_s": list(scenario.window_s),
        "n_p": machine.n_p,
        "R_s": machine.R_s,
        "scenario": scenario.model_dump(mode="json"),
        "parameters": {"pmsm_sim": plant, "mfpcc_controller": controller},
        "motor_file": machine.model_dump(mode="json"),
        "versions": versions(),
    }


def run(
    scenario: Scenario,
    scheme: str,
    engine: str,
    folder: Path,
    seed: int,
    progress: Tell,
    *,
    separate: bool = False,
) -> None:
    """Record the experiment into `<folder>/<scheme>`.

    Parameters
    ----------
    scenario : Scenario
        The experiment.
    scheme : str
        Who controls the current at the start.
    engine : str
        `ros`: the real graph; `inprocess`: the same kernels without it.
    folder : Path
        Where the recording goes.
    seed : int
        Seed of all noise.
    progress : callable
        Told the number of periods done, now and then.
    separate : bool
        Plant and controller as two processes (engine `ros`).

    Raises
    ------
    mfpcc_experiments.bags.BagError
        If the recording cannot be written.
    mfpcc_experiments.graph.drive.DriveError
        If the graph does not run to the end, or messages are lost (engine `ros`).
    pwm_node.ros_environment.RosError
        If ROS cannot start (engine `ros`).
    """
    config = configuration(scenario, scheme, engine, seed)
    if engine == "inprocess":
        _run_inprocess(config, folder / scheme, scenario.periods, progress)
        return
    # rclpy is needed for this engine only, and may end the process as soon as it is imported
    ros_environment.check(processes=2 if separate else 1)
    from mfpcc_experiments.graph import drive

    record = drive.record_separate if separate else drive.record_composed
    record(config, folder / scheme, scenario.periods, progress)


def _run_inprocess(config: dict[str, Any], path: Path, periods: int, progress: Tell) -> None:
    plant, controller = (config["parameters"][n] for n in ("pmsm_sim", "mfpcc_controller"))
    engine = Engine(plant, controller)
    samples = []
    with BagWriter(path, config=config, oversampling=plant["oversampling"]) as writer:
        for trace in engine.run(periods):
            write_trace(
                writer,
                trace,
                state_every=plant["state_decimation"],
                lut_every=controller["diagnostics_decimation"],
            )
            samples.append(trace.feedback)
            progress(engine.period)
        timing = step_time(Controller(controller), np.concatenate(samples))
        writer.close(
            {
                "step_time_us": timing,
                "lost_periods": 0,
                "faults": [
                    *latched("pmsm_sim", engine.plant.faults()),
                    *latched("mfpcc_controller", engine.controller.faults()),
                ],
            }
        )


def write_trace(
    writer: BagWriter, trace: Trace, *, state_every: int = 1, lut_every: int = 1
) -> None:
    """Append a piece of an in-process run to a recording, in the order of the real loop.

    Parameters
    ----------
    writer : BagWriter
        The recording.
    trace : Trace
        What passed.
    state_every, lut_every : int
        Decimation of `drive_state` and `lut_diagnostics`, as of the nodes' parameters; 0: none.
    """
    state = Wire(
        DriveState,
        i_abc_oversampled=trace.i_abc.shape[1],
        legs_oversampled=trace.legs.shape[1],
    )
    waveforms: dict[str, NDArray[Any]] = {
        "i_abc_oversampled": trace.i_abc,
        "legs_oversampled": trace.legs,
    }
    streams = (
        ("phase_feedback", trace.feedback, _serialized(Wire(PhaseFeedback), trace.feedback), 1),
        (
            "drive_state",
            trace.state,
            _serialized(state, trace.state, **waveforms),
            state_every,
        ),
        ("duty_command", trace.command, _serialized(Wire(DutyCommand), trace.command), 1),
        (
            "lut_diagnostics",
            trace.lut,
            _named(trace),
            lut_every,
        ),
    )
    topics = [
        (topic, stamps.nanoseconds(rows["stamp"]).tolist(), messages, every)
        for topic, rows, messages, every in streams
    ]
    for k, period in enumerate(trace.feedback["period"].tolist()):
        for topic, times, messages, every in topics:
            data = next(messages)
            if every and period % every == 0:
                writer.write(topic, times[k], data)


def _serialized(wire: Wire, rows: NDArray[np.void], **tails: NDArray[Any]) -> Iterator[bytes]:
    names = rows.dtype.names or ()
    for k in range(len(rows)):
        for name in names:
            wire.fixed[name][0] = rows[name][k]
        for name, values in tails.items():
            wire.tail[name][:] = values[k]
        yield wire.to_bytes()


def _named(trace: Trace) -> Iterator[bytes]:
    """The diagnostics, with the name of who controlled in each period."""
    borders = np.flatnonzero(np.diff(trace.fallen)) + 1
    for rows in np.split(np.arange(len(trace.lut)), borders):
        wire = Wire(LutDiagnostics)
        wire.set_string("scheme", trace.fallback if trace.fallen[rows[0]] else trace.scheme)
        yield from _serialized(wire, trace.lut[rows])

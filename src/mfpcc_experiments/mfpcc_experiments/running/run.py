"""One experiment with one scheme, on either engine, into one recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mfpcc_controller.controller import Controller
from mfpcc_experiments.bags import BagWriter
from mfpcc_experiments.measuring import latched
from mfpcc_experiments.progress import Tell
from mfpcc_experiments.running.configuration import configuration
from mfpcc_experiments.running.engine import Engine, step_time
from mfpcc_experiments.running.scenario import Scenario
from mfpcc_experiments.running.trace import write_trace
from pwm_node.ros import ros_environment


def run(
    scenario: Scenario,
    scheme: str,
    engine: str,
    folder: Path,
    seed: int,
    progress: Tell,
    *,
    separate: bool = False,
    name: str | None = None,
) -> None:
    """Record the experiment into `<folder>/<name>`.

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
        Called with the number of periods done, now and then.
    separate : bool
        Plant and controller as two processes (engine `ros`).
    name : str, optional
        Of the recording; default: the scheme's.

    Raises
    ------
    mfpcc_experiments.bags.BagError
        If the recording cannot be written.
    mfpcc_experiments.graph.session.DriveError
        If the graph does not run to the end, or messages are lost (engine `ros`).
    pwm_node.ros.ros_environment.RosError
        If ROS cannot start (engine `ros`).
    """
    config = configuration(scenario, scheme, engine, seed)
    path = folder / (name or scheme)
    if engine == "inprocess":
        _run_inprocess(config, path, scenario.periods, progress)
        return
    # rclpy is needed for this engine only, and may end the process as soon as it is imported
    ros_environment.check(processes=2 if separate else 1)
    if separate:
        from mfpcc_experiments.graph.separate import record
    else:
        from mfpcc_experiments.graph.composed import record

    record(config, path, scenario.periods, progress)


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

"""The plant in this process, and the controller in one of its own."""

from __future__ import annotations

import contextlib
import os
import subprocess
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml
from ament_index_python.packages import get_package_prefix

from mfpcc_experiments.bags import BagWriter
from mfpcc_experiments.graph import session
from mfpcc_experiments.graph.recorder import Recorder
from mfpcc_experiments.progress import Tell
from pmsm_sim.node import PmsmSim
from pwm_node import interrupts
from pwm_node.ros import spin

_STOP_WITHIN = 10.0  # s


def record(config: Mapping[str, Any], path: Path, periods: int, progress: Tell) -> None:
    """Run the plant in this process and the controller in one of its own, and record both.

    What the plant publishes is recorded in line, what the controller publishes as it arrives here.
    A recorder in a third process would get each of the four messages on its own, which takes the
    two that work about as much time again.

    Parameters and errors are those of `composed.record`.
    """
    plant_values, controller_values = session.values(config)
    controller_values["recorders"] = 1
    with contextlib.ExitStack() as stack:
        context = stack.enter_context(session.context())
        plant = PmsmSim(context=context, parameter_overrides=session.overrides(plant_values))
        stack.callback(plant.destroy_node)
        session.refuse_company(plant)
        writer = stack.enter_context(
            BagWriter(path, config=config, oversampling=plant_values["oversampling"])
        )
        plant.tap = lambda topic: session.sink(writer, topic)
        recorder = Recorder(writer, topics=("duty_command", "lut_diagnostics"), context=context)
        stack.callback(recorder.destroy_node)
        controller = stack.enter_context(
            _process("mfpcc_controller", "controller", controller_values)
        )
        watch = session.Watch(plant, controller)
        session.now_and_then(plant, lambda: progress(watch.look()))
        begin = time.monotonic()
        code = spin.run([plant, recorder], until=watch.over)
        wall = time.monotonic() - begin
        done = max(plant.period, 0)
        if recorder.error is not None:
            raise recorder.error
        if done == periods:
            _take_the_rest(recorder, periods, controller_values["diagnostics_decimation"])
        recorder.take_all(last=True)
        found = session.outcome(plant, [plant], wall)
        name = plant.get_name()
        found["parameter_changes"] += [c for c in recorder.parameter_changes if c["node"] != name]
        found["faults"] += [fault for fault in recorder.latched if fault["node"] != name]
        writer.close({"gaps": recorder.gaps, **found})
    session.judge(done, periods, "after an error (see above)" if code else watch.trouble)
    lost = {topic: count for topic, count in recorder.gaps.items() if count}
    if lost:
        raise session.DriveError(f"the recording has gaps: {lost}")
    progress(periods)


def _take_the_rest(recorder: Recorder, periods: int, decimation: int) -> None:
    """Wait for what the controller published last: it comes after the command that ends the run."""
    last = {"duty_command": periods}
    if decimation:
        last["lut_diagnostics"] = (periods - 1) // decimation * decimation
    deadline = time.monotonic() + _STOP_WITHIN
    while True:
        recorder.take_all()
        missing = [topic for topic, end in last.items() if recorder.last_period[topic] < end]
        if not missing:
            return
        if time.monotonic() > deadline:
            raise session.DriveError(
                f"the end of {missing[0]} did not arrive in {_STOP_WITHIN:.0f} s"
            )
        time.sleep(0.001)


@contextlib.contextmanager
def _process(
    package: str, executable: str, values: Mapping[str, Any]
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a node with these parameters; stop it at the end, by force where it does not."""
    program = Path(get_package_prefix(package), "lib", package, executable)
    text = yaml.safe_dump({"/**": {"ros__parameters": session.nonempty(values)}})
    # A file without a place: should this process be killed, nothing of it is left.
    with os.fdopen(os.memfd_create("parameters"), "w") as file:
        file.write(text)
        file.flush()
        process = subprocess.Popen(
            [program, "--ros-args", "--params-file", f"/dev/fd/{file.fileno()}"],
            pass_fds=[file.fileno()],
            # Ctrl-C is for this process, which stops them in order
            start_new_session=True,
            env=interrupts.ending_with_this_process(),
        )
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(_STOP_WITHIN)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

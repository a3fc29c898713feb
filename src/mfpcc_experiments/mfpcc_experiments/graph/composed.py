"""Plant and controller in this process, over real topics: the fast way."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from rclpy.task import Future

from mfpcc_controller.controller import Controller
from mfpcc_controller.node import MfpccController
from mfpcc_experiments.bags import BagWriter
from mfpcc_experiments.graph import session
from mfpcc_experiments.progress import Tell
from pmsm_sim.node import PmsmSim
from pmsm_sim.plant import Plant
from pwm_node.ros import spin


@contextlib.contextmanager
def _nodes(
    plant_values: Mapping[str, Any], controller_values: Mapping[str, Any], **options: Any
) -> Iterator[tuple[PmsmSim, MfpccController]]:
    """Both nodes with these parameters; they leave the graph at the end."""
    with contextlib.ExitStack() as stack:
        plant = PmsmSim(parameter_overrides=session.overrides(plant_values), **options)
        stack.callback(plant.destroy_node)
        controller = MfpccController(
            parameter_overrides=session.overrides(controller_values), **options
        )
        stack.callback(controller.destroy_node)
        yield plant, controller


def record(config: Mapping[str, Any], path: Path, periods: int, progress: Tell) -> None:
    """Run both nodes in this process over real topics, and record what they publish in line.

    Parameters
    ----------
    config : mapping
        From `running.configuration`.
    path : Path
        The new bag.
    periods : int
        Number of periods; the plant ends the run after them.
    progress : callable
        Called with the number of periods done.

    Raises
    ------
    DriveError
        If another drive is on the graph, or the run does not come to its end.
    BagError
        If the recording cannot be written.
    """
    plant_values, controller_values = session.values(config)
    with (
        session.context() as context,
        _nodes(plant_values, controller_values, context=context) as nodes,
    ):
        plant, controller = nodes
        session.refuse_company(plant)
        session.now_and_then(plant, lambda: progress(max(plant.period, 0)))
        with BagWriter(path, config=config, oversampling=plant_values["oversampling"]) as writer:
            for node in nodes:
                node.tap = lambda topic: session.sink(writer, topic)
            begin = time.monotonic()
            code = spin.run(nodes, until=Future())
            wall = time.monotonic() - begin
            done = max(plant.period, 0)
            median, p99 = controller.step_times.percentiles(50, 99)
            writer.close(
                {
                    "step_time_us": {"median": median, "p99": p99},
                    "lost_periods": controller.lost_periods,
                    **session.outcome(plant, nodes, wall),
                }
            )
    session.judge(done, periods, "after an error (see above)" if code else "")
    progress(periods)


@dataclass(frozen=True)
class ComposedRun:
    """
    What is left of a run that was not recorded.

    Attributes
    ----------
    plant, controller : Plant, Controller
        As they were at the end.
    messages : dict
        What was published, serialized, by loop topic.
    """

    plant: Plant
    controller: Controller
    messages: dict[str, list[bytes]]


@contextlib.contextmanager
def runs() -> Iterator[Callable[[Mapping[str, Any], Mapping[str, Any]], ComposedRun]]:
    """
    Run both nodes in this process over real topics, as often as one likes.

    Nothing is recorded, and the nodes log nothing; a run that stands still is ended.

    Yields
    ------
    callable
        Takes a value for every parameter of the two tables; the plant's `periods` end the run.

    Raises
    ------
    DriveError
        If another drive is on the graph, or a node fails.
    """
    with session.context() as context:
        scout = Node("scout", context=context)
        session.refuse_company(scout)
        scout.destroy_node()

        def once(
            plant_values: Mapping[str, Any], controller_values: Mapping[str, Any]
        ) -> ComposedRun:
            options = {"context": context, "enable_rosout": False}
            messages: dict[str, list[bytes]] = {}
            with _nodes(plant_values, controller_values, **options) as nodes:
                plant, controller = nodes
                for node in nodes:
                    node.get_logger().set_level(LoggingSeverity.FATAL)
                    node.tap = lambda topic: messages.setdefault(topic, []).append
                watch = session.Watch(plant)
                session.now_and_then(plant, watch.look)
                code = spin.run(nodes, until=watch.over)
                done = max(plant.period, 0)
            session.judge(
                done,
                done if watch.trouble else plant_values["periods"],
                "after an error of a node" if code else "",
            )
            return ComposedRun(plant.core, controller.core, messages)

        yield once

"""Parameters of a drive that runs at full speed, set from another process."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import drives
from figures import Figure, figure
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

_WITHIN = 60.0  # s


def measure(*, quick: bool) -> list[Figure]:
    """Time until a `set` is answered; the new value is in force by then."""
    times = sorted(_set_times(20 if quick else 200))
    slowest = times[int(0.99 * (len(times) - 1))]
    return [
        figure("parameter set at full speed, answered and in force", times, "ms"),
        figure("the same, 99 % of them", slowest, "ms", bar="value <= 20"),
    ]


def _set_times(count: int) -> list[float]:
    times = []
    values = {**drives.PLANT, **drives.CONTROLLER}
    with (
        tempfile.TemporaryDirectory() as folder,
        drives.running("mfpcc_experiments", "drive", values, Path(folder)),
        drives.graph() as context,
    ):
        node = Node("setter", context=context)
        # On SingleThreadedExecutor every answer takes 0.05 ms longer than the one before, whoever
        # answers: what is measured would be the one who asks.
        executor = EventsExecutor(context=context)
        executor.add_node(node)
        client = AsyncParameterClient(node, "pmsm_sim")
        if not client.wait_for_services(_WITHIN):
            raise RuntimeError("the drive did not start")
        time.sleep(1.0)  # it runs at full speed now
        for number in range(count):
            begin = time.perf_counter()
            answer = client.set_parameters([Parameter("load_torque", value=1.0 + number % 2)])
            executor.spin_until_future_complete(answer, timeout_sec=_WITHIN)
            times.append((time.perf_counter() - begin) * 1e3)
            if not answer.result().results[0].successful:
                raise RuntimeError(answer.result().results[0].reason)
            time.sleep(0.01)
        executor.shutdown()
        node.destroy_node()
    return times

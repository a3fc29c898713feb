"""One run of an experiment.

`scenario` is the experiment as data, `run` records it with one scheme after another, by either of
the `ENGINES`. `engine` is the drive without ROS, `closed_loop` a run of it in memory, and `batch`
runs many and measures them, without a recording. What is stored with a recording comes from
`configuration`, and `trace` writes one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mfpcc_experiments.front_door import front_door

if TYPE_CHECKING:
    from mfpcc_experiments.running.engine import Engine, Trace
    from mfpcc_experiments.running.scenario import Scenario

#: What can run an experiment: the real graph, or the same kernels without ROS.
ENGINES = ("ros", "inprocess")

__all__ = ["ENGINES", "Engine", "Scenario", "Trace", "closed_loop", "run", "scenario"]

__getattr__ = front_door(
    __name__,
    {
        "engine": ("Engine", "Trace"),
        "scenario": ("Scenario",),
    },
)

"""What runs on the ROS graph.

`composed` and `separate` record a scenario with both nodes in this process, or in one each;
`session` holds what both have in common, and `drive` is the executable. `recorder` and `replayer`
are nodes of their own. The black box keeps the last seconds before a trip: `black_box` (the
recording), `excerpt` (what of it belongs to a trip), `trip` (the page), `archive` (the folder).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mfpcc_experiments.front_door import front_door

if TYPE_CHECKING:
    from mfpcc_experiments.graph.black_box import BlackBox, BlackBoxNode
    from mfpcc_experiments.graph.recorder import Recorder
    from mfpcc_experiments.graph.replayer import Replayer

__all__ = ["BlackBox", "BlackBoxNode", "Recorder", "Replayer", "composed", "separate"]

__getattr__ = front_door(
    __name__,
    {
        "black_box": ("BlackBox", "BlackBoxNode"),
        "recorder": ("Recorder",),
        "replayer": ("Replayer",),
    },
)

"""
Recordings: bytes on disk, and as arrays.

`BagWriter` writes a bag while a drive runs; `read` gives a `Recording`, arrays with one row per
message, of any bag that holds the topics of the loop, or refuses it with a `BagError`; `recover`
repairs one whose writer was killed. `bags_in` finds the bags in a folder of results.

From the disk upwards: `disk` (records, and files of every kind), `bag_parts` (files of a bag),
`layouts` and `columns` (messages to arrays), `completeness` (which of them belong together),
`recording`. Downwards: `writer`, `metadata`. What both need: `topics`, `definitions`, `provenance`,
`errors`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mfpcc_experiments.front_door import front_door

if TYPE_CHECKING:
    from mfpcc_experiments.bags.bag_parts import bags_in
    from mfpcc_experiments.bags.errors import BagError
    from mfpcc_experiments.bags.provenance import versions
    from mfpcc_experiments.bags.recording import Recording, read
    from mfpcc_experiments.bags.topics import LOOP_TOPICS
    from mfpcc_experiments.bags.writer import BagWriter

__all__ = [
    "LOOP_TOPICS",
    "BagError",
    "BagWriter",
    "Recording",
    "bags_in",
    "read",
    "versions",
]

__getattr__ = front_door(
    __name__,
    {
        "bag_parts": ("bags_in",),
        "errors": ("BagError",),
        "provenance": ("versions",),
        "recording": ("Recording", "read"),
        "topics": ("LOOP_TOPICS",),
        "writer": ("BagWriter",),
    },
)

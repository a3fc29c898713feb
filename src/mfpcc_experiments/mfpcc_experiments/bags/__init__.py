"""
Recordings: bytes on disk, and as arrays.

`BagWriter` writes a bag while a drive runs; `read` gives a `Recording`, arrays with one row per
message, of any bag that holds the topics of the loop, or refuses it with a `BagError`; `recover`
repairs one whose writer was killed. `bags_in` finds the bags in a folder of results.

From the disk upwards: `mcap_format` and `mcap_file` (records), `storage` (files of every kind),
`bag_parts` (files of a bag), `layouts` and `columns` (messages to arrays), `completeness` (which of
them belong together), `recording`. Downwards: `writer`, `sink`, `metadata`. What both need:
`topics`, `definitions`, `provenance`, `errors`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mfpcc_experiments.bags.bag_parts import bags_in
    from mfpcc_experiments.bags.errors import BagError
    from mfpcc_experiments.bags.provenance import versions
    from mfpcc_experiments.bags.recording import Recording, read
    from mfpcc_experiments.bags.topics import LOOP_TOPICS
    from mfpcc_experiments.bags.writer import BagWriter

_WHERE = {
    "BagError": "errors",
    "BagWriter": "writer",
    "LOOP_TOPICS": "topics",
    "Recording": "recording",
    "bags_in": "bag_parts",
    "read": "recording",
    "versions": "provenance",
}

__all__ = [
    "LOOP_TOPICS",
    "BagError",
    "BagWriter",
    "Recording",
    "bags_in",
    "read",
    "versions",
]


def __getattr__(name: str) -> Any:
    """Import what is asked for only then: a node that only records needs nothing that reads."""
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(importlib.import_module(f"{__name__}.{_WHERE[name]}"), name)

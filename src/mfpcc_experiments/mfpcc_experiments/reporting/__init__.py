"""From numbers to pages.

`compare` makes a folder of results from recordings: ``metrics.json``, the figures (`figures`) and
the page (`report`, with the viewer's `traces`). `export` writes a recording for other tools.
`table` is the one place where figures of merit become text, `style` the one where colours and
formats stand, and `html` makes pages that need nothing but themselves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mfpcc_experiments.front_door import front_door

if TYPE_CHECKING:
    from mfpcc_experiments.reporting.style import (
        COLOURS,
        FORMATS,
        MARKS,
        PHASES,
        REFERENCE,
        STYLE,
        mark,
    )
    from mfpcc_experiments.reporting.table import Line, lines

__all__ = [
    "COLOURS",
    "FORMATS",
    "MARKS",
    "PHASES",
    "REFERENCE",
    "STYLE",
    "Line",
    "compare",
    "export",
    "figures",
    "html",
    "lines",
    "mark",
    "replay_figure",
    "report",
    "traces",
]

__getattr__ = front_door(
    __name__,
    {
        "style": ("COLOURS", "FORMATS", "MARKS", "PHASES", "REFERENCE", "STYLE", "mark"),
        "table": ("Line", "lines"),
    },
)

"""From arrays to numbers.

`evaluate` gives one row of ``metrics.json``: the figures of merit, each of them an entry of
`METRICS`, over the evaluation window (`cut`), and the notes on what happened in the run
(`History`). `replay` feeds recorded samples to another scheme. `QUANTITIES` are what there is to
draw, and `columns` makes the table for other tools.

From the bottom: `waveform` (pure functions), `window`, `happened`, `steadiness` (what a window can
be asked), `copper`, `steps`, `content` (what figures are computed from), `metrics`, `measured`.
`compiled` and `compiled_steadiness` are the figures of a window once more, for compiled loops.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mfpcc_experiments.front_door import front_door

if TYPE_CHECKING:
    from mfpcc_experiments.measuring.happened import History, latched, rows_of, scheme_title
    from mfpcc_experiments.measuring.measured import Measured, labels, shown
    from mfpcc_experiments.measuring.metrics import METRICS, Metric, evaluate, of_the_run
    from mfpcc_experiments.measuring.replay import Replay, Samples
    from mfpcc_experiments.measuring.signals import QUANTITIES, Quantity, Signal
    from mfpcc_experiments.measuring.steadiness import Need
    from mfpcc_experiments.measuring.window import Window, cut

__all__ = [
    "METRICS",
    "QUANTITIES",
    "History",
    "Measured",
    "Metric",
    "Need",
    "Quantity",
    "Replay",
    "Samples",
    "Signal",
    "Window",
    "cut",
    "evaluate",
    "labels",
    "latched",
    "of_the_run",
    "rows_of",
    "scheme_title",
    "shown",
]

__getattr__ = front_door(
    __name__,
    {
        "happened": ("History", "latched", "rows_of", "scheme_title"),
        "measured": ("Measured", "labels", "shown"),
        "metrics": ("METRICS", "Metric", "evaluate", "of_the_run"),
        "replay": ("Replay", "Samples"),
        "signals": ("QUANTITIES", "Quantity", "Signal"),
        "steadiness": ("Need",),
        "window": ("Window", "cut"),
    },
)

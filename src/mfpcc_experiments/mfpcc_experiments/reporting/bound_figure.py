"""The figure of predictions beside what the data allow: over speed, and over frequency."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from mfpcc_experiments.identifying.bound import Bound, size
from mfpcc_experiments.measuring import Replay, scheme_title
from mfpcc_experiments.reporting.figures import save
from mfpcc_experiments.reporting.style import COLOURS, REFERENCE, STYLE


def draw(found: Bound, results: Sequence[Replay], path: Path) -> None:
    """
    Draw prediction errors of schemes beside the two predictors that know nothing of control.

    Parameters
    ----------
    found : Bound
        From `bound.bound`.
    results : sequence of Replay
        One per scheme.
    path : Path
        The PNG file.
    """
    lines: list[tuple[Any, str, dict[str, Any]]] = [
        (found.unchanged, "nothing changes", {"color": "#8c8c8c", "ls": ":", "lw": 1.4}),
        *(
            (
                found.error(result),
                scheme_title(result.scheme),
                {"color": COLOURS[n % len(COLOURS)]},
            )
            for n, result in enumerate(results)
        ),
        (found.least_squares, "least squares", {"color": REFERENCE, "ls": "--", "lw": 1.4}),
    ]
    parts = found.by_speed()
    speed = [float(np.abs(found.speed[rows]).mean()) for rows in parts]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.4, 3.2), layout=ConstrainedLayoutEngine())
        left, right = figure.subplots(1, 2)
        for error, label, look in lines:
            left.plot(speed, [size(error[rows]) for rows in parts], marker="o", ms=3, **look)
            frequency, density = found.spectrum(error)
            right.plot(frequency, 1e3 * density, label=label, **look)
        left.set_xlabel("Speed (r/min)")
        left.set_ylabel("Prediction error, rms (A)")
        left.set_yscale("log")
        right.set_xlabel("Frequency in the rotor frame (Hz)")
        right.set_ylabel("Prediction error (mA/√Hz)")
        right.set_xscale("log")
        right.set_yscale("log")
        figure.legend(*right.get_legend_handles_labels(), loc="outside upper center", ncols=4)
        save(figure, path.with_suffix(""))

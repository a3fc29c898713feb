"""The figure of a replay: what schemes would have predicted and commanded on the same samples."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator

from mfpcc_experiments.measuring import Replay, Samples, scheme_title
from mfpcc_experiments.measuring.replay_summary import window_rows
from mfpcc_experiments.reporting.figures import format_value, limits, note, save
from mfpcc_experiments.reporting.style import COLOURS, REFERENCE, STYLE

#: Time shown of the duties (s): a few tens of periods, so that single ones can be seen.
_CLOSE_UP = 4e-3


def draw(
    samples: Samples,
    results: Sequence[Replay],
    rows: Sequence[dict[str, Any]],
    path: Path,
    window_s: Sequence[float] | None = None,
) -> None:
    """
    Draw a replay: one line per scheme, with its prediction errors and the duty of leg a.

    Parameters
    ----------
    samples : Samples
        What was fed.
    results : sequence of Replay
        What came of it, one per scheme.
    rows : sequence of dict
        Their objects of ``metrics.json``.
    path : Path
        The PNG file.
    window_s : sequence of two floats, optional
        Evaluated time (s), as of `replay_summary`.
    """
    window = window_rows(samples, window_s)
    T_s = samples.recording.T_s
    time = samples.feedback["period"][window] * T_s
    close = window.start + np.arange(min(round(_CLOSE_UP / T_s), len(time)))
    close_ms = 1e3 * (samples.feedback["period"][close].astype(np.int64) + 1) * T_s
    with mpl.rc_context(STYLE):
        n = len(results)
        figure = Figure(
            figsize=(7.4, 0.85 + 1.15 * n), layout=ConstrainedLayoutEngine(w_pad=0.03, h_pad=0.03)
        )
        axes = figure.subplots(n, 3, sharex="col", sharey="col", squeeze=False)
        titles = ("Prediction error, d (A)", "Prediction error, q (A)", "Duty of leg a")
        for axis, title in zip(axes[0], titles, strict=True):
            axis.set_title(title)
        for line, result, row in zip(axes, results, rows, strict=True):
            title = scheme_title(result.scheme)
            line[0].set_ylabel(title.replace("-", "-\n", 1) if len(title) > 10 else title)
            for n_axis, name in enumerate("dq"):
                values = result.error[window, n_axis]
                line[n_axis].plot(time, values, color=COLOURS[n_axis], lw=0.5)
                note(line[n_axis], f"max {format_value(row['lut_error_max'][name], 'A')}")
            # A duty holds for its period: steps, with the recorded ones beneath.
            line[2].step(
                close_ms,
                np.where(samples.answered[close], samples.duty[close, 0], np.nan),
                where="post",
                color=REFERENCE,
                lw=0.9,
                label="recorded",
            )
            line[2].step(
                close_ms,
                result.duty[close, 0],
                where="post",
                color=COLOURS[2],
                lw=0.9,
                ls="--",
                label="commanded in the replay",
            )
        for n_axis in range(2):
            shown = [result.error[window, n_axis] for result in results]
            limits([line[n_axis] for line in axes], shown, top=0.3)
            axes[0][n_axis].set_xlim(time[0], time[-1])
            axes[-1][n_axis].set_xlabel("Time (s)")
        axes[0][2].set_ylim(-0.05, 1.05)
        axes[0][2].set_xlim(close_ms[0], close_ms[-1])
        axes[-1][2].set_xlabel("Time (ms)")
        for axis in axes[-1]:
            axis.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        figure.legend(*axes[0][2].get_legend_handles_labels(), loc="outside upper right", ncols=2)
        save(figure, path.with_suffix(""))

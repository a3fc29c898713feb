"""One measured recording: what figures and report need of it, and no more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.measuring.happened import scheme_title
from mfpcc_experiments.measuring.signals import Signal
from mfpcc_experiments.measuring.window import Window


@dataclass(frozen=True)
class Measured:
    """
    One recording after its evaluation.

    Attributes
    ----------
    path : Path
        Where the recording is.
    label : str
        Short name, different for all that are compared.
    row : dict
        Its object of ``metrics.json``.
    window : Window
        Signals of the evaluation window.
    signals : dict of Signal
        Quantities over the whole recording, by name (see `signals.QUANTITIES`).
    config : dict
        Configuration of the run.
    lags : dict of array
        Of a paced run, how late its periods began (`start`) and when in them the command was there
        (`round_trip`): rows of a duration (ns) and how many periods had it (see `pwm_node.lags`).
    """

    path: Path
    label: str
    row: dict[str, Any]
    window: Window
    signals: dict[str, Signal]
    config: dict[str, Any] = field(default_factory=dict)
    lags: dict[str, NDArray[np.int64]] = field(default_factory=dict)


def labels(rows: Sequence[dict[str, Any]], paths: Sequence[Path]) -> list[str]:
    """
    Short names for recordings that tell them apart.

    The scheme alone where that is enough; else with the experiment, the motor, the engine or the
    seed, whichever differs; else with the folder.

    Parameters
    ----------
    rows : sequence of dict
        Objects of ``metrics.json``.
    paths : sequence of Path
        Their recordings.
    """
    names = [scheme_title(str(row["scheme"])) for row in rows]
    for key in ("experiment", "motor", "engine", "seed"):
        if len(set(names)) == len(names):
            return names
        if len({str(row[key]) for row in rows}) > 1:
            word = "seed " if key == "seed" else ""
            names = [
                name if row[key] is None else f"{name}, {word}{row[key]}"
                for name, row in zip(names, rows, strict=True)
            ]
    if len(set(names)) < len(names):
        names = [f"{n}, {p.resolve().name}" for n, p in zip(names, paths, strict=True)]
    if len(set(names)) < len(names):
        names = [f"{n} ({k})" for k, n in enumerate(names, 1)]
    return names


def shown(runs: Sequence[Measured]) -> list[Measured]:
    """Of recordings that differ in their seed alone the first, which figures and traces show."""
    first: dict[Any, Measured] = {}
    for run in runs:
        first.setdefault(run.row["setup"], run)
    return list(first.values())

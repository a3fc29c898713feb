"""One measured recording: what figures and report need of it, and no more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.bags import Recording
from mfpcc_experiments.measuring.happened import scheme_title
from mfpcc_experiments.measuring.waveform import to_dq
from mfpcc_experiments.measuring.window import Window, phase_currents
from pwm_node.units import RPM


@dataclass(frozen=True)
class Signal:
    """
    A quantity over the whole recording.

    Attributes
    ----------
    begin, step : float
        Time of the first value and between two values (s).
    values : ndarray, shape (n,)
        The values; NaN where there is none.
    """

    begin: float
    step: float
    values: NDArray[np.float32]


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
        Quantities over the whole recording, by name (see `signals`).
    config : dict
        Configuration of the run.
    """

    path: Path
    label: str
    row: dict[str, Any]
    window: Window
    signals: dict[str, Signal]
    config: dict[str, Any] = field(default_factory=dict)


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
            names = [f"{name}, {row[key]}" for name, row in zip(names, rows, strict=True)]
    if len(set(names)) < len(names):
        names = [f"{n}, {p.resolve().name}" for n, p in zip(names, paths, strict=True)]
    if len(set(names)) < len(names):
        names = [f"{n} ({k})" for k, n in enumerate(names, 1)]
    return names


def signals(recording: Recording) -> dict[str, Signal]:
    """
    Quantities of a recording over all its time, gaps filled with NaN.

    Parameters
    ----------
    recording : Recording
        From `recording.read`.

    Returns
    -------
    dict of Signal
        ``i_a`` (A, measured), ``i_d``, ``i_q``, ``i_d_ref``, ``i_q_ref`` (A), ``error_d``,
        ``error_q`` (A, measured minus predicted), ``speed``, ``speed_ref`` (r/min), ``torque``,
        ``load_torque`` (N m), as far as recorded.
    """
    T_s = recording.T_s
    feedback, lut, state = recording.feedback, recording.lut, recording.state
    found: dict[str, Signal] = {"i_a": _signal(feedback["period"], feedback["i_a"], T_s)}
    if len(lut):
        for n, axis in enumerate("dq"):
            for name, values in (
                (f"i_{axis}", lut["i_dq"]),
                (f"i_{axis}_ref", lut["i_dq_ref"]),
                (f"error_{axis}", lut["prediction_error"]),
            ):
                found[name] = _signal(lut["period"], values[:, n], T_s)
    elif recording.n_p:
        i_dq = to_dq(phase_currents(feedback), recording.n_p * feedback["encoder_angle"])
        found["i_d"] = _signal(feedback["period"], i_dq.real, T_s)
        found["i_q"] = _signal(feedback["period"], i_dq.imag, T_s)
    if len(state):
        found["speed"] = _signal(state["period"], state["speed"] / RPM, T_s)
        found["torque"] = _signal(state["period"], state["torque"], T_s)
        found["load_torque"] = _signal(state["period"], state["load_torque"], T_s)
    elif recording.n_p and len(lut):
        found["speed"] = _signal(lut["period"], lut["w_m"] / recording.n_p / RPM, T_s)
    if len(lut) and np.isfinite(lut["speed_ref"]).any():
        found["speed_ref"] = _signal(lut["period"], lut["speed_ref"] / RPM, T_s)
    return found


def _signal(period: NDArray[Any], values: NDArray[Any], T_s: float) -> Signal:
    """Values by period number as an equally spaced signal."""
    period = period.astype(np.int64)
    first, span = int(period[0]), int(period[-1] - period[0])
    step = 1
    if len(period) > 1:
        step = max(1, int(np.median(np.diff(period))))  # above 1 where the topic is decimated
    # A gap of hours in a damaged numbering must not become gigabytes of nothing.
    if span // step + 1 > 4 * len(period) + 1000:
        return Signal(first * T_s, step * T_s, np.asarray(values, dtype=np.float32))
    filled = np.full(span // step + 1, np.nan, dtype=np.float32)
    filled[(period - first) // step] = values
    return Signal(first * T_s, step * T_s, filled)

"""
The quantities of a recording over all of its time, and how they are drawn.

A quantity is one entry of `QUANTITIES`. The entry says where its values come from, and in which
panel of the report's viewer it stands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.bags import Recording
from mfpcc_experiments.measuring.waveform import plausible, to_dq
from mfpcc_experiments.measuring.window import Window, phase_currents
from pwm_node.units import RPM

#: Period numbers, and the value in each of them.
Values = tuple[NDArray[Any], NDArray[Any]]


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
class Quantity:
    """
    One quantity over the whole recording.

    Attributes
    ----------
    name : str
        By which it is known.
    panel, unit : str
        Title of the panel that it is drawn in, and its unit. The first quantity of a panel is drawn
        as a full line, others are dashed.
    values : callable
        `values(recording)`: its values by period, or None if they were not recorded.
    fine : callable, optional
        `fine(window)`: the same on the oversampled waveform of an evaluation window, if there is
        one; shape (n,).
    """

    name: str
    panel: str
    unit: str
    values: Callable[[Recording], Values | None]
    fine: Callable[[Window], NDArray[Any] | None] | None = None


def _state(field: str) -> Callable[[Recording], Values | None]:
    """A field of `drive_state`."""

    def values(r: Recording) -> Values | None:
        return (r.state["period"], r.state[field]) if len(r.state) else None

    return values


def _diagnostics(field: str, axis: int) -> Callable[[Recording], Values | None]:
    """An axis of a field of `lut_diagnostics`."""

    def values(r: Recording) -> Values | None:
        return (r.lut["period"], r.lut[field][:, axis]) if len(r.lut) else None

    return values


def _current(axis: int) -> Callable[[Recording], Values | None]:
    """The measured current, which follows from the samples where no diagnostics were recorded."""
    recorded = _diagnostics("i_dq", axis)

    def values(r: Recording) -> Values | None:
        if len(r.lut) or not r.n_p:
            return recorded(r)
        i_dq = to_dq(phase_currents(r.feedback), r.n_p * r.feedback["encoder_angle"])
        return r.feedback["period"], i_dq.imag if axis else i_dq.real

    return values


def _speed(r: Recording) -> Values | None:
    """The true speed where it was recorded, else the observer's."""
    if len(r.state):
        return r.state["period"], r.state["speed"] / RPM
    if r.n_p and len(r.lut):
        return r.lut["period"], r.lut["w_m"] / r.n_p / RPM
    return None


def _speed_reference(r: Recording) -> Values | None:
    if len(r.lut) and np.isfinite(r.lut["speed_ref"]).any():
        return r.lut["period"], r.lut["speed_ref"] / RPM
    return None


def _fine_phase(w: Window) -> NDArray[Any] | None:
    return None if w.fine_abc is None else w.fine_abc[:, 0]


def _fine_axis(axis: int) -> Callable[[Window], NDArray[Any] | None]:
    def values(w: Window) -> NDArray[Any] | None:
        if w.fine_dq is None:
            return None
        return w.fine_dq.imag if axis else w.fine_dq.real

    return values


#: All of them, in the order of the panels.
QUANTITIES: tuple[Quantity, ...] = (
    Quantity(
        "i_a", "Phase current a", "A", lambda r: (r.feedback["period"], r.feedback["i_a"]),
        _fine_phase,
    ),
    Quantity("i_d", "i_d", "A", _current(0), _fine_axis(0)),
    Quantity("i_d_ref", "i_d", "A", _diagnostics("i_dq_ref", 0)),
    Quantity("i_q", "i_q", "A", _current(1), _fine_axis(1)),
    Quantity("i_q_ref", "i_q", "A", _diagnostics("i_dq_ref", 1)),
    Quantity("error_d", "Prediction error d", "A", _diagnostics("prediction_error", 0)),
    Quantity("error_q", "Prediction error q", "A", _diagnostics("prediction_error", 1)),
    Quantity("torque", "Torque", "N m", _state("torque")),
    Quantity("load_torque", "Torque", "N m", _state("load_torque")),
    Quantity("speed", "Speed", "r/min", _speed),
    Quantity("speed_ref", "Speed", "r/min", _speed_reference),
)  # fmt: skip


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
        `QUANTITIES` by their names, as far as recorded.
    """
    found = {}
    for quantity in QUANTITIES:
        values = quantity.values(recording)
        if values is not None:
            found[quantity.name] = _signal(*values, recording.T_s)
    return found


def _signal(period: NDArray[Any], values: NDArray[Any], T_s: float) -> Signal:
    """Values by period number as an equally spaced signal."""
    period, values = period.astype(np.int64), plausible(values)
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

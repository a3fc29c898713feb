"""A recording as one table: a row per PWM period, a column per quantity, named with its unit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.bags import Recording
from mfpcc_experiments.measuring.happened import rows_of

# Topic, its field, and the columns that it becomes: names end with the unit, where there is one.
_COLUMNS: tuple[tuple[str, str, Sequence[str]], ...] = (
    ("feedback", "i_a", ("i_a_A",)),
    ("feedback", "i_b", ("i_b_A",)),
    ("feedback", "i_c", ("i_c_A",)),
    ("feedback", "encoder_angle", ("encoder_angle_rad",)),
    ("feedback", "dc_voltage", ("u_dc_V",)),
    ("command", "duty", ("duty_a", "duty_b", "duty_c")),
    ("command", "enable", ("enable",)),
    ("command", "vectors", ("vector_1", "vector_2")),
    ("command", "dwell", ("dwell_1", "dwell_2")),
    ("lut", "i_dq", ("i_d_A", "i_q_A")),
    ("lut", "i_dq_ref", ("i_d_ref_A", "i_q_ref_A")),
    ("lut", "prediction_error", ("prediction_error_d_A", "prediction_error_q_A")),
    ("lut", "w_m", ("w_m_rad_per_s",)),
    ("lut", "speed_ref", ("w_M_ref_rad_per_s",)),
    ("state", "i_dq", ("i_d_true_A", "i_q_true_A")),
    ("state", "speed", ("w_M_true_rad_per_s",)),
    ("state", "angle", ("theta_M_true_rad",)),
    ("state", "torque", ("tau_M_true_N_m",)),
    ("state", "load_torque", ("tau_L_true_N_m",)),
    ("state", "dc_current", ("i_dc_true_A",)),
    ("state", "temperature", ("temperature_true_degC",)),
    ("state", "gates_on", ("gates_on",)),
)


def columns(recording: Recording) -> dict[str, NDArray[Any]]:
    """
    Return the table of a recording.

    Parameters
    ----------
    recording : Recording
        From `recording.read`.

    Returns
    -------
    dict of ndarray, shape (n,)
        One row per recorded sample. ``period`` and ``time_s`` (start of the period), then the
        measured, commanded, controller's and true quantities as far as they are recorded, each
        with its unit at the end of its name; ``duty_*`` and ``enable`` are what applied in that
        period. A number that was not recorded in a period is NaN; ``enable`` and ``gates_on`` are
        1, 0 or NaN. ``scheme`` tells who controlled the current, empty where nothing tells.
    """
    period = recording.feedback["period"]
    table: dict[str, NDArray[Any]] = {"period": period, "time_s": period * recording.T_s}
    for topic, field, names in _COLUMNS:
        rows = getattr(recording, topic)
        if not len(rows):
            continue
        row, there = rows_of(rows["period"], period)
        values = rows[field][row].astype(np.float64).reshape(len(period), -1)
        values[~there] = np.nan
        table.update(zip(names, values.T, strict=True))
    if len(recording.lut):
        row, there = rows_of(recording.lut["period"], period)
        table["scheme"] = np.where(there, recording.scheme[row], "")
    return table

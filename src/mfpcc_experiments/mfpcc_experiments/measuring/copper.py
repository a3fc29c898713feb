"""The resistance that a winding had, warm or drifted."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from mfpcc_experiments.measuring import happened
from mfpcc_experiments.measuring.window import window_rows
from pmsm_sim.parameters import TABLE as PLANT
from pmsm_sim.parts.thermal import REFERENCE_TEMPERATURE

if TYPE_CHECKING:
    from mfpcc_experiments.bags import Recording
    from mfpcc_experiments.measuring.happened import History


def resistance(
    recording: Recording, past: History, window_s: Sequence[float]
) -> tuple[float | None, str]:
    """
    Stator resistance that the winding had in the window (ohm), and what there is to say of it.

    R = R_s drift.resistance (1 + alpha_Cu (T - 20 degC)), as of `pmsm_sim.plant`; without a plant
    that tells, the motor file's.
    """
    T_s = recording.T_s
    R_s = recording.config.get("R_s")
    if not isinstance(R_s, (int, float)):
        return None, "no copper loss: the resistance is not stored in the recording"
    if not happened.parameters(recording, "pmsm_sim"):
        return float(R_s), "copper loss with the resistance of the motor file"

    def value(name: str, period: int) -> float:
        found = happened.value_at(recording, past.changes, "pmsm_sim", name, period)
        # recorded by a version without such a parameter
        default: Any = PLANT[name].default
        return float(found) if isinstance(found, int | float) else default

    rows = window_rows(recording.feedback["period"], window_s, T_s)
    period = recording.feedback["period"][rows].astype(np.int64)
    borders = [c.period for c in past.changes if c.node == "pmsm_sim"]
    starts = sorted({int(period[0]), *(b for b in borders if period[0] < b <= period[-1])})
    state = recording.state[window_rows(recording.state["period"], window_s, T_s)]
    total = 0.0
    for begin, stop in pairwise([*starts, int(period[-1]) + 1]):
        heats = (
            value("drift.thermal_resistance", begin) > 0.0
            or value("drift.time_constant", begin) > 0.0
        )
        inside = (state["period"] >= begin) & (state["period"] < stop)
        if inside.any():
            temperature = float(np.mean(state["temperature"][inside]))
        elif heats:
            return None, "no copper loss: the temperature of the winding is not recorded"
        else:
            temperature = value("drift.temperature", begin)
        rise = temperature - REFERENCE_TEMPERATURE
        ratio = value("drift.resistance", begin) * (
            1.0 + value("drift.copper_coefficient", begin) * rise
        )
        total += ratio * (stop - begin)
    mean = float(R_s) * total / (int(period[-1]) + 1 - int(period[0]))
    different = abs(mean / float(R_s) - 1.0) > 1e-6
    text = f"copper loss with {mean:.3g} ohm, the resistance that the winding had"
    return mean, text if different else ""

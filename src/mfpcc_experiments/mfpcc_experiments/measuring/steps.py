"""Steps of the current reference in a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mfpcc_experiments.measuring.waveform import step_response

if TYPE_CHECKING:
    from mfpcc_experiments.bags import Recording
    from mfpcc_experiments.measuring.happened import History


def current_steps(recording: Recording, past: History, scheme: str) -> list[dict[str, Any]]:
    """
    Settling and overshoot of every clear step of the current reference.

    A step is clear if the reference jumps within one period and stands still for 20 samples before
    and after (a speed loop moves it all the time; no settling is defined there), while the gates
    are on and one scheme, the one that the row is of, controls.
    """
    lut = recording.lut
    steps: list[dict[str, Any]] = []
    if len(lut) < 41:
        return steps
    period = lut["period"].astype(np.int64)
    every = int(np.median(np.diff(period)))
    for axis, name in enumerate(("d", "q")):
        i, ref = lut["i_dq"][:, axis], lut["i_dq_ref"][:, axis]
        jumps = np.flatnonzero(np.diff(ref) != 0.0) + 1
        # what moves in every period is no step, and need not be looked at one by one
        apart = np.diff(jumps, prepend=0, append=len(ref))
        for n in np.flatnonzero((apart[:-1] >= 20) & (apart[1:] >= 20)).tolist():
            k, end = int(jumps[n]), int(jumps[n] + apart[n + 1])
            first, last = int(period[k - 20]), int(period[end - 1])
            whole = last - first == (end - 1 - (k - 20)) * every
            if not whole or past.is_off_in(first, last + 1):
                continue
            if past.scheme_in(first, last + 1) != scheme:
                continue
            response = step_response(i[k:end], float(ref[k - 1]), float(ref[k]))
            settling = response.settling
            steps.append(
                {
                    "axis": name,
                    "time_s": float(period[k] * recording.T_s),
                    "from": float(ref[k - 1]),
                    "to": float(ref[k]),
                    "settling_periods": None if settling is None else settling * every,
                    "overshoot_percent": 100.0 * response.overshoot,
                }
            )
    return steps

"""What the tests of the plant share: a bench that runs it period by period."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from mfpcc_msgs.msg import DriveState, PhaseFeedback

from pmsm_sim.parameters import TABLE
from pmsm_sim.plant import Plant, advance
from pwm_node.wire import fixed_dtype


class Bench:
    """A plant driven period by period, without a controller.

    Parameters
    ----------
    oversampling : int
        Points of the waveform per period.
    i_dq : (float, float)
        Current at the start (A).
    values
        Parameters that differ from their defaults, `_` for the dots of their names.

    Attributes
    ----------
    feedback, state : lists of records, one per period
    i_abc : list of arrays, shape (n, 3)
    legs : list of arrays, shape (n,)
    """

    def __init__(self, *, oversampling=0, i_dq=(0.0, 0.0), **values):
        dotted = {name.replace(".", "_"): name for name in TABLE}
        changes = {dotted[name]: value for name, value in values.items()}
        self.plant = Plant(TABLE.complete({**changes, "oversampling": oversampling}))
        self.par, self.st = self.plant.par, self.plant.st
        self.st["i_d"], self.st["i_q"] = i_dq
        self.n = oversampling
        self.feedback, self.state, self.i_abc, self.legs = [], [], [], []

    def run(self, periods, duty=(0.5, 0.5, 0.5), *, enable=True, command=True):
        """Apply the duties (or what `duty(k)` gives) for so many periods."""
        for _ in range(periods):
            fb = np.zeros(1, fixed_dtype(PhaseFeedback))
            ds = np.zeros(1, fixed_dtype(DriveState))
            i_abc, legs = np.zeros(3 * self.n), np.zeros(self.n, np.uint8)
            if command:
                now = duty(int(self.st["period"][0])) if callable(duty) else duty
                self.st["duty"] = np.reshape(now, (1, 3))
                self.st["enable"] = enable
                self.st["latched"] = True
            advance(self.par, self.st, fb, ds, i_abc, legs)
            self.feedback.append(fb[0])
            self.state.append(ds[0])
            self.i_abc.append(i_abc.reshape(-1, 3))
            self.legs.append(legs)
        return self

    def column(self, name):
        """One field of `drive_state` over all periods."""
        return np.array([row[name] for row in self.state])

    @property
    def waveform(self):
        """Oversampled phase currents, shape (periods * oversampling, 3)."""
        return np.concatenate(self.i_abc)


@pytest.fixture
def bench():
    """The class `Bench`."""
    return Bench


@pytest.fixture
def unprotected(bench):
    """`Bench` without the inverter's protection, for runs far from what a drive would allow."""
    return partial(bench, fault_react=False)

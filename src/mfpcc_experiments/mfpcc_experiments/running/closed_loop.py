"""A closed loop in one call: what the tests of the schemes and the figures of the method run.

For experiments, use a scenario and `mfpcc run`; this leaves no recording.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_controller.controller import Controller
from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments.measuring import waveform
from mfpcc_experiments.running.engine import Engine
from pmsm_sim.parameters import TABLE as PLANT

#: Of the three phase sensors, so that i_d and i_q have 20 mA rms (A)
NOISE = 0.0245

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """
    What passed on the loop, one row per period.

    Attributes
    ----------
    feedback, command, lut, state : structured arrays, shape (n,)
        The fixed parts of the four messages.
    i_abc : float64 array, shape (n, m, 3)
        Phase currents (A) at m equal steps of each period.
    controller : Controller
        As it was at the end.
    """

    feedback: NDArray[np.void]
    command: NDArray[np.void]
    lut: NDArray[np.void]
    state: NDArray[np.void]
    i_abc: Array
    controller: Controller

    @property
    def T_s(self) -> float:
        """PWM period (s)."""
        return float(self.controller.cfg["T_s"][0])

    def rows(self, start: float, end: float | None = None) -> slice:
        """Rows from one time to another (s); without an end, to the end."""
        return slice(round(start / self.T_s), None if end is None else round(end / self.T_s))

    def error(self, start: float, end: float | None = None) -> Array:
        """Measured current minus its reference (A), shape (n, 2)."""
        rows = self.rows(start, end)
        return np.asarray((self.lut["i_dq"] - self.lut["i_dq_ref"])[rows])

    def ripple(self, start: float, end: float | None = None) -> Array:
        """Peak-to-peak ripple of i_d and i_q on the control samples (A)."""
        return np.asarray(np.ptp(self.lut["i_dq"][self.rows(start, end)], axis=0))

    def lut_error(self, start: float, end: float | None = None) -> float:
        """Largest difference of measured and predicted current on either axis (A)."""
        return float(np.max(np.abs(self.lut["prediction_error"][self.rows(start, end)])))

    def largest_current(self) -> float:
        """Largest amplitude of the true current (A)."""
        return float(np.max(np.hypot(*self.state["i_dq"].T)))

    def thd(self, start: float, end: float | None = None) -> float:
        """Total harmonic distortion (ratio) of phase a on the oversampled waveform."""
        rows = self.rows(start, end)
        theta = self.controller.motor.n_p * waveform.unwrap(self.state["angle"][rows])
        i_a = self.i_abc[rows, :, 0]
        thd = waveform.thd(i_a.ravel(), waveform.oversample_angle(theta, i_a.shape[1]))
        if thd is None:
            raise ValueError("no whole electrical period between these times")
        return thd


def run(
    scheme: str,
    seconds: float,
    *,
    motor: str = "seed_750",
    rpm: float = 750.0,
    load: float = 2.0,
    seed: int = 1,
    oversampling: int = 0,
    plant: Mapping[str, Any] | None = None,
    controller: Mapping[str, Any] | None = None,
    schedule: Iterable[str] = (),
) -> Run:
    """
    Run a closed loop from the speed it is to keep.

    Parameters
    ----------
    scheme : str
        Who controls the current at the start.
    seconds : float
        Simulated time (s).
    motor : str
        A name of `config/motors`.
    rpm, load : float
        Speed at the start and its reference (r/min); load torque (N m).
    seed : int
        Seed of all noise, which is that of `NOISE` unless `plant` says otherwise.
    oversampling : int
        Points per period of `Run.i_abc`.
    plant, controller : mapping, optional
        Further parameters of either.
    schedule : iterable of str
        Entries 'SECONDS NAME VALUE', of either.

    Returns
    -------
    Run
        All that passed.
    """
    entries = list(schedule)
    of_plant = [entry for entry in entries if entry.split()[1] in PLANT]
    engine = Engine(
        PLANT.complete(
            {
                "motor": motor,
                "initial_speed_rpm": rpm,
                "load_torque": load,
                "noise.current_rms": NOISE,
                "seed": seed,
                "oversampling": oversampling,
                "schedule": of_plant,
                **(plant or {}),
            }
        ),
        CONTROLLER.complete(
            {
                "motor": motor,
                "scheme": scheme,
                "speed_ref_rpm": rpm,
                "load.inertia": (plant or {}).get("load.inertia", 0.0),
                "schedule": [entry for entry in entries if entry not in of_plant],
                **(controller or {}),
            }
        ),
    )
    traces = list(engine.run(round(seconds * engine.controller.values["pwm_frequency"])))

    def joined(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(trace, name) for trace in traces])

    state = joined("state")
    return Run(
        feedback=joined("feedback"),
        command=joined("command"),
        lut=joined("lut"),
        state=state,
        i_abc=joined("i_abc").reshape(len(state), oversampling, 3),
        controller=engine.controller,
    )

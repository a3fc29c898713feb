"""The plant's parameters and state as NumPy records: inspectable, copyable, storable.

Every kernel of this package takes arrays of length 1 of these; `values` in the docstrings of the
fields are SI units.
"""

from __future__ import annotations

import numpy as np

PLANT_PAR = np.dtype(
    [
        # machine
        ("R_s", np.float64),  # stator resistance (ohm)
        ("L_d", np.float64),  # d- and q-axis inductance (H)
        ("L_q", np.float64),
        ("psi_f", np.float64),  # permanent-magnet flux linkage (V s)
        ("n_p", np.float64),  # number of pole pairs; whole, kept as float for the arithmetic
        # mechanics
        ("J", np.float64),  # inertia (kg m^2)
        ("B", np.float64),  # viscous friction (N m s)
        ("tau_L", np.float64),  # load torque (N m)
        # supply, sensors, time
        ("u_dc", np.float64),  # DC-link voltage (V)
        ("noise_rms", np.float64),  # noise of each phase-current sensor (A)
        ("seed", np.uint64),
        ("T_s", np.float64),  # PWM period (s)
        ("period_ns", np.int64),  # the same in ns, for stamps without rounding
        ("h_max", np.float64),  # longest internal step (s)
    ],
    align=True,
)

PLANT_STATE = np.dtype(
    [
        ("period", np.uint64),  # the period that begins now
        ("i_d", np.float64),  # stator current in the rotor frame (A)
        ("i_q", np.float64),
        ("w_M", np.float64),  # mechanical speed (rad/s)
        ("theta_M", np.float64),  # mechanical angle (rad), in [0, 2 pi)
        ("energy_in", np.float64),  # from the DC link since the start (J)
        # what the inverter applies in the period that begins now
        ("duty", np.float64, (3,)),
        ("enable", np.bool_),
        ("latched", np.bool_),  # a command for this period is there
        # the period's switching pattern: seven intervals of constant leg states
        ("t_switch", np.float64, (8,)),  # their limits (s from the start of the period)
        ("legs", np.int64, (7,)),  # bit 0, 1, 2: upper switch of leg a, b, c
    ],
    align=True,
)

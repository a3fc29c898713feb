"""The plant's parameters and state as NumPy records: inspectable, copyable, storable.

Every kernel of this package takes arrays of length 1 of these. All values are in SI units.
"""

from __future__ import annotations

import numpy as np

# Largest flux map: B-spline coefficients along i_d and i_q.
MAP_SIZE = 37

PLANT_PAR = np.dtype(
    [
        # machine, as it is now (temperature and drift included)
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
        # missing commands (see `inverter.take_command`)
        ("hold", np.bool_),  # whether the first missing command is replaced by the one before
        ("loss_limit", np.int64),  # so many missing in a row: gates off, latched
    ],
    align=True,
)

# How the three bridge legs are connected (see `bridge`)
BRIDGE = np.dtype(
    [
        # what clamps a leg that carries positive, and negative current: v = rail u_dc - drop - r i
        ("rail_p", np.float64, (3,)),
        ("drop_p", np.float64, (3,)),
        ("r_p", np.float64, (3,)),
        ("rail_n", np.float64, (3,)),
        ("drop_n", np.float64, (3,)),
        ("r_n", np.float64, (3,)),
        ("watched", np.int64, (3,)),  # 1: the two differ, so the sign of the current matters
        ("can_float", np.int64, (3,)),  # 1: there are voltages at which neither conducts
        ("mode", np.int64, (3,)),  # sign of the current; 0: none flows
    ],
    align=True,
)

# What `bridge.solve` finds for one instant
ELECTRIC = np.dtype(
    [
        ("di_d", np.float64),  # derivative of the machine current (A/s)
        ("di_q", np.float64),
        ("i_alpha", np.float64),  # stator current in the stationary frame (A)
        ("i_beta", np.float64),
        ("psi_d", np.float64),  # flux linkage (V s)
        ("psi_q", np.float64),
        ("v", np.float64, (3,)),  # terminal voltages; against the star point if no leg conducts
        ("c", np.float64),  # cosine and sine of the electrical angle
        ("s", np.float64),
        ("w_m", np.float64),  # electrical speed (rad/s)
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
        # commands that were not there in time, and those refused
        ("armed", np.bool_),  # a command has been accepted: from now on one has to be there
        ("missing_in_row", np.int64),
        ("missed", np.uint64),  # since the start
        ("refused", np.uint64),  # since the start
        ("tripped", np.bool_),  # gates off until cleared
        ("gates_on", np.bool_),  # whether the gates are driven in this period
        # the period's switching pattern: seven intervals of constant leg states
        ("t_switch", np.float64, (8,)),  # their limits (s from the start of the period)
        ("legs", np.int64, (7,)),  # bit 0, 1, 2: upper switch of leg a, b, c
        ("bridge", BRIDGE),
        ("electric", ELECTRIC),
    ],
    align=True,
)

"""The plant's parameters and state as NumPy records: inspectable, copyable, storable.

They are put together from the fields of the parts (`parts`). Every kernel of this package takes
arrays of length 1 of these. All values are in SI units.
"""

from __future__ import annotations

import numpy as np

from pmsm_sim.bridge import BRIDGE, ELECTRIC
from pmsm_sim.columns import FIRST_ENERGY, N_INTEGRATED
from pmsm_sim.parts import PARTS

PLANT_PAR = np.dtype(
    [
        ("pwm_frequency", np.float64),  # (Hz)
        ("T_s", np.float64),  # PWM period (s)
        ("h_max", np.float64),  # longest internal step (s) of the ideal model
        ("h_general", np.float64),  # and of the general one
        # whether there are effects that only the general model has
        ("general", np.bool_),
        *(field for part in PARTS for field in part.par),
    ],
    align=True,
)

PLANT_STATE = np.dtype(
    [
        ("period", np.uint64),  # the period that begins now
        ("energy_in", np.float64),  # from the DC link since the start (J)
        ("general_before", np.bool_),  # it ran in the period before, so what only it knows holds
        ("energy", np.float64, (N_INTEGRATED - FIRST_ENERGY,)),  # (J) since the start
        *(field for part in PARTS for field in part.state),
        ("bridge", BRIDGE),
        ("electric", ELECTRIC),
    ],
    align=True,
)

"""The plant's parameters and state as NumPy records: inspectable, copyable, storable.

They are put together from the fields of the parts (`parts`). Every kernel of this package takes
arrays of length 1 of these. All values are in SI units.
"""

from __future__ import annotations

import numpy as np

from pmsm_sim.bridge import BRIDGE, ELECTRIC
from pmsm_sim.columns import ENERGIES, N_ROW
from pmsm_sim.parts import PARTS

# The instant where a step starts, that where it ends, and another that is looked at; four
# derivatives.
WORK_ROWS = 7

PLANT_PAR = np.dtype(
    [
        ("pwm_frequency", np.float64),  # (Hz)
        ("T_s", np.float64),  # PWM period (s)
        ("h_max", np.float64),  # longest internal step (s) of the ideal model
        ("h_general", np.float64),  # and of the general one
        # whether there are effects that only the general model has
        ("general", np.bool_),
        ("full", np.bool_),  # and there, whether only the full step has them
        *(field for part in PARTS for field in part.par),
    ],
    align=True,
)

PLANT_STATE = np.dtype(
    [
        ("period", np.uint64),  # the period that begins now
        ("energy_in", np.float64),  # from the DC link since the start (J)
        ("general_before", np.bool_),  # it ran in the period before, so what only it knows holds
        ("energy", np.float64, (len(ENERGIES),)),  # (J) since the start
        *(field for part in PARTS for field in part.state),
        ("bridge", BRIDGE),
        ("electric", ELECTRIC),
        ("events", np.int64),  # times the conduction changed by itself in the period before
        ("work", np.float64, (WORK_ROWS, N_ROW)),  # of the general model
    ],
    align=True,
)

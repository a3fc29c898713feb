"""A row of the general model's work space: the drive at one instant (see `general`)."""

from __future__ import annotations

INTEGRATED = (
    "i_d",  # machine current (A): what magnetises
    "i_q",
    "w_M",  # speed of the rotor (rad/s)
    "turn_M",  # angle turned by the rotor since the period began (rad)
    "u_dc",  # DC-link voltage (V)
    "w_L",  # speed of the load behind the shaft (rad/s)
    "twist",  # of the shaft (rad)
    "tau_brake",  # torque of the powder brake (N m)
    "supply",  # energies (J): into the DC link
    "dc",  # from the DC link into the inverter
    "inverter",  # lost in switches and diodes
    "copper",
    "iron",
    "friction",
    "load",  # given to the load
    "chopper",
)
N_INTEGRATED = len(INTEGRATED)
FIRST_ENERGY = INTEGRATED.index("supply")

ROW = (
    *INTEGRATED,
    "i_f_alpha",  # behind the current sensors' low-pass (A)
    "i_f_beta",
    # what follows from the above
    "c",  # cosine and sine of the electrical angle
    "s",
    "psi_alpha",  # flux linkage in the stationary frame (V s)
    "psi_beta",
    "i_alpha",  # machine current there (A)
    "i_beta",
    "tau_M",  # torque of the machine, cogging included (N m)
    "psi_d",  # flux linkage in the rotor frame without harmonics (V s)
    "psi_q",
    "L_dd",  # incremental inductances (H)
    "L_dq",
    "L_qq",
)
N_ROW = len(ROW)


def column(name: str) -> int:
    """Return the column of a quantity."""
    return ROW.index(name)

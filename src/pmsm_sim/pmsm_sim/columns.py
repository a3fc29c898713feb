"""What the general model integrates: the columns of its work space (see `general`)."""

from __future__ import annotations

INTEGRATED = (
    "i_d",  # machine current (A)
    "i_q",
    "w_M",  # speed of the rotor (rad/s)
    "turn_M",  # angle turned by the rotor since the period began (rad)
    "u_dc",  # DC-link voltage (V)
    "w_L",  # speed of the load behind the shaft (rad/s)
    "twist",  # of the shaft (rad)
    "tau_brake",  # torque of the powder brake (N m)
    "i_f_alpha",  # behind the current sensors' low-pass (A)
    "i_f_beta",
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


def column(name: str) -> int:
    """Return the column of a quantity."""
    return INTEGRATED.index(name)

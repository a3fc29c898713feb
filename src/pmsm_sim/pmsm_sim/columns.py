"""A row of the general model's work space: the drive at one instant (see `general`)."""

from __future__ import annotations

#: Energies (J), in the order of their columns: into the DC link; from there into the inverter; lost
#: in switches and diodes; in copper, iron and friction; given to the load; lost in the chopper.
ENERGIES = ("supply", "dc", "inverter", "copper", "iron", "friction", "load", "chopper")

(
    # what is integrated
    I_D,  # machine current (A): what magnetises
    I_Q,
    W_M,  # speed of the rotor (rad/s)
    TURN_M,  # angle turned by the rotor since the period began (rad)
    U_DC,  # DC-link voltage (V)
    W_L,  # speed of the load behind the shaft (rad/s)
    TWIST,  # of the shaft (rad)
    TAU_BRAKE,  # torque of the powder brake (N m)
    SUPPLY,  # `ENERGIES`
    DC,
    INVERTER,
    COPPER,
    IRON,
    FRICTION,
    LOAD,
    CHOPPER,
    # what is not, but solved step by step
    I_F_ALPHA,  # behind the current sensors' low-pass (A)
    I_F_BETA,
    # what follows from the above
    C,  # cosine and sine of the electrical angle
    S,
    PSI_ALPHA,  # flux linkage in the stationary frame (V s)
    PSI_BETA,
    I_ALPHA,  # machine current there (A)
    I_BETA,
    TAU_M,  # torque of the machine, cogging included (N m)
    PSI_D,  # flux linkage in the rotor frame without harmonics (V s)
    PSI_Q,
    L_DD,  # incremental inductances (H)
    L_DQ,
    L_QD,
    L_QQ,
) = range(31)
N_ROW = L_QQ + 1
N_INTEGRATED = CHOPPER + 1

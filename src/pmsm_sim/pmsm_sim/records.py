"""The plant's parameters and state as NumPy records: inspectable, copyable, storable.

Every kernel of this package takes arrays of length 1 of these. All values are in SI units.
"""

from __future__ import annotations

import numpy as np

from pmsm_sim import protection
from pmsm_sim.injection import INJECTOR

# Flux map: most cells along one current, and the spline coefficients they need.
MAP_CELLS = 24
MAP_SIZE = MAP_CELLS + 5
# Load profile: most points.
PROFILE_SIZE = 64

# Quantities that the general model integrates: the columns of its work space (see `general`)
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

PLANT_PAR = np.dtype(
    [
        # machine, as it is now (temperature and drift included)
        ("R_s", np.float64),  # stator resistance (ohm)
        ("L_d", np.float64),  # d- and q-axis inductance (H)
        ("L_q", np.float64),
        ("psi_f", np.float64),  # permanent-magnet flux linkage (V s)
        ("n_p", np.float64),  # number of pole pairs; whole, kept as float for the arithmetic
        # mechanics
        ("J", np.float64),  # inertia of the rotor, and of the load if there is no shaft (kg m^2)
        ("B", np.float64),  # viscous friction (N m s)
        ("tau_L", np.float64),  # load torque (N m)
        # supply, sensors, time
        ("u_dc", np.float64),  # DC-link voltage, where it is stiff (V)
        ("noise_rms", np.float64),  # noise of each phase-current sensor (A)
        ("seed", np.uint64),
        ("pwm_frequency", np.float64),  # (Hz)
        ("T_s", np.float64),  # PWM period (s)
        ("h_max", np.float64),  # longest internal step (s) of the ideal model
        ("h_general", np.float64),  # and of the general one
        # missing commands (see `inverter.take_command`)
        ("hold", np.bool_),  # whether the first missing command is replaced by the one before
        *protection.PAR_FIELDS,
        # what load_torque and dc_voltage say, before injected faults
        ("tau_set", np.float64),  # (N m)
        ("u_dc_set", np.float64),  # (V)
        # which effects there are; all false: the ideal model, and nothing below is looked at
        ("general", np.bool_),  # what only the general model has
        ("modulator", np.bool_),  # duties are not applied as they come
        ("sensors", np.bool_),  # measurements have more errors than noise
        ("drifts", np.bool_),  # the temperature moves
        # inverter
        ("timer_counts", np.float64),  # of the PWM timer from 0 to its peak; 0: no quantisation
        ("min_pulse", np.float64),  # shorter pulses are left out (s)
        ("dead_time", np.float64),  # (s)
        ("switch_voltage", np.float64),  # on-state: constant part (V), resistance (ohm)
        ("switch_resistance", np.float64),
        ("diode_voltage", np.float64),
        ("diode_resistance", np.float64),
        # machine beyond the linear equations
        ("iron_conductance", np.float64),  # across the induced voltage (S); 0: no iron loss
        ("iron_floating", np.float64),  # the same for legs without current (see `bridge.solve`)
        ("psi_h", np.float64, (4,)),  # 5th, 7th, 11th, 13th harmonic of the magnet flux (V s)
        ("harmonics", np.bool_),  # whether there are any
        ("cogging_torque", np.float64),  # (N m)
        ("cogging_periods", np.float64),  # per turn
        ("saturates", np.bool_),  # the flux linkage comes from the map
        ("psi_shift", np.float64),  # flux of the magnets above that of the map (V s)
        ("map_start", np.float64, (2,)),  # smallest i_d, i_q (A)
        ("map_rate", np.float64, (2,)),  # cells per ampere
        ("map_cells", np.int64, (2,)),
        ("map", np.float64, (MAP_SIZE, MAP_SIZE)),  # B-spline coefficients of the co-energy (J)
        # DC link
        ("rectifier", np.bool_),  # a rectifier and a capacitor instead of a stiff voltage
        ("capacitance", np.float64),  # (F)
        ("grid_peak", np.float64),  # line-to-line (V)
        ("grid_w", np.float64),  # (rad/s)
        ("grid_conductance", np.float64),  # of what lies in series with the rectifier (S)
        ("chopper_conductance", np.float64),  # (S); 0: no chopper
        ("chopper_on", np.float64),  # voltages at which it switches (V)
        ("chopper_off", np.float64),
        # mechanics and load
        ("load_kind", np.int64),  # index in LOAD_KINDS
        ("coulomb", np.float64),  # Coulomb friction (N m)
        ("quadratic", np.float64),  # load torque over speed squared (N m s^2)
        ("w_imposed", np.float64),  # (rad/s)
        ("brake_rate", np.float64),  # 1 / time constant of the powder brake (1/s); 0: no lag
        ("shaft", np.bool_),  # a load behind an elastic shaft
        ("J_load", np.float64),  # its inertia (kg m^2)
        ("shaft_stiffness", np.float64),  # (N m/rad)
        ("shaft_damping", np.float64),  # (N m s)
        ("profile_points", np.int64),
        ("profile_t", np.float64, (PROFILE_SIZE,)),  # (s)
        ("profile_tau", np.float64, (PROFILE_SIZE,)),  # (N m)
        # sensors
        ("gain", np.float64, (3,)),
        ("offset", np.float64, (3,)),  # (A)
        ("filter_rate", np.float64),  # 2 pi times the bandwidth (rad/s); 0: none
        ("adc_step", np.float64),  # (A); 0: no quantisation
        ("adc_codes", np.float64),  # half their number
        ("sampling_lead", np.float64),  # currents are sampled so long before the period (s)
        ("encoder_counts", np.float64),  # per turn; 0: no quantisation
        ("encoder_offset", np.float64),  # (rad)
        ("encoder_latency", np.float64),  # (s)
        ("angle_noise", np.float64),  # rms (rad)
        # temperature
        ("R_20", np.float64),  # at 20 degC, drift included (ohm)
        ("psi_20", np.float64),  # (V s)
        ("psi_map", np.float64),  # flux of the magnets that the map contains (V s)
        ("ambient", np.float64),  # temperature towards which it moves (degC)
        ("thermal_rate", np.float64),  # 1 / time constant (1/s); 0: at once
        ("thermal_resistance", np.float64),  # rise per copper loss (K/W)
        ("copper_coefficient", np.float64),  # (1/K)
        ("magnet_coefficient", np.float64),
    ],
    align=True,
)

LOAD_KINDS = ("torque", "brake", "speed")

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
        ("e_alpha", np.float64),  # induced voltage (V)
        ("e_beta", np.float64),
        ("torque", np.float64),  # electromagnetic (N m)
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
        ("i_d", np.float64),  # machine current in the rotor frame (A)
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
        *protection.STATE_FIELDS,
        ("gates_on", np.bool_),  # whether the gates are driven in this period
        # the period's switching pattern: seven intervals of constant leg states
        ("t_switch", np.float64, (8,)),  # their limits (s from the start of the period)
        ("legs", np.int64, (7,)),  # bit 0, 1, 2: upper switch of leg a, b, c
        # more of the general model
        ("general_before", np.bool_),  # it ran in the period before, so the following holds
        ("u_dc", np.float64),  # as `INTEGRATED`
        ("w_L", np.float64),
        ("twist", np.float64),
        ("tau_brake", np.float64),
        ("i_f_alpha", np.float64),
        ("i_f_beta", np.float64),
        ("i_sampled", np.float64, (2,)),  # alpha and beta current for the next sample (A)
        ("theta_sampled", np.float64),  # rotor angle for the next sample (rad)
        ("level", np.int64, (3,)),  # what leg x was told last: 1 high, 0 low
        ("since", np.float64, (3,)),  # how long ago that changed (s)
        ("chopping", np.bool_),
        ("temperature", np.float64),  # of winding and magnets (degC)
        ("energy", np.float64, (N_INTEGRATED - FIRST_ENERGY,)),  # (J) since the start
        ("injector", INJECTOR),
        ("bridge", BRIDGE),
        ("electric", ELECTRIC),
    ],
    align=True,
)

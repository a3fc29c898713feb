"""The machine's flux linkage and torque, in the rotor frame.

Linear, method section 1:

    psi_d = psi_f + L_d i_d        psi_q = L_q i_q

Saturated: psi_d and psi_q are the derivatives of one co-energy W'(i_d, i_q), a bivariate B-spline
fitted to a flux map (`flux_map`). That makes the map reciprocal (dpsi_d/di_q = dpsi_q/di_d), so
the field stores energy and makes none.

Harmonics of the magnets' flux, psi_a = psi_f cos(theta) + sum_n psi_n cos(n theta) in phase a, add
with the electrical angle theta

    psi_d: (psi_5 + psi_7) cos 6 theta + (psi_11 + psi_13) cos 12 theta
    psi_q: (psi_7 - psi_5) sin 6 theta + (psi_13 - psi_11) sin 12 theta

Torque is the derivative of the co-energy with respect to the angle:

    tau = 1.5 n_p (psi_d i_q - psi_q i_d + i_d dpsi_d/dtheta + i_q dpsi_q/dtheta)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pmsm_sim import flux_map
from pmsm_sim.flux_map import co_energy
from pmsm_sim.motor import MotorPars
from pmsm_sim.parts.part import MOST_STEPS, Part
from pwm_node.compiled import inlined, kernel
from pwm_node.parameters import Parameter

# Harmonics of the magnets' flux
_HARMONICS = (5, 7, 11, 13)

# Newton's method on a flux map ends after so many moves at the latest.
_MOST_MOVES = 12

PARAMETERS = (
    Parameter(
        "machine.flux_map",
        "",
        "Saturation: a name of config/flux_maps or the path of a file; empty: linear machine",
        read_only=True,
    ),
    Parameter(
        "machine.iron_loss_resistance",
        0.0,
        "Resistance across the induced voltage that stands for the iron loss; 0: no iron loss",
        unit="ohm",
        minimum=0.0,
        maximum=1e7,
    ),
    *(
        Parameter(
            f"machine.emf_{n}",
            0.0,
            f"{n}th harmonic of the back-EMF over its fundamental",
            minimum=-0.5,
            maximum=0.5,
        )
        for n in _HARMONICS
    ),
    Parameter(
        "machine.cogging_torque",
        0.0,
        "Amplitude of the cogging torque",
        unit="N m",
        minimum=0.0,
        maximum=1e3,
    ),
    Parameter(
        "machine.cogging_periods",
        24,
        "Periods of the cogging torque per turn",
        minimum=1,
        maximum=1_000,
    ),
    Parameter(
        "drift.resistance",
        1.0,
        "Stator resistance divided by that of the motor file",
        minimum=0.01,
        maximum=100.0,
        also=(
            "drift.R",
            "drift.R_s",
        ),
    ),
    Parameter(
        "drift.flux",
        1.0,
        "Magnet flux divided by that of the motor file or flux map",
        minimum=0.0,
        maximum=10.0,
        also=(
            "drift.psi",
            "drift.psi_f",
        ),
    ),
)

PAR = (
    # as it is now, temperature and drift included
    ("R_s", np.float64),  # stator resistance (ohm)
    ("L_d", np.float64),  # d- and q-axis inductance (H)
    ("L_q", np.float64),
    ("psi_f", np.float64),  # permanent-magnet flux linkage (V s)
    ("n_p", np.float64),  # number of pole pairs; whole, kept as float for the arithmetic
    # at 20 degC, drift included
    ("R_20", np.float64),  # (ohm)
    ("psi_20", np.float64),  # (V s)
    ("psi_map", np.float64),  # flux of the magnets that the map contains (V s)
    ("iron_conductance", np.float64),  # across the induced voltage (S); 0: no iron loss
    ("iron_floating", np.float64),  # the same for legs without current (see `bridge.solve`)
    ("psi_h", np.float64, (4,)),  # 5th, 7th, 11th, 13th harmonic of the magnet flux (V s)
    ("harmonics", np.bool_),  # whether there are any
    ("cogging_torque", np.float64),  # (N m)
    ("cogging_periods", np.float64),  # per turn
    ("saturates", np.bool_),  # the flux linkage comes from the map
    ("psi_shift", np.float64),  # flux of the magnets above that of the map (V s)
    ("map", flux_map.MAP),
)

STATE = (
    ("i_d", np.float64),  # current in the rotor frame (A)
    ("i_q", np.float64),
)


def _start(par: np.void, st: np.void, values: Mapping[str, Any], motor: MotorPars) -> None:
    for name in ("L_d", "L_q", "n_p"):
        par[name] = getattr(motor, name)
    name = values["machine.flux_map"]
    par["saturates"] = bool(name)
    par["psi_map"] = motor.psi_f
    if name:
        found = flux_map.load(name)
        par["map"] = found.map_[0]
        par["psi_map"] = found.psi_f


def _configure(par: np.void, st: np.void, values: Mapping[str, Any], motor: MotorPars) -> None:
    par["R_20"] = motor.R_s * values["drift.resistance"]
    par["psi_20"] = par["psi_map"] * values["drift.flux"]
    ratios = [values[f"machine.emf_{n}"] for n in _HARMONICS]
    par["psi_h"] = [r * par["psi_20"] / n for r, n in zip(ratios, _HARMONICS, strict=True)]
    par["harmonics"] = any(ratios)
    R_iron = values["machine.iron_loss_resistance"]
    par["iron_conductance"] = 1.0 / R_iron if R_iron > 0.0 else 0.0
    shortest = par["T_s"] / MOST_STEPS
    smallest = 2.0 * shortest / min(par["L_d"], par["L_q"])
    par["iron_floating"] = max(par["iron_conductance"], smallest)


def _general(par: np.void) -> bool:
    return bool(
        par["iron_conductance"] > 0.0
        or par["harmonics"]
        or par["cogging_torque"] != 0.0
        or par["saturates"]
    )


def _rates(par: np.void) -> list[float]:
    R = par["R_s"] + max(par["switch_resistance"], par["diode_resistance"])
    return [R / min(par["L_d"], par["L_q"])]


def _full(par: np.void) -> bool:
    return bool(par["harmonics"] or par["cogging_torque"] != 0.0 or par["saturates"])


PART = Part(
    parameters=PARAMETERS,
    par=PAR,
    state=STATE,
    start=_start,
    configure=_configure,
    general=_general,
    full=_full,
    rates=_rates,
)


@kernel
def torque(par, i_d, i_q):
    """Electromagnetic torque (N m) of the linear machine."""
    return 1.5 * par.n_p * (par.psi_f + (par.L_d - par.L_q) * i_d) * i_q


@inlined
def cogging(par, theta_M):
    """Cogging torque (N m): -tau sin(N theta_M), N periods per turn."""
    if par.cogging_torque == 0.0:
        return 0.0
    return -par.cogging_torque * math.sin(par.cogging_periods * theta_M)


@inlined
def harmonics(par, c, s):
    """Flux linkage of the harmonics (V s) in d and q, and its derivative with the angle."""
    z_2 = complex(c, s) ** 2
    z_6 = z_2 * z_2 * z_2
    z_12 = z_6 * z_6
    sum_6, sum_12 = par.psi_h[1] + par.psi_h[0], par.psi_h[3] + par.psi_h[2]
    difference_6, difference_12 = par.psi_h[1] - par.psi_h[0], par.psi_h[3] - par.psi_h[2]
    psi_d = sum_6 * z_6.real + sum_12 * z_12.real
    psi_q = difference_6 * z_6.imag + difference_12 * z_12.imag
    turn_d = -6.0 * sum_6 * z_6.imag - 12.0 * sum_12 * z_12.imag
    turn_q = 6.0 * difference_6 * z_6.real + 12.0 * difference_12 * z_12.real
    return psi_d, psi_q, turn_d, turn_q


@kernel
def flux(par, i_d, i_q, c, s):
    """Flux linkage and what follows from it.

    Parameters
    ----------
    i_d, i_q : float
        Machine current (A).
    c, s : float
        Cosine and sine of the electrical angle.

    Returns
    -------
    psi_d, psi_q : flux linkage (V s)
    turn_d, turn_q : its derivative with respect to the electrical angle (V s/rad)
    L_dd, L_dq, L_qd, L_qq : incremental inductances (H), see `flux_map.co_energy`
    """
    if par.saturates:
        _, psi_d, psi_q, L_dd, L_dq, L_qd, L_qq = co_energy(par.map, i_d, i_q)
        psi_d += par.psi_shift
    else:
        psi_d, psi_q = par.psi_f + par.L_d * i_d, par.L_q * i_q
        L_dd, L_dq, L_qd, L_qq = par.L_d, 0.0, 0.0, par.L_q
    turn_d = turn_q = 0.0
    if par.harmonics:
        more_d, more_q, turn_d, turn_q = harmonics(par, c, s)
        psi_d += more_d
        psi_q += more_q
    return psi_d, psi_q, turn_d, turn_q, L_dd, L_dq, L_qd, L_qq


@inlined
def current(par, per_L, psi_d, psi_q, near, last_move):
    """Current of a flux linkage (V s) without harmonics: the inverse of `flux`.

    A flux map is inverted by Newton's method. The error after an iteration goes with the square
    of its move.

    Parameters
    ----------
    per_L : (float, float)
        1 / L_d, 1 / L_q (1/H).
    near : tuple
        The result at a neighbouring point, from where it starts.
    last_move : float
        The iterations end after a move shorter than this, in cells of the flux map.

    Returns
    -------
    tuple
        i_d, i_q (A), psi_d, psi_q (V s), and the incremental inductances L_dd, L_dq, L_qd,
        L_qq (H).
    """
    if not par.saturates:
        i_d, i_q = (psi_d - par.psi_f) * per_L[0], psi_q * per_L[1]
        return i_d, i_q, psi_d, psi_q, par.L_d, 0.0, 0.0, par.L_q
    i_d, i_q, at_d, at_q, L_dd, L_dq, L_qd, L_qq = near
    small_d, small_q = last_move / par.map.rate[0], last_move / par.map.rate[1]
    for n in range(_MOST_MOVES):
        off_d, off_q = psi_d - at_d, psi_q - at_q
        inverse = 1.0 / (L_dd * L_qq - L_dq * L_qd)
        move_d = (L_qq * off_d - L_dq * off_q) * inverse
        move_q = (L_dd * off_q - L_qd * off_d) * inverse
        i_d += move_d
        i_q += move_q
        if n > 0 and abs(move_d) < small_d and abs(move_q) < small_q:
            break
        _, at_d, at_q, L_dd, L_dq, L_qd, L_qq = co_energy(par.map, i_d, i_q)
        at_d += par.psi_shift
    return i_d, i_q, psi_d, psi_q, L_dd, L_dq, L_qd, L_qq

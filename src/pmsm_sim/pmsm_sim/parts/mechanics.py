"""Shaft and load: torques, friction, and how they move.

Friction and brakes oppose the motion. Around standstill, where their sign is not defined, they
grow smoothly with speed, sign(w) ~ w / sqrt(w^2 + w_0^2), so a shaft held by them creeps below
w_0 instead of standing still.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from pmsm_sim import columns as col
from pmsm_sim.motor import MotorPars
from pmsm_sim.parts.part import MOST_STEPS, Part
from pwm_node.compiled import inlined, kernel
from pwm_node.parameters import Parameter
from pwm_node.units import RPM

_LOAD_KINDS = ("torque", "brake", "speed")
_BRAKE, _SPEED = _LOAD_KINDS.index("brake"), _LOAD_KINDS.index("speed")


# Speed below which friction is not fully there (rad/s; 1 r/min).
_STANDSTILL = 0.1
# Most points of a load profile
_PROFILE_SIZE = 64

PARAMETERS = (
    Parameter(
        "load_torque",
        0.0,
        "Load torque",
        unit="N m",
        minimum=-1e4,
        maximum=1e4,
        also=("tau_L", "T_L"),
    ),
    Parameter(
        "load.kind",
        "torque",
        "torque: load_torque acts whatever the speed; brake: load_torque of a magnetic powder "
        "brake, against the motion; speed: load.speed_rpm is imposed on the rotor",
        choices=_LOAD_KINDS,
    ),
    Parameter(
        "load.speed_rpm",
        0.0,
        "Speed imposed on the rotor where load.kind is speed",
        unit="r/min",
        minimum=-1e5,
        maximum=1e5,
    ),
    Parameter(
        "load.brake_lag",
        0.0,
        "Time constant with which the powder brake follows load_torque; 0: at once",
        unit="s",
        minimum=0.0,
        maximum=100.0,
    ),
    Parameter(
        "load.quadratic",
        0.0,
        "Load torque divided by the square of the speed (fan, pump)",
        unit="N m s^2",
        minimum=0.0,
        maximum=10.0,
    ),
    Parameter(
        "load.profile",
        [0.0, 0.0],
        "Load torque over time, added to the others: time (s) and torque (N m) alternate, with "
        "straight lines between the points",
        read_only=True,
    ),
    Parameter(
        "load.coulomb_friction",
        0.0,
        "Coulomb friction of the rotor",
        unit="N m",
        minimum=0.0,
        maximum=1e3,
    ),
    Parameter(
        "load.viscous_friction",
        0.0,
        "Viscous friction, added to that of the motor file",
        unit="N m s",
        minimum=0.0,
        maximum=10.0,
    ),
    Parameter(
        "load.inertia",
        0.0,
        "Inertia of the load, added to that of the motor file",
        unit="kg m^2",
        minimum=0.0,
        maximum=1e3,
        read_only=True,
        also=("load.J",),
    ),
    Parameter(
        "load.shaft_stiffness",
        0.0,
        "Stiffness of the shaft between motor and load.inertia; 0: rigid",
        unit="N m/rad",
        minimum=0.0,
        maximum=1e7,
        read_only=True,
    ),
    Parameter(
        "load.shaft_damping",
        0.0,
        "Damping of the shaft",
        unit="N m s",
        minimum=0.0,
        maximum=1e3,
    ),
    Parameter(
        "initial_speed_rpm",
        0.0,
        "Rotor speed at period 0",
        unit="r/min",
        minimum=-1e5,
        maximum=1e5,
        read_only=True,
    ),
    Parameter(
        "initial_angle",
        0.0,
        "Mechanical rotor angle at period 0",
        unit="rad",
        minimum=-1e3,
        maximum=1e3,
        read_only=True,
    ),
)

PAR = (
    ("J", np.float64),  # inertia of the rotor, and of the load if there is no shaft (kg m^2)
    ("B", np.float64),  # viscous friction (N m s)
    ("load_torque", np.float64),  # what the parameter says (N m)
    ("tau_L", np.float64),  # the same with injected faults (N m)
    ("load_kind", np.int64),  # index in _LOAD_KINDS
    ("imposed", np.bool_),  # whether the load imposes the speed
    ("coulomb_friction", np.float64),  # (N m)
    ("quadratic", np.float64),  # load torque over speed squared (N m s^2)
    ("w_imposed", np.float64),  # (rad/s)
    ("brake_rate", np.float64),  # 1 / time constant of the powder brake (1/s); 0: no lag
    ("shaft", np.bool_),  # a load behind an elastic shaft
    ("J_load", np.float64),  # its inertia (kg m^2)
    ("shaft_stiffness", np.float64),  # (N m/rad)
    ("shaft_damping", np.float64),  # (N m s)
    ("profile_points", np.int64),
    ("profile_t", np.float64, (_PROFILE_SIZE,)),  # (s)
    ("profile_tau", np.float64, (_PROFILE_SIZE,)),  # (N m)
)

STATE = (
    ("w_M", np.float64),  # mechanical speed (rad/s)
    ("theta_M", np.float64),  # mechanical angle (rad), in [0, 2 pi)
    ("w_L", np.float64),  # speed of the load behind the shaft (rad/s)
    ("twist", np.float64),  # of the shaft (rad)
    ("tau_brake", np.float64),  # torque of the powder brake (N m)
)


def _check(values: Mapping[str, Any]) -> str | None:
    if values["load.shaft_stiffness"] > 0.0 and values["load.inertia"] == 0.0:
        return "'load.inertia' = 0 is out of range: behind an elastic shaft it must be above 0"
    points = values["load.profile"]
    if len(points) % 2 or not 2 <= len(points) <= 2 * _PROFILE_SIZE:
        return (
            f"'load.profile' must have pairs of time (s) and torque (N m), 1 to {_PROFILE_SIZE} of "
            f"them; it has {len(points)} values"
        )
    times = points[::2]
    if any(a >= b for a, b in pairwise(times)):
        return f"'load.profile': the times must increase from point to point, not {times}"
    return None


def _start(par: np.void, st: np.void, values: Mapping[str, Any], motor: MotorPars) -> None:
    st["w_M"] = values["initial_speed_rpm"] * RPM
    st["theta_M"] = values["initial_angle"] % (2.0 * math.pi)


def _configure(par: np.void, st: np.void, values: Mapping[str, Any], motor: MotorPars) -> None:
    par["tau_L"] = par["load_torque"]
    par["load_kind"] = _LOAD_KINDS.index(values["load.kind"])
    par["imposed"] = par["load_kind"] == _SPEED
    par["w_imposed"] = values["load.speed_rpm"] * RPM
    par["B"] = motor.B + values["load.viscous_friction"]
    par["shaft"] = par["shaft_stiffness"] > 0.0
    par["J"] = motor.J if par["shaft"] else motor.J + values["load.inertia"]
    par["J_load"] = values["load.inertia"]
    lag = values["load.brake_lag"]
    # one that is faster than the shortest step cannot be told from it
    par["brake_rate"] = min(1.0 / lag, MOST_STEPS / par["T_s"]) if lag > 0.0 else 0.0
    points = values["load.profile"]
    n = len(points) // 2
    if not any(points[1::2]):
        n = 0  # no torque at any time
    par["profile_points"] = n
    par["profile_t"] = np.resize(points[0 : 2 * n : 2] + [0.0] * _PROFILE_SIZE, _PROFILE_SIZE)
    par["profile_tau"] = np.resize(points[1 : 2 * n : 2] + [0.0] * _PROFILE_SIZE, _PROFILE_SIZE)


def _full(par: np.void) -> bool:
    return bool(
        par["load_kind"] != _LOAD_KINDS.index("torque")
        or par["quadratic"] > 0.0
        or par["shaft"]
        or par["profile_points"] > 0
    )


def _general(par: np.void) -> bool:
    return _full(par) or bool(par["coulomb_friction"] > 0.0)


def _rates(par: np.void) -> list[float]:
    brake = abs(float(par["tau_L"])) if par["load_kind"] == _BRAKE else 0.0
    rates = [
        par["brake_rate"],
        (par["B"] + (par["coulomb_friction"] + brake) / _STANDSTILL) / par["J"],
    ]
    if par["shaft"]:
        slowness = 1.0 / par["J"] + 1.0 / par["J_load"]
        rates.append(math.sqrt(par["shaft_stiffness"] * slowness))
        rates.append(par["shaft_damping"] * slowness)
        rates.append(brake / _STANDSTILL / par["J_load"])
    return rates


PART = Part(
    parameters=PARAMETERS,
    par=PAR,
    state=STATE,
    check=_check,
    start=_start,
    configure=_configure,
    general=_general,
    full=_full,
    rates=_rates,
)


@kernel
def _sign(w):
    return w / math.sqrt(w * w + _STANDSTILL * _STANDSTILL)


@kernel
def _friction(par, w_M):
    """Viscous and Coulomb friction (N m): B w + tau_C sign(w)."""
    return par.B * w_M + par.coulomb_friction * _sign(w_M)


@kernel
def _profile(par, t):
    """Load torque (N m) of the profile at the simulated time t (s): straight lines between its
    points, constant before and after them."""
    last = par.profile_points - 1
    if last < 0:
        return 0.0
    if t <= par.profile_t[0]:
        return par.profile_tau[0]
    for n in range(last):
        t_0, t_1 = par.profile_t[n], par.profile_t[n + 1]
        if t < t_1:
            x = (t - t_0) / (t_1 - t_0)
            return par.profile_tau[n] + x * (par.profile_tau[n + 1] - par.profile_tau[n])
    return par.profile_tau[last]


@kernel
def _load_torque(par, period, t, w, tau_brake):
    """Torque of the load (N m) at the speed w (rad/s), t (s) after the period began.

    `torque`: as given, whatever the speed. `brake`: a magnetic powder brake, whose torque opposes
    the motion and follows its command with a first-order lag. Both: plus quadratic part (fan,
    pump) k w |w| and profile.
    """
    tau = tau_brake * _sign(w) if par.load_kind == _BRAKE else par.tau_L
    tau += par.quadratic * w * abs(w)
    if par.profile_points > 0:
        tau += _profile(par, period * par.T_s + t)
    return tau


@kernel
def shown_load(par, st):
    """Torque of the load (N m) at the start of the period, for `drive_state`."""
    tau = st.tau_brake if par.load_kind == _BRAKE else par.tau_L
    tau += par.quadratic * st.w_M * abs(st.w_M)
    return tau + _profile(par, st.period * par.T_s)


@kernel
def begin_mechanics(par, st, y, fresh):
    """State at the start of a period; `fresh`: the general model did not run in that before."""
    y[col.W_M] = par.w_imposed if par.imposed else st.w_M
    if fresh:
        st.w_L = y[col.W_M]
        st.twist = 0.0
        st.tau_brake = par.tau_L
    if par.brake_rate == 0.0:
        st.tau_brake = par.tau_L
    y[col.W_L], y[col.TWIST], y[col.TAU_BRAKE] = st.w_L, st.twist, st.tau_brake


@kernel
def end_mechanics(st, y):
    """State after a period, but for the angle."""
    st.w_M = y[col.W_M]
    st.w_L, st.twist, st.tau_brake = y[col.W_L], y[col.TWIST], y[col.TAU_BRAKE]


@inlined
def accelerate(par, per_J, w_M, tau_M):
    """What `move` gives for one mass under a constant torque: dw_M; friction.

    `per_J` is 1 / J.
    """
    tau_f = par.B * w_M
    if par.coulomb_friction > 0.0:
        tau_f = _friction(par, w_M)
    return (tau_M - tau_f - par.tau_L) * per_J, tau_f * w_M


@inlined
def move(par, period, t, w_M, w_L, twist, tau_brake, tau_M):
    """Derivatives of speeds and angles, t (s) after the period began, and powers.

    Parameters
    ----------
    w_M, w_L, twist, tau_brake : float
        The state (rad/s, rad/s, rad, N m).
    tau_M : float
        Torque of the machine (N m).

    Returns
    -------
    dw_M, dw_L, dtwist, dtau_brake : derivatives of the state
    friction, load : power lost, and given to the load (W)
    """
    tau_f = _friction(par, w_M)
    loss = tau_f * w_M
    dtau_brake = (par.tau_L - tau_brake) * par.brake_rate
    if par.imposed:
        return 0.0, 0.0, 0.0, dtau_brake, loss, (tau_M - tau_f) * w_M
    if par.shaft:
        slip = w_M - w_L
        tau_shaft = par.shaft_stiffness * twist + par.shaft_damping * slip
        tau_L = _load_torque(par, period, t, w_L, tau_brake)
        dw_M, dw_L = (tau_M - tau_f - tau_shaft) / par.J, (tau_shaft - tau_L) / par.J_load
        loss += par.shaft_damping * slip * slip
        return dw_M, dw_L, slip, dtau_brake, loss, tau_L * w_L
    tau_L = _load_torque(par, period, t, w_M, tau_brake)
    return (tau_M - tau_f - tau_L) / par.J, 0.0, 0.0, dtau_brake, loss, tau_L * w_M

"""
The drive as a model that is fitted: the measured current from voltage, angle and speed alone.

In the rotor frame, with the mean voltage of a period constant in the stationary frame,

    L_d di_d/dt = u_d - R_s i_d + w_m L_q i_q
    L_q di_q/dt = u_q - R_s i_q - w_m (L_d i_d + psi_f)

u_d, u_q are without the voltage that dead time and on-state voltages take, u_dead in the direction
of the legs' currents (a vector of known shape, so that its size is the only unknown). The rotor
frame lies by `zero` ahead of the angle that is given: 0 where the encoder's zero is right. The
sensors are a first-order low-pass in the stationary frame,
and have offsets. Nothing measured enters but the angle: so noise of the currents does not bias the
parameters, as it does in a prediction from sample to sample, and feedback of a controller does no
harm (an output-error model; L. Ljung, System Identification, 2nd ed., sections 4.3 and 13.4).
"""

from __future__ import annotations

import math

import numpy as np

from pwm_node.compiled import kernel

#: Parameters of `simulate`, in their order, and their units.
NAMES = (
    "R_s",
    "L_d",
    "L_q",
    "psi_f",
    "zero",
    "u_dead",
    "tau",
    "offset_a",
    "offset_b",
    "i_d0",
    "i_q0",
)


@kernel
def _slope_d(R_s, L_d, L_q, w, u, i_d, i_q):
    return (u.real - R_s * i_d + w * L_q * i_q) / L_d


@kernel
def _slope_q(R_s, L_d, L_q, psi_f, w, u, i_d, i_q):
    return (u.imag - R_s * i_q - w * (L_d * i_d + psi_f)) / L_q


@kernel
def simulate(par, T_s, theta, w_m, u_s_ab, s_ab, out):
    """
    Simulate the measured current.

    Parameters
    ----------
    par : ndarray, shape (11,)
        As `NAMES`: ohm, H, H, V s, rad, V, s, A, A, A, A.
    T_s : float
        (s)
    theta, w_m : ndarray, shape (n,)
        Electrical angle at the samples (rad), mean speed from each to the next (rad/s).
    u_s_ab, s_ab : ndarray of complex, shape (n,)
        Mean voltage from each sample to the next (V), and the direction of the legs' currents.
    out : ndarray of complex, shape (n,)
        Becomes the measured current in the stationary frame (A).
    """
    R_s, L_d, L_q, psi_f, zero, u_dead, tau = (
        par[0],
        par[1],
        par[2],
        par[3],
        par[4],
        par[5],
        par[6],
    )
    offset = complex(par[7], par[8])
    i_d, i_q = par[9], par[10]
    turn = complex(math.cos(theta[0] + zero), math.sin(theta[0] + zero))
    i_ab = complex(i_d, i_q) * turn
    y = i_ab
    decay = math.exp(-T_s / tau) if tau > 0.0 else 0.0
    out[0] = y + offset
    for k in range(theta.shape[0] - 1):
        w = w_m[k]
        half = complex(math.cos(0.5 * w * T_s), -math.sin(0.5 * w * T_s))
        u_0 = (u_s_ab[k] - u_dead * s_ab[k]) * turn.conjugate()
        u_1 = u_0 * half
        u_2 = u_1 * half
        # Runge-Kutta of fourth order, the voltage turning in the rotor frame
        a_d = _slope_d(R_s, L_d, L_q, w, u_0, i_d, i_q)
        a_q = _slope_q(R_s, L_d, L_q, psi_f, w, u_0, i_d, i_q)
        h = 0.5 * T_s
        b_d = _slope_d(R_s, L_d, L_q, w, u_1, i_d + h * a_d, i_q + h * a_q)
        b_q = _slope_q(R_s, L_d, L_q, psi_f, w, u_1, i_d + h * a_d, i_q + h * a_q)
        c_d = _slope_d(R_s, L_d, L_q, w, u_1, i_d + h * b_d, i_q + h * b_q)
        c_q = _slope_q(R_s, L_d, L_q, psi_f, w, u_1, i_d + h * b_d, i_q + h * b_q)
        d_d = _slope_d(R_s, L_d, L_q, w, u_2, i_d + T_s * c_d, i_q + T_s * c_q)
        d_q = _slope_q(R_s, L_d, L_q, psi_f, w, u_2, i_d + T_s * c_d, i_q + T_s * c_q)
        i_d += T_s / 6.0 * (a_d + 2.0 * (b_d + c_d) + d_d)
        i_q += T_s / 6.0 * (a_q + 2.0 * (b_q + c_q) + d_q)
        ahead = theta[k + 1] + zero
        turn = complex(math.cos(ahead), math.sin(ahead))
        following = complex(i_d, i_q) * turn
        # The low-pass, of a current that goes straight from sample to sample
        lag = (following - i_ab) * (tau / T_s)
        y = following - lag + (y - i_ab + lag) * decay
        i_ab = following
        out[k + 1] = y + offset


def direction(i_abc: np.ndarray, i_th: float) -> np.ndarray:
    """
    Direction in which dead time and on-state voltages act, as a vector.

    Parameters
    ----------
    i_abc : ndarray, shape (n, 3)
        Phase currents (A).
    i_th : float
        Below it a current counts as not certain of its sign (A).

    Returns
    -------
    ndarray of complex, shape (n,)
        Times the voltage of one leg, what is missing of the commanded voltage.
    """
    sign = np.clip(i_abc / i_th, -1.0, 1.0)
    a = np.exp(2j * np.pi / 3.0)
    vector: np.ndarray = 2.0 / 3.0 * (sign[:, 0] + a * sign[:, 1] + a**2 * sign[:, 2])
    return vector

"""
One step ahead by least squares: what a linear model with fixed coefficients explains.

In the rotor frame of the middle of a period, with real coefficients for d and for q each,

    i(k+1) - i(k) = A i(k) + B u(k) + w_m (E + F i(k)) + c

F is for salient machines, whose frame turns otherwise than their currents; at standstill w_m = 0
and the regressors are (i, u, 1). What is left is the least error that any predictor of this kind
can have on these data, whatever its parameters: the bound that schemes are judged against.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.identifying.steps import Steps

#: Fewer steps than this tell nothing of 16 coefficients.
FEWEST = 50


@dataclass(frozen=True)
class OneStep:
    """
    What least squares leave; one row per step that was used.

    Attributes
    ----------
    rows : ndarray of int64, shape (m,)
        Which steps of all.
    error : ndarray of complex, shape (m,)
        Measured minus predicted next current, in the rotor frame of that sample (A).
    unchanged : ndarray of complex, shape (m,)
        The same, for a predictor that says: the current in the rotor frame does not change.
    coefficients : ndarray, shape (8, 2)
        Of i_d, i_q, u_d, u_q, w_m, w_m i_d, w_m i_q, 1, for the increments of d and q.
    """

    rows: NDArray[np.int64]
    error: NDArray[np.complex128]
    unchanged: NDArray[np.complex128]
    coefficients: NDArray[np.float64]


def one_step(steps: Steps, rows: NDArray[np.int64] | None = None) -> OneStep | None:
    """
    Fit one step ahead.

    Parameters
    ----------
    steps : Steps
        The recording.
    rows : ndarray of int64, optional
        Steps to use, if they are whole; default: all that are.

    Returns
    -------
    OneStep or None
        None where there are too few steps.
    """
    chosen = np.flatnonzero(steps.whole) if rows is None else rows[steps.whole[rows]]
    if len(chosen) < FEWEST:
        return None
    half = 0.5 * steps.T_s * steps.w_m[chosen]
    middle = np.exp(-1j * (steps.theta_m[chosen] + half))
    i, w = steps.i_s_ab[chosen] * middle, steps.w_m[chosen]
    u = steps.u_s_ab[chosen] * middle
    following = steps.i_s_ab[chosen + 1] * middle
    regressors = np.stack(
        [i.real, i.imag, u.real, u.imag, w, w * i.real, w * i.imag, np.ones(len(i))], axis=1
    )
    # Columns of one size, so that what cannot be told apart is left out alike.
    size = np.sqrt((regressors**2).mean(axis=0))
    size[size == 0.0] = 1.0
    change = following - i
    found, *_ = np.linalg.lstsq(
        regressors / size, np.stack([change.real, change.imag], axis=1), rcond=1e-9
    )
    found /= size[:, None]
    predicted = regressors @ found
    turn = np.exp(-1j * half)  # from the middle of the period to its end
    error = (change - (predicted[:, 0] + 1j * predicted[:, 1])) * turn
    unchanged = following * turn - i / turn
    return OneStep(chosen, error, unchanged, found)

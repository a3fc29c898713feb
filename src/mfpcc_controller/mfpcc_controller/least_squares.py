"""Recursive weighted least squares of two outputs on the same twelve regressors.

With theta the coefficients of the outputs d and q, x the regressors, and P the covariance of the
coefficients, an error e' of variance r gives

    K = P x / (r + x' P x),  theta <- theta + K e',  P <- P - K x' P

(a Kalman filter for coefficients that walk at random about their first guess). Directions in which
nothing moves are not learned, and two causes that cannot be told apart stay as they were.

P x does not depend on the error: `foresee` is called once the regressors are known, `correct` when
the error is. P is kept whole, though it is symmetric, and the terms are written out: in this form
the compiler makes vectors of the columns, which takes half the time.
"""

from __future__ import annotations

import numpy as np

from pwm_node.compiled import kernel

#: Number of regressors
N = 12

# Columns: whole vectors of any processor. Those beyond N are zeros.
_WIDE = 16

#: Fields of a record for these kernels
FIELDS = (
    ("d", np.float64, (_WIDE,)),  # coefficients of either output
    ("q", np.float64, (_WIDE,)),
    ("P", np.float64, (N, _WIDE)),  # their covariance, over the outputs' unit squared
    ("P_first", np.float64, (N,)),  # its first diagonal
    ("x", np.float64, (N,)),  # regressors that the next error is about
    ("Px", np.float64, (_WIDE,)),
    ("of_first", np.float64),  # share of the first four regressors in x' P x
    ("known", np.float64),  # x' P x
    ("since", np.int64),  # last walk, in corrections
)


@kernel
def begin(fit, a, width):
    """Coefficient a is zero, give or take `width`."""
    fit.d[a], fit.q[a] = 0.0, 0.0
    fit.P_first[a] = width * width
    for b in range(_WIDE):
        fit.P[a, b] = 0.0
    fit.P[a, a] = width * width
    fit.since = 0


@kernel
def _all_of(x):
    return x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8], x[9], x[10], x[11]


@kernel
def foresee(fit):
    """P x, and x' P x, of the regressors."""
    P, x, Px = fit.P, fit.x, fit.Px
    x_0, x_1, x_2, x_3, x_4, x_5, x_6, x_7, x_8, x_9, x_10, x_11 = _all_of(x)
    for a in range(_WIDE):
        first = x_0 * P[0, a] + x_1 * P[1, a] + x_2 * P[2, a] + x_3 * P[3, a]
        second = x_4 * P[4, a] + x_5 * P[5, a] + x_6 * P[6, a] + x_7 * P[7, a]
        third = x_8 * P[8, a] + x_9 * P[9, a] + x_10 * P[10, a] + x_11 * P[11, a]
        Px[a] = first + second + third
    fit.of_first = x_0 * Px[0] + x_1 * Px[1] + (x_2 * Px[2] + x_3 * Px[3])
    second = x_4 * Px[4] + x_5 * Px[5] + (x_6 * Px[6] + x_7 * Px[7])
    third = x_8 * Px[8] + x_9 * Px[9] + (x_10 * Px[10] + x_11 * Px[11])
    fit.known = fit.of_first + (second + third)


@kernel
def correct(fit, by_d, by_q, by_P):
    """theta += P x by, P -= by_P P x x' P."""
    P, Px, d, q = fit.P, fit.Px, fit.d, fit.q
    K_0, K_1, K_2, K_3, K_4, K_5, K_6, K_7, K_8, K_9, K_10, K_11 = _all_of(Px)
    for a in range(_WIDE):
        d[a] += by_d * Px[a]
        q[a] += by_q * Px[a]
        K = by_P * Px[a]
        P[0, a] -= K_0 * K
        P[1, a] -= K_1 * K
        P[2, a] -= K_2 * K
        P[3, a] -= K_3 * K
        P[4, a] -= K_4 * K
        P[5, a] -= K_5 * K
        P[6, a] -= K_6 * K
        P[7, a] -= K_7 * K
        P[8, a] -= K_8 * K
        P[9, a] -= K_9 * K
        P[10, a] -= K_10 * K
        P[11, a] -= K_11 * K


@kernel
def walk(fit, share):
    """P is drawn to the first guess's by a share per correction, all in every twelfth."""
    fit.since += 1
    if fit.since < N:
        return
    fit.since = 0
    keep = 1.0 - N * share
    for a in range(N):
        for b in range(N):
            fit.P[a, b] *= keep
        fit.P[a, a] += N * share * fit.P_first[a]

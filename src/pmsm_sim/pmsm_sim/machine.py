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

import numpy as np

from pwm_node.compiled import kernel

# Polynomials of the quintic B-spline with unit knots: row j, power k, of the j-th of the six basis
# functions that are not zero in a cell, over the place u in 0..1 in it.
_QUINTIC = (
    np.array(
        [
            [1, -5, 10, -10, 5, -1],
            [26, -50, 20, 20, -20, 5],
            [66, 0, -60, 0, 30, -10],
            [26, 50, 20, -20, -20, 10],
            [1, 5, 10, 10, 5, -5],
            [0, 0, 0, 0, 0, 1],
        ],
        dtype=np.float64,
    )
    / 120.0
)


@kernel
def torque(par, i_d, i_q):
    """Electromagnetic torque (N m) of the linear machine."""
    return 1.5 * par.n_p * (par.psi_f + (par.L_d - par.L_q) * i_d) * i_q


@kernel
def _basis(u, j):
    """Basis function j at u: its value, first and second derivative."""
    p = _QUINTIC[j]
    value = p[0] + u * (p[1] + u * (p[2] + u * (p[3] + u * (p[4] + u * p[5]))))
    first = p[1] + u * (2.0 * p[2] + u * (3.0 * p[3] + u * (4.0 * p[4] + u * 5.0 * p[5])))
    second = 2.0 * p[2] + u * (6.0 * p[3] + u * (12.0 * p[4] + u * 20.0 * p[5]))
    return value, first, second


@kernel
def _cell(par, axis, i):
    """Cell of the map and place in it, and by how much (A) the current lies outside the map."""
    x = (i - par.map_start[axis]) * par.map_rate[axis]
    last = par.map_cells[axis]
    inside = min(max(x, 0.0), float(last))
    cell = min(int(inside), last - 1)
    return cell, inside - cell, (x - inside) / par.map_rate[axis]


@kernel
def co_energy(par, i_d, i_q):
    """Co-energy of the flux map and its derivatives (W', psi_d, psi_q, L_dd, L_dq, L_qq).

    Outside the map its border goes on with constant incremental inductances.
    """
    cell_d, u_d, over_d = _cell(par, 0, i_d)
    cell_q, u_q, over_q = _cell(par, 1, i_q)
    basis_q = (
        _basis(u_q, 0),
        _basis(u_q, 1),
        _basis(u_q, 2),
        _basis(u_q, 3),
        _basis(u_q, 4),
        _basis(u_q, 5),
    )
    W = psi_d = psi_q = L_dd = L_dq = L_qq = 0.0
    for j in range(6):
        row = row_1 = row_2 = 0.0
        for k in range(6):
            a = par.map[cell_d + j, cell_q + k]
            b_0, b_1, b_2 = basis_q[k]
            row += a * b_0
            row_1 += a * b_1
            row_2 += a * b_2
        b_0, b_1, b_2 = _basis(u_d, j)
        W += b_0 * row
        psi_d += b_1 * row
        psi_q += b_0 * row_1
        L_dd += b_2 * row
        L_dq += b_1 * row_1
        L_qq += b_0 * row_2
    rate_d, rate_q = par.map_rate[0], par.map_rate[1]
    psi_d *= rate_d
    psi_q *= rate_q
    L_dd *= rate_d * rate_d
    L_dq *= rate_d * rate_q
    L_qq *= rate_q * rate_q
    if over_d != 0.0 or over_q != 0.0:
        W += psi_d * over_d + psi_q * over_q
        W += 0.5 * (L_dd * over_d**2 + L_qq * over_q**2) + L_dq * over_d * over_q
        psi_d += L_dd * over_d + L_dq * over_q
        psi_q += L_dq * over_d + L_qq * over_q
    return W, psi_d, psi_q, L_dd, L_dq, L_qq


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
    L_dd, L_dq, L_qq : incremental inductances (H)
    """
    if par.saturates:
        _, psi_d, psi_q, L_dd, L_dq, L_qq = co_energy(par, i_d, i_q)
        psi_d += par.psi_shift
    else:
        psi_d, psi_q = par.psi_f + par.L_d * i_d, par.L_q * i_q
        L_dd, L_dq, L_qq = par.L_d, 0.0, par.L_q
    turn_d = turn_q = 0.0
    if par.harmonics:
        z_2 = complex(c, s) ** 2
        z_6 = z_2 * z_2 * z_2
        z_12 = z_6 * z_6
        sum_6, sum_12 = par.psi_h[1] + par.psi_h[0], par.psi_h[3] + par.psi_h[2]
        difference_6, difference_12 = par.psi_h[1] - par.psi_h[0], par.psi_h[3] - par.psi_h[2]
        psi_d += sum_6 * z_6.real + sum_12 * z_12.real
        psi_q += difference_6 * z_6.imag + difference_12 * z_12.imag
        turn_d = -6.0 * sum_6 * z_6.imag - 12.0 * sum_12 * z_12.imag
        turn_q = 6.0 * difference_6 * z_6.real + 12.0 * difference_12 * z_12.real
    return psi_d, psi_q, turn_d, turn_q, L_dd, L_dq, L_qq

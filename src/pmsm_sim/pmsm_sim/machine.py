"""Machine and mechanics between two switching instants.

Rotor-frame equations of method section 1, integrated with the classical fourth-order
Runge-Kutta method. The stator voltage is constant in the stationary frame, so it turns in the
rotor frame; the turn inside one step is small, and its sine and cosine are polynomials.
"""

from __future__ import annotations

from pwm_node.compiled import kernel


@kernel
def flux(par, i_d, i_q):
    """Flux linkage (psi_d, psi_q) (V s) and incremental inductances (L_dd, L_dq, L_qq) (H)."""
    return par.psi_f + par.L_d * i_d, par.L_q * i_q, par.L_d, 0.0, par.L_q


@kernel
def torque(par, i_d, i_q):
    """Electromagnetic torque (N m)."""
    return 1.5 * par.n_p * (par.psi_f + (par.L_d - par.L_q) * i_d) * i_q

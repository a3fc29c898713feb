"""A simple drive: ideal switches, stiff DC link, one mass, load torque and viscous friction.

The state is the flux linkage in the stationary frame, magnets and their harmonics are written phase
by phase, and DOP853 integrates from one switching instant to the next with tight tolerances:

    dpsi_alpha_beta / dt = u_alpha_beta - R_s i_alpha_beta
    tau = n_p sum_x i_x dpsi_magnets,x / dtheta + 1.5 n_p (L_d - L_q) i_d i_q

The magnets may have harmonics, or the machine a flux map.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmsm_sim.flux_map import FluxMap
from pmsm_sim.plant import Plant

_ORDERS = np.array([1, 5, 7, 11, 13])
_SHIFT = np.array([0.0, 2.0, 4.0]) * np.pi / 3.0  # by which phases a, b, c come later
_AXES = np.exp(1j * _SHIFT)


class ReferencePlant:
    """
    An independent integration of a plant's equations.

    Parameters
    ----------
    plant : Plant
        Gives parameters, flux map and the state to start with.
    flux_map : FluxMap, optional
        Of a saturated machine.
    rtol, atol : float
        Tolerances of DOP853.
    """

    def __init__(
        self,
        plant: Plant,
        flux_map: FluxMap | None = None,
        *,
        rtol: float = 1e-11,
        atol: float = 1e-13,
    ) -> None:
        par, st = plant.par[0], plant.st[0]
        self.R_s, self.L_d, self.L_q = (float(par[n]) for n in ("R_s", "L_d", "L_q"))
        self.n_p, self.J, self.B = (float(par[n]) for n in ("n_p", "J", "B"))
        self.tau_L, self.u_dc, self.T_s = (float(par[n]) for n in ("tau_L", "u_dc", "T_s"))
        # flux linkage of the magnets in one phase, by harmonic order
        self.psi = np.array([float(par["psi_f"]), *map(float, par["psi_h"])])
        self.flux_map = flux_map
        self._tolerances = {"rtol": rtol, "atol": atol}
        self._i_dq = complex(st["i_d"], st["i_q"])
        theta_m = self.n_p * float(st["theta_M"])
        psi = self._flux(self._i_dq, theta_m)
        self.y = np.array([psi.real, psi.imag, float(st["w_M"]), float(st["theta_M"])])

    def _magnets(self, theta_m: float) -> tuple[complex, NDArray[np.float64]]:
        """Flux linkage of the magnets (space vector), and its derivative in each phase."""
        angle = np.outer(_ORDERS, theta_m - _SHIFT)
        phases = self.psi @ np.cos(angle)
        slopes = -(self.psi * _ORDERS) @ np.sin(angle)
        return complex(2.0 / 3.0 * phases @ _AXES), slopes

    def _flux(self, i_dq: complex, theta_m: float) -> complex:
        """Flux linkage in the stationary frame."""
        turn = complex(np.exp(1j * theta_m))
        magnets, _ = self._magnets(theta_m)
        if self.flux_map is not None:
            # the map contains the fundamental of the magnets
            psi_dq = complex(*self.flux_map.flux(i_dq.real, i_dq.imag))
            return turn * psi_dq + magnets - self.psi[0] * turn
        return turn * complex(self.L_d * i_dq.real, self.L_q * i_dq.imag) + magnets

    def current(self, y: ArrayLike) -> complex:
        """Current in the rotor frame (A) of the state y."""
        psi_alpha, psi_beta, _, theta_M = np.asarray(y)
        theta_m = self.n_p * theta_M
        turn = complex(np.exp(1j * theta_m))
        magnets, _ = self._magnets(theta_m)
        psi_dq = (complex(psi_alpha, psi_beta) - magnets) / turn
        if self.flux_map is not None:
            psi_d = psi_dq.real + float(self.psi[0])
            return complex(*self.flux_map.current(psi_d, psi_dq.imag, start=self._i_dq))
        return complex(psi_dq.real / self.L_d, psi_dq.imag / self.L_q)

    def _derivative(self, t: float, y: NDArray[np.float64], u: complex) -> NDArray[np.float64]:
        w_M, theta_M = y[2], y[3]
        i_dq = self.current(y)
        turn = complex(np.exp(1j * self.n_p * theta_M))
        i_ab = turn * i_dq
        slopes = self._magnets(self.n_p * theta_M)[1]
        phases = (i_ab * _AXES.conj()).real
        tau = self.n_p * float(phases @ slopes)
        if self.flux_map is not None:
            # what the map adds to its magnets' fundamental: psi x i
            psi = complex(*self.flux_map.flux(i_dq.real, i_dq.imag)) - self.psi[0]
            tau += 1.5 * self.n_p * (psi.conjugate() * i_dq).imag
        else:
            tau += 1.5 * self.n_p * (self.L_d - self.L_q) * i_dq.real * i_dq.imag
        du = u - self.R_s * i_ab
        return np.array([du.real, du.imag, (tau - self.tau_L - self.B * w_M) / self.J, w_M])

    def period(self, duty: Sequence[float] | NDArray[np.float64]) -> tuple[complex, float]:
        """One PWM period with these duties; returns current (A) and speed (rad/s) at its end."""
        from scipy.integrate import ode

        duty = np.asarray(duty, dtype=float)
        half = 0.5 * self.T_s
        instants = np.unique(np.concatenate([[0.0], half - half * duty, half + half * duty]))
        limits = [*instants[(instants >= 0.0) & (instants < self.T_s)], self.T_s]
        for start, end in pairwise(limits):
            high = np.abs(0.5 * (start + end) - half) < half * duty
            u = complex(2.0 / 3.0 * self.u_dc * (high @ _AXES))
            solver = ode(self._derivative).set_f_params(u)
            solver.set_integrator("dop853", nsteps=10_000, **self._tolerances)
            solver.set_initial_value(self.y, start)
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # tolerances not reached
                self.y = solver.integrate(end)
            self._i_dq = self.current(self.y)
        return self._i_dq, float(self.y[2])

"""The plant against an independent integration of independently written equations."""

from __future__ import annotations

import numpy as np
import pytest

from pmsm_sim import flux_map
from pmsm_sim.reference import ReferencePlant

MACHINES = {
    "spmsm": {"motor": "seed_750"},
    "ipmsm": {"motor": "ipmsm"},
    "harmonic": {"motor": "seed_750", "machine_emf_5": 0.04, "machine_emf_7": -0.03},
    "saturated": {"motor": "ipmsm", "machine_flux_map": "ipmsm_saturated"},
}


@pytest.fixture
def bench(unprotected):
    return unprotected


class CurrentLoop:
    """A plain PI current controller with speed loop, so that the run is closed-loop.

    It acts on the sample of the period before, as a real one does.
    """

    def __init__(self, drive, speed_ref, tau_max=6.0):
        self.drive, self.speed_ref, self.tau_max = drive, speed_ref, tau_max
        par = drive.par[0]
        self.L = complex(par["L_d"], par["L_q"])
        self.T_s = float(par["T_s"])
        self.integral = 0j
        self.next = np.full(3, 0.5)

    def __call__(self, k):
        duty = self.next
        par, st = self.drive.par[0], self.drive.st[0]
        n_p, psi_f = float(par["n_p"]), float(par["psi_f"])
        w_m = n_p * float(st["w_M"])
        i = complex(st["i_d"], st["i_q"])
        tau = np.clip(0.5 * (self.speed_ref - w_m / n_p), -self.tau_max, self.tau_max)
        e = 1j * tau / (1.5 * n_p * psi_f) - i
        alpha = 1500.0
        self.integral += (
            alpha * 200.0 * self.T_s * complex(self.L.real * e.real, self.L.imag * e.imag)
        )
        u = alpha * complex(self.L.real * e.real, self.L.imag * e.imag) + self.integral
        u += 1j * w_m * (complex(self.L.real * i.real, self.L.imag * i.imag) + psi_f)
        u *= np.exp(1j * (n_p * float(st["theta_M"]) + 1.5 * w_m * self.T_s))
        phases = (u * np.exp(-1j * np.array([0.0, 2.0, 4.0]) * np.pi / 3.0)).real
        zero = 0.5 * (phases.max() + phases.min())
        self.next = np.clip(0.5 + (phases - zero) / float(par["u_dc"]), 0.0, 1.0)
        return duty


def compare(bench, periods, general=False, **values):
    """Largest differences of current (A) and speed (rad/s) over a closed-loop run."""
    drive = bench(initial_speed_rpm=700.0, load_torque=2.0, **values)
    drive.par["general"] |= general
    map_ = flux_map.load(values["machine_flux_map"]) if "machine_flux_map" in values else None
    reference = ReferencePlant(drive.plant, map_)
    loop = CurrentLoop(drive, 750.0 * np.pi / 30.0)
    worst_i = worst_w = 0.0
    for _ in range(periods):
        drive.run(1, loop)
        i, w = reference.period(drive.st["duty"][0])
        st = drive.st[0]
        worst_i = max(worst_i, abs(i - complex(st["i_d"], st["i_q"])))
        worst_w = max(worst_w, abs(w - float(st["w_M"])))
    assert abs(float(drive.st["i_q"][0])) > 1.0  # it was a run under load
    return worst_i, worst_w


@pytest.mark.parametrize("name", ["spmsm", "ipmsm"])
def test_the_general_model_of_an_ideal_drive(bench, name):
    worst_i, worst_w = compare(bench, 60, general=True, **MACHINES[name])
    assert worst_i < 1e-6
    assert worst_w < 1e-8


@pytest.mark.parametrize("name", ["spmsm", "ipmsm", "harmonic", "saturated"])
def test_closed_loop(bench, name):
    """Over 15 ms here; over 0.2 s by `mfpcc validate`, with the same limits."""
    worst_i, worst_w = compare(bench, 150, **MACHINES[name])
    assert worst_i < 1e-6
    assert worst_w < 1e-8

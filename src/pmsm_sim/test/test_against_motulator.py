"""The plant against an independent simulator: motulator (Aalto University), from PyPI.

It is no part of the environment of this workspace, since it needs Python 3.12; these tests run
where it is installed (requirements/bench.txt).
"""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("motulator", reason="motulator is not installed: requirements/bench.txt")

from motulator.common.model._simulation import SolverCfg
from motulator.drive import model
from motulator.drive.model import Simulation
from motulator.drive.utils._parameters import SynchronousMachinePars

# Its carrier comparison rounds duties to so many levels; ours are given in these steps.
_LEVELS = 2**12


@pytest.fixture
def bench(unprotected):
    return unprotected


class _Replay:
    """Stands for its control system: gives the duties, and notes the state at each half period."""

    def __init__(self, half_period, duties, enabled):
        self.t, self._half = 0.0, half_period
        self._duties, self._enabled = duties, enabled
        self.n = 0
        self.i_dq, self.w_M = [], []

    def get_enable(self):
        return bool(self._enabled[min(self.n // 2, len(self._enabled) - 1)])

    def __call__(self, mdl):
        if self.n % 2 == 0:
            self.i_dq.append(complex(mdl.machine.out.i_s_dq))
            self.w_M.append(float(np.real(mdl.mechanics.state.w_M)))
        duty = self._duties[min(self.n // 2, len(self._duties) - 1)]
        self.n += 1
        self.t += self._half
        return self._half, duty

    def post_process(self):
        return None


def _motulator(drive, duties, enabled=None, *, w_M, i_dq=0j, t_d=0.0, u_th=0.0, rtol=1e-8):
    """Current and speed at the start of each period, from the same parameters and duties."""
    par = drive.par[0]
    machine = model.SynchronousMachine(
        SynchronousMachinePars(
            n_p=int(par["n_p"]),
            R_s=float(par["R_s"]),
            L_d=float(par["L_d"]),
            L_q=float(par["L_q"]),
            psi_f=float(par["psi_f"]),
            G_c=float(par["iron_conductance"]),
        )
    )
    machine.state.psi_s_dq = complex(machine.par.psi_s_dq(i_dq))
    mechanics = model.MechanicalSystem(J=float(par["J"]), B_L=float(par["B"]))
    mechanics.set_external_load_torque(float(par["tau_L"]))
    mechanics.state.w_M = complex(w_M)
    converter = model.VoltageSourceConverter(u_dc=float(par["u_dc"]), t_d=t_d, u_th=u_th)
    mdl = model.Drive(machine, mechanics, converter, pwm=True, delay=0)
    replay = _Replay(
        0.5 * float(par["T_s"]), duties, [True] * len(duties) if enabled is None else enabled
    )
    cfg = SolverCfg(rtol=rtol, atol=1e-10)
    simulation = Simulation(mdl, replay, show_progress=False, cfg=cfg)
    simulation.simulate(t_stop=len(duties) * float(par["T_s"]))
    n = len(duties)
    return np.array(replay.i_dq[:n]), np.array(replay.w_M[:n])


def _duties(n, amplitude, w, T_s=1e-4):
    """A rotating voltage in steps that both modulators can give exactly."""
    k = np.arange(n)[:, None]
    wanted = 0.5 + amplitude * np.cos(
        w * (k + 0.5) * T_s + np.pi / 2 - np.arange(3) * 2 * np.pi / 3
    )
    return np.round(_LEVELS * np.clip(wanted, 0.0, 1.0)) / _LEVELS


@pytest.mark.parametrize(
    ("motor", "values"),
    [
        ("seed_750", {}),
        ("ipmsm", {}),
        ("seed_750", {"machine_iron_loss_resistance": 400.0}),
    ],
)
def test_same_machine_inverter_and_duties(bench, motor, values):
    drive = bench(motor=motor, initial_speed_rpm=700.0, load_torque=2.0, **values)
    w = 4 * 700.0 * np.pi / 30.0
    psi_f = float(drive.par["psi_f"][0])
    duties = _duties(200, (w * psi_f + 8.0) / 311.0, w)
    i, w_M = _motulator(drive, duties, w_M=700.0 * np.pi / 30.0)
    drive.run(200, lambda k: duties[k])
    ours = drive.column("i_dq") @ [1.0, 1j]
    assert abs(ours).max() > 2.0
    if values:
        # ours is the magnetising current, theirs that at the terminals
        terminal = np.array([row["i_a"] for row in drive.feedback])[1:]
        theta = np.array([4 * row["angle"] for row in drive.state])[1:]
        assert terminal == pytest.approx((i[1:] * np.exp(1j * theta)).real, abs=1e-4)
    else:
        assert ours == pytest.approx(i, abs=1e-5)
    assert drive.column("speed") == pytest.approx(w_M, abs=1e-5)


def test_blocked_gates(bench):
    """Three, two and no phases conducting, then rectifying the EMF of a fast machine."""
    for rpm, i_dq in [(700.0, 3 + 4j), (4500.0, 0j)]:
        drive = bench(initial_speed_rpm=rpm, i_dq=(i_dq.real, i_dq.imag))
        drive.plant.st["enable"] = False
        duties = np.full((60, 3), 0.5)
        i, w_M = _motulator(
            drive, duties, [False] * 60, w_M=rpm * np.pi / 30.0, i_dq=i_dq, rtol=1e-9
        )
        drive.run(60, enable=False)
        ours = drive.column("i_dq") @ [1.0, 1j]
        assert ours == pytest.approx(i, abs=2e-4)
        assert drive.column("speed") == pytest.approx(w_M, abs=1e-4)


def test_dead_time_and_drops(bench):
    """Theirs holds the sign of the current of the last switching instant, ours does not; with a
    current far from zero the mean phase voltages, and so the currents, agree."""
    t_d, u_th = 2e-6, 1.0
    drive = bench(
        inverter_dead_time=t_d,
        inverter_switch_voltage=u_th,
        inverter_diode_voltage=u_th,
    )
    drive.par["J"] = 1e12
    duties = np.tile(np.array([0.54, 0.5, 0.44]), (400, 1))
    duties = np.round(_LEVELS * duties) / _LEVELS
    i, _ = _motulator(drive, duties, w_M=0.0, t_d=t_d, u_th=u_th)
    drive.run(400, lambda k: duties[k])
    ours = drive.column("i_dq") @ [1.0, 1j]
    R = float(drive.par["R_s"][0])
    # standing: the mean phase voltage is R i
    assert R * abs(ours[-1] - i[-1]) < 0.02
    assert abs(ours[-1]) > 3.0

"""The reference: the same drive in motulator, the inverter at switching level, the same carrier.

Prints the wall-clock time (s) of a simulation of so many seconds. Control is motulator's own
current-vector control with encoder, once per carrier period as here.
"""

from __future__ import annotations

import math
import sys
import time

import motulator.drive.control.sm as control
from motulator.drive import model

from pmsm_sim import motor

_T_S = 100e-6  # s, carrier and sampling period
_SPEED = 750.0 * math.pi / 30.0  # rad/s
_LOAD = 2.0  # N m
_SPEED_BANDWIDTH = 100.0  # rad/s


def main(seconds: float) -> float:
    """Wall-clock time of the simulation (s)."""
    pars = motor.load("seed_750")
    par = model.SynchronousMachinePars(
        n_p=pars.n_p, R_s=pars.R_s, L_d=pars.L_d, L_q=pars.L_q, psi_f=pars.psi_f
    )
    mechanics = model.MechanicalSystem(J=pars.J)
    mechanics.state.w_M = complex(_SPEED)
    mechanics.set_external_load_torque(_LOAD)
    plant = model.Drive(
        model.SynchronousMachine(par),
        mechanics,
        model.VoltageSourceConverter(u_dc=pars.u_dc),
        pwm=True,
        single_update=True,
    )
    cfg = control.CurrentVectorControllerCfg(i_s_max=pars.i_max, sensorless=False, T_s=_T_S)
    drive = control.VectorControlSystem(
        control.CurrentVectorController(par, cfg),
        control.SpeedController(J=pars.J, alpha_s=_SPEED_BANDWIDTH),
        pwm=control.PWM(single_update=True),
    )
    drive.set_speed_ref(_SPEED)
    simulation = model.Simulation(plant, drive, show_progress=False)
    begin = time.perf_counter()
    result = simulation.simulate(t_stop=seconds)
    wall = time.perf_counter() - begin
    speed = float(result.mdl.mechanics.w_M[-1])
    if not result.success or abs(speed - _SPEED) > 0.2 * _SPEED:
        raise RuntimeError(f"the simulation has gone astray: {speed:.1f} rad/s at its end")
    return wall


if __name__ == "__main__":
    print(main(float(sys.argv[1])))

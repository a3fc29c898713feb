"""The simulated drive: inverter, machine, mechanics and sensors, one PWM period at a time.

`Plant` holds the records; the kernel `advance` does the work of one period and is what both the
node and the in-process engine call. Nothing here knows of ROS.

There are two models of a period. The ideal one (`ideal`) is what remains when every effect is off
and the gates are driven: it costs a small part of a microsecond. The general one (`general`) has
all effects and blocked gates. Where both apply they agree to the error of the integration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pmsm_sim import motor
from pmsm_sim.columns import ENERGIES
from pmsm_sim.flux_map import co_energy
from pmsm_sim.general import integrate
from pmsm_sim.ideal import integrate_ideal
from pmsm_sim.parts import PARTS
from pmsm_sim.parts.injection import (
    FREEZE,
    LOSE,
    MAX_INJECTIONS,
    REPEAT,
    SHIFT,
    SPOIL,
    InjectionError,
    described,
    inject_causes,
    inject_gates,
    inject_sample,
    injection,
)
from pmsm_sim.parts.inverter import take_command
from pmsm_sim.parts.machine import flux, torque
from pmsm_sim.parts.mechanics import shown_load
from pmsm_sim.parts.protection import FAULTS, protect
from pmsm_sim.parts.sensors import sample, wrapped
from pmsm_sim.parts.thermal import warm
from pmsm_sim.records import PLANT_PAR, PLANT_STATE
from pwm_node import stamps
from pwm_node.compiled import kernel
from pwm_node.errors import ForPeople

# Answers of `latch`
ACCEPTED = 0
WRONG_PERIOD = 1
OUT_OF_RANGE = 2
LOST = 3

# Longest step of the general model, over the fastest time constant there is.
_STEP_PER_TIME_CONSTANT = 0.15
# No current (A), speed (rad/s), voltage (V) or torque (N m) of a drive.
_BEYOND = 1e9


class PlantError(ForPeople, ValueError):
    """A simulation that has run away; no sample of it leaves the plant."""


@kernel
def latch(st_, cmd_):
    """Take the command for the period that begins now.

    Returns `ACCEPTED`, `WRONG_PERIOD` or `OUT_OF_RANGE`; only an accepted command has an effect.
    An injected fault can lose one on its way (`LOST`).
    """
    st, cmd = st_[0], cmd_[0]
    if cmd.period == 0:
        return WRONG_PERIOD  # the first command is for period 1
    if cmd.period != st.period or st.latched:
        st.refused += np.uint64(1)
        return WRONG_PERIOD
    fault = st.injector.duty_link
    if fault == LOSE:
        st.refused += np.uint64(1)
        return LOST
    if fault == SPOIL:
        st.refused += np.uint64(1)
        return OUT_OF_RANGE
    for x in range(3):
        # written so that NaN is out of range
        if not (cmd.duty[x] >= 0.0 and cmd.duty[x] <= 1.0):
            st.refused += np.uint64(1)
            return OUT_OF_RANGE
    if fault != FREEZE:
        for x in range(3):
            st.duty[x] = cmd.duty[x]
    st.enable = cmd.enable
    if fault == SHIFT:
        st.duty[0] = min(max(st.duty[0] + st.injector.duty_error, 0.0), 1.0)
    elif fault == REPEAT:
        st.refused += np.uint64(1)  # the second of the two
    st.latched = True
    return ACCEPTED


@kernel
def _describe_general(par, st, c, s, ds):
    """The part of the truth that only the general model knows."""
    psi_d, psi_q, turn_d, turn_q, _, _, _, _ = flux(par, st.i_d, st.i_q, c, s)
    ds.torque = (
        1.5 * par.n_p * (psi_d * st.i_q - psi_q * st.i_d + turn_d * st.i_d + turn_q * st.i_q)
    )
    ds.load_torque = shown_load(par, st)
    if par.rectifier and st.general_before:
        ds.dc_voltage = st.u_dc


@kernel
def advance(par_, st_, fb_, ds_, i_abc, legs_out):
    """One PWM period: sample, then integrate it with the duties latched for it.

    Parameters
    ----------
    par_, st_ : arrays of length 1 of `PLANT_PAR`, `PLANT_STATE`
    fb_, ds_ : arrays of length 1
        The fixed parts of `PhaseFeedback` and `DriveState`, written here.
    i_abc : float64 array, shape (3 n,)
        Phase currents at n equal steps of the period, written here; n may be 0.
    legs_out : uint8 array, shape (n,)
    """
    par, st, fb, ds = par_[0], st_[0], fb_[0], ds_[0]
    faulty = st.injector.on
    if faulty:
        inject_causes(par, st)
    if par.drifts:
        warm(par, st)
    protect(par, st)
    take_command(par, st)
    if faulty:
        inject_gates(par, st)
    theta_m = par.n_p * st.theta_M
    c, s = math.cos(theta_m), math.sin(theta_m)
    stamps.put(fb.stamp, st.period, par.pwm_frequency)
    ds.stamp.sec, ds.stamp.nanosec = fb.stamp.sec, fb.stamp.nanosec
    sample(par, st, c, s, fb)
    if faulty:
        inject_sample(par, st, fb)
        stamps.put(fb.stamp, fb.period, par.pwm_frequency)

    ds.period = st.period
    ds.i_dq[0] = st.i_d
    ds.i_dq[1] = st.i_q
    ds.torque = torque(par, st.i_d, st.i_q)
    ds.speed = st.w_M
    ds.angle = st.theta_M
    ds.load_torque = par.tau_L
    ds.dc_voltage = par.u_dc
    ds.temperature = st.temperature + st.injector.warmth
    ds.gates_on = st.gates_on
    if par.general:
        _describe_general(par, st, c, s, ds)

    if st.gates_on and not (par.general or st.injector.some_leg_off):
        turn_M, energy = integrate_ideal(par, st, c, s, i_abc, legs_out)
        st.general_before = False
    else:
        turn_M, energy = integrate(par, st, i_abc, legs_out)

    ds.dc_current = energy / (ds.dc_voltage * par.T_s)
    st.theta_M = wrapped(st.theta_M + turn_M)
    st.energy_in += energy
    st.period += np.uint64(1)
    size = abs(st.i_d) + abs(st.i_q) + abs(st.w_M) + abs(st.u_dc)
    size += abs(st.i_f_alpha) + abs(st.i_f_beta) + abs(st.w_L) + abs(st.tau_brake)
    if not size < _BEYOND:  # written so that NaN is beyond
        raise PlantError(
            "the simulated drive has left what can be simulated: check the motor file, and among "
            "the parameters those of load, speed and DC link"
        )


class Plant:
    """The simulated drive and its parameters.

    Parameters
    ----------
    values : mapping
        A value for every parameter of `pmsm_sim.parameters.TABLE`.
    machine : MotorPars, optional
        The motor, where it has been read already.

    Attributes
    ----------
    par, st : arrays of length 1 of `PLANT_PAR`, `PLANT_STATE`

    Raises
    ------
    pwm_node.yaml_files.FileError
        If the motor or the flux map cannot be used.
    """

    def __init__(self, values: Mapping[str, Any], machine: motor.MotorPars | None = None) -> None:
        self.motor = machine or motor.load(values["motor"])
        self._values = dict(values)
        self.oversampling: int = values["oversampling"]
        self.par = np.zeros(1, PLANT_PAR)
        self.st = np.zeros(1, PLANT_STATE)
        self._latch = self.st["latch"][0]

        par, st = self.par[0], self.st[0]
        par["pwm_frequency"] = values["pwm_frequency"]
        par["T_s"] = 1.0 / values["pwm_frequency"]
        par["h_max"] = 0.5 * par["T_s"]
        for part in PARTS:
            part.start(par, st, values, self.motor)
        self.apply({})

    def begin_as(self, other: Plant, *, seed: int) -> None:
        """Take over the state of another plant, but for the seed of the noise."""
        self.motor, self.oversampling = other.motor, other.oversampling
        self._values = {**other._values, "seed": seed}
        # as bytes: NumPy copies a record field by field, which takes four times as long
        self.par.view(np.uint8)[:] = other.par.view(np.uint8)
        self.st.view(np.uint8)[:] = other.st.view(np.uint8)
        self.par["seed"] = seed

    def apply(self, changes: Mapping[str, Any]) -> None:
        """Take over changed parameters; they act from the next period on."""
        self._values.update(changes)
        par, st, values = self.par[0], self.st[0], self._values
        for part in PARTS:
            for name, field in part.copied:
                par[field] = values[name]
            part.configure(par, st, values, self.motor)
        par["general"] = any(part.general(par) for part in PARTS)
        par["full"] = any(part.full(par) for part in PARTS)
        fastest = max(rate for part in PARTS for rate in part.rates(par))
        par["h_general"] = min(par["h_max"], _STEP_PER_TIME_CONSTANT / fastest)

    def block(self, blocked: bool) -> None:
        """Block the gates, or no longer: they come back after a command that has them off."""
        self.st["blocked"] = blocked
        self.st["awaits_off"] |= blocked

    def stop(self) -> None:
        """Safe torque off: block the gates until they are cleared."""
        self._latch["tripped"] = True

    def slow_down(self) -> None:
        """The inverter alone cannot ramp a motor down: as `stop`."""
        self.stop()

    @property
    def tripped(self) -> bool:
        """Whether the gates are off until `clear_faults`."""
        return bool(self._latch["tripped"])

    def clear_faults(self) -> list[str]:
        """Forget the latched faults; returns those whose cause lasts, and then clears none.

        The gates come back after a command that has them off, and then one that has them on.
        """
        tripped = self.tripped
        lasting = FAULTS.clear(self._latch)
        if not lasting:
            self.st["awaits_off"] |= tripped
            self.st["missing_in_row"] = 0
        return lasting

    def faults(self) -> list[tuple[str, int, str]]:
        """Latched faults, oldest first: code, period of the first occurrence, what was seen."""
        return FAULTS.latched(self._latch, self.par["limit"][0])

    def inject(
        self,
        unit: str,
        kind: str,
        start: float,
        duration: float,
        magnitude: float | None = None,
        *,
        seed: int = 0,
    ) -> str:
        """Inject a fault from a time on (s), or if that is past, from now on.

        Parameters are those of `injection.injection`; returns it as a line of text.

        Raises
        ------
        InjectionError
            Faults may not be injected here, not this one, or there are too many.
        """
        injector, now = self.st["injector"][0], int(self.st["period"][0])
        if not injector["on"]:
            raise InjectionError("faults are injected only where 'fault_injection' is true")
        if unit == "dc_link" and self._values["dc_link.kind"] == "rectifier":
            raise InjectionError("dc_link fails only where 'dc_link.kind' is stiff")
        T_s = float(self.par["T_s"][0])
        row = injection(
            unit, kind, start, duration, magnitude, seed=seed, T_s=T_s, earliest=max(now, 1)
        )
        over = np.flatnonzero(injector["list"]["end"] <= now)
        if len(over) == 0:
            raise InjectionError(f"{MAX_INJECTIONS} faults are injected already")
        n = int(over[0])
        injector["list"][n] = row
        injector["n"] = max(int(injector["n"]), n + 1)
        return described(injector["list"][n], T_s)

    def injections(self) -> list[str]:
        """Faults that are injected now or will be, each as a line of text."""
        injector, T_s = self.st["injector"][0], float(self.par["T_s"][0])
        lasting = injector["list"]["end"] > self.st["period"][0]
        return [described(row, T_s) for row in injector["list"][lasting]]

    def energies(self) -> dict[str, float]:
        """Energy by kind (J): what has flowed since the start, and what is stored now.

        Returns
        -------
        dict
            Flowed: `supply` into the DC link; `dc` from there into the inverter; `inverter`,
            `copper`, `iron`, `friction`, `chopper` lost; `load` given to the load. Stored:
            `field`, `capacitor`, `kinetic`, `shaft`, `cogging`. Their balance is

                supply = inverter + copper + iron + friction + chopper + load + change of stored

            Counted by the general model only: valid if it has run from the start.
        """
        par, st = self.par[0], self.st[0]
        flowed = dict(zip(ENERGIES, map(float, st["energy"]), strict=True))
        i_d, i_q = float(st["i_d"]), float(st["i_q"])
        if par["saturates"]:
            W, psi_d, psi_q, *_ = co_energy(par["map"], i_d, i_q)
            W_0 = co_energy(par["map"], 0.0, 0.0)[0]
            field = 1.5 * (psi_d * i_d + psi_q * i_q - (W - W_0))
        else:
            field = 0.75 * float(par["L_d"] * i_d**2 + par["L_q"] * i_q**2)
        kinetic = 0.0
        if not par["imposed"]:
            kinetic = 0.5 * float(par["J"] * st["w_M"] ** 2)
            if par["shaft"]:
                kinetic += 0.5 * float(par["J_load"] * st["w_L"] ** 2)
        cogging = 0.0
        if par["cogging_torque"] != 0.0:
            N = float(par["cogging_periods"])
            cogging = -float(par["cogging_torque"]) / N * math.cos(N * float(st["theta_M"]))
        return {
            **flowed,
            "field": field,
            "capacitor": 0.5 * float(par["capacitance"] * st["u_dc"] ** 2)
            if par["rectifier"]
            else 0.0,
            "kinetic": kinetic,
            "shaft": 0.5 * float(par["shaft_stiffness"] * st["twist"] ** 2),
            "cogging": cogging,
        }

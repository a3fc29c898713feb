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

from pmsm_sim import flux_map, motor, protection
from pmsm_sim.general import integrate
from pmsm_sim.ideal import MOST_STEPS, integrate_ideal
from pmsm_sim.injection import (
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
    parse,
)
from pmsm_sim.inverter import take_command
from pmsm_sim.machine import co_energy, flux, torque
from pmsm_sim.mechanics import STANDSTILL, profile
from pmsm_sim.protection import FAULTS, protect
from pmsm_sim.records import (
    FIRST_ENERGY,
    INTEGRATED,
    LOAD_KINDS,
    PLANT_PAR,
    PLANT_STATE,
    PROFILE_SIZE,
)
from pmsm_sim.sensors import sample, wrapped
from pwm_node import stamps
from pwm_node.compiled import kernel
from pwm_node.errors import ForPeople

# Answers of `latch`
ACCEPTED = 0
WRONG_PERIOD = 1
OUT_OF_RANGE = 2
LOST = 3

_TWO_PI = 2.0 * math.pi
_RPM = _TWO_PI / 60.0
# The temperature at which the values of a motor file hold (degC).
REFERENCE_TEMPERATURE = 20.0
# Longest step of the general model, over the fastest time constant there is.
_STEP_PER_TIME_CONSTANT = 0.15
_BRAKE = LOAD_KINDS.index("brake")
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
def _set_temperature(par, temperature):
    rise = temperature - REFERENCE_TEMPERATURE
    par.R_s = par.R_20 * (1.0 + par.copper_coefficient * rise)
    par.psi_f = par.psi_20 * (1.0 + par.magnet_coefficient * rise)
    par.psi_shift = par.psi_f - par.psi_map


@kernel
def _warm(par, st):
    """Temperature of winding and magnets over one period, and what it changes.

    dT/dt = (T_ambient + R_th P_copper - T) / tau
    R_s = R_20 (1 + alpha_Cu (T - 20)),   psi_f = psi_20 (1 + alpha_magnet (T - 20))
    """
    copper = 1.5 * par.R_s * (st.i_d * st.i_d + st.i_q * st.i_q)
    end = par.ambient + par.thermal_resistance * copper
    if par.thermal_rate > 0.0:
        st.temperature = end + (st.temperature - end) * math.exp(-par.thermal_rate * par.T_s)
    else:
        st.temperature = end
    _set_temperature(par, st.temperature)


@kernel
def _describe_general(par, st, c, s, ds):
    """The part of the truth that only the general model knows."""
    psi_d, psi_q, turn_d, turn_q, _, _, _ = flux(par, st.i_d, st.i_q, c, s)
    ds.torque = (
        1.5 * par.n_p * (psi_d * st.i_q - psi_q * st.i_d + turn_d * st.i_d + turn_q * st.i_q)
    )
    tau = st.tau_brake if par.load_kind == _BRAKE else par.tau_L
    tau += par.quadratic * st.w_M * abs(st.w_M)
    ds.load_torque = tau + profile(par, st.period * par.T_s)
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
        _warm(par, st)
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

    Attributes
    ----------
    par, st : arrays of length 1 of `PLANT_PAR`, `PLANT_STATE`

    Raises
    ------
    pwm_node.yaml_files.FileError
        If the motor or the flux map cannot be used.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.motor = motor.load(values["motor"])
        name = values["machine.flux_map"]
        self._map = flux_map.load(name) if name else None
        self._values = dict(values)
        self.oversampling: int = values["oversampling"]
        self.par = np.zeros(1, PLANT_PAR)
        self.st = np.zeros(1, PLANT_STATE)
        self._latch = self.st["latch"][0]

        par = self.par
        if self._map is not None:
            for field in ("map_start", "map_rate", "map_cells", "map"):
                par[field] = self._map.par[field]
        for field in ("L_d", "L_q", "n_p"):
            par[field] = getattr(self.motor, field)
        par["pwm_frequency"] = values["pwm_frequency"]
        par["T_s"] = 1.0 / values["pwm_frequency"]
        par["h_max"] = 0.5 * par["T_s"]
        par["seed"] = values["seed"]

        # until the first command comes: the zero vector
        st = self.st
        st["duty"] = 0.5
        st["enable"] = True
        st["w_M"] = values["initial_speed_rpm"] * _RPM
        st["theta_M"] = values["initial_angle"] % _TWO_PI
        st["temperature"] = REFERENCE_TEMPERATURE
        injections = parse(values["injections"], float(par["T_s"][0]))
        injector = st["injector"][0]
        injector["on"] = values["fault_injection"]
        injector["n"] = len(injections)
        injector["list"][: len(injections)] = injections
        injector["copies"] = 1
        self.apply({})

    def apply(self, changes: Mapping[str, Any]) -> None:
        """Take over changed parameters; they act from the next period on."""
        self._values.update(changes)
        par, values = self.par[0], self._values
        for name, field in _DIRECT.items():
            par[field] = values[name]
        par["tau_set"], par["u_dc_set"] = par["tau_L"], par["u_dc"]
        _set_inverter(par, values)
        protection.configure(par, values, self.motor)
        _set_machine(par, values, self.motor, self._map)
        _set_dc_link(par, values)
        _set_mechanics(par, values, self.motor)
        _set_sensors(par, values)
        _set_drift(par, values)
        if not par["drifts"]:
            self.st["temperature"] = par["ambient"]
        _set_temperature(par, self.st["temperature"][0])
        _set_model(par)

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
        flowed = dict(zip(INTEGRATED[FIRST_ENERGY:], map(float, st["energy"]), strict=True))
        i_d, i_q = float(st["i_d"]), float(st["i_q"])
        if par["saturates"]:
            W, psi_d, psi_q, _, _, _ = co_energy(par, i_d, i_q)
            W_0 = co_energy(par, 0.0, 0.0)[0]
            field = 1.5 * (psi_d * i_d + psi_q * i_q - (W - W_0))
        else:
            field = 0.75 * float(par["L_d"] * i_d**2 + par["L_q"] * i_q**2)
        kinetic = 0.0
        if LOAD_KINDS[par["load_kind"]] != "speed":
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


# parameter -> field of PLANT_PAR, where that is all
_DIRECT = {
    "load_torque": "tau_L",
    "dc_voltage": "u_dc",
    "noise.current_rms": "noise_rms",
    "inverter.dead_time": "dead_time",
    "inverter.min_pulse": "min_pulse",
    "inverter.switch_voltage": "switch_voltage",
    "inverter.switch_resistance": "switch_resistance",
    "inverter.diode_voltage": "diode_voltage",
    "inverter.diode_resistance": "diode_resistance",
    "machine.cogging_torque": "cogging_torque",
    "machine.cogging_periods": "cogging_periods",
    "dc_link.capacitance": "capacitance",
    "dc_link.chopper_on": "chopper_on",
    "dc_link.chopper_off": "chopper_off",
    "load.coulomb_friction": "coulomb",
    "load.quadratic": "quadratic",
    "load.shaft_damping": "shaft_damping",
    "sensor.current_gain": "gain",
    "sensor.current_offset": "offset",
    "sensor.encoder_offset": "encoder_offset",
    "sensor.encoder_latency": "encoder_latency",
    "sensor.angle_noise": "angle_noise",
    "drift.temperature": "ambient",
    "drift.thermal_resistance": "thermal_resistance",
    "drift.copper_coefficient": "copper_coefficient",
    "drift.magnet_coefficient": "magnet_coefficient",
}


def _set_inverter(par: np.void, values: Mapping[str, Any]) -> None:
    par["hold"] = values["inverter.missing_command"] == "hold"
    # the timer counts up and down once in a period
    counts = 0.5 * values["inverter.timer_clock"] * par["T_s"]
    par["timer_counts"] = max(1.0, round(counts)) if counts > 0.0 else 0.0
    par["modulator"] = counts > 0.0 or values["inverter.min_pulse"] > 0.0


def _set_machine(
    par: np.void,
    values: Mapping[str, Any],
    pars: motor.MotorPars,
    map_: flux_map.FluxMap | None,
) -> None:
    par["saturates"] = map_ is not None
    par["psi_map"] = map_.psi_f if map_ is not None else pars.psi_f
    par["R_20"] = pars.R_s * values["drift.resistance"]
    par["psi_20"] = par["psi_map"] * values["drift.flux"]
    ratios = [values[f"machine.emf_{n}"] for n in (5, 7, 11, 13)]
    par["psi_h"] = [r * par["psi_20"] / n for r, n in zip(ratios, (5, 7, 11, 13), strict=True)]
    par["harmonics"] = any(ratios)
    R_iron = values["machine.iron_loss_resistance"]
    par["iron_conductance"] = 1.0 / R_iron if R_iron > 0.0 else 0.0
    shortest = par["T_s"] / MOST_STEPS
    smallest = 2.0 * shortest / min(par["L_d"], par["L_q"])
    par["iron_floating"] = max(par["iron_conductance"], smallest)


def _set_dc_link(par: np.void, values: Mapping[str, Any]) -> None:
    par["rectifier"] = values["dc_link.kind"] == "rectifier"
    par["grid_peak"] = math.sqrt(2.0) * values["dc_link.grid_voltage"]
    par["grid_w"] = _TWO_PI * values["dc_link.grid_frequency"]
    par["grid_conductance"] = 1.0 / values["dc_link.grid_resistance"]
    R = values["dc_link.chopper_resistance"]
    par["chopper_conductance"] = 1.0 / R if R > 0.0 else 0.0


def _set_mechanics(par: np.void, values: Mapping[str, Any], pars: motor.MotorPars) -> None:
    par["load_kind"] = LOAD_KINDS.index(values["load.kind"])
    par["w_imposed"] = values["load.speed_rpm"] * _RPM
    par["B"] = pars.B + values["load.viscous_friction"]
    stiffness = values["load.shaft_stiffness"]
    par["shaft"] = stiffness > 0.0
    par["shaft_stiffness"] = stiffness
    par["J"] = pars.J if par["shaft"] else pars.J + values["load.inertia"]
    par["J_load"] = values["load.inertia"]
    lag = values["load.brake_lag"]
    # one that is faster than the shortest step cannot be told from it
    par["brake_rate"] = min(1.0 / lag, MOST_STEPS / par["T_s"]) if lag > 0.0 else 0.0
    points = values["load.profile"]
    n = len(points) // 2
    if not any(points[1::2]):
        n = 0  # no torque at any time
    par["profile_points"] = n
    par["profile_t"] = np.resize(points[0 : 2 * n : 2] + [0.0] * PROFILE_SIZE, PROFILE_SIZE)
    par["profile_tau"] = np.resize(points[1 : 2 * n : 2] + [0.0] * PROFILE_SIZE, PROFILE_SIZE)


def _set_sensors(par: np.void, values: Mapping[str, Any]) -> None:
    # a low-pass that is faster than the shortest step cannot be told from it
    par["filter_rate"] = min(_TWO_PI * values["sensor.current_bandwidth"], MOST_STEPS / par["T_s"])
    bits = values["sensor.adc_bits"]
    par["adc_codes"] = 2.0 ** (bits - 1)
    par["adc_step"] = values["sensor.adc_range"] / par["adc_codes"] if bits > 0 else 0.0
    par["sampling_lead"] = values["sensor.sampling_lead"] * par["T_s"]
    par["encoder_counts"] = 4.0 * values["sensor.encoder_lines"]
    par["sensors"] = bool(
        bits > 0
        or np.any(par["gain"] != 1.0)
        or np.any(par["offset"] != 0.0)
        or par["encoder_counts"] > 0.0
        or par["encoder_offset"] != 0.0
        or par["encoder_latency"] > 0.0
        or par["angle_noise"] > 0.0
    )


def _set_drift(par: np.void, values: Mapping[str, Any]) -> None:
    tau = values["drift.time_constant"]
    par["thermal_rate"] = 1.0 / tau if tau > 0.0 else 0.0
    par["drifts"] = tau > 0.0 or par["thermal_resistance"] > 0.0


def _set_model(par: np.void) -> None:
    """Choose the model, and the step of the general one."""
    drops = [par[f"{part}_{kind}"] for part in ("switch", "diode") for kind in _DROPS]
    par["general"] = bool(
        par["dead_time"] > 0.0
        or any(drops)
        or par["iron_conductance"] > 0.0
        or par["harmonics"]
        or par["cogging_torque"] != 0.0
        or par["saturates"]
        or par["rectifier"]
        or par["load_kind"] != LOAD_KINDS.index("torque")
        or par["coulomb"] > 0.0
        or par["quadratic"] > 0.0
        or par["shaft"]
        or par["profile_points"] > 0
        or par["filter_rate"] > 0.0
        or par["sampling_lead"] > 0.0
        or par["encoder_latency"] > 0.0
    )
    R = par["R_s"] + max(par["switch_resistance"], par["diode_resistance"])
    rates = [
        R / min(par["L_d"], par["L_q"]),
        # its error stays in the measurement
        0.25 * par["filter_rate"],
        par["brake_rate"],
        (par["B"] + (par["coulomb"] + _brake_torque(par)) / STANDSTILL) / par["J"],
    ]
    if par["rectifier"]:
        conductance = par["grid_conductance"] + par["chopper_conductance"]
        rates.append(conductance / par["capacitance"])
    if par["shaft"]:
        slowness = 1.0 / par["J"] + 1.0 / par["J_load"]
        rates.append(math.sqrt(par["shaft_stiffness"] * slowness))
        rates.append(par["shaft_damping"] * slowness)
        rates.append(_brake_torque(par) / STANDSTILL / par["J_load"])
    # the derivatives of a flux map's spline jump from cell to cell
    longest = 0.02 if par["saturates"] else 0.125
    par["h_general"] = min(longest * par["T_s"], _STEP_PER_TIME_CONSTANT / max(rates))


_DROPS = ("voltage", "resistance")


def _brake_torque(par: np.void) -> float:
    return abs(float(par["tau_L"])) if par["load_kind"] == _BRAKE else 0.0

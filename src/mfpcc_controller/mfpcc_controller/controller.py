"""The drive controller: one PWM period from the sample to the command.

`Controller` holds the records. The kernel `control` does the work of one period and is what both
the node and the in-process engine call; its stages `sample`, `schemes.step`, `command` are kernels
of their own, so that a plug-in in Python can stand in the place of the second. A controller sees
measurement records, and nothing else of the plant. Nothing here knows of ROS.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_controller import firmware, model, motor, plug_in, protection, schemes
from mfpcc_controller.observer import observe, turned_by
from mfpcc_controller.protection import FAULTS
from mfpcc_controller.records import CONTROL_CFG, CONTROL_MEMORY
from mfpcc_controller.speed_loop import current_reference, mtpa_d
from mfpcc_controller.vectors import copy_output, leg_duties, set_output
from pwm_node import stamps
from pwm_node.compiled import direct, kernel

_BUILT_IN = len(schemes.BUILT_IN)

_TWO_PI = 2.0 * math.pi
_INV_SQRT3 = 1.0 / math.sqrt(3.0)
_THIRD = 1.0 / 3.0

# Dwell times may sum up to one and a rounding error.
_WHOLE_PERIOD = 1.0 + 1e-9


@kernel
def _give_up(cfg, mem):
    """The scheme in control does badly: the fallback from now on; if it is it, the gates."""
    schemes.forget(mem)
    if mem.fallen or cfg.fallback == cfg.scheme:
        mem.failed = True
    mem.fallen = True


@kernel
def sample(cfg, mem, fb):
    """Take the sample: currents, angle, speed, the turns of the periods at hand, references."""
    step = fb.period - mem.period if mem.running else np.uint64(0)
    mem.consecutive = step == np.uint64(1)
    mem.running = True
    mem.period = fb.period
    credible = protection.accept(cfg, mem, fb, step)

    copy_output(mem.now, mem.past)
    if mem.consecutive:
        copy_output(mem.next, mem.now)
    else:
        # nothing is known of what the inverter does; without a command it is the zero vector
        set_output(mem.now, 0, 0, 0.0, 0.0)
        mem.now.on = True
        mem.pll_samples = 0
    mem.contiguous = mem.consecutive and mem.past.on

    if credible:
        mem.u_dc = fb.dc_voltage
        mem.derating = fb.derating
        mem.theta_m = cfg.n_p * fb.encoder_angle
    else:
        if mem.u_dc == 0.0:
            mem.u_dc = cfg.u_dc
        mem.theta_m = mem.pll_theta
    mem.turn = complex(math.cos(mem.theta_m), -math.sin(mem.theta_m))
    observe(cfg, mem)
    half = turned_by(0.5 * cfg.T_s * mem.w_m)
    mem.turn_past = mem.turn_now
    mem.turn_now = mem.turn * half
    mem.turn_next = mem.turn_now * (half * half)

    mem.i_dq_past = mem.i_dq
    if credible:
        i_alpha = (2.0 * fb.i_a - fb.i_b - fb.i_c) * _THIRD
        i_beta = (fb.i_b - fb.i_c) * _INV_SQRT3
        mem.i_dq = complex(i_alpha, i_beta) * mem.turn
        protection.watch(cfg, mem, fb)
    elif abs(mem.i_hat) <= cfg.i_max:
        mem.i_dq = mem.i_hat
    mem.e = mem.i_dq - mem.i_hat if mem.contiguous else 0j
    if mem.guard.slowing:
        protection.slow_down(cfg, mem)
    current_reference(cfg, mem)

    if mem.chosen != cfg.scheme:
        mem.chosen = cfg.scheme
        mem.fallen = False
        mem.guard.overrun = 0.0
    misled, overran = protection.misled(cfg, mem), protection.overran(cfg, mem)
    if (misled or overran) and cfg.react:
        _give_up(cfg, mem)
    active = cfg.fallback if mem.fallen else cfg.scheme
    mem.kept = mem.active == active
    mem.active = active
    mem.eta = 0.0
    mem.updated = np.uint8(0)
    mem.bounded = False


@kernel
def _sound(mem):
    """Whether the chosen output can be given to the inverter; written so that NaN is not.

    A built-in scheme that predicts no number has lost its way too; a plug-in need not predict.
    """
    out = mem.next
    return (
        (mem.active >= _BUILT_IN or abs(mem.i_hat) < np.inf)
        and out.d_a >= 0.0
        and out.d_b >= 0.0
        and out.d_a + out.d_b <= _WHOLE_PERIOD
        and out.a >= 0
        and out.a <= 6
        and out.b >= 0
        and out.b <= 6
    )


@kernel
def _fall_back(cfg, mem):
    """The scheme in control has failed: the fallback answers the same sample."""
    protection.report(mem, protection.SCHEME, 0.0)
    schemes.forget(mem)
    if not mem.fallen and cfg.fallback != mem.active:
        mem.fallen = True
        mem.active = cfg.fallback
        mem.kept = False
        schemes.step(cfg, mem)
        if _sound(mem):
            return
    mem.fallen = True
    mem.failed = True
    set_output(mem.next, 0, 0, 0.0, 0.0)
    mem.i_hat = mem.i_dq


@kernel
def _diagnose(cfg, mem, diag):
    """Fill the diagnostics record."""
    if mem.active < _BUILT_IN:
        schemes.show(cfg, mem, diag)
    else:
        plug_in.show(diag)
    diag.period = mem.period
    stamps.put(diag.stamp, mem.period, cfg.pwm_frequency)
    diag.prediction_error[0] = mem.e.real
    diag.prediction_error[1] = mem.e.imag
    diag.i_dq[0] = mem.i_dq.real
    diag.i_dq[1] = mem.i_dq.imag
    diag.i_dq_ref[0] = mem.i_dq_ref.real
    diag.i_dq_ref[1] = mem.i_dq_ref.imag
    diag.w_m = mem.w_m
    diag.speed_ref = cfg.w_M_ref if cfg.speed_control else np.nan
    diag.learning_rate = mem.eta
    diag.updated = mem.updated
    diag.bounded = mem.bounded


@kernel
def command(cfg, mem, cmd, diag, want_diag):
    """Check the chosen output, fall back if need be, and fill the command and the diagnostics."""
    if not _sound(mem):
        _fall_back(cfg, mem)
    elif mem.active >= _BUILT_IN:
        # a plug-in sets vectors and dwell times only
        set_output(mem.next, mem.next.a, mem.next.b, mem.next.d_a, mem.next.d_b)
        if not abs(mem.i_hat) < np.inf:
            mem.i_hat = model.predict(cfg, mem)
    on = protection.released(cfg, mem) and cfg.enable and not mem.failed
    if not on:
        set_output(mem.next, 0, 0, 0.0, 0.0)
    mem.next.on = on
    cmd.period = mem.period + np.uint64(1)
    stamps.put(cmd.stamp, cmd.period, cfg.pwm_frequency)
    leg_duties(mem.next, cmd.duty)
    cmd.vectors[0] = mem.next.a
    cmd.vectors[1] = mem.next.b
    cmd.dwell[0] = mem.next.d_a
    cmd.dwell[1] = mem.next.d_b
    cmd.enable = on
    if want_diag:
        _diagnose(cfg, mem, diag)


@kernel
def answer(cfg, mem, fb, cmd, diag, want_diag):
    """`control` on the records themselves, for compiled loops."""
    if protection.stale(mem, fb):
        # the answer that is there stands
        protection.refuse(cfg, mem, fb)
        return
    sample(cfg, mem, fb)
    schemes.step(cfg, mem)
    command(cfg, mem, cmd, diag, want_diag)


@kernel
def control(cfg_, mem_, fb_, cmd_, diag_, want_diag):
    """One period: from the sample of period k to the command for period k + 1.

    Parameters
    ----------
    cfg_, mem_ : arrays of length 1 of `CONTROL_CFG`, `CONTROL_MEMORY`
    fb_, cmd_, diag_ : arrays of length 1
        The fixed parts of `PhaseFeedback` (read), `DutyCommand` and `LutDiagnostics` (written).
    want_diag : bool
        Whether to fill `diag_`.
    """
    answer(cfg_[0], mem_[0], fb_[0], cmd_[0], diag_[0], want_diag)


@kernel
def _is_stale(mem_, fb_):
    return protection.stale(mem_[0], fb_[0])


@kernel
def _sample(cfg_, mem_, fb_):
    sample(cfg_[0], mem_[0], fb_[0])


@kernel
def _command(cfg_, mem_, cmd_, diag_, want_diag):
    schemes.step(cfg_[0], mem_[0])
    command(cfg_[0], mem_[0], cmd_[0], diag_[0], want_diag)


class Controller:
    """The drive controller and its parameters.

    Parameters
    ----------
    values : mapping
        A value for every parameter of `mfpcc_controller.parameters.TABLE`.
    est_par : EstimatedPars, optional
        The motor, where it has been read already.

    Attributes
    ----------
    cfg, mem : arrays of length 1 of `CONTROL_CFG`, `CONTROL_MEMORY`
    """

    def __init__(
        self, values: Mapping[str, Any], est_par: motor.EstimatedPars | None = None
    ) -> None:
        self.motor = est_par or motor.load(values["motor"])
        self.values = dict(values)
        self.cfg = np.zeros(1, CONTROL_CFG)
        self.mem = np.zeros(1, CONTROL_MEMORY)
        self._latch = self.mem["guard"]["latch"][0]
        self.cfg["pwm_frequency"] = values["pwm_frequency"]
        self.cfg["T_s"] = 1.0 / values["pwm_frequency"]
        self.cfg["n_p"] = self.motor.n_p
        self.cfg["i_max"] = self.motor.i_max
        self.cfg["enable"] = True
        self.mem["derating"] = 1.0
        self.mem["flux_share"] = 1.0
        self.mem["active"] = -1
        self.mem["chosen"] = -1
        self._plug_in: plug_in.Host | None = None
        self._firmware: firmware.Firmware | None = None
        self._control: Callable[..., Any] = control
        self.apply(values)

    def begin_as(self, other: Controller) -> None:
        """Take over the state of another controller, of a compiled scheme."""
        self.motor, self.values = other.motor, dict(other.values)
        self.cfg[:], self.mem[:] = other.cfg, other.mem
        self._plug_in, self._firmware, self._control = None, None, control

    @property
    def scheme(self) -> str:
        """Name of the scheme in control: the chosen one, or the fallback in its place."""
        return str(self.values["fallback_scheme" if self.fallen else "scheme"])

    @property
    def fallen(self) -> bool:
        """Whether the chosen scheme failed; a new choice ends that."""
        return bool(self.mem["fallen"][0])

    @property
    def failed(self) -> bool:
        """Whether the fallback failed too, and the gates are off for it until `clear_faults`."""
        return bool(self.mem["failed"][0])

    @property
    def enabled(self) -> bool:
        """Whether the gates are to be on; while they are off, no scheme learns or integrates."""
        return bool(self.cfg["enable"][0])

    @enabled.setter
    def enabled(self, on: bool) -> None:
        self.cfg["enable"] = on

    @property
    def tripped(self) -> bool:
        """Whether the gates are off until `clear_faults`."""
        return bool(self._latch["tripped"]) or self.failed

    @property
    def slowing(self) -> bool:
        """Whether safe stop 1 is on its way to zero."""
        return bool(self.mem["guard"]["slowing"][0])

    @property
    def released(self) -> bool:
        """Whether nothing but `enabled` keeps the gates off."""
        return not (self.tripped or self.mem["guard"]["awaits_zero"][0])

    def inherit_faults(self, other: Controller) -> None:
        """Take over what another controller has latched, and that power waits for a zero.

        A ramp to standstill that was on its way ends here: it does not begin anew.
        """
        for name in ("latch", "awaits_zero"):
            self.mem["guard"][name] = other.mem["guard"][name]
        self._latch["present"] = 0
        self._latch["tripped"] |= other.failed or other.slowing

    def stop(self) -> None:
        """Safe torque off: the gates go off with the next command, until `clear_faults`."""
        self.mem["guard"]["slowing"] = False
        self._latch["tripped"] = True

    def slow_down(self) -> None:
        """Safe stop 1: ramp down to zero speed, then `stop`; or after twice the ramp's time."""
        guard = self.mem["guard"][0]
        if guard["slowing"] or self.tripped:
            return
        if guard["awaits_zero"]:
            # the gates are off; a ramp to zero would bring the power back
            self.stop()
            return
        if not self.cfg["speed_control"][0]:
            self.cfg["speed_control"] = True
            self.cfg["w_M_ref"] = self.mem["w_m"] / self.cfg["n_p"]
        guard["stop_left"] = 2.0 * self.values["stop.ramp_time"]
        guard["slowing"] = True

    def feedback_lost(self, seconds: float) -> None:
        """Disable, since no sample has come for so long."""
        # its cause is there until the next sample
        period, react = int(self.mem["period"][0]), bool(self.values["fault.react"])
        FAULTS.trip(self._latch, protection.FEEDBACK_LOST, period, seconds, react=react)

    def overran(self, microseconds: float) -> None:
        """Let another scheme take over with the next sample: this one has taken so long."""
        self.mem["guard"]["overrun"] = microseconds

    def clear_faults(self) -> list[str]:
        """Forget the latched faults; returns those whose cause lasts, and then clears none.

        The inverter is enabled again once the reference has been at zero.
        """
        lasting = FAULTS.clear(self._latch)
        if not lasting:
            self.mem["guard"]["awaits_zero"] = True
            self.mem["guard"]["slowing"] = False
            self.mem["fallen"] = False
            self.mem["failed"] = False
            self._apply_references()
        return lasting

    def faults(self) -> list[tuple[str, int, str]]:
        """Latched faults, oldest first: code, period of the first occurrence, what was seen."""
        found = FAULTS.latched(self._latch)
        if self.complaint and self._latch["value"][protection.SCHEME] == 0.0:
            # a plug-in that gave no valid output says itself why
            found = [(c, k, self.complaint if c == "SCHEME" else text) for c, k, text in found]
        return found

    @property
    def compiled(self) -> bool:
        """Whether `control` alone does a period: no plug-in in Python, and no firmware."""
        return self._plug_in is None and self._firmware is None

    @property
    def complaint(self) -> str:
        """What a plug-in that failed has to say, for people; empty otherwise."""
        return self._plug_in.complaint if self._plug_in is not None else ""

    def bind(
        self,
        feedback: NDArray[np.void],
        command: NDArray[np.void],
        diagnostics: NDArray[np.void],
    ) -> None:
        """Compile, or load, the kernel; from now on `step` is called with these arrays only."""
        self._control = direct(control, self.cfg, self.mem, feedback, command, diagnostics, True)

    def step(
        self,
        feedback: NDArray[np.void],
        command: NDArray[np.void],
        diagnostics: NDArray[np.void],
        want_diagnostics: bool,
    ) -> None:
        """One period, whoever is in control; parameters as of `control`."""
        if self._firmware is not None:
            self._firmware.step(
                self.cfg, self.mem, feedback, command, diagnostics, want_diagnostics
            )
            return
        host = self._plug_in
        if host is None or _is_stale(self.mem, feedback):
            self._control(self.cfg, self.mem, feedback, command, diagnostics, want_diagnostics)
            return
        _sample(self.cfg, self.mem, feedback)
        if self.mem["active"][0] >= _BUILT_IN:
            host.step()
        _command(self.cfg, self.mem, command, diagnostics, want_diagnostics)

    def apply(self, changes: Mapping[str, Any]) -> None:
        """Take over changed parameters; they act from the next sample on."""
        self.values.update(changes)
        values, cfg, est_par = self.values, self.cfg, self.motor
        T_s = 1.0 / values["pwm_frequency"]
        if "scheme" in changes:
            self._choose_scheme(values["scheme"])
        cfg["fallback"] = schemes.NAMES.index(values["fallback_scheme"])
        cfg["R_s"] = est_par.R_s * values["mismatch.resistance"]
        cfg["L_d"] = est_par.L_d * values["mismatch.inductance"]
        cfg["L_q"] = est_par.L_q * values["mismatch.inductance"]
        cfg["psi_f"] = est_par.psi_f * values["mismatch.flux"]
        cfg["b_d"] = T_s / cfg["L_d"]
        cfg["b_q"] = T_s / cfg["L_q"]
        self._apply_references()
        protection.configure(cfg[0], self.motor, values)

        cfg["rank_sectors"] = values["sector_search"] == "ranking"
        cfg["project"] = values["overmodulation"] == "project"
        gain = values["deadbeat.gain"]
        cfg["gain"] = [gain or scheme.gain for scheme in schemes.BUILT_IN]
        for scheme in schemes.BUILT_IN:
            scheme.configure(cfg[0], self.mem[0], values)

    def _choose_scheme(self, name: str) -> None:
        # also one that failed, chosen again, gets another chance
        self.mem["chosen"] = -1
        self._plug_in = self._firmware = None
        if name in schemes.NAMES:
            self.cfg["scheme"] = schemes.NAMES.index(name)
        elif name.startswith(firmware.PREFIX):
            self._firmware = firmware.Firmware(name)
            self.cfg["scheme"] = self._firmware.scheme
        else:
            # a new number each time, so that the switch is seen
            self.cfg["scheme"] = max(int(self.cfg["scheme"][0]), _BUILT_IN - 1) + 1
            self._plug_in = plug_in.Host(name, self.motor, self.cfg, self.mem)

    def _apply_references(self) -> None:
        """Parameters of the speed loop, the references and the rotor observer."""
        values, cfg, est_par = self.values, self.cfg, self.motor
        if not self.slowing:
            cfg["speed_control"] = values["control_mode"] == "speed"
            cfg["w_M_ref"] = values["speed_ref_rpm"] * _TWO_PI / 60.0
        cfg["i_dq_ref"] = complex(values["i_d_ref"], values["i_q_ref"])
        # References are made from the motor file, whatever mismatch the current control has: all
        # schemes shall follow the same ones.
        cfg["ref_L_d"], cfg["ref_L_q"] = est_par.L_d, est_par.L_q
        cfg["ref_psi_f"] = est_par.psi_f
        saliency = est_par.L_q - est_par.L_d
        salient = values["mtpa"] and abs(saliency) > 1e-3 * est_par.L_q
        cfg["mtpa"] = est_par.psi_f / (4.0 * saliency) if salient else 0.0
        cfg["torque_max"] = self._torque_limit(values["torque_limit"])
        cfg["weaken"] = values["field_weakening"]
        if not values["field_weakening"]:
            self.mem["flux_share"] = 1.0
            self.mem["weakened"] = False
        # gains of Harnefors et al. for bandwidth alpha_s; torque per ampere of the motor file
        alpha_s = values["speed.bandwidth"]
        inertia = (est_par.J + values["load.inertia"]) / (1.5 * est_par.n_p * est_par.psi_f)
        cfg["k_t"] = alpha_s * inertia
        cfg["k_p"] = 2.0 * alpha_s * inertia
        cfg["k_i"] = alpha_s * alpha_s * inertia
        omega_o = values["observer.bandwidth"]
        cfg["pll_k_p"] = 2.0 * omega_o
        cfg["pll_k_i"] = omega_o * omega_o

    def _torque_limit(self, torque: float) -> float:
        """Largest torque (N m; 0: what i_max makes) in A with the magnet's flux alone."""
        est_par, mtpa = self.motor, float(self.cfg["mtpa"][0])
        i_d = mtpa_d(mtpa, est_par.i_max) if mtpa else self.values["i_d_ref"]
        flux = est_par.psi_f + (est_par.L_d - est_par.L_q) * i_d
        most = est_par.i_max * max(flux / est_par.psi_f, 1.0)
        if torque == 0.0:
            return most
        return min(most, torque / (1.5 * est_par.n_p * est_par.psi_f))

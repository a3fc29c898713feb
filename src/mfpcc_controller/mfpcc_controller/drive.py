"""The drive controller: one PWM period from the sample to the command.

`Controller` holds the records; the kernel `control` does the work of one period and is what both
the node and the in-process engine call. A controller sees measurement records, and nothing else
of the plant. Nothing here knows of ROS.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mfpcc_controller import motor
from mfpcc_controller.observer import observe
from mfpcc_controller.parameters import SCHEMES
from mfpcc_controller.records import CONTROL_CFG, CONTROL_MEMORY
from mfpcc_controller.schemes import mbpcc, mfpcc, mls_mfpcc
from mfpcc_controller.speed_loop import current_reference
from mfpcc_controller.vectors import leg_duties
from pwm_node.compiled import kernel

_MLS_MFPCC = SCHEMES.index("mls_mfpcc")
_MFPCC = SCHEMES.index("mfpcc")
_MBPCC = SCHEMES.index("mbpcc")

_TWO_PI = 2.0 * math.pi
_INV_SQRT3 = 1.0 / math.sqrt(3.0)


@kernel
def _measure(cfg, mem, fb):
    """Take the sample: currents, angle, speed, and the turns of the three periods at hand."""
    mem.contiguous = mem.running and fb.period == mem.period + np.uint64(1)
    mem.running = True
    mem.period = fb.period

    mem.past.a, mem.past.b = mem.now.a, mem.now.b
    mem.past.d_a, mem.past.d_b = mem.now.d_a, mem.now.d_b
    if mem.contiguous:
        mem.now.a, mem.now.b = mem.next.a, mem.next.b
        mem.now.d_a, mem.now.d_b = mem.next.d_a, mem.next.d_b
    else:
        # nothing is known of what the inverter does; without a command it is the zero vector
        mem.now.a, mem.now.b, mem.now.d_a, mem.now.d_b = 0, 0, 0.0, 0.0
        mem.pll_samples = 0

    mem.u_dc = fb.dc_voltage
    mem.theta_m = cfg.n_p * fb.encoder_angle
    observe(cfg, mem)
    mem.turn = complex(math.cos(mem.theta_m), -math.sin(mem.theta_m))
    half = 0.5 * cfg.T_s * mem.w_m
    half_turn = complex(math.cos(half), -math.sin(half))
    mem.turn_past = mem.turn_now
    mem.turn_now = mem.turn * half_turn
    mem.turn_next = mem.turn_now * half_turn * half_turn

    mem.i_dq_past = mem.i_dq
    i_alpha = (2.0 * fb.i_a - fb.i_b - fb.i_c) / 3.0
    i_beta = (fb.i_b - fb.i_c) * _INV_SQRT3
    mem.i_dq = complex(i_alpha, i_beta) * mem.turn
    mem.e = mem.i_dq - mem.i_hat if mem.contiguous else 0j


@kernel
def _scheme_step(cfg, mem):
    if cfg.scheme == _MLS_MFPCC:
        mls_mfpcc.step(cfg, mem)
    elif cfg.scheme == _MFPCC:
        mfpcc.step(cfg, mem)
    else:
        mbpcc.step(cfg, mem)


@kernel
def _scheme_show(cfg, mem):
    if cfg.scheme == _MLS_MFPCC:
        mls_mfpcc.show(cfg, mem)
    elif cfg.scheme == _MFPCC:
        mfpcc.show(cfg, mem)
    else:
        mbpcc.show(cfg, mem)


@kernel
def _set_stamp(stamp, period, period_ns):
    t_ns = np.int64(period) * period_ns
    stamp.sec = t_ns // 1_000_000_000
    stamp.nanosec = t_ns % 1_000_000_000


@kernel
def _command(cfg, mem, cmd):
    """Fill the command record with the chosen output."""
    cmd.period = mem.period + np.uint64(1)
    _set_stamp(cmd.stamp, cmd.period, cfg.period_ns)
    leg_duties(mem.next, cmd.duty)
    cmd.vectors[0] = mem.next.a
    cmd.vectors[1] = mem.next.b
    cmd.dwell[0] = mem.next.d_a
    cmd.dwell[1] = mem.next.d_b
    cmd.enable = True


@kernel
def _diagnose(cfg, mem, diag):
    """Fill the diagnostics record."""
    _scheme_show(cfg, mem)
    diag.period = mem.period
    _set_stamp(diag.stamp, mem.period, cfg.period_ns)
    for j in range(7):
        diag.gradient_re[j] = mem.g[j].real
        diag.gradient_im[j] = mem.g[j].imag
        diag.age[j] = mem.age[j]
    diag.prediction_error[0] = mem.e.real
    diag.prediction_error[1] = mem.e.imag
    diag.i_dq[0] = mem.i_dq.real
    diag.i_dq[1] = mem.i_dq.imag
    diag.i_dq_ref[0] = mem.i_dq_ref.real
    diag.i_dq_ref[1] = mem.i_dq_ref.imag
    diag.w_m = mem.w_m
    diag.speed_ref = cfg.w_M_ref if cfg.speed_control else np.nan
    for j in range(3):
        diag.error_share[j] = mem.share[j]
    diag.learning_rate = mem.eta
    diag.updated = mem.updated
    diag.bounded = mem.bounded


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
    cfg, mem = cfg_[0], mem_[0]
    _measure(cfg, mem, fb_[0])
    mem.scheme_kept = mem.active == cfg.scheme
    mem.active = cfg.scheme
    mem.updated = np.uint8(0)
    mem.bounded = False
    mem.eta = 0.0
    current_reference(cfg, mem)
    _scheme_step(cfg, mem)
    _command(cfg, mem, cmd_[0])
    if want_diag:
        _diagnose(cfg, mem, diag_[0])


class Controller:
    """The drive controller and its parameters.

    Parameters
    ----------
    values : mapping
        A value for every parameter of `mfpcc_controller.parameters.TABLE`.

    Attributes
    ----------
    cfg, mem : arrays of length 1 of `CONTROL_CFG`, `CONTROL_MEMORY`
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.motor = motor.load(values["motor"])
        self.values = dict(values)
        self.cfg = np.zeros(1, CONTROL_CFG)
        self.mem = np.zeros(1, CONTROL_MEMORY)
        self.cfg["T_s"] = 1.0 / values["pwm_frequency"]
        self.cfg["period_ns"] = round(1e9 / values["pwm_frequency"])
        self.cfg["n_p"] = self.motor.n_p
        self.cfg["i_max"] = self.motor.i_max
        self.mem["active"] = -1
        self.apply(values)

    @property
    def scheme(self) -> str:
        """Name of the scheme in control."""
        return str(self.values["scheme"])

    def apply(self, changes: Mapping[str, Any]) -> None:
        """Take over changed parameters; they act from the next sample on."""
        self.values.update(changes)
        values, cfg, est_par = self.values, self.cfg, self.motor
        cfg["scheme"] = SCHEMES.index(values["scheme"])
        cfg["R_s"] = est_par.R_s * values["mismatch.resistance"]
        cfg["L_d"] = est_par.L_d * values["mismatch.inductance"]
        cfg["L_q"] = est_par.L_q * values["mismatch.inductance"]
        cfg["psi_f"] = est_par.psi_f * values["mismatch.flux"]

        cfg["speed_control"] = values["control_mode"] == "speed"
        cfg["w_M_ref"] = values["speed_ref_rpm"] * _TWO_PI / 60.0
        cfg["i_dq_ref"] = complex(values["i_d_ref"], values["i_q_ref"])
        # gains of Harnefors et al. for bandwidth alpha_s; torque per ampere of the motor file
        alpha_s = values["speed.bandwidth"]
        inertia = est_par.J / (1.5 * est_par.n_p * est_par.psi_f)
        cfg["k_t"] = alpha_s * inertia
        cfg["k_p"] = 2.0 * alpha_s * inertia
        cfg["k_i"] = alpha_s * alpha_s * inertia
        omega_o = values["observer.bandwidth"]
        cfg["pll_k_p"] = 2.0 * omega_o
        cfg["pll_k_i"] = omega_o * omega_o

        cfg["rank_sectors"] = values["sector_search"] == "ranking"
        cfg["project"] = values["overmodulation"] == "project"
        if "mls.window" in changes:
            # the ring is laid out for its length: start a new one
            self.mem["mls"]["filled"] = 0
            self.mem["mls"]["pair_filled"] = 0
            self.mem["mls"]["head"] = 0
        for name in ("window", "beta", "eta_min", "eta_max", "e_0", "g_max"):
            cfg[f"mls_{name}"] = values[f"mls.{name}"]
        cfg["mfpcc_u_min"] = values["mfpcc.u_min"]

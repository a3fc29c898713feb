"""Speed loop and current references: torque limit, maximum torque per ampere, field weakening."""

from __future__ import annotations

import math

from mfpcc_controller.vectors import square
from pwm_node.compiled import kernel

# Share of the linear modulation range that field weakening leaves to be used.
_VOLTAGE_SHARE = 0.95
_INV_SQRT3 = 1.0 / math.sqrt(3.0)


@kernel
def mtpa_d(mtpa, i_s):
    """i_d of the largest torque at the current amplitude i_s (A).

    `i_d = m - sqrt(m^2 + i_s^2 / 2)` with `m = psi_f / (4 (L_q - L_d))` (Morimoto, Takeda, Hirasa,
    Taniguchi 1990, doi:10.1109/28.60058). The mirror image, for L_d > L_q, has m < 0.
    """
    root = math.sqrt(mtpa * mtpa + 0.5 * i_s * i_s)
    return mtpa - root if mtpa > 0.0 else mtpa + root


@kernel
def _weaken(cfg, mem):
    """Move `mem.i_d_weak` by what the committed voltage lacks to the limit.

    An integrator on the voltage that is really asked for needs no motor parameter but for its
    gain, and so finds the limit with any scheme and any model (Harnefors, Pietilainen, Gertmar
    2001, doi:10.1109/41.949390).
    """
    limit = _VOLTAGE_SHARE * _INV_SQRT3
    lack = mem.u_dc * (limit - math.sqrt(square(mem.now.u)))
    gain = cfg.weaken / max(abs(mem.w_m), 1.0)
    i_d = mem.i_d_weak + cfg.T_s * gain * lack
    mem.i_d_weak = min(max(i_d, -cfg.i_max), 0.0)


@kernel
def current_reference(cfg, mem):
    """Set `mem.i_dq_ref`, within the share of `cfg.i_max` that the inverter allows.

    Speed control is a two-degree-of-freedom PI controller with active damping and
    back-calculation anti-windup (Harnefors, Saarakkala, Hinkkanen 2013,
    doi:10.1109/TIA.2013.2258392): no overshoot at a step of the reference, and a load step is
    answered with the same bandwidth.
    """
    i_max = mem.derating * cfg.i_max
    i_d = cfg.i_dq_ref.real
    if cfg.weaken > 0.0:
        _weaken(cfg, mem)
        i_d += mem.i_d_weak
    if i_d != 0.0:
        i_d = min(max(i_d, -i_max), i_max)
    i_q_max = i_max if i_d == 0.0 else math.sqrt(i_max * i_max - i_d * i_d)
    if not cfg.speed_control:
        mem.speed_ready = False
        mem.i_dq_ref = complex(i_d, min(max(cfg.i_dq_ref.imag, -i_q_max), i_q_max))
        return
    if mem.pll_samples < 2 or not mem.now.on:
        # no speed yet, or no torque; and no bump when it comes
        mem.speed_ready = False
        mem.i_dq_ref = complex(i_d, 0.0)
        return

    w_M = mem.w_m / cfg.n_p
    damping = cfg.k_p - cfg.k_t
    if not mem.speed_ready:
        mem.i_q_int = damping * w_M + mem.i_dq.imag
        mem.speed_ready = True
    w_error = cfg.w_M_ref - w_M
    wish = cfg.k_t * w_error - damping * w_M + mem.i_q_int
    i_s_max = min(cfg.i_s_max, i_max)
    i_s = min(max(wish, -i_s_max), i_s_max)
    if cfg.mtpa != 0.0:
        # the loop asks for torque; here it is made with the smallest current
        d_0 = mtpa_d(cfg.mtpa, i_s)
        i_q = math.copysign(math.sqrt(i_s * i_s - d_0 * d_0), i_s)
        i_d = min(max(i_d + d_0, -i_max), i_max)
        i_q_max = math.sqrt(i_max * i_max - i_d * i_d)
    else:
        i_q = i_s
    i_q_real = min(max(i_q, -i_q_max), i_q_max)
    mem.i_q_int += cfg.T_s * cfg.k_i * (w_error + (i_s - wish + i_q_real - i_q) / cfg.k_t)
    mem.i_dq_ref = complex(i_d, i_q_real)

"""Speed loop and current references."""

from __future__ import annotations

import math

from pwm_node.compiled import kernel


@kernel
def current_reference(cfg, mem):
    """Set `mem.i_dq_ref`, within `cfg.i_max`.

    Speed control is a two-degree-of-freedom PI controller with active damping and
    back-calculation anti-windup (Harnefors, Saarakkala, Hinkkanen 2013,
    doi:10.1109/TIA.2013.2258392): no overshoot at a step of the reference, and a load step is
    answered with the same bandwidth.
    """
    i_d = min(max(cfg.i_dq_ref.real, -cfg.i_max), cfg.i_max)
    i_q_max = math.sqrt(cfg.i_max * cfg.i_max - i_d * i_d)
    if cfg.speed_control:
        w_M = mem.w_m / cfg.n_p
        damping = cfg.k_p - cfg.k_t
        if mem.pll_samples < 2:
            # no speed yet; and no bump when it comes
            mem.i_q_int = 0.0
            i_q = 0.0
        else:
            if not mem.speed_ready:
                mem.i_q_int = damping * w_M + mem.i_dq.imag
                mem.speed_ready = True
            wish = cfg.k_t * (cfg.w_M_ref - w_M) - damping * w_M + mem.i_q_int
            i_q = min(max(wish, -i_q_max), i_q_max)
            mem.i_q_int += cfg.T_s * cfg.k_i * (cfg.w_M_ref - w_M + (i_q - wish) / cfg.k_t)
    else:
        mem.speed_ready = False
        i_q = min(max(cfg.i_dq_ref.imag, -i_q_max), i_q_max)
    mem.i_dq_ref = complex(i_d, i_q)

"""PI-FOC: PI control of i_d and i_q with decoupling and space-vector modulation.

What a drive has by default, tuned as the books say (Harnefors and Nee 1998,
doi:10.1109/28.658735): internal-model gains for the bandwidth alpha, active damping so that a
disturbance of the voltage dies out as fast as a step of the reference, cross coupling and back-EMF
fed forward, anti-windup by back-calculation, and the voltage turned on by the 1.5 periods until the
middle of the period it applies to.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mfpcc_controller import model, search
from mfpcc_controller.schemes import mbpcc
from mfpcc_controller.schemes.built_in import BuiltIn
from mfpcc_controller.vectors import ACTIVE_LENGTH, next_vector, scaled
from pwm_node.compiled import kernel
from pwm_node.parameters import Parameter

# Bandwidth over PWM frequency, at most: the delay of 1.5 periods leaves it stable, with an
# inductance that is twice the true one as well.
_FASTEST = 0.2

PARAMETERS = (
    Parameter(
        "pi.bandwidth",
        908.0,
        "Bandwidth of the current control of pi_foc; never more than a fifth of the PWM frequency",
        unit="rad/s",
        minimum=1.0,
        maximum=20_000.0,
    ),
)

CFG = np.dtype([("alpha", np.float64)], align=True)  # (rad/s)

MEMORY = np.dtype(
    [
        ("ready", np.bool_),
        ("integral", np.complex128),  # (V)
    ],
    align=True,
)


def configure(cfg: np.void, mem: np.void, values: Mapping[str, Any]) -> None:
    """Take over the bandwidth, as far as the delay allows."""
    cfg["pi_foc"]["alpha"] = min(values["pi.bandwidth"], _FASTEST / cfg["T_s"])


@kernel
def _per_axis(d, q, z):
    return complex(d * z.real, q * z.imag)


@kernel
def step(cfg, mem):
    """Voltage from the present error, realised in period k + 1."""
    pi, alpha, i_dq = mem.pi_foc, cfg.pi_foc.alpha, mem.i_dq
    k_d, k_q = alpha * cfg.L_d, alpha * cfg.L_q
    error = mem.i_dq_ref - i_dq
    # decoupling, back-EMF and active damping with the resistance R_a = k_p - R_s
    known = complex(
        -mem.w_m * cfg.L_q * i_dq.imag - (k_d - cfg.R_s) * i_dq.real,
        mem.w_m * (cfg.L_d * i_dq.real + cfg.psi_f) - (k_q - cfg.R_s) * i_dq.imag,
    )
    proportional = _per_axis(k_d, k_q, error)
    if not (pi.ready and mem.kept and mem.contiguous):
        if not mem.now.on:
            # the gates are off: what is applied is no voltage to go on with, but the EMF is known
            pi.integral = _per_axis(k_d, k_q, i_dq)
        elif mem.contiguous and max(mem.now.d_a, 1.0 - mem.now.d_a - mem.now.d_b) == 1.0:
            # a single vector holds no current: the model, and what it missed in the last increment
            u_past = scaled(mem.u_dc, mem.past.u * mem.turn_past)
            h = model.natural(cfg, mem.w_m, mem.i_dq_past) + model.forced(cfg, u_past)
            missed = mem.i_dq_past + h - mem.i_dq
            pi.integral = _per_axis(k_d, k_q, i_dq) + _per_axis(
                1.0 / cfg.b_d, 1.0 / cfg.b_q, missed
            )
        else:
            # go on with the voltage that is being applied
            u_now = scaled(mem.u_dc, mem.now.u * mem.turn_now)
            pi.integral = u_now - known - proportional
        pi.ready = True
    wish = proportional + pi.integral + known
    u_1 = scaled(ACTIVE_LENGTH * mem.u_dc, mem.turn_next)
    search.choose(cfg, wish, u_1, next_vector(u_1), mem.next)
    u_real = scaled(mem.u_dc, mem.next.u * mem.turn_next)
    step_d, step_q = cfg.T_s * alpha * k_d, cfg.T_s * alpha * k_q
    missing = u_real - wish
    pi.integral += _per_axis(step_d, step_q, error + _per_axis(1.0 / k_d, 1.0 / k_q, missing))
    # no part of the control: what the model behind the decoupling predicts, for the diagnostics
    mem.i_hat = model.predict(cfg, mem)


SCHEME = BuiltIn(
    name="pi_foc",
    step=step,
    show=mbpcc.show,
    parameters=PARAMETERS,
    cfg=CFG,
    configure=configure,
    memory=MEMORY,
)

"""Current gradients of the motor model (method section 3), for the schemes that use one."""

from __future__ import annotations

from mfpcc_controller.vectors import ACTIVE_LENGTH, next_vector, scaled
from pwm_node.compiled import kernel


@kernel
def natural(cfg, w_m, i_dq):
    """Natural response of one period (A, rotor frame): what the zero vector would give."""
    i_d, i_q = i_dq.real, i_dq.imag
    return complex(
        cfg.b_d * (w_m * cfg.L_q * i_q - cfg.R_s * i_d),
        cfg.b_q * (-w_m * (cfg.L_d * i_d + cfg.psi_f) - cfg.R_s * i_q),
    )


@kernel
def forced(cfg, u_dq):
    """Forced response of one period (A, rotor frame) to the voltage u_dq (V, rotor frame)."""
    return complex(cfg.b_d * u_dq.real, cfg.b_q * u_dq.imag)


@kernel
def forced_vectors(cfg, u_dc, turn):
    """Forced responses of V1 and V2 (A, rotor frame); the other four follow from them."""
    u_1 = scaled(ACTIVE_LENGTH * u_dc, turn)
    return forced(cfg, u_1), forced(cfg, next_vector(u_1))


@kernel
def predict(cfg, mem):
    """Sample k + 1 by the model, with the committed output (A, rotor frame)."""
    u_now = scaled(mem.u_dc, mem.now.u * mem.turn_now)
    return mem.i_dq + natural(cfg, mem.w_m, mem.i_dq) + forced(cfg, u_now)

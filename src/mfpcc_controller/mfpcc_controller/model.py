"""Current gradients of the motor model (method section 3), for the schemes that use one."""

from __future__ import annotations

from mfpcc_controller.vectors import BASIC_VECTORS
from pwm_node.compiled import kernel


@kernel
def natural(cfg, w_m, i_dq):
    """Natural response of one period (A, rotor frame): what the zero vector would give."""
    i_d, i_q = i_dq.real, i_dq.imag
    return complex(
        cfg.T_s / cfg.L_d * (-cfg.R_s * i_d + w_m * cfg.L_q * i_q),
        cfg.T_s / cfg.L_q * (-cfg.R_s * i_q - w_m * (cfg.L_d * i_d + cfg.psi_f)),
    )


@kernel
def forced(cfg, u_dq):
    """Forced response of one period (A, rotor frame) to the voltage u_dq (V, rotor frame)."""
    return complex(cfg.T_s / cfg.L_d * u_dq.real, cfg.T_s / cfg.L_q * u_dq.imag)


@kernel
def forced_vectors(cfg, u_dc, turn, G):
    """Forced responses of V1..V6 (A, rotor frame) into G[1..6]; G[0] is left alone."""
    for j in range(1, 4):
        G[j] = forced(cfg, u_dc * BASIC_VECTORS[j] * turn)
        G[j + 3] = -G[j]

"""Ultra-local model with a linear extended state observer, deadbeat, three vectors.

    di/dt = F + alpha u,   alpha = 1 / L per axis

F is all but the voltage: resistance, back-EMF, cross coupling, errors of alpha. A linear extended
state observer with both poles at w_o estimates current and F together; the voltage that brings the
current onto its reference in one period follows at once, and space-vector modulation makes it
(Zhang, Jin, Huang 2021, doi:10.1109/TIE.2020.2970660; poles after Gao 2003,
doi:10.1109/ACC.2003.1242516). It is the paper's other family of model-free schemes. The only
parameter is alpha, from the controller's inductance.
"""

from __future__ import annotations

import math

from mfpcc_controller import model, search
from mfpcc_controller.diagnostics import show_gradients, show_nothing_learned
from mfpcc_controller.vectors import scaled
from pwm_node.compiled import kernel


@kernel
def reach(cfg, mem, unknown):
    """Predict sample k + 1 with the committed output, reach the reference at k + 2.

    `unknown` is T_s F: what the current does in one period without voltage (A).
    """
    u_now = scaled(mem.u_dc, mem.now.u * mem.turn_now)
    i_1 = mem.i_dq + unknown + model.forced(cfg, u_now)
    x = mem.i_dq_ref - i_1 - unknown
    G_1, G_2 = model.forced_vectors(cfg, mem.u_dc, mem.turn_next)
    search.choose(cfg, x, G_1, G_2, mem.next)
    mem.i_hat = i_1


@kernel
def take_over(cfg, mem):
    """Start the observer where the last increment leaves it, unless it was in control then."""
    eso = mem.ultra
    if eso.ready and mem.kept and mem.contiguous:
        return
    eso.z_1 = mem.i_dq
    eso.z_2 = 0j
    if mem.contiguous:
        u_past = scaled(mem.u_dc, mem.past.u * mem.turn_past)
        unknown = mem.i_dq - mem.i_dq_past - model.forced(cfg, u_past)
        eso.z_2 = scaled(1.0 / cfg.T_s, unknown)
    eso.ready = True


@kernel
def step(cfg, mem):
    """Observe F, then reach the reference."""
    take_over(cfg, mem)
    eso, T_s = mem.ultra, cfg.T_s
    # both poles of the error at exp(-w_o T_s)
    pole = math.exp(-cfg.ultra_w_o * T_s)
    err = mem.i_dq - eso.z_1
    i_0 = eso.z_1 + scaled(1.0 - pole * pole, err)
    eso.z_2 += scaled((1.0 - pole) * (1.0 - pole) / T_s, err)
    u_now = scaled(mem.u_dc, mem.now.u * mem.turn_now)
    unknown = scaled(T_s, eso.z_2)
    eso.z_1 = i_0 + unknown + model.forced(cfg, u_now)
    reach(cfg, mem, unknown)


@kernel
def show(cfg, mem, diag):
    """The gradients: T_s F, and T_s alpha u_j."""
    G_1, G_2 = model.forced_vectors(cfg, mem.u_dc, mem.turn_now)
    back = mem.turn_now.conjugate()
    show_gradients(diag, scaled(cfg.T_s, mem.ultra.z_2), G_1 * back, G_2 * back)
    show_nothing_learned(diag)

"""MBPCC: model-based predictive current control with three vectors (method sections 3, 4, 7)."""

from __future__ import annotations

from mfpcc_controller import model, search
from mfpcc_controller.vectors import mean_voltage
from pwm_node.compiled import kernel


@kernel
def step(cfg, mem):
    """Predict sample k + 1 with the committed output, then reach the reference at k + 2."""
    u_now = mean_voltage(mem.now, mem.u_dc) * mem.turn_now
    i_1 = mem.i_dq + model.natural(cfg, mem.w_m, mem.i_dq) + model.forced(cfg, u_now)
    x = mem.i_dq_ref - i_1 - model.natural(cfg, mem.w_m, i_1)
    model.forced_vectors(cfg, mem.u_dc, mem.turn_next, mem.G)
    search.choose(cfg, x, mem.G, mem.next)
    mem.i_hat = i_1


@kernel
def show(cfg, mem):
    """The model's gradients at this sample."""
    model.forced_vectors(cfg, mem.u_dc, mem.turn_now, mem.g)
    for j in range(1, 7):
        mem.g[j] *= mem.turn_now.conjugate()
    mem.g[0] = model.natural(cfg, mem.w_m, mem.i_dq)

"""MBPCC: model-based predictive current control with three vectors (method sections 3, 4, 7)."""

from __future__ import annotations

from mfpcc_controller import model, search
from mfpcc_controller.diagnostics import show_gradients, show_nothing_learned
from mfpcc_controller.schemes.built_in import BuiltIn
from pwm_node.compiled import kernel


@kernel
def step(cfg, mem):
    """Predict sample k + 1 with the committed output, then reach the reference at k + 2."""
    i_1 = model.predict(cfg, mem)
    x = search.correction(cfg, mem, i_1) - model.natural(cfg, mem.w_m, i_1)
    G_1, G_2 = model.forced_vectors(cfg, mem.u_dc, mem.turn_next)
    search.choose(cfg, x, G_1, G_2, mem.next)
    mem.i_hat = i_1


@kernel
def show(cfg, mem, diag):
    """The model's gradients at this sample."""
    G_1, G_2 = model.forced_vectors(cfg, mem.u_dc, mem.turn_now)
    back = mem.turn_now.conjugate()
    show_gradients(diag, model.natural(cfg, mem.w_m, mem.i_dq), G_1 * back, G_2 * back)
    show_nothing_learned(diag)


SCHEME = BuiltIn(name="mbpcc", step=step, show=show)

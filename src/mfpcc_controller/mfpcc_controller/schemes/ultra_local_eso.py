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
from collections.abc import Mapping
from typing import Any

import numpy as np

from mfpcc_controller import model, search
from mfpcc_controller.diagnostics import show_gradients, show_nothing_learned
from mfpcc_controller.schemes.built_in import BuiltIn
from mfpcc_controller.vectors import scaled
from pwm_node.compiled import kernel
from pwm_node.parameters import Parameter

PARAMETERS = (
    Parameter(
        "ultra_local.bandwidth",
        1_200.0,
        "Bandwidth of the observer of ultra_local_eso",
        unit="rad/s",
        minimum=1.0,
        maximum=20_000.0,
    ),
)

CFG = np.dtype([("w_o", np.float64)], align=True)  # (rad/s)

#: The observer's states
MEMORY = np.dtype(
    [
        ("ready", np.bool_),
        ("z_1", np.complex128),  # current at the next sample (A)
        ("z_2", np.complex128),  # F (A/s)
    ],
    align=True,
)


def configure(cfg: np.void, mem: np.void, values: Mapping[str, Any]) -> None:
    """Take over the bandwidth."""
    cfg["ultra_local_eso"]["w_o"] = values["ultra_local.bandwidth"]


@kernel
def reach(cfg, mem, unknown):
    """Predict sample k + 1 with the committed output, reach the reference at k + 2.

    `unknown` is T_s F: what the current does in one period without voltage (A).
    """
    u_now = scaled(mem.u_dc, mem.now.u * mem.turn_now)
    i_1 = mem.i_dq + unknown + model.forced(cfg, u_now)
    x = search.correction(cfg, mem, i_1) - unknown
    G_1, G_2 = model.forced_vectors(cfg, mem.u_dc, mem.turn_next)
    search.choose(cfg, x, G_1, G_2, mem.next)
    mem.i_hat = i_1


@kernel
def take_over(cfg, mem, observer):
    """Start an observer where the last increment leaves it, unless it was in control then."""
    if observer.ready and mem.kept and mem.contiguous:
        return
    observer.z_1 = mem.i_dq
    observer.z_2 = 0j
    if mem.contiguous:
        u_past = scaled(mem.u_dc, mem.past.u * mem.turn_past)
        unknown = mem.i_dq - mem.i_dq_past - model.forced(cfg, u_past)
        observer.z_2 = scaled(1.0 / cfg.T_s, unknown)
    observer.ready = True


@kernel
def step(cfg, mem):
    """Observe F, then reach the reference."""
    eso, T_s = mem.ultra_local_eso, cfg.T_s
    take_over(cfg, mem, eso)
    # both poles of the error at exp(-w_o T_s)
    pole = math.exp(-cfg.ultra_local_eso.w_o * T_s)
    err = mem.i_dq - eso.z_1
    i_0 = eso.z_1 + scaled(1.0 - pole * pole, err)
    eso.z_2 += scaled((1.0 - pole) * (1.0 - pole) / T_s, err)
    u_now = scaled(mem.u_dc, mem.now.u * mem.turn_now)
    unknown = scaled(T_s, eso.z_2)
    eso.z_1 = i_0 + unknown + model.forced(cfg, u_now)
    reach(cfg, mem, unknown)


@kernel
def show_observed(cfg, mem, observer, diag):
    """The gradients by an observer: T_s F, and T_s alpha u_j."""
    G_1, G_2 = model.forced_vectors(cfg, mem.u_dc, mem.turn_now)
    back = mem.turn_now.conjugate()
    show_gradients(diag, scaled(cfg.T_s, observer.z_2), G_1 * back, G_2 * back)
    show_nothing_learned(diag)


@kernel
def show(cfg, mem, diag):
    """The gradients by this observer."""
    show_observed(cfg, mem, mem.ultra_local_eso, diag)


SCHEME = BuiltIn(
    name="ultra_local_eso",
    step=step,
    show=show,
    parameters=PARAMETERS,
    cfg=CFG,
    configure=configure,
    memory=MEMORY,
    gain=0.24,
)

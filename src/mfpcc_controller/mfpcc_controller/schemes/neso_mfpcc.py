"""NESO-MFPCC: MBPCC whose model is corrected by a nonlinear extended state observer (method
section 7, after the paper's rival).

Per axis, with h the model's increment of the period:

    err = z1 - i(k)
    z1 <- z1 + h + T_s (z2 - 2 w_o err)
    z2 <- z2 - T_s w_o^2 fal(err)
    fal(x) = x  if |x| <= delta,  else delta^(1 - alpha) |x|^alpha sign(x)

and T_s z2, all that the model does not know, is added to the natural response in both predictions.
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

# Over the current limit; alpha = 1/2, so that the power is a root
_DELTA = 0.1 / 12.0

PARAMETERS = (
    Parameter(
        "neso.bandwidth",
        800.0,
        "Bandwidth of the observer of neso_mfpcc",
        unit="rad/s",
        minimum=1.0,
        maximum=20_000.0,
    ),
)

CFG = np.dtype(
    [
        ("w_o", np.float64),  # (rad/s)
        ("delta", np.float64),  # (A)
    ],
    align=True,
)

MEMORY = np.dtype(
    [
        ("ready", np.bool_),
        ("z_1", np.complex128),  # current at the next sample (A)
        ("z_2", np.complex128),  # what the model does not know (A/s)
    ],
    align=True,
)


def configure(cfg: np.void, mem: np.void, values: Mapping[str, Any]) -> None:
    """Take over the bandwidth."""
    own = cfg["neso_mfpcc"]
    own["w_o"] = values["neso.bandwidth"]
    own["delta"] = _DELTA * cfg["i_max"]


@kernel
def _fal(x, delta):
    size = abs(x)
    if size <= delta:
        return x
    return math.copysign(math.sqrt(delta * size), x)


@kernel
def step(cfg, mem):
    """Observe, predict sample k + 1 with the committed output, reach the reference at k + 2."""
    eso, T_s = mem.neso_mfpcc, cfg.T_s
    w_o, delta = cfg.neso_mfpcc.w_o, cfg.neso_mfpcc.delta
    h = model.predict(cfg, mem) - mem.i_dq
    if not (eso.ready and mem.contiguous and mem.kept):
        # start from what the model missed in the last increment
        eso.z_1 = mem.i_dq
        eso.z_2 = 0j
        if mem.contiguous:
            u_past = scaled(mem.u_dc, mem.past.u * mem.turn_past)
            h_past = model.natural(cfg, mem.w_m, mem.i_dq_past) + model.forced(cfg, u_past)
            eso.z_2 = scaled(1.0 / T_s, mem.i_dq - mem.i_dq_past - h_past)
        eso.ready = True
    err = eso.z_1 - mem.i_dq
    z_2 = eso.z_2
    eso.z_1 += h + scaled(T_s, z_2 - scaled(2.0 * w_o, err))
    eso.z_2 = z_2 - scaled(T_s * w_o * w_o, complex(_fal(err.real, delta), _fal(err.imag, delta)))

    unknown = scaled(T_s, eso.z_2)
    i_1 = mem.i_dq + h + unknown
    x = search.correction(cfg, mem, i_1) - model.natural(cfg, mem.w_m, i_1) - unknown
    G_1, G_2 = model.forced_vectors(cfg, mem.u_dc, mem.turn_next)
    search.choose(cfg, x, G_1, G_2, mem.next)
    mem.i_hat = i_1


@kernel
def show(cfg, mem, diag):
    """The model's gradients at this sample, the natural one with what the observer adds."""
    G_1, G_2 = model.forced_vectors(cfg, mem.u_dc, mem.turn_now)
    back = mem.turn_now.conjugate()
    natural = model.natural(cfg, mem.w_m, mem.i_dq) + scaled(cfg.T_s, mem.neso_mfpcc.z_2)
    show_gradients(diag, natural, G_1 * back, G_2 * back)
    show_nothing_learned(diag)


SCHEME = BuiltIn(
    name="neso_mfpcc",
    step=step,
    show=show,
    parameters=PARAMETERS,
    cfg=CFG,
    configure=configure,
    memory=MEMORY,
    gain=0.24,
)

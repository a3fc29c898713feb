"""Two-vector MFPCC: one active vector and the zero vector per period.

For each of the six active vectors the share of the period that comes nearest to the reference,

    d_j = x . G_j / |G_j|^2   within 0..1,

and of the six the one with the smallest remaining error (the zero vector shortens it, as in Ma et
al. 2023 in the paper's references; they sample twice per period to tell natural and forced
response apart, where this one has the two increments of the `linear` update of `mfpcc` for it, so
that it needs no second sample). The table is that of `mfpcc`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mfpcc_controller import search
from mfpcc_controller.diagnostics import show_gradients, show_shares
from mfpcc_controller.schemes.built_in import BuiltIn
from mfpcc_controller.schemes.mfpcc import MEMORY, initialise, predict, update_linear
from mfpcc_controller.vectors import scaled, set_output, square
from pwm_node.compiled import kernel
from pwm_node.parameters import Parameter

# Smallest change of the voltage, over that of the DC link, where the parameter leaves it open
_U_MIN = 50.0 / 311.0

PARAMETERS = (
    Parameter(
        "mfpcc_two_vector.u_min",
        0.0,
        "Smallest change of the voltage from which mfpcc_two_vector learns a gain; 0: 16 % of the "
        "DC link's (50 V of 311 V)",
        unit="V",
        minimum=0.0,
        maximum=1e3,
    ),
)

CFG = np.dtype([("u_min", np.float64)], align=True)  # (V)


def configure(cfg: np.void, mem: np.void, values: Mapping[str, Any]) -> None:
    """Take over the smallest voltage change."""
    u_min = values["mfpcc_two_vector.u_min"] or _U_MIN * cfg["u_dc"]
    cfg["mfpcc_two_vector"]["u_min"] = u_min


@kernel
def step(cfg, mem):
    """Update the table, predict k + 1, find vector and share for k + 2."""
    lut = mem.mfpcc_two_vector
    if not (lut.ready and mem.kept):
        initialise(cfg, mem, lut)
    if mem.contiguous:
        update_linear(mem, lut, cfg.mfpcc_two_vector.u_min)
    else:
        lut.history = False
    g = lut.g
    i_1 = predict(mem, g)
    x = search.correction(cfg, mem, i_1) - g[0]
    best, best_d, best_cost = 0, 0.0, square(x)
    for j in range(1, 7):
        G_j = g[j] - g[0]
        d = (x.real * G_j.real + x.imag * G_j.imag) / square(G_j)
        d = min(max(d, 0.0), 1.0)
        cost = square(x - scaled(d, G_j))
        if cost < best_cost:
            best, best_d, best_cost = j, d, cost
    set_output(mem.next, best, 0, best_d, 0.0)
    mem.i_hat = i_1


@kernel
def show(cfg, mem, diag):
    """The table."""
    lut = mem.mfpcc_two_vector
    back = mem.turn_now.conjugate()
    show_gradients(diag, lut.g[0], (lut.g[1] - lut.g[0]) * back, (lut.g[2] - lut.g[0]) * back)
    for j in range(7):
        diag.age[j] = mem.period - lut.updated_at[0]
    show_shares(diag, 0.0, 0.0, 0.0)


SCHEME = BuiltIn(
    name="mfpcc_two_vector",
    step=step,
    show=show,
    parameters=PARAMETERS,
    cfg=CFG,
    configure=configure,
    memory=MEMORY,
    gain=0.7,
)

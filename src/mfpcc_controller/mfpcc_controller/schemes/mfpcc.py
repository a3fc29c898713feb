"""MFPCC: the conventional model-free scheme, one vector per period (method section 7).

Seven look-up-table entries hold the whole increment of each vector in the rotor frame; all seven
costs are computed and the best vector applies for the whole period.

`linear` update (the mechanism of which the paper says that its denominator vanishes): per axis

    gain = (di(k-1) - di(k-2)) / (u(k-1) - u(k-2)),   entry_j = di(k-1) + gain (u_j - u(k-1))

and an axis whose denominator is small keeps its entries.
"""

from __future__ import annotations

import numpy as np

from mfpcc_controller import model
from mfpcc_controller.vectors import BASIC_VECTORS, mean_voltage
from pwm_node.compiled import kernel


@kernel
def _initialise(cfg, mem):
    """Entries from the controller's model, as a drive would be commissioned."""
    lut = mem.mfpcc
    g_0 = model.natural(cfg, mem.w_m, mem.i_dq)
    for j in range(7):
        lut.g[j] = g_0 + model.forced(cfg, mem.u_dc * BASIC_VECTORS[j] * mem.turn_now)
    lut.ready = True
    lut.history = False


@kernel
def _update_linear(cfg, mem):
    lut = mem.mfpcc
    di = mem.i_dq - mem.i_dq_past
    u = mean_voltage(mem.past, mem.u_dc) * mem.turn_past
    if lut.history:
        d_u = u - lut.u_prev
        d_di = di - lut.di_prev
        update_d = abs(d_u.real) >= cfg.mfpcc_u_min
        update_q = abs(d_u.imag) >= cfg.mfpcc_u_min
        gain_d = d_di.real / d_u.real if update_d else 0.0
        gain_q = d_di.imag / d_u.imag if update_q else 0.0
        for j in range(7):
            u_j = mem.u_dc * BASIC_VECTORS[j] * mem.turn_past
            g_d = di.real + gain_d * (u_j.real - u.real) if update_d else lut.g[j].real
            g_q = di.imag + gain_q * (u_j.imag - u.imag) if update_q else lut.g[j].imag
            lut.g[j] = complex(g_d, g_q)
        if update_d or update_q:
            mem.updated = np.uint8(127)
            lut.updated_at = mem.period
    lut.di_prev = di
    lut.u_prev = u
    lut.history = True


@kernel
def step(cfg, mem):
    """Update the table from the last increment, predict k + 1, try all seven for k + 2."""
    lut = mem.mfpcc
    if not lut.ready:
        _initialise(cfg, mem)
    if mem.contiguous:
        _update_linear(cfg, mem)
    else:
        lut.history = False

    if mem.now.d_b == 0.0 and (mem.now.d_a == 1.0 or mem.now.d_a == 0.0):
        i_1 = mem.i_dq + lut.g[mem.now.a if mem.now.d_a == 1.0 else 0]
    else:
        # taken over from a scheme with several vectors: weigh the entries by their shares
        i_1 = (
            mem.i_dq
            + (1.0 - mem.now.d_a - mem.now.d_b) * lut.g[0]
            + mem.now.d_a * lut.g[mem.now.a]
            + mem.now.d_b * lut.g[mem.now.b]
        )
    wish = mem.i_dq_ref - i_1
    best, best_cost = 0, np.inf
    for j in range(7):
        miss = wish - lut.g[j]
        cost = miss.real * miss.real + miss.imag * miss.imag
        if cost < best_cost:
            best, best_cost = j, cost
    mem.next.a = best
    mem.next.b = 0
    mem.next.d_a = 1.0 if best > 0 else 0.0
    mem.next.d_b = 0.0
    mem.i_hat = i_1


@kernel
def show(cfg, mem):
    """The table, split into the natural entry and the forced ones in the stationary frame."""
    lut = mem.mfpcc
    mem.g[0] = lut.g[0]
    for j in range(1, 7):
        mem.g[j] = (lut.g[j] - lut.g[0]) * mem.turn_now.conjugate()
    for j in range(7):
        mem.age[j] = mem.period - lut.updated_at

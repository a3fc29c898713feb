"""MLS-MFPCC: three vectors, a table of current gradients kept true by moving least squares.

No motor parameter is used once the table is filled. Entry 0 is the natural response, held in the
rotor frame; entries 1..6 are the forced responses, held in the stationary frame, where those of
a machine without saliency are constants (method section 3). Each period the error of the last
prediction is shared among the natural entry and the two vectors that were applied, a weighted
least-squares fit over the last N shares gives their corrections, and symmetry carries them to
all six forced entries (method sections 5 and 6).
"""

from __future__ import annotations

import math

import numpy as np

from mfpcc_controller import model, search
from mfpcc_controller.records import WINDOW_MAX
from mfpcc_controller.vectors import BASIC_VECTORS
from pwm_node.compiled import kernel

# Keeps the fit defined for a vector that was hardly applied; far below any dwell that matters.
_EPS = 1e-6


@kernel
def _initialise(cfg, mem):
    """First table: isotropic at the mean inductance of the controller's model, nothing natural."""
    lut = mem.mls
    inductance = 0.5 * (cfg.L_d + cfg.L_q)
    for j in range(7):
        lut.g[j] = cfg.T_s / inductance * mem.u_dc * BASIC_VECTORS[j]
    lut.filled = 0
    lut.pair_filled = 0
    lut.ready = True


@kernel
def _bounded(delta, g_max):
    """delta with its length limited to g_max, and whether it was."""
    size = math.hypot(delta.real, delta.imag)
    if size > g_max:
        return delta * (g_max / size), True
    return delta, False


@kernel
def _set_symmetric(g, a, g_a, g_b):
    """All six forced entries from two adjacent ones (method section 6)."""
    b = a % 6 + 1
    c = b % 6 + 1
    g_c = g_b - g_a
    g[a] = g_a
    g[b] = g_b
    g[c] = g_c
    g[c % 6 + 1] = -g_a
    g[(c + 1) % 6 + 1] = -g_b
    g[(c + 2) % 6 + 1] = -g_c


@kernel
def _learn(cfg, mem):
    """Correct the table by the error of the prediction of this sample."""
    lut, past, e = mem.mls, mem.past, mem.e
    d_a, d_b = past.d_a, past.d_b
    scale = 1.0 / (1.0 + d_a * d_a + d_b * d_b)
    mem.share[0] = scale
    mem.share[1] = d_a * d_a * scale
    mem.share[2] = d_b * d_b * scale
    size = math.hypot(e.real, e.imag)
    mem.eta = cfg.mls_eta_min + (cfg.mls_eta_max - cfg.mls_eta_min) * (
        1.0 - math.exp(-size / cfg.mls_e_0)
    )

    # the window: newest sample at `head`; a new pair starts with an empty one
    head = lut.head + 1
    if head >= cfg.mls_window:
        head = 0
    lut.head = head
    lut.filled = min(lut.filled + 1, cfg.mls_window)
    if past.a != lut.pair_a:
        lut.pair_a = past.a
        lut.pair_filled = 0
    lut.pair_filled = min(lut.pair_filled + 1, cfg.mls_window)
    e_ab = e * mem.turn_past.conjugate()
    lut.e_0[head] = scale * e
    lut.e_a[head] = mem.share[1] * e_ab
    lut.e_b[head] = mem.share[2] * e_ab
    lut.d_a[head] = d_a
    lut.d_b[head] = d_b

    # delta_j = sum beta^n d_j e_j / (eps + sum beta^n d_j^2)
    sum_0, sum_a, sum_b = 0j, 0j, 0j
    norm_0, norm_a, norm_b = _EPS, _EPS, _EPS
    weight = 1.0
    at = head
    for n in range(lut.filled):
        sum_0 += weight * lut.e_0[at]
        norm_0 += weight
        if n < lut.pair_filled:
            sum_a += (weight * lut.d_a[at]) * lut.e_a[at]
            sum_b += (weight * lut.d_b[at]) * lut.e_b[at]
            norm_a += weight * lut.d_a[at] * lut.d_a[at]
            norm_b += weight * lut.d_b[at] * lut.d_b[at]
        weight *= cfg.mls_beta
        at = at - 1 if at > 0 else cfg.mls_window - 1

    delta_0, hit_0 = _bounded(mem.eta / norm_0 * sum_0, cfg.mls_g_max)
    lut.g[0] += delta_0
    mem.bounded = hit_0
    mem.updated = np.uint8(1)
    if past.a > 0:
        delta_a, hit_a = _bounded(mem.eta / norm_a * sum_a, cfg.mls_g_max)
        delta_b, hit_b = _bounded(mem.eta / norm_b * sum_b, cfg.mls_g_max)
        mem.bounded = hit_0 or hit_a or hit_b
        _set_symmetric(lut.g, past.a, lut.g[past.a] + delta_a, lut.g[past.a % 6 + 1] + delta_b)
        mem.updated = np.uint8(127)
        lut.forced_at = mem.period
    lut.natural_at = mem.period


@kernel
def step(cfg, mem):
    """Learn from the last error, predict k + 1, reach the reference at k + 2."""
    lut = mem.mls
    if not lut.ready:
        _initialise(cfg, mem)
    elif mem.contiguous and mem.scheme_kept:
        _learn(cfg, mem)
    else:
        lut.filled = 0
        lut.pair_filled = 0

    now = mem.now
    forced = (now.d_a * lut.g[now.a] + now.d_b * lut.g[now.b]) * mem.turn_now
    i_1 = mem.i_dq + lut.g[0] + forced
    x = mem.i_dq_ref - i_1 - lut.g[0]
    for j in range(1, 4):
        mem.G[j] = lut.g[j] * mem.turn_next
        mem.G[j + 3] = -mem.G[j]
    search.choose(cfg, x, mem.G, mem.next)
    mem.i_hat = i_1


@kernel
def show(cfg, mem):
    """The table as it is."""
    lut = mem.mls
    for j in range(7):
        mem.g[j] = lut.g[j]
        mem.age[j] = mem.period - (lut.forced_at if j > 0 else lut.natural_at)

"""MLS-MFPCC as in the paper: what `mls_mfpcc` starts from, to the letter (method sections 3 to 6).

The table holds the natural response of one period `g_0` in the rotor frame and the forced ones of
V1 to V6 in the stationary frame, where those of a machine without saliency are constants:

    i(k+1) = i(k) + g_0 + (d_a g_a + d_b g_b) exp(-1j theta_mid)

*Shares.* The error `e(k) = i(k) - i_hat(k)` of the last prediction is shared out by the type of the
vectors of period k - 1 and by how long they were applied, with d_0 = 1 for the natural response:

    e_j = e d_j^2 / (1 + d_a^2 + d_b^2)

*Moving least squares.* Over a window of N samples, for each of the three the weighted fit

    delta_j = sum beta^n d_j e_j / (eps + sum beta^n d_j^2),   n = 0 .. N - 1

The window of the active vectors holds consecutive periods of one pair: it is emptied when the pair
changes. With N = 1 this is the normalised LMS update.

*Learning rate and bound.* `g_j <- g_j + sat(eta delta_j, g_max)` with `eta = eta_min + (eta_max -
eta_min) (1 - exp(-|e| / e_0))`.

*Symmetry.* With b the vector after a, `g_c = g_b - g_a` is that of the one after b, and the three
opposite ones are the negatives: all seven entries are new in every period.

*Search.* The costs of V1, V3 and V5 are ranked, dwell times that do not fit into the period are
scaled; `sector_search` and `overmodulation` are for the other schemes.

Where the paper is silent: the table starts with the mean inductance of the controller's model, and
at the first sample with a known past the natural response is what the last increment leaves, so
that a switch makes no bump.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mfpcc_controller import search
from mfpcc_controller.diagnostics import show_shares
from mfpcc_controller.schemes.built_in import BuiltIn
from mfpcc_controller.vectors import ACTIVE_LENGTH, DIRECTIONS, scaled, set_output, square
from pwm_node.compiled import kernel
from pwm_node.parameters import Parameter, Value

# Keeps the fit defined for a vector that was hardly applied; far below any dwell that matters.
_EPS = 1e-6

_WINDOW_MAX = 32

_OPPOSITE = (0, 4, 5, 6, 1, 2, 3)

# Scale of the error and the bound, over the current limit, where the parameters leave them open:
# the 0.3 A of a drive whose limit is 12 A
_BY_ITSELF = 0.025

PARAMETERS = (
    Parameter(
        "mls.window",
        5,
        "Samples in the moving-least-squares window of mls_mfpcc_paper",
        minimum=1,
        maximum=_WINDOW_MAX,
    ),
    Parameter("mls.beta", 0.8, "Forgetting factor of the window", minimum=0.0, maximum=1.0),
    Parameter("mls.eta_min", 0.05, "Learning rate at small errors", minimum=0.0, maximum=1.0),
    Parameter("mls.eta_max", 0.5, "Learning rate at large errors", minimum=0.0, maximum=1.0),
    Parameter(
        "mls.e_0",
        0.0,
        "Error at which the learning rate is 63 % of the way from small to large; 0: 2.5 % of the "
        "motor's current limit",
        unit="A",
        minimum=0.0,
        maximum=1e3,
    ),
    Parameter(
        "mls.g_max",
        0.0,
        "Largest change of a gradient in one period; 0: 2.5 % of the motor's current limit",
        unit="A",
        minimum=0.0,
        maximum=1e3,
    ),
)


def _check(values: Mapping[str, Value]) -> str | None:
    low, high = values["mls.eta_min"], values["mls.eta_max"]
    if low > high:  # type: ignore[operator]
        return f"'mls.eta_min' = {low} must not exceed 'mls.eta_max' = {high}"
    return None


CFG = np.dtype(
    [
        ("window", np.int64),
        ("beta", np.float64),
        ("oldest", np.float64),  # weight of the sample that leaves the window
        ("mean", np.float64),  # 1 / sum of the weights of a full window
        ("eta_max", np.float64),
        ("eta_span", np.float64),  # eta_max - eta_min
        ("per_e_0", np.float64),  # (1/A)
        ("g_max", np.float64),  # (A)
    ],
    align=True,
)

MEMORY = np.dtype(
    [
        ("ready", np.bool_),  # the look-up table holds something
        ("g", np.complex128, (7,)),  # the table (A per period): natural in dq, forced in ab
        ("learned_at", np.uint64),  # period of the last update
        ("begun", np.bool_),  # the natural entry is that of this run
        # weighted sums over the window, and the norms of the active vectors'
        ("sum_0", np.complex128),  # (A, dq)
        ("sum_a", np.complex128),  # (A, ab)
        ("sum_b", np.complex128),
        ("norm_a", np.float64),
        ("norm_b", np.float64),
        ("pair", np.int64),  # vector a of the pair that the window is for
        ("pair_age", np.int64),  # periods since its first sample
        # what each sample in the window gave to them
        ("head", np.int64),
        ("e_0", np.complex128, (_WINDOW_MAX,)),
        ("e_a", np.complex128, (_WINDOW_MAX,)),
        ("e_b", np.complex128, (_WINDOW_MAX,)),
        ("q_a", np.float64, (_WINDOW_MAX,)),
        ("q_b", np.float64, (_WINDOW_MAX,)),
    ],
    align=True,
)


def configure(cfg: np.void, mem: np.void, values: Mapping[str, Any]) -> None:
    """Take over the parameters; the sums of another window are forgotten."""
    own, lut = cfg["mls_mfpcc_paper"], mem["mls_mfpcc_paper"]
    window, beta = values["mls.window"], values["mls.beta"]
    if (own["window"], own["beta"]) != (window, beta):
        lut["begun"] = False
    own["window"] = window
    own["beta"] = beta
    own["oldest"] = beta**window
    own["mean"] = 1.0 / np.sum(beta ** np.arange(window))
    own["eta_max"] = values["mls.eta_max"]
    own["eta_span"] = values["mls.eta_max"] - values["mls.eta_min"]
    by_itself = _BY_ITSELF * cfg["i_max"]
    own["per_e_0"] = 1.0 / (values["mls.e_0"] or by_itself)
    own["g_max"] = values["mls.g_max"] or by_itself


@kernel
def _fill(cfg, mem):
    """First table: the mean inductance of the controller's model, nothing natural."""
    g = mem.mls_mfpcc_paper.g
    g_1 = 2.0 * cfg.T_s / (cfg.L_d + cfg.L_q) * ACTIVE_LENGTH * mem.u_dc
    g[0] = 0j
    for j in range(1, 7):
        g[j] = scaled(g_1, DIRECTIONS[j])
    mem.mls_mfpcc_paper.learned_at = mem.period
    mem.mls_mfpcc_paper.ready = True


@kernel
def _forced(g, out):
    """Forced response of one period to an output (A, ab)."""
    return scaled(out.d_a, g[out.a]) + scaled(out.d_b, g[out.b])


@kernel
def _bounded(cfg, mem, g):
    """A change of an entry, no larger than g_max."""
    limit = cfg.mls_mfpcc_paper.g_max
    size_sq = square(g)
    if size_sq <= limit * limit:
        return g
    mem.bounded = True
    return scaled(limit / math.sqrt(size_sq), g)


@kernel
def _learn(cfg, mem):
    """Correct the table by the error of the prediction of this sample."""
    own, lut, past, e = cfg.mls_mfpcc_paper, mem.mls_mfpcc_paper, mem.past, mem.e
    d_a, d_b = past.d_a, past.d_b
    q_a, q_b = d_a * d_a, d_b * d_b
    share = 1.0 / (1.0 + q_a + q_b)
    e_ab = e * mem.turn_past.conjugate()
    e_0, e_a, e_b = (
        scaled(share, e),
        scaled(d_a * q_a * share, e_ab),
        scaled(d_b * q_b * share, e_ab),
    )

    # the sums over the window go on from those of the sample before
    beta, keep = own.beta, own.beta
    if past.a != lut.pair:
        lut.pair = past.a
        lut.pair_age = -1
        keep = 0.0
    lut.pair_age += 1
    head = lut.head + 1 if lut.head + 1 < own.window else 0
    lut.head = head
    lut.sum_0 = e_0 + scaled(beta, lut.sum_0) - scaled(own.oldest, lut.e_0[head])
    lut.sum_a = e_a + scaled(keep, lut.sum_a)
    lut.sum_b = e_b + scaled(keep, lut.sum_b)
    lut.norm_a = q_a + keep * lut.norm_a
    lut.norm_b = q_b + keep * lut.norm_b
    if lut.pair_age >= own.window:
        lut.sum_a -= scaled(own.oldest, lut.e_a[head])
        lut.sum_b -= scaled(own.oldest, lut.e_b[head])
        lut.norm_a -= own.oldest * lut.q_a[head]
        lut.norm_b -= own.oldest * lut.q_b[head]
    lut.e_0[head], lut.e_a[head], lut.e_b[head] = e_0, e_a, e_b
    lut.q_a[head], lut.q_b[head] = q_a, q_b

    eta = own.eta_max - own.eta_span * math.exp(-own.per_e_0 * math.sqrt(square(e)))
    g = lut.g
    g[0] += _bounded(cfg, mem, scaled(eta * own.mean, lut.sum_0))
    mem.eta = eta
    lut.learned_at = mem.period
    a, b = past.a, past.b
    if a == 0 or b != a % 6 + 1:
        # one vector alone, or none: taken over from another scheme
        mem.updated = np.uint8(1)
        return
    g_a = g[a] + _bounded(cfg, mem, scaled(eta / (_EPS + lut.norm_a), lut.sum_a))
    g_b = g[b] + _bounded(cfg, mem, scaled(eta / (_EPS + lut.norm_b), lut.sum_b))
    g_c = g_b - g_a
    c = b % 6 + 1
    g[a], g[b], g[c] = g_a, g_b, g_c
    g[_OPPOSITE[a]], g[_OPPOSITE[b]], g[_OPPOSITE[c]] = -g_a, -g_b, -g_c
    mem.updated = np.uint8(127)


@kernel
def _empty_window(lut):
    """Forget samples that do not connect to those to come."""
    lut.pair = -1
    lut.sum_0, lut.sum_a, lut.sum_b = 0j, 0j, 0j
    lut.norm_a, lut.norm_b = 0.0, 0.0
    for n in range(lut.e_0.shape[0]):
        lut.e_0[n] = 0j


@kernel
def _begin(mem):
    """First sample with a known past: the natural entry is what the last increment leaves."""
    lut = mem.mls_mfpcc_paper
    lut.g[0] = mem.i_dq - mem.i_dq_past - _forced(lut.g, mem.past) * mem.turn_past
    lut.begun = True
    mem.updated = np.uint8(1)
    mem.eta = 1.0


@kernel
def step(cfg, mem):
    """Learn from the last error, predict k + 1, reach the reference at k + 2."""
    lut = mem.mls_mfpcc_paper
    if not lut.ready:
        _fill(cfg, mem)
        lut.begun = False
    if not (mem.contiguous and mem.kept and lut.begun):
        _empty_window(lut)
        lut.begun = False
        if mem.contiguous:
            _begin(mem)
    else:
        _learn(cfg, mem)
    g = lut.g
    i_1 = mem.i_dq + g[0] + _forced(g, mem.now) * mem.turn_now
    x = search.correction(cfg, mem, i_1) - g[0]
    a, b, d_a, d_b = search.by_ranking(x, g[1] * mem.turn_next, g[2] * mem.turn_next)
    total = d_a + d_b
    if total > 1.0:
        d_a /= total
        d_b = 1.0 - d_a
    set_output(mem.next, a, b, d_a, d_b)
    mem.i_hat = i_1


@kernel
def show(cfg, mem, diag):
    """The table as it is, and how the last error was shared out."""
    lut, past = mem.mls_mfpcc_paper, mem.past
    age = np.uint32(mem.period - lut.learned_at)
    for j in range(7):
        diag.gradient_re[j], diag.gradient_im[j] = lut.g[j].real, lut.g[j].imag
        diag.age[j] = age
    if mem.updated != 127:
        show_shares(diag, 0.0, 0.0, 0.0)
        return
    q_a, q_b = past.d_a * past.d_a, past.d_b * past.d_b
    share = 1.0 / (1.0 + q_a + q_b)
    show_shares(diag, share, q_a * share, q_b * share)


SCHEME = BuiltIn(
    name="mls_mfpcc_paper",
    step=step,
    show=show,
    parameters=PARAMETERS,
    check=_check,
    cfg=CFG,
    configure=configure,
    memory=MEMORY,
)

"""MLS-MFPCC: three vectors, a table of current gradients kept true by moving least squares.

No motor parameter is used once the table is filled. Each period the error of the last prediction
is shared among the natural entry and the two vectors that were applied (method section 5), a
weighted least-squares fit over the last shares gives their corrections, and symmetry carries them
to all six forced entries (section 6). Beyond the paper:

*The table as a map.* Six forced entries with the paper's symmetry are a linear map from voltage to
gradient. The memory holds it as such, in two complex numbers: the answers to 1 V on the d and on
the q axis, in the rotor frame. There the map of a salient machine is constant too (in the
stationary frame, where the entries of a machine without saliency are constants, a salient one's
turn with the rotor); per volt it does not mind a DC link that sags.

*Learning from the moving part of the voltage.* An error that stays can be the natural entry's or
the forced ones', and it does not matter whose. An error that moves with the voltage is the map's
alone. So a second, slow correction fits the map to the deviation v of the voltage from its mean:

    m_d <- m_d + k_d e,  m_q <- m_q + k_q e,    k = mu v / (mean |v|^2 + |v|^2)

with the natural entry moved against it, so that the prediction at the mean voltage stays. What the
noise of the sensors makes the voltage move is enough to learn from: it finds both inductances of a
salient machine within some 20 ms, at any speed, and a deadbeat loop with the right gains is
quieter. The shares of section 5 alone cannot: they go with the square of the dwell times, which are
small at low speed.

*The learning rate* follows the square of the error, `eta_max - (eta_max - eta_min) e_0^2 / (e_0^2 +
|e|^2)`: of the paper's words (smooth at small errors, rapid at large ones) as true a reading as an
exponential, and twice as quiet since noise hardly moves it. The second correction fades with the
same factor: a large error is not about the map.

*The bound* acts on the error as it comes in, so that no correction exceeds g_max and no outlier
stays in the window.

*Recursive sums.* The weighted sums over the window are carried on from period to period; a limited
window takes out the sample that leaves it. Without a limit the forgetting factor alone ends it.
"""

from __future__ import annotations

import math

import numpy as np

from mfpcc_controller import search
from mfpcc_controller.diagnostics import NEVER, show_gradients, show_shares
from mfpcc_controller.vectors import (
    ACTIVE_LENGTH,
    DIRECTIONS,
    SIN_60,
    next_vector,
    scaled,
    square,
)
from pwm_node.compiled import kernel

# Keeps the fit defined for a vector that was hardly applied; far below any dwell that matters.
_EPS = 1e-6

# Mean square voltage deviation below which little is learned from it, over the square of u_dc.
# Without noise the voltage hardly moves, and what then moves with it (a change of speed) is not
# its answer: the map drifted away there, until the current burst out and taught it again.
_V_SQ_MIN = 1e-4

# Square of an error (A^2) that no drive can make; written so that NaN is above it too.
_ABSURD = 1e8


@kernel
def _response(lut, u_dq):
    """Forced response of one period (A, rotor frame) to the voltage u_dq (V, rotor frame)."""
    return scaled(u_dq.real, lut.m_d) + scaled(u_dq.imag, lut.m_q)


@kernel
def forget(lut):
    """Empty the window, since what is in it does not belong to the samples to come."""
    lut.pair = -1
    lut.sum_0 = 0j
    for n in range(lut.e_0.shape[0]):
        lut.e_0[n] = 0j
    lut.u_known = False


@kernel
def _initialise(cfg, lut):
    """First table: isotropic at the mean inductance of the controller's model, nothing natural."""
    gain = 2.0 * cfg.T_s / (cfg.L_d + cfg.L_q)
    lut.g_0 = 0j
    lut.m_d = complex(gain, 0.0)
    lut.m_q = complex(0.0, gain)
    lut.u_var = 0.0
    lut.learned = False
    lut.ready = True
    forget(lut)


@kernel
def _leave_window(cfg, lut, e_0, e_a, e_b, q_a, q_b):
    """Take the sample that is N periods old out of the sums, and keep the new one."""
    head = lut.head + 1
    if head >= cfg.mls_window:
        head = 0
    lut.head = head
    oldest = cfg.mls_oldest
    lut.sum_0 -= scaled(oldest, lut.e_0[head])
    if lut.pair_age >= cfg.mls_window:
        lut.sum_a -= scaled(oldest, lut.e_a[head])
        lut.sum_b -= scaled(oldest, lut.e_b[head])
        lut.norm_a -= oldest * lut.q_a[head]
        lut.norm_b -= oldest * lut.q_b[head]
    lut.e_0[head], lut.e_a[head], lut.e_b[head] = e_0, e_a, e_b
    lut.q_a[head], lut.q_b[head] = q_a, q_b


@kernel
def _learn(cfg, mem):
    """Correct the table by the error of the prediction of this sample."""
    lut, past, e = mem.mls, mem.past, mem.e
    e_sq = square(e)
    small = cfg.mls_e_0_sq / (cfg.mls_e_0_sq + e_sq)
    eta = cfg.mls_eta_max - cfg.mls_eta_span * small
    if e_sq > cfg.mls_e_max_sq:
        e = scaled(math.sqrt(cfg.mls_e_max_sq / e_sq), e)
        mem.bounded = True

    # shares by type and duration, e_j = e d_j^2 / (1 + d_a^2 + d_b^2), and their weighted sums
    # over the window: sum beta^n d_j e_j, and of the active vectors sum beta^n d_j^2
    d_a, d_b = past.d_a, past.d_b
    q_a, q_b = d_a * d_a, d_b * d_b
    share = 1.0 / (1.0 + q_a + q_b)
    e_0, e_a, e_b = scaled(share, e), scaled(d_a * q_a * share, e), scaled(d_b * q_b * share, e)
    beta = cfg.mls_beta
    keep = beta
    lut.pair_age += 1
    if past.a != lut.pair:
        # a new pair starts with an empty window
        lut.pair = past.a
        lut.pair_age = 0
        keep = 0.0
    lut.sum_0 = e_0 + scaled(beta, lut.sum_0)
    lut.sum_a = e_a + scaled(keep, lut.sum_a)
    lut.sum_b = e_b + scaled(keep, lut.sum_b)
    lut.norm_a = q_a + keep * lut.norm_a
    lut.norm_b = q_b + keep * lut.norm_b
    if cfg.mls_window > 0:
        _leave_window(cfg, lut, e_0, e_a, e_b, q_a, q_b)
    if mem.u_dc != lut.u_dc:
        lut.u_dc = mem.u_dc
        lut.per_volt = 1.0 / (SIN_60 * ACTIVE_LENGTH * mem.u_dc)
    step = eta * lut.per_volt
    step_a = scaled(step / (_EPS + lut.norm_a), lut.sum_a)
    step_b = scaled(step / (_EPS + lut.norm_b), lut.sum_b)

    # the moving part of the voltage
    mean = lut.u_mean
    v = lut.u_dq - mean
    v_sq = square(v)
    floor = _V_SQ_MIN * mem.u_dc * mem.u_dc
    k = scaled(cfg.mls_mu / (floor + lut.u_var + v_sq), v)
    lut.u_var += cfg.mls_gamma * (v_sq - lut.u_var)
    lut.u_mean = mean + scaled(cfg.mls_gamma, v)
    e = scaled(small, e)

    # both into the map: with unit vectors a and b, 60 degrees apart, a voltage u is
    # (u x b) a + (a x u) b over sin 60 degrees
    a = DIRECTIONS[past.a] * mem.turn_past
    b = next_vector(a)
    lut.m_d += scaled(b.imag, step_a) - scaled(a.imag, step_b) + scaled(k.real, e)
    lut.m_q += scaled(a.real, step_b) - scaled(b.real, step_a) + scaled(k.imag, e)
    lut.g_0 += scaled(eta * cfg.mls_mean, lut.sum_0)
    lut.g_0 -= scaled(k.real * mean.real + k.imag * mean.imag, e)
    lut.learned_at = mem.period
    lut.learned = True
    mem.eta = eta
    mem.updated = np.uint8(127)


@kernel
def step(cfg, mem):
    """Learn from the last error, predict k + 1, reach the reference at k + 2."""
    lut = mem.mls
    if not lut.ready:
        _initialise(cfg, lut)
    elif mem.contiguous and mem.kept and square(mem.e) < _ABSURD:
        _learn(cfg, mem)
    else:
        forget(lut)

    u_dq = scaled(mem.u_dc, mem.now.u * mem.turn_now)
    lut.u_dq = u_dq
    if not lut.u_known:
        lut.u_mean = u_dq
        lut.u_known = True
    i_1 = mem.i_dq + lut.g_0 + _response(lut, u_dq)
    x = mem.i_dq_ref - i_1 - lut.g_0
    u_1 = scaled(ACTIVE_LENGTH * mem.u_dc, mem.turn_next)
    search.choose(cfg, x, _response(lut, u_1), _response(lut, next_vector(u_1)), mem.next)
    mem.i_hat = i_1


@kernel
def show(cfg, mem, diag):
    """The table as it is, and how the last error was shared out."""
    lut, past = mem.mls, mem.past
    u_1 = scaled(ACTIVE_LENGTH * mem.u_dc, mem.turn_now)
    back = mem.turn_now.conjugate()
    g_1 = _response(lut, u_1) * back
    g_2 = _response(lut, next_vector(u_1)) * back
    show_gradients(diag, lut.g_0, g_1, g_2)
    age = np.uint32(mem.period - lut.learned_at) if lut.learned else NEVER
    for j in range(7):
        diag.age[j] = age
    if mem.updated == 0:
        show_shares(diag, 0.0, 0.0, 0.0)
        return
    q_a, q_b = past.d_a * past.d_a, past.d_b * past.d_b
    share = 1.0 / (1.0 + q_a + q_b)
    show_shares(diag, share, q_a * share, q_b * share)

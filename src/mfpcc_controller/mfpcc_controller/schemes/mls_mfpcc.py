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
alone. So a second, slow correction fits the map to the deviations v of the voltage and e' of the
error from their means over some periods:

    m_d <- m_d + k_d e',  m_q <- m_q + k_q e',    k_d = mu v_d / (mean v_d^2 + v_d^2), k_q likewise

with the natural entry moved against it, so that the prediction at the mean voltage stays. What the
noise of the sensors makes the voltage move is enough to learn from: it finds both inductances of a
salient machine within some 50 ms, at any speed, and a deadbeat loop with the right gains is
quieter. The shares of section 5 alone cannot: they go with the square of the dwell times, which are
small at low speed. While errors are large, mu is ten times as large.

*The turn of the frame.* Of the natural response, -1j omega T_s i is due to the turn of the rotor
frame alone, and known without a parameter of the motor. The natural entry holds the rest, which
changes less when the current steps.

*The encoder's steps* turn the measured current to and fro, and the loop answers to that with
voltage. Where the currents are quiet, this is most of what moves, and taken for an answer to the
voltage it would bend the map by half. What the rotor observer cannot follow is known for a step of
the encoder and is taken out of the error before anything is learned from it.

*The learning rate* follows the square of the error, `eta_max - (eta_max - eta_min) e_0^2 / (e_0^2 +
|e|^2)`: of the paper's words (smooth at small errors, rapid at large ones) as true a reading as an
exponential, and quieter, since noise hardly moves it.

*The bound* acts on the error as it comes in, so that no correction exceeds g_max and no outlier
stays in the window.

*Recursive sums.* The weighted sums over the window are carried on from period to period; a limited
window takes out the sample that leaves it. Without a limit the forgetting factor alone ends it.

*A start without a bump.* At the first sample with a known past, the natural entry is what the last
increment of the current leaves. An empty table is filled by a few short pulses first.

*The inverter's legs*, an option: see `leg_drop`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mfpcc_controller import leg_drop, search
from mfpcc_controller.diagnostics import show_gradients, show_shares
from mfpcc_controller.schemes.built_in import BuiltIn
from mfpcc_controller.vectors import (
    ACTIVE_LENGTH,
    DIRECTIONS,
    SIN_60,
    cross,
    next_vector,
    scaled,
    set_output,
    square,
)
from pwm_node.compiled import kernel
from pwm_node.parameters import Parameter, Value

# Keeps the fit defined for a vector that was hardly applied; far below any dwell that matters.
_EPS = 1e-6

# Mean square voltage deviation below which little is learned from it, over the square of u_dc: 1 V
# of 311 V. Without noise the voltage hardly moves, and what then moves with it (a change of speed)
# is not its answer.
_V_SQ_MIN = 1e-5


# Self-commissioning: dwell of the first and the longest pulses, and the answer that is enough,
# over the current limit.
_FIRST_PULSE = 0.01
_LAST_PULSE = 0.5
_ANSWER = 0.1

# Longest limited moving-least-squares window
_WINDOW_MAX = 32

# A fresh map, and one whose errors stay large, is learned faster by this factor; it comes to be
# learned faster, and slower again, in this time (s).
_HASTE = 10.0
_HASTE_TIME = 0.02

# Error at which the learning rate is halfway, and largest change of a gradient in one period, over
# the current limit, where the parameters leave them open
_BY_ITSELF = 0.025

PARAMETERS = (
    Parameter(
        "mls.start",
        "model",
        "What the table of mls_mfpcc holds at first: the model's mean inductance, or nothing, "
        "which is then measured by a few short pulses",
        choices=("model", "empty"),
    ),
    Parameter(
        "mls.window",
        0,
        "Samples in the moving-least-squares window; 0: all, the forgetting factor alone limits it",
        minimum=0,
        maximum=_WINDOW_MAX,
    ),
    Parameter("mls.beta", 0.8, "Forgetting factor of the window", minimum=0.0, maximum=1.0),
    Parameter("mls.eta_min", 0.02, "Learning rate at small errors", minimum=0.0, maximum=1.0),
    Parameter("mls.eta_max", 0.5, "Learning rate at large errors", minimum=0.0, maximum=1.0),
    Parameter(
        "mls.e_0",
        0.0,
        "Error at which the learning rate is halfway from small to large; 0: 2.5 % of the "
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
    Parameter(
        "mls.map_rate",
        0.005,
        "Rate at which the forced entries follow what the moving part of the voltage tells; "
        "0: the paper's update alone",
        minimum=0.0,
        maximum=1.0,
    ),
    Parameter(
        "mls.map_memory",
        2e-3,
        "Memory of the voltage's mean, from which its moving part is counted",
        unit="s",
        minimum=1e-3,
        maximum=10.0,
    ),
    Parameter(
        "mls.compensate_inverter",
        False,
        "mls_mfpcc learns what dead time and on-state voltages take from the inverter's legs, "
        "and adds it",
    ),
)


def _check(values: Mapping[str, Value]) -> str | None:
    low, high = values["mls.eta_min"], values["mls.eta_max"]
    if low > high:  # type: ignore[operator]
        return f"'mls.eta_min' = {low} must not exceed 'mls.eta_max' = {high}"
    if values["mls.beta"] == 1.0 and values["mls.window"] == 0:
        return "'mls.window' = 0 (not limited) needs 'mls.beta' below 1: something has to end it"
    return None


CFG = np.dtype(
    [
        ("empty", np.bool_),  # start with nothing in the table
        ("window", np.int64),  # 0: not limited
        ("beta", np.float64),
        ("oldest", np.float64),  # weight of the sample that leaves the window
        ("mean", np.float64),  # 1 / sum of all weights
        ("eta_max", np.float64),
        ("eta_span", np.float64),  # eta_max - eta_min
        ("e_0_sq", np.float64),  # (A^2)
        ("e_max_sq", np.float64),  # (g_max / eta_max)^2 (A^2)
        ("mu", np.float64),  # rate of learning the map
        ("mu_most", np.float64),  # while errors are large
        ("mu_span", np.float64),  # their difference
        ("gamma", np.float64),
        ("settle", np.float64),  # share of a period in the time in which mu comes and goes
        ("inverter", np.bool_),  # whether to compensate what the inverter's legs lose
    ],
    align=True,
)

MEMORY = np.dtype(
    [
        ("ready", np.bool_),  # the look-up table holds something
        # the table: the natural entry (A per period, dq), and the forced entries as a linear map,
        # which they are by their symmetry: answer to 1 V on the d and on the q axis (A/V, dq)
        ("g_0", np.complex128),
        ("m_d", np.complex128),
        ("m_q", np.complex128),
        ("learned_at", np.uint64),  # period of the last update
        # weighted sums over the window, and the norms of the active vectors' (dq)
        ("sum_0", np.complex128),
        ("sum_a", np.complex128),
        ("sum_b", np.complex128),
        ("norm_a", np.float64),
        ("norm_b", np.float64),
        ("pair", np.int64),  # vector a of the pair that the window is for
        ("pair_age", np.int64),  # periods since its first sample
        # what is in a limited window
        ("head", np.int64),
        ("e_0", np.complex128, (_WINDOW_MAX,)),
        ("e_a", np.complex128, (_WINDOW_MAX,)),
        ("e_b", np.complex128, (_WINDOW_MAX,)),
        ("q_a", np.float64, (_WINDOW_MAX,)),
        ("q_b", np.float64, (_WINDOW_MAX,)),
        # voltage of the period that the next error is about, its mean and mean square deviation
        ("u_dq", np.complex128),  # (V)
        ("u_mean", np.complex128),
        ("var_d", np.float64),  # (V^2)
        ("var_q", np.float64),
        ("e_mean", np.complex128),  # mean of the error (A)
        ("rate", np.float64),  # of learning from the moving part of the voltage
        ("begun", np.bool_),  # the natural entry is that of this run
        # 1 / (sin(60 degrees) |u_j|), and the least variance, for the u_dc they were computed for
        ("per_volt", np.float64),
        ("floor", np.float64),
        ("u_dc", np.float64),
        ("drop", leg_drop.MEMORY),
        # self-commissioning
        ("stage", np.int64),
        ("dwell", np.float64),
        ("du", np.complex128, (3,)),  # voltages of the pulses (V, dq)
        ("di", np.complex128, (3,)),  # and what the current did (A)
    ],
    align=True,
)


def configure(cfg: np.void, mem: np.void, values: Mapping[str, Any]) -> None:
    """Take over the parameters; the sums of another window are forgotten."""
    own, lut, T_s = cfg["mls_mfpcc"], mem["mls_mfpcc"], cfg["T_s"]
    window, beta = values["mls.window"], values["mls.beta"]
    if (own["window"], own["beta"]) != (window, beta):
        lut["pair"] = -1
        for name in ("sum_0", "sum_a", "sum_b", "norm_a", "norm_b", "e_0"):
            lut[name] = 0.0
    own["empty"] = values["mls.start"] == "empty"
    own["window"] = window
    own["beta"] = beta
    own["oldest"] = beta**window if window else 0.0
    own["mean"] = 1.0 / (window if beta == 1.0 else (1.0 - own["oldest"]) / (1.0 - beta))
    own["eta_max"] = values["mls.eta_max"]
    own["eta_span"] = values["mls.eta_max"] - values["mls.eta_min"]
    by_itself = _BY_ITSELF * cfg["i_max"]
    own["e_0_sq"] = (values["mls.e_0"] or by_itself) ** 2
    g_max = values["mls.g_max"] or by_itself
    own["e_max_sq"] = (g_max / max(values["mls.eta_max"], 1e-9)) ** 2
    own["inverter"] = values["mls.compensate_inverter"]
    own["mu"] = values["mls.map_rate"]
    own["mu_most"] = _HASTE * values["mls.map_rate"]
    own["mu_span"] = own["mu_most"] - values["mls.map_rate"]
    own["settle"] = T_s / _HASTE_TIME
    own["gamma"] = T_s / values["mls.map_memory"]


@kernel
def _response(lut, u_dq):
    """Forced response of one period (A, rotor frame) to the voltage u_dq (V, rotor frame)."""
    return scaled(u_dq.real, lut.m_d) + scaled(u_dq.imag, lut.m_q)


@kernel
def _forget(lut):
    """Empty the window, since what is in it does not belong to the samples to come."""
    lut.pair = -1
    lut.sum_0 = 0j
    for n in range(lut.e_0.shape[0]):
        lut.e_0[n] = 0j
    lut.begun = False
    lut.stage = 0


@kernel
def _fill(mem, m_d, m_q):
    """A first table."""
    lut = mem.mls_mfpcc
    lut.g_0, lut.m_d, lut.m_q = 0j, m_d, m_q
    lut.learned_at = mem.period
    # also what a table that failed has left
    lut.sum_a, lut.sum_b = 0j, 0j
    lut.norm_a, lut.norm_b = 0.0, 0.0
    lut.var_d, lut.var_q = 0.0, 0.0
    lut.drop.volts, lut.drop.mean, lut.drop.variance = 0.0, 0j, 0.0
    lut.ready = True
    _forget(lut)


@kernel
def _fill_from_model(cfg, mem):
    """First table: isotropic at the mean inductance of the controller's model, nothing natural."""
    gain = 2.0 * cfg.T_s / (cfg.L_d + cfg.L_q)
    _fill(mem, complex(gain, 0.0), complex(0.0, gain))
    mem.mls_mfpcc.rate = cfg.mls_mfpcc.mu_most


@kernel
def _commission(cfg, mem):
    """Fill an empty table by measurement, with nothing known of the motor but its current limit.

    Pulses of V1, V3 and V5, together no voltage, and what the current did in these three periods
    are three equations `di = g_0 + m_d u_d + m_q u_q` for the three unknowns, at any speed. The
    first pulses are so short that no motor minds, then longer until the answer stands out.
    """
    lut = mem.mls_mfpcc
    stage = lut.stage
    if stage == 0 or not mem.contiguous:
        stage = 0
        lut.dwell = max(lut.dwell, _FIRST_PULSE)
    elif stage >= 2:
        lut.du[stage - 2] = scaled(mem.u_dc, mem.past.u * mem.turn_past)
        lut.di[stage - 2] = mem.i_dq - mem.i_dq_past
    mem.i_hat = mem.i_dq
    set_output(mem.next, 0, 0, 0.0, 0.0)
    if stage < 3:
        set_output(mem.next, 2 * stage + 1, 0, lut.dwell, 0.0)
    lut.stage = stage + 1
    if stage < 4:
        return
    lut.stage = 0
    u_1, u_2 = lut.du[1] - lut.du[0], lut.du[2] - lut.du[0]
    i_1, i_2 = lut.di[1] - lut.di[0], lut.di[2] - lut.di[0]
    size = math.sqrt(square(i_1) + square(i_2))
    wanted = _ANSWER * cfg.i_max
    if size < wanted and lut.dwell < _LAST_PULSE and square(mem.i_dq) < 0.25 * cfg.i_max**2:
        # at most eight times longer: short pulses answer with noise only
        lut.dwell = min(_LAST_PULSE, lut.dwell * min(8.0, 1.5 * wanted / size))
        return
    inverse = 1.0 / cross(u_1, u_2)
    m_d = scaled(inverse * u_2.imag, i_1) - scaled(inverse * u_1.imag, i_2)
    m_q = scaled(inverse * u_1.real, i_2) - scaled(inverse * u_2.real, i_1)
    _fill(mem, m_d, m_q)
    lut.rate = cfg.mls_mfpcc.mu


@kernel
def _leave_window(own, lut, e_0, e_a, e_b, q_a, q_b):
    """Take the sample that is N periods old out of the sums, and keep the new one."""
    head = lut.head + 1
    if head >= own.window:
        head = 0
    lut.head = head
    lut.pair_age += 1
    oldest = own.oldest
    lut.sum_0 -= scaled(oldest, lut.e_0[head])
    if lut.pair_age >= own.window:
        lut.sum_a -= scaled(oldest, lut.e_a[head])
        lut.sum_b -= scaled(oldest, lut.e_b[head])
        lut.norm_a -= oldest * lut.q_a[head]
        lut.norm_b -= oldest * lut.q_b[head]
    lut.e_0[head], lut.e_a[head], lut.e_b[head] = e_0, e_a, e_b
    lut.q_a[head], lut.q_b[head] = q_a, q_b


@kernel
def _learn(cfg, mem):
    """Correct the table by the error of the prediction of this sample."""
    own, lut = cfg.mls_mfpcc, mem.mls_mfpcc
    past, i_dq = mem.past, mem.i_dq
    # without what the encoder's steps have turned the current by: that is no error of the table,
    # but the loop answers to it, so it would pass for one that moves with the voltage
    e = mem.e + complex(-mem.jitter * i_dq.imag, mem.jitter * i_dq.real)
    e_sq = square(e)
    small = own.e_0_sq / (own.e_0_sq + e_sq)
    eta = own.eta_max - own.eta_span * small
    e_map = e
    if e_sq > own.e_max_sq:
        e = scaled(math.sqrt(own.e_max_sq / e_sq), e)
        mem.bounded = True
        if lut.rate < 2.0 * own.mu:
            # a map that is wrong by far makes errors as large; otherwise they are about something
            # else
            e_map = e

    # shares by type and duration, e_j = e d_j^2 / (1 + d_a^2 + d_b^2), and their weighted sums
    # over the window: sum beta^n d_j e_j, and of the active vectors sum beta^n d_j^2
    d_a, d_b = past.d_a, past.d_b
    q_a, q_b = d_a * d_a, d_b * d_b
    share = 1.0 / (1.0 + q_a + q_b)
    e_0, e_a, e_b = scaled(share, e), scaled(d_a * q_a * share, e), scaled(d_b * q_b * share, e)
    beta = own.beta
    keep = beta
    if past.a != lut.pair:
        # a new pair starts with an empty window
        lut.pair = past.a
        lut.pair_age = -1
        keep = 0.0
    lut.sum_0 = e_0 + scaled(beta, lut.sum_0)
    lut.sum_a = e_a + scaled(keep, lut.sum_a)
    lut.sum_b = e_b + scaled(keep, lut.sum_b)
    lut.norm_a = q_a + keep * lut.norm_a
    lut.norm_b = q_b + keep * lut.norm_b
    if own.window > 0:
        _leave_window(own, lut, e_0, e_a, e_b, q_a, q_b)
    if mem.u_dc != lut.u_dc:
        lut.u_dc = mem.u_dc
        lut.per_volt = 1.0 / (SIN_60 * ACTIVE_LENGTH * mem.u_dc)
        lut.floor = _V_SQ_MIN * mem.u_dc * mem.u_dc
    fit_a = scaled(lut.per_volt / (_EPS + lut.norm_a), lut.sum_a)
    fit_b = scaled(lut.per_volt / (_EPS + lut.norm_b), lut.sum_b)

    # the moving part of the voltage
    mean = lut.u_mean
    v = lut.u_dq - mean
    d_sq, q_sq = v.real * v.real, v.imag * v.imag
    all_d, all_q = lut.floor + lut.var_d + d_sq, lut.floor + lut.var_q + q_sq
    rate = lut.rate / (all_d * all_q)
    k = complex(rate * all_q * v.real, rate * all_d * v.imag)
    lut.rate += own.settle * (own.mu_most - own.mu_span * small - lut.rate)
    lut.var_d += own.gamma * (d_sq - lut.var_d)
    lut.var_q += own.gamma * (q_sq - lut.var_q)
    lut.u_mean = mean + scaled(own.gamma, v)
    e_map -= lut.e_mean
    lut.e_mean += scaled(own.gamma, e_map)

    # both into the map: with unit vectors a and b, 60 degrees apart, a voltage u is
    # (u x b) a + (a x u) b over sin 60 degrees
    a = DIRECTIONS[past.a] * mem.turn_past
    b = next_vector(a)
    fit_d = scaled(b.imag, fit_a) - scaled(a.imag, fit_b)
    fit_q = scaled(a.real, fit_b) - scaled(b.real, fit_a)
    lut.m_d += scaled(eta, fit_d) + scaled(k.real, e_map)
    lut.m_q += scaled(eta, fit_q) + scaled(k.imag, e_map)
    pivot = scaled(k.real * mean.real + k.imag * mean.imag, e_map)
    lut.g_0 += scaled(eta * own.mean, lut.sum_0) - pivot
    lut.learned_at = mem.period
    mem.eta = eta
    mem.updated = np.uint8(127)


@kernel
def _turned(turn, i_dq):
    """Natural response (A) to the turn of the frame alone, known with no motor parameter."""
    return complex(turn * i_dq.imag, -turn * i_dq.real)


@kernel
def _begin(cfg, mem):
    """First sample with a known past: the natural entry is what the last increment leaves."""
    lut = mem.mls_mfpcc
    u_past = scaled(mem.u_dc, mem.past.u * mem.turn_past)
    known = _response(lut, u_past) + _turned(cfg.T_s * mem.w_m, mem.i_dq_past)
    lut.g_0 = mem.i_dq - mem.i_dq_past - known
    lut.u_mean = u_past
    lut.e_mean = 0j
    lut.begun = True
    mem.updated = np.uint8(1)
    mem.eta = 1.0


@kernel
def _lost(cfg, lut, i_dq, turn):
    """Response (A) to 1 V lost in each leg, with the current i_dq in the middle of a period."""
    s = leg_drop.signs(cfg, i_dq * turn.conjugate())
    return -_response(lut, s * turn)


@kernel
def step(cfg, mem):
    """Learn from the last error, predict k + 1, reach the reference at k + 2."""
    own, lut = cfg.mls_mfpcc, mem.mls_mfpcc
    if not lut.ready:
        if own.empty:
            _commission(cfg, mem)
        else:
            _fill_from_model(cfg, mem)
        if not lut.ready:
            return
    if not (mem.contiguous and mem.kept and lut.begun):
        _forget(lut)
        if mem.contiguous:
            _begin(cfg, mem)
    else:
        if own.inverter:
            leg_drop.learn(lut.drop, mem.e - lut.e_mean, mem.u_dc, own.gamma)
        _learn(cfg, mem)

    u_dq = scaled(mem.u_dc, mem.now.u * mem.turn_now)
    lut.u_dq = u_dq
    turn = cfg.T_s * mem.w_m
    i_1 = mem.i_dq + lut.g_0 + _turned(turn, mem.i_dq) + _response(lut, u_dq)
    if own.inverter:
        lut.drop.effect = _lost(cfg, lut, mem.i_dq, mem.turn_now)
        i_1 += scaled(lut.drop.volts, lut.drop.effect)
    x = mem.i_dq_ref - i_1 - lut.g_0 - _turned(turn, i_1)
    if own.inverter:
        x -= scaled(lut.drop.volts, _lost(cfg, lut, i_1, mem.turn_next))
    u_1 = scaled(ACTIVE_LENGTH * mem.u_dc, mem.turn_next)
    search.choose(cfg, x, _response(lut, u_1), _response(lut, next_vector(u_1)), mem.next)
    mem.i_hat = i_1


@kernel
def show(cfg, mem, diag):
    """The table as it is, and how the last error was shared out."""
    lut, past = mem.mls_mfpcc, mem.past
    u_1 = scaled(ACTIVE_LENGTH * mem.u_dc, mem.turn_now)
    back = mem.turn_now.conjugate()
    g_1 = _response(lut, u_1) * back
    g_2 = _response(lut, next_vector(u_1)) * back
    show_gradients(diag, lut.g_0 + _turned(cfg.T_s * mem.w_m, mem.i_dq), g_1, g_2)
    age = np.uint32(mem.period - lut.learned_at)
    for j in range(7):
        diag.age[j] = age
    if mem.updated != 127:
        show_shares(diag, 0.0, 0.0, 0.0)
        return
    q_a, q_b = past.d_a * past.d_a, past.d_b * past.d_b
    share = 1.0 / (1.0 + q_a + q_b)
    show_shares(diag, share, q_a * share, q_b * share)


SCHEME = BuiltIn(
    name="mls_mfpcc",
    step=step,
    show=show,
    parameters=PARAMETERS,
    check=_check,
    cfg=CFG,
    configure=configure,
    memory=MEMORY,
)

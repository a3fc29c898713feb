"""MLS-MFPCC: three vectors, a table of current gradients kept true by moving least squares.

What moves the current in one period is fitted by weighted least squares to the recent past, with no
parameter of the motor but a first guess of its inductance. In the rotor frame, with real
coefficients,

    i(k+1) - i(k) = B_0 v(k) + B_1 v(k-1)
                    + A i_s(k) + E w + c + D s(i_s) + w (C cos 6 theta + S sin 6 theta)
    v = u - w T_s J B^-1 i

u is the mean voltage of a period in the rotor frame of its middle, theta is taken there too, J
turns by 90 degrees, and B = B_0 + B_1. The seven entries of the table are B's answers to the seven
vectors, and the natural one is all the rest. (The paper's symmetric entries *are* such a linear
map; here it is per volt, so that a DC link that sags does not touch it, and in the rotor frame,
where that of a salient machine is constant too.)

*Two taps.* What the current sensor delays, by its bandwidth or because it samples early, shows one
period later. With B_0 alone the map would be learned too small, down to half, which is the edge of
a deadbeat loop's stability.

*The turn of the frame.* The flux, T_s B^-1 i, turns against the rotor frame by w T_s. So what it
takes of the voltage is known from the map itself, saliency included; v is what is left. It is v
that is the regressor, and not u: both parts are B times something, and an error of B shows by their
sum. (With u, a d gain that is too small takes the cross-coupling for smaller than it is, and what
u_d answers to that makes it smaller still: to zero, in fast run-ups of a salient machine.)

*What is fitted, and to what.* The increment is that of the *measured* currents. Its noise is
n(k+1) - n(k), and the voltages of the periods k and k - 1 were decided before n(k) was seen: they
do not contain it. (Fitted to the error e of the prediction instead, whose current is filtered, the
map comes out at 1.5 times the truth: that error contains the same old noise as the voltage which
answered it.) With the filter below, the error to learn from is

    e'(k+1) = e(k+1) - (1 - l) e(k)

less what the encoder's steps have turned the current by, which the rotor observer cannot follow.

*i_s* is the reference that the current has by now, and the predicted current where it is off by
more than noise explains. The deadbeat voltage is B^-1 (i_ref - i), so that noise moves current and
voltage as one; whatever goes with the current would be mistaken for an answer to the voltage.

*Legs.* s is the space vector of the signs of the phase currents: dead time and on-state voltages
take from each leg a voltage with the sign of its current. *EMF.* Its 5th and 7th harmonics are the
6th in the rotor frame.

*Memory by directions.* The fit is recursive, with a covariance P that says how well each direction
is known (`least_squares`): where nothing moves, nothing is learned, and two causes that cannot be
told apart stay as they were between themselves. All the while P is drawn a little towards the first
guess's. The constant c takes what no regressor explains; it follows with a fixed share of each
error, whatever the noise is. r, the mean square of e', counts every error by at most 25 times its
expectation; of an error that was cut P takes the same share less, since it told less.

*Quiet drives.* r is never taken for less than a least value. What is left in a drive without noise
is slow, coherent and not of this model (the speed estimate's delay, a second-order term); over
thousands of samples it would bend the map in directions that hardly move. So the less noise there
is below that value, the faster the constant follows, and takes what is slow.

*Errors with memory*, one like the other, are no noise either, but what no regressor tells: a speed
that changes faster than the rotor observer follows (a light rotor, a load step). The observer's l
below tells them. There the constant follows faster, too; else the map and the legs would take it,
and with the next change of sign of the current answer for it.

*The observer.* Control starts from `i_f = i_hat + l e`. A prediction that is right leaves errors
without memory; positive correlation of one error and the next says that l is too small, negative
that it is too large. So l is moved by e(k) e(k-1). An error beyond what noise explains is followed
at once (l = 1).

*Control.* With N the natural response but for the turn, u_0(i) = -B^-1 N(i) + w T_s J B^-1 i holds
the current i. From the predicted sample, the current that comes when what is under way has arrived
is `i~ = i_hat(k+1) + B_1 (u(k) - u_0(i_hat))`; the next voltage brings that to the reference:
`u(k+1) = u_0(i~) + B^-1 (i_ref - i~)`. The loop has the whole gain in any case. Where B_0 is larger
than B, nothing comes late: a current that decays within the period (a short L / R) leaves a B_1
against B_0, and `u(k+1) = u_0(i~) + B_0^-1 (i_ref - i~)` reaches the reference.

*Start.* The first guess of B is the model's mean inductance, or (`mls.start: empty`) what moves the
current by its limit in one period: the largest of any motor, so that the first moves are small. The
guess may be wrong by ten; the first periods, mostly of zero voltage, tell the natural response, and
the moves that follow the map. After a switch the constant takes the last increment.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mfpcc_controller import least_squares, search
from mfpcc_controller.diagnostics import show_gradients, show_shares
from mfpcc_controller.schemes.built_in import BuiltIn
from mfpcc_controller.vectors import ACTIVE_LENGTH, next_vector, scaled, signs, square
from pwm_node.compiled import kernel
from pwm_node.parameters import Parameter

# Regressors: u(k), u(k-1), i (2 each), w, 1, s (2), cos 6 theta, sin 6 theta
_N = least_squares.N
_CONSTANT = 7

# How far from its first guess each coefficient may be, for regressors of about one. The unit is
# the first guess of the gain G (A) of a period with the largest voltage; of A, the current limit.
_WIDTHS = (1.5, 1.5, 0.3, 0.3, 0.03, 0.03, 3.0, 1.0, 0.03, 0.03, 0.1, 0.1)
_OF_CURRENT = (4, 5)

# Share of the first guess's variance by which the coefficients walk in _WALK_TIME (s)
_WALK = 2e-5
_WALK_TIME = 0.05
# Share of an error that the constant follows at least, in a period of _FOLLOW_TIME (s) or a longer
# one; in a shorter one in proportion, since what it follows is no faster there. Where there is
# less noise than the least that is counted with, it costs no ripple to follow more: up to so many
# times its square
_FOLLOW = 0.03
_FOLLOW_TIME = 1e-4
_FOLLOW_MORE = 100.0

# Noise: first guess, which counts as so many samples, and least value, over the current limit; how
# many samples it is a mean of; how many times its expectation an error may count; beyond _LOUD
# times it is not noise
_NOISE_FIRST, _NOISE_FIRST_SAMPLES = 1e-2, 10.0
_NOISE_LEAST = 2e-3
_NOISE_MEMORY = 500.0
_LIMIT = 25.0
_LOUD = 25.0
# Differences of the current and its reference up to so many times the noise are noise.
_NEAR = 4.0

# Currents of this share of the limit have a sign; below it goes over smoothly, as that of a leg
# does (the current of a leg ripples, and is clamped at zero).
_SIGN = 0.03

# The observer's share: first value, bounds, and rates of itself and of the variance it is based on
_SHARE = 0.5
_SHARE_LEAST, _SHARE_MOST = 0.01, 0.95
# Above this share errors have memory: they are no noise, but what no regressor tells
_COLOURED = 0.8
_SHARE_RATE = 0.01

# A map flatter than this (its determinant over the square of its size) is none of a motor.
_FLAT = 0.02

PARAMETERS = (
    Parameter(
        "mls.start",
        "model",
        "What mls_mfpcc starts from: the model's mean inductance, or nothing of the motor but its "
        "current limit",
        choices=("model", "empty"),
    ),
)

CFG = np.dtype(
    [
        ("empty", np.bool_),
        ("u", np.float64),  # unit of the voltage: the largest there is in every direction (V)
        ("per_u", np.float64),
        ("per_i", np.float64),  # 1 / current limit (1/A)
        ("per_w", np.float64),  # 1 / top speed (s/rad, electrical)
        ("slope", np.float64),  # of the signs (1/A)
        ("walk", np.float64),  # share by which P is drawn to the first guess in a period
        ("follow", np.float64),  # share of an error that the constant follows at least
        ("least_noise", np.float64),  # (A^2)
    ],
    align=True,
)

MEMORY = np.dtype(
    [
        ("ready", np.bool_),  # there is a table
        ("begun", np.bool_),  # x, the filter and the past voltage are those of this run
        # coefficients of d and q (A), and their covariance (A^2)
        *least_squares.FIELDS,
        ("x_next", np.float64, (_N,)),  # regressors of the period after x's that are no voltage
        ("of_voltage", np.float64),  # share of the last error that went to B
        ("s", np.float64),  # expected square of the error, per axis (A^2)
        ("r", np.float64),  # mean square of the noise, per axis (A^2)
        ("samples", np.float64),  # that it is a mean of
        ("learned_at", np.uint64),  # period of the last update
        # observer
        ("i_f", np.complex128),  # filtered current (A)
        ("share", np.float64),  # l
        ("e", np.complex128),  # last error, and what of it the filter left (A)
        ("e_left", np.complex128),
        ("e_sq", np.float64),  # mean of |e|^2 (A^2)
        ("i_due", np.complex128),  # what the current has to be at k + 1: the last reference (A)
        ("v_past", np.complex128),  # v of the period before, over its unit (dq)
        # the table: natural entry (A per period, dq), and answers to 1 V on the d and the q axis
        ("g_0", np.complex128),
        ("m_d", np.complex128),
        ("m_q", np.complex128),
    ],
    align=True,
)


def configure(cfg: np.void, mem: np.void, values: Mapping[str, Any]) -> None:
    """Take over the parameters."""
    own, i_max = cfg["mls_mfpcc"], cfg["i_max"]
    own["empty"] = values["mls.start"] == "empty"
    own["u"] = cfg["u_dc"] / math.sqrt(3.0)
    own["per_u"] = 1.0 / own["u"]
    own["per_i"] = 1.0 / i_max
    own["per_w"] = 0.01 / cfg["w_rest"]
    own["slope"] = 1.0 / (_SIGN * i_max)
    own["walk"] = _WALK * cfg["T_s"] / _WALK_TIME
    own["follow"] = _FOLLOW * min(cfg["T_s"] / _FOLLOW_TIME, 1.0)
    own["least_noise"] = (_NOISE_LEAST * i_max) ** 2


@kernel
def _fill(cfg, mem):
    """First guess of the coefficients: a gain, isotropic, and nothing natural."""
    own, lut = cfg.mls_mfpcc, mem.mls_mfpcc
    gain = cfg.i_max if own.empty else 2.0 * cfg.T_s / (cfg.L_d + cfg.L_q) * own.u
    for a in range(_N):
        least_squares.begin(lut, a, _WIDTHS[a] * (cfg.i_max if a in _OF_CURRENT else gain))
    lut.d[0], lut.q[1] = gain, gain
    lut.r = (_NOISE_FIRST * cfg.i_max) ** 2
    lut.samples = _NOISE_FIRST_SAMPLES
    lut.share = _SHARE
    lut.e_sq = 0.0
    lut.s = lut.r
    lut.learned_at = mem.period
    lut.begun = False
    lut.ready = True


@kernel
def _response(lut, u_dq):
    """Forced response of one period (A, rotor frame) to the voltage u_dq (V, rotor frame)."""
    return scaled(u_dq.real, lut.m_d) + scaled(u_dq.imag, lut.m_q)


@kernel
def _settled(noise, i, due):
    """`due`, plus what of i - due is more than noise on an axis."""
    d, q = i.real - due.real, i.imag - due.imag
    return complex(
        due.real + d - min(max(d, -noise), noise), due.imag + q - min(max(q, -noise), noise)
    )


@kernel
def _regress(own, x, w, i_s, turn):
    """Fill in the regressors of the natural response; `w` is over top speed."""
    s = signs(own.slope, i_s, turn)
    t_2 = turn * turn
    t_6 = t_2 * t_2 * t_2
    x[4], x[5] = own.per_i * i_s.real, own.per_i * i_s.imag
    x[6], x[7] = w, 1.0
    x[8], x[9] = s.real, s.imag
    x[10], x[11] = w * t_6.real, -w * t_6.imag


@kernel
def _rest(b, x):
    """What neither voltage nor current make of one axis' natural response (A per period)."""
    return b[6] * x[6] + b[7] + (b[8] * x[8] + b[9] * x[9]) + (b[10] * x[10] + b[11] * x[11])


@kernel
def _fit(cfg, mem, e_d, e_q, e_sq):
    """Correct all coefficients by an error, and their covariance."""
    own, lut = cfg.mls_mfpcc, mem.mls_mfpcc
    noise = max(lut.r, own.least_noise)
    s = noise + lut.known
    lut.s = s
    weight = 1.0 / s
    mem.eta = lut.known * weight
    lut.of_voltage = lut.of_first / lut.known if lut.known > 0.0 else 0.0
    bound = 1.0
    if e_sq > _LIMIT * s:
        bound = math.sqrt(_LIMIT * s / e_sq)
        mem.bounded = True
    by = bound * weight
    least_squares.correct(lut, by * e_d, by * e_q, by)
    least_squares.walk(lut, own.walk)
    if lut.P[_CONSTANT, _CONSTANT] < lut.P_first[_CONSTANT]:
        follow = own.follow * own.follow
        if lut.r < noise:
            follow *= min(noise / lut.r, _FOLLOW_MORE)
        if lut.share > _COLOURED:
            more = (lut.share - _COLOURED) / (_SHARE_MOST - _COLOURED)
            follow *= 1.0 + more * (_FOLLOW_MORE - 1.0)
        lut.P[_CONSTANT, _CONSTANT] += follow * noise


@kernel
def _learn(cfg, mem):
    """Correct the coefficients and the filter by the error of this sample."""
    lut, i_dq, e = mem.mls_mfpcc, mem.i_dq, mem.e
    e_d = e.real - mem.jitter * i_dq.imag - lut.e_left.real
    e_q = e.imag + mem.jitter * i_dq.real - lut.e_left.imag

    e_sq = e_d * e_d + e_q * e_q
    _fit(cfg, mem, e_d, e_q, e_sq)
    lut.samples = min(lut.samples + 1.0, _NOISE_MEMORY)
    lut.r += (min(0.5 * e_sq, _LIMIT * lut.r) - lut.r) / lut.samples
    lut.learned_at = mem.period
    mem.updated = np.uint8(127)

    # the observer
    error_sq = square(e)
    lut.e_sq += _SHARE_RATE * (0.5 * (error_sq + square(lut.e)) - lut.e_sq)
    colour = e.real * lut.e.real + e.imag * lut.e.imag
    if lut.e_sq > 0.0:
        lut.share += _SHARE_RATE * min(max(colour / lut.e_sq, -3.0), 3.0)
        lut.share = min(max(lut.share, _SHARE_LEAST), _SHARE_MOST)
    share = 1.0 if error_sq > _LOUD * lut.s else lut.share
    lut.e = e
    lut.e_left = scaled(1.0 - share, e)
    lut.i_f = mem.i_hat + scaled(share, e)


@kernel
def _begin(cfg, mem):
    """A sample with no prediction: the filter starts at it, the constant at the last increment."""
    own, lut, i_dq = cfg.mls_mfpcc, mem.mls_mfpcc, mem.i_dq
    lut.i_f = i_dq
    lut.e, lut.e_left = 0j, 0j
    lut.i_due = i_dq
    if not mem.contiguous:
        lut.v_past = scaled(own.per_u * mem.u_dc, mem.now.u * mem.turn_now)
        return
    lut.v_past = scaled(own.per_u * mem.u_dc, mem.past.u * mem.turn_past)
    x, i_past, u, turn = lut.x, mem.i_dq_past, lut.v_past, cfg.T_s * mem.w_m
    x[0], x[1], x[2], x[3] = u.real, u.imag, u.real, u.imag
    _regress(own, x, own.per_w * mem.w_m, i_past, mem.turn_past)
    left_d = i_dq.real - i_past.real - turn * i_past.imag
    left_q = i_dq.imag - i_past.imag + turn * i_past.real
    for a in range(_N):
        left_d -= x[a] * lut.d[a]
        left_q -= x[a] * lut.q[a]
    if lut.samples == _NOISE_FIRST_SAMPLES or left_d * left_d + left_q * left_q > _LOUD * lut.s:
        lut.d[_CONSTANT] += left_d
        lut.q[_CONSTANT] += left_q
    mem.updated = np.uint8(1)
    mem.eta = 1.0


@kernel
def _answer(b, z):
    """B z, or A z, of a map by its rows."""
    return complex(b[0] * z.real + b[1] * z.imag, b[2] * z.real + b[3] * z.imag)


@kernel
def _needed(inverse, b, z):
    """B^-1 z, with the inverse of the determinant."""
    return complex(
        inverse * (b[3] * z.real - b[1] * z.imag), inverse * (b[0] * z.imag - b[2] * z.real)
    )


@kernel
def _turned(turn, psi):
    """-J psi turn: the voltage that the turn of the frame makes of a flux."""
    return complex(turn * psi.imag, -turn * psi.real)


@kernel
def step(cfg, mem):
    """Learn from the last error, predict k + 1, reach the reference at k + 2."""
    own, lut = cfg.mls_mfpcc, mem.mls_mfpcc
    if not lut.ready:
        _fill(cfg, mem)
    fresh = not (mem.contiguous and mem.kept and lut.begun)
    if fresh:
        _begin(cfg, mem)
    else:
        _learn(cfg, mem)
    i_x = mem.i_dq if fresh else mem.i_hat
    lut.begun = True
    d, q, x, i_f = lut.d, lut.q, lut.x, lut.i_f

    b_0, b_1 = (d[0], d[1], q[0], q[1]), (d[2], d[3], q[2], q[3])
    b = (d[0] + d[2], d[1] + d[3], q[0] + q[2], q[1] + q[3])
    det = b[0] * b[3] - b[1] * b[2]
    d_sq, q_sq, dq = b[0] * b[0] + b[1] * b[1], b[2] * b[2] + b[3] * b[3], b[0] * b[2] + b[1] * b[3]
    if det < 0.5 * _FLAT * (d_sq + q_sq) or b[0] + b[3] <= 0.0:
        # not yet one that could be inverted
        det = 0.5 * (d_sq + q_sq)
        d_sq, q_sq, dq = det, det, 0.0
        b = (math.sqrt(det), 0.0, 0.0, math.sqrt(det))
    inverse = 1.0 / det
    decay = (own.per_i * d[4], own.per_i * d[5], own.per_i * q[4], own.per_i * q[5])
    turn = cfg.T_s * mem.w_m
    w = own.per_w * mem.w_m
    noise = _NEAR * math.sqrt(max(lut.r, own.least_noise))

    # predict
    u = scaled(own.per_u * mem.u_dc, mem.now.u * mem.turn_now)
    y = lut.x_next
    if fresh:
        _regress(own, y, w, i_x, mem.turn_now)
        lut.v_past += _turned(turn, _needed(inverse, b, mem.i_dq_past))
    v = u + _turned(turn, _needed(inverse, b, i_x))
    x[0], x[1], x[2], x[3] = v.real, v.imag, lut.v_past.real, lut.v_past.imag
    for a in range(4, _N):
        x[a] = y[a]
    x[6] = w
    least_squares.foresee(lut)
    forced = _answer(b_0, v) + _answer(b_1, lut.v_past)
    i_1 = i_f + _answer(decay, i_f) + forced + complex(_rest(d, x), _rest(q, x))
    lut.v_past = v

    # what the current of period k + 1 does by itself: the rest and M i_1, M = A - w T_s B J B^-1
    _regress(own, y, w, _settled(noise, i_1, lut.i_due), mem.turn_next)
    rest = complex(_rest(d, y), _rest(q, y))
    w_B = turn * inverse
    m = (decay[0] - w_B * dq, decay[1] + w_B * d_sq, decay[2] - w_B * q_sq, decay[3] + w_B * dq)
    lut.g_0 = rest + _answer(m, i_1)

    # where the current ends when what is under way has arrived, and from there to the reference
    i_2 = i_1 + _answer(b_1, u + _needed(inverse, b, lut.g_0))
    natural = rest + _answer(m, i_2)
    if d[0] + q[1] > 0.0 and d[0] * q[1] - d[1] * q[0] > det:
        # nothing comes late, but what comes decays: the answer of one period is that of B_0
        natural = _answer(b_0, _needed(inverse, b, natural))
        b = b_0
    wish = search.correction(cfg, mem, i_2) - natural
    lut.m_d = complex(own.per_u * b[0], own.per_u * b[2])
    lut.m_q = complex(own.per_u * b[1], own.per_u * b[3])
    u_1 = scaled(ACTIVE_LENGTH * mem.u_dc, mem.turn_next)
    search.choose(cfg, wish, _response(lut, u_1), _response(lut, next_vector(u_1)), mem.next)
    mem.i_hat = i_1
    lut.i_due = mem.i_dq_ref


@kernel
def show(cfg, mem, diag):
    """The table as it is, and how the last error was shared out."""
    lut, past = mem.mls_mfpcc, mem.past
    u_1 = scaled(ACTIVE_LENGTH * mem.u_dc, mem.turn_now)
    back = mem.turn_now.conjugate()
    g_1 = _response(lut, u_1) * back
    g_2 = _response(lut, next_vector(u_1)) * back
    show_gradients(diag, lut.g_0, g_1, g_2)
    age = np.uint32(mem.period - lut.learned_at)
    for j in range(7):
        diag.age[j] = age
    if mem.updated != 127:
        show_shares(diag, 0.0, 0.0, 0.0)
        return
    # between the two vectors, B's share is the voltage's that they made
    total = past.d_a + past.d_b
    a = lut.of_voltage * past.d_a / total if total > 0.0 else 0.0
    show_shares(diag, 1.0 - lut.of_voltage, a, lut.of_voltage - a)


SCHEME = BuiltIn(
    name="mls_mfpcc",
    step=step,
    show=show,
    parameters=PARAMETERS,
    cfg=CFG,
    configure=configure,
    memory=MEMORY,
)

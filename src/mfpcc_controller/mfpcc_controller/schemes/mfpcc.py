"""MFPCC: the conventional model-free scheme, one vector per period (method section 7).

Seven look-up-table entries hold the whole increment of each vector in the rotor frame; all seven
costs are computed and the best vector applies for the whole period. Three ways to keep the table:

`linear` (the mechanism of which the paper says that its denominator vanishes when a vector is
repeated; after Ma et al. 2021 in the paper's references). Per axis

    gain = (di(k-1) - di(k-2)) / (u(k-1) - u(k-2)),   entry_j = di(k-1) + gain (u_j - u(k-1))

with u(k-1), u(k-2) in the rotor frame in the middle of their periods and u_j in the middle of the
period that the entries are for. While the denominator is small the last gain stays in use. This
reading gives the figures of method section 10; keeping the entries instead, or turning u_j to the
middle of period k-1, gives a THD one tenth larger at 2 N m and the same at 5 N m.

`last` (Lin et al. 2014 in the paper's references): the entry of the vector that was applied is
replaced by the increment just measured. Entries of vectors not applied go stale.

`last_refresh`: the same, and a vector not applied for `mfpcc.refresh` periods is applied for one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mfpcc_controller import model, search
from mfpcc_controller.diagnostics import show_shares
from mfpcc_controller.schemes.built_in import BuiltIn
from mfpcc_controller.vectors import (
    ACTIVE_LENGTH,
    next_vector,
    scaled,
    set_output,
    square,
)
from pwm_node.compiled import kernel
from pwm_node.parameters import Parameter

_UPDATES = ("linear", "last", "last_refresh")
_LINEAR = _UPDATES.index("linear")
_LAST_REFRESH = _UPDATES.index("last_refresh")

# Smallest change of the voltage, over that of the DC link, where the parameter leaves it open
_U_MIN = 20.0 / 311.0

PARAMETERS = (
    Parameter("mfpcc.update", "linear", "How mfpcc keeps its table", choices=_UPDATES),
    Parameter(
        "mfpcc.u_min",
        0.0,
        "Smallest change of the voltage from which mfpcc learns a gain (mfpcc.update: linear); "
        "0: 6.4 % of the DC link's (20 V of 311 V)",
        unit="V",
        minimum=0.0,
        maximum=1e3,
    ),
    Parameter(
        "mfpcc.refresh",
        50,
        "Number of periods without a vector after which it is applied for one period "
        "(mfpcc.update: last_refresh)",
        minimum=7,
        maximum=100_000,
    ),
)

CFG = np.dtype(
    [
        ("update", np.int64),  # position in _UPDATES
        ("u_min", np.float64),  # (V)
        ("refresh", np.uint64),  # periods
    ],
    align=True,
)

#: The table
MEMORY = np.dtype(
    [
        ("ready", np.bool_),
        ("g", np.complex128, (7,)),  # whole increments, all in dq (A per period)
        ("gain_d", np.float64),  # (A/V)
        ("gain_q", np.float64),
        ("di_prev", np.complex128),  # increment of period k - 2 (A)
        ("u_prev", np.complex128),  # voltage of period k - 2, in dq (V)
        ("history", np.bool_),  # the two above are there
        ("updated_at", np.uint64, (7,)),
    ],
    align=True,
)


def configure(cfg: np.void, mem: np.void, values: Mapping[str, Any]) -> None:
    """Take over how the table is kept."""
    own = cfg["mfpcc"]
    own["update"] = _UPDATES.index(values["mfpcc.update"])
    own["u_min"] = values["mfpcc.u_min"] or _U_MIN * cfg["u_dc"]
    own["refresh"] = values["mfpcc.refresh"]


@kernel
def fill(lut, u_dc, turn, g_0, gain_d, gain_q):
    """All seven entries: g_0 of the zero vector, and per axis the gain times the voltage."""
    u_1 = scaled(ACTIVE_LENGTH * u_dc, turn)
    u_2 = next_vector(u_1)
    g_1 = complex(gain_d * u_1.real, gain_q * u_1.imag)
    g_2 = complex(gain_d * u_2.real, gain_q * u_2.imag)
    g = lut.g
    g[0] = g_0
    g[1] = g_0 + g_1
    g[2] = g_0 + g_2
    g[3] = g_0 + g_2 - g_1
    g[4] = g_0 - g_1
    g[5] = g_0 - g_2
    g[6] = g_0 + g_1 - g_2


@kernel
def initialise(cfg, mem, lut):
    """Entries from the controller's model, as a drive would be commissioned."""
    lut.gain_d, lut.gain_q = cfg.b_d, cfg.b_q
    g_0 = model.natural(cfg, mem.w_m, mem.i_dq)
    fill(lut, mem.u_dc, mem.turn_now, g_0, lut.gain_d, lut.gain_q)
    for j in range(7):
        lut.updated_at[j] = mem.period
    lut.ready = True
    lut.history = False


@kernel
def update_linear(mem, lut, u_min):
    """Gains from the last two increments, entries from the gains."""
    di = mem.i_dq - mem.i_dq_past
    u = scaled(mem.u_dc, mem.past.u * mem.turn_past)
    if lut.history:
        d_di, d_u = di - lut.di_prev, u - lut.u_prev
        if abs(d_u.real) > u_min:
            lut.gain_d = d_di.real / d_u.real
        if abs(d_u.imag) > u_min:
            lut.gain_q = d_di.imag / d_u.imag
        gain_d, gain_q = lut.gain_d, lut.gain_q
        g_0 = complex(di.real - gain_d * u.real, di.imag - gain_q * u.imag)
        fill(lut, mem.u_dc, mem.turn_now, g_0, gain_d, gain_q)
        lut.updated_at[0] = mem.period
        mem.updated = np.uint8(127)
    lut.di_prev = di
    lut.u_prev = u
    lut.history = True


@kernel
def _update_last(mem):
    """The entry of the vector that was applied, if it was one alone."""
    lut, past = mem.mfpcc, mem.past
    if past.d_a + past.d_b == 0.0:
        j = 0
    elif past.d_a == 1.0:
        j = past.a
    else:
        return
    lut.g[j] = mem.i_dq - mem.i_dq_past
    lut.updated_at[j] = mem.period
    mem.updated = np.uint8(1 << j)


@kernel
def update(cfg, mem):
    """Bring the table up to date with this sample."""
    lut = mem.mfpcc
    if not (lut.ready and mem.kept):
        # a table of an earlier time is worth less than the model
        initialise(cfg, mem, lut)
    if not mem.contiguous:
        lut.history = False
    elif cfg.mfpcc.update == _LINEAR:
        update_linear(mem, lut, cfg.mfpcc.u_min)
    else:
        _update_last(mem)


@kernel
def predict(mem, g):
    """Sample k + 1 by the table, with the committed output."""
    now = mem.now
    if now.d_a == 1.0:
        return mem.i_dq + g[now.a]
    if now.d_a + now.d_b == 0.0:
        return mem.i_dq + g[0]
    # several vectors, taken over from another scheme: their entries by their shares
    whole = scaled(1.0 - now.d_a - now.d_b, g[0])
    return mem.i_dq + whole + scaled(now.d_a, g[now.a]) + scaled(now.d_b, g[now.b])


@kernel
def _stale(cfg, mem):
    """A vector that was not applied for too long, or -1."""
    lut = mem.mfpcc
    oldest = 0
    for j in range(1, 7):
        if lut.updated_at[j] < lut.updated_at[oldest]:
            oldest = j
    # its application takes two periods to show
    if mem.period - lut.updated_at[oldest] < cfg.mfpcc.refresh:
        return -1
    if mem.now.a == oldest or mem.past.a == oldest:
        return -1
    return oldest


@kernel
def step(cfg, mem):
    """Update the table from the last increment, predict k + 1, try all seven for k + 2."""
    update(cfg, mem)
    g = mem.mfpcc.g
    i_1 = predict(mem, g)
    wish = search.correction(cfg, mem, i_1)
    best, best_cost = 0, np.inf
    for j in range(7):
        cost = square(wish - g[j])
        if cost < best_cost:
            best, best_cost = j, cost
    if cfg.mfpcc.update == _LAST_REFRESH:
        stale = _stale(cfg, mem)
        if stale >= 0:
            best = stale
    set_output(mem.next, best, 0, 1.0 if best > 0 else 0.0, 0.0)
    mem.i_hat = i_1


@kernel
def show(cfg, mem, diag):
    """The table, split into the natural entry and the forced ones in the stationary frame."""
    lut = mem.mfpcc
    back = mem.turn_now.conjugate()
    g_0 = lut.g[0]
    diag.gradient_re[0], diag.gradient_im[0] = g_0.real, g_0.imag
    for j in range(1, 7):
        g_j = (lut.g[j] - g_0) * back
        diag.gradient_re[j], diag.gradient_im[j] = g_j.real, g_j.imag
    for j in range(7):
        at = lut.updated_at[0 if cfg.mfpcc.update == _LINEAR else j]
        diag.age[j] = mem.period - at
    show_shares(diag, 0.0, 0.0, 0.0)


SCHEME = BuiltIn(
    name="mfpcc",
    step=step,
    show=show,
    parameters=PARAMETERS,
    cfg=CFG,
    configure=configure,
    memory=MEMORY,
)

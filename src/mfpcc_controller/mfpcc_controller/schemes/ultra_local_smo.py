"""Ultra-local model with a sliding-mode observer, deadbeat, three vectors.

As `ultra_local_eso`, but F comes from a sliding-mode observer:

    dz1/dt = alpha u + z2 + k sat(err / w),   dz2/dt = (k / (4 w)) k sat(err / w),   err = i - z1

Outside the layer of width w the observer slides with a force of k whatever the error is, so that
large disturbances act with a bounded strength; inside, it is linear, which keeps the chattering of
a true switching function out of the prediction, and the factor 1/4 damps it critically. The
current gradients of all vectors then are T_s (z2 + alpha u_j), which is how Sun et al. (2023, the
paper's reference) use it; the boundary layer is Slotine's (Slotine, Hedrick, Misawa 1987,
doi:10.1115/1.3143852).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mfpcc_controller import model
from mfpcc_controller.schemes.built_in import BuiltIn
from mfpcc_controller.schemes.ultra_local_eso import MEMORY, reach, show_observed, take_over
from mfpcc_controller.vectors import scaled
from pwm_node.compiled import kernel
from pwm_node.parameters import Parameter

# Where the parameters leave them open: width over the current limit, and strength over width (1/s)
_WIDTH = 1.0 / 12.0
_RATE = 2_000.0
# Strength over width and over the PWM frequency, at most: 2 is the edge of stability
_FASTEST = 0.2

PARAMETERS = (
    Parameter(
        "smo.gain",
        0.0,
        "Strength of the observer of ultra_local_smo; 0: 2000 times 'smo.width' in a second, but "
        "at most a fifth of it in a PWM period",
        unit="A/s",
        minimum=0.0,
        maximum=1e6,
    ),
    Parameter(
        "smo.width",
        0.0,
        "Error of the observer of ultra_local_smo up to which it is linear (boundary layer); 0: a "
        "twelfth of the motor's current limit",
        unit="A",
        minimum=0.0,
        maximum=1e3,
    ),
)

CFG = np.dtype(
    [
        ("k", np.float64),  # (A/s)
        ("width", np.float64),  # (A)
    ],
    align=True,
)


def configure(cfg: np.void, mem: np.void, values: Mapping[str, Any]) -> None:
    """Take over strength and width."""
    own = cfg["ultra_local_smo"]
    own["width"] = values["smo.width"] or _WIDTH * cfg["i_max"]
    rate = min(_RATE, _FASTEST / cfg["T_s"])
    own["k"] = values["smo.gain"] or rate * own["width"]


@kernel
def _sat(x):
    return min(max(x, -1.0), 1.0)


@kernel
def step(cfg, mem):
    """Observe F, then reach the reference."""
    own, smo, T_s = cfg.ultra_local_smo, mem.ultra_local_smo, cfg.T_s
    k, width = own.k, own.width
    take_over(cfg, mem, smo)
    err = mem.i_dq - smo.z_1
    force = scaled(k, complex(_sat(err.real / width), _sat(err.imag / width)))
    u_now = scaled(mem.u_dc, mem.now.u * mem.turn_now)
    smo.z_2 += scaled(T_s * k / (4.0 * width), force)
    smo.z_1 += model.forced(cfg, u_now) + scaled(T_s, smo.z_2 + force)
    reach(cfg, mem, scaled(T_s, smo.z_2))


@kernel
def show(cfg, mem, diag):
    """The gradients by this observer."""
    show_observed(cfg, mem, mem.ultra_local_smo, diag)


SCHEME = BuiltIn(
    name="ultra_local_smo",
    step=step,
    show=show,
    parameters=PARAMETERS,
    cfg=CFG,
    configure=configure,
    memory=MEMORY,
    gain=0.24,
)

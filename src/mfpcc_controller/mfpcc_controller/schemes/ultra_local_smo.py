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

from mfpcc_controller import model
from mfpcc_controller.schemes.ultra_local_eso import reach, take_over
from mfpcc_controller.vectors import scaled
from pwm_node.compiled import kernel


@kernel
def _sat(x):
    return min(max(x, -1.0), 1.0)


@kernel
def step(cfg, mem):
    """Observe F, then reach the reference."""
    take_over(cfg, mem)
    smo, T_s, k, width = mem.ultra, cfg.T_s, cfg.smo_k, cfg.smo_width
    err = mem.i_dq - smo.z_1
    force = scaled(k, complex(_sat(err.real / width), _sat(err.imag / width)))
    u_now = scaled(mem.u_dc, mem.now.u * mem.turn_now)
    smo.z_2 += scaled(T_s * k / (4.0 * width), force)
    smo.z_1 += model.forced(cfg, u_now) + scaled(T_s, smo.z_2 + force)
    reach(cfg, mem, scaled(T_s, smo.z_2))

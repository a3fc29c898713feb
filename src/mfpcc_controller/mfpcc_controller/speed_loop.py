"""Speed loop and current references: torque limit, maximum torque per ampere, field weakening.

The speed loop asks for torque in amperes: the current on the q axis that would make it with the
magnet's flux alone. What follows turns this into the pair of currents that makes it, by the values
of the motor file, within the limits of current and of flux.
"""

from __future__ import annotations

import math

from mfpcc_controller.vectors import square
from pwm_node.compiled import kernel

# Share of the linear modulation range that field weakening leaves to be used.
_VOLTAGE_SHARE = 0.98
_INV_SQRT3 = 1.0 / math.sqrt(3.0)
# Bandwidth of field weakening (rad/s): slower than the current, faster than the speed
_WEAKENING_BANDWIDTH = 100.0
# Flux that is allowed, over that of the voltage and the speed: resistance and wrong values move it
_FLUX_LEAST, _FLUX_MOST = 0.1, 2.0
# Torque over what is asked for, below which it is limited
_ALL = 0.99
# Magnet and reluctance may cancel out; a flux below this share of the magnet's is not counted with.
_FLUX_FOR_TORQUE = 0.1


@kernel
def mtpa_d(mtpa, i_s):
    """i_d of the largest torque at the current amplitude i_s (A).

    `i_d = m - sqrt(m^2 + i_s^2 / 2)` with `m = psi_f / (4 (L_q - L_d))` (Morimoto, Takeda, Hirasa,
    Taniguchi 1990, doi:10.1109/28.60058). The mirror image, for L_d > L_q, has m < 0.
    """
    root = math.sqrt(mtpa * mtpa + 0.5 * i_s * i_s)
    return mtpa - root if mtpa > 0.0 else mtpa + root


@kernel
def _mtpa_q(mtpa, torque):
    """i_q of the smallest current that makes this torque (A with the magnet's flux alone).

    With c = 4 m, the currents on that line are `i_d = c / 2 - sqrt(c^2 / 4 + i_q^2)`, so that the
    torque t and z = |i_q / c| fulfil `t = z (1 / 2 + sqrt(1 / 4 + z^2))`, which is
    `z^4 + t z - t^2 = 0`: convex, and Newton's method comes from above.
    """
    c = abs(4.0 * mtpa)
    t = abs(torque) / c
    z = min(t, math.sqrt(t))
    for _ in range(6):
        slope = 4.0 * z * z * z + t
        if slope > 0.0:
            z -= (z * z * z * z + t * z - t * t) / slope
    return math.copysign(c * z, torque)


@kernel
def _allowed_flux(cfg, mem):
    """Flux linkage (V s) at which the voltage reaches its limit.

    By the speed alone it is `u / |w|`. An integrator on the voltage that is really asked for
    (Harnefors, Pietilainen, Gertmar 2001, doi:10.1109/41.949390) corrects it by what the
    resistance takes and the motor file does not know. More flux is more voltage at any current,
    beyond the short-circuit current too, so that its sign is always right.
    """
    limit = _VOLTAGE_SHARE * _INV_SQRT3 * mem.u_dc
    lack = 1.0 - mem.u_dc * math.sqrt(square(mem.now.u)) / limit
    share = mem.flux_share + cfg.T_s * _WEAKENING_BANDWIDTH * lack
    if lack < 0.0 or mem.weakened:
        mem.flux_share = min(max(share, _FLUX_LEAST), _FLUX_MOST)
    else:
        # not needed: back to what the speed says
        mem.flux_share = min(share, max(mem.flux_share, 1.0))
    return mem.flux_share * limit / max(abs(mem.w_m), 1.0)


@kernel
def _weakened(cfg, mem, i_max, i_d, i_q):
    """The currents with the torque of these, or as much of it as there is, within the flux.

    On the ellipse of the allowed flux, `psi_d = F cos a` and `psi_q = F sin a`, torque and current
    both grow with a, until the torque is at its largest (maximum torque per volt) where

        2 s psi_d^2 + L_q psi_f psi_d - s F^2 = 0,   s = L_d - L_q

    (Morimoto et al. 1990). So a is found by halving: from that of the same i_d up to there, the
    largest with no more torque than asked for, and no more current than i_max.
    """
    F = _allowed_flux(cfg, mem)
    psi_f, L_d, L_q = cfg.ref_psi_f, cfg.ref_L_d, cfg.ref_L_q
    s, magnet = L_d - L_q, L_q * psi_f
    psi_d, psi_q = psi_f + L_d * i_d, L_q * i_q
    mem.weakened = psi_d * psi_d + psi_q * psi_q > F * F
    if not mem.weakened:
        return i_d, i_q
    torque = abs((psi_f + s * i_d) * i_q)
    last = 2.0 * s * F * F / (magnet + math.sqrt(magnet * magnet + 8.0 * s * s * F * F))
    first = min(max(psi_d, last), F)
    # tan(a / 2)
    low, high = math.sqrt((F - first) / (F + first)), math.sqrt((F - last) / (F + last))
    for _ in range(24):
        tan = 0.5 * (low + high)
        scale = F / (1.0 + tan * tan)
        x, y = ((1.0 - tan * tan) * scale - psi_f) / L_d, 2.0 * tan * scale / L_q
        if (psi_f + s * x) * y > torque or x * x + y * y > i_max * i_max:
            high = tan
        else:
            low = tan
    scale = F / (1.0 + low * low)
    x, y = ((1.0 - low * low) * scale - psi_f) / L_d, 2.0 * low * scale / L_q
    return max(x, -i_max), math.copysign(y, i_q)


@kernel
def _set_reference(cfg, mem, i_max, i_d, i_q):
    """Set `mem.i_dq_ref` to these currents (A), within the limits."""
    if cfg.weaken:
        i_d, i_q = _weakened(cfg, mem, i_max, i_d, i_q)
    i_q_max = i_max if i_d == 0.0 else math.sqrt(max(i_max * i_max - i_d * i_d, 0.0))
    mem.i_dq_ref = complex(i_d, min(max(i_q, -i_q_max), i_q_max))


@kernel
def _torque(cfg, i_d, i_q):
    """Torque of these currents: the i_q (A) that would make it with the magnet's flux alone."""
    return i_q * ((cfg.ref_psi_f + (cfg.ref_L_d - cfg.ref_L_q) * i_d) / cfg.ref_psi_f)


@kernel
def current_reference(cfg, mem):
    """Set `mem.i_dq_ref`, within the share of `cfg.i_max` that the inverter allows.

    Speed control is a two-degree-of-freedom PI controller with active damping and
    back-calculation anti-windup (Harnefors, Saarakkala, Hinkkanen 2013,
    doi:10.1109/TIA.2013.2258392): no overshoot at a step of the reference, and a load step is
    answered with the same bandwidth.
    """
    i_max = mem.derating * cfg.i_max
    i_d = cfg.i_dq_ref.real
    if i_d != 0.0:
        i_d = min(max(i_d, -i_max), i_max)
    if not cfg.speed_control:
        mem.speed_ready = False
        _set_reference(cfg, mem, i_max, i_d, cfg.i_dq_ref.imag)
        return
    if mem.pll_samples < 2 or not mem.now.on:
        # no speed yet, or no torque; and no bump when it comes
        mem.speed_ready = False
        _set_reference(cfg, mem, i_max, i_d, 0.0)
        return

    w_M = mem.w_m / cfg.n_p
    damping = cfg.k_p - cfg.k_t
    if not mem.speed_ready:
        held_d = i_d if cfg.mtpa == 0.0 else mem.i_dq.real
        mem.torque_int = damping * w_M + _torque(cfg, held_d, mem.i_dq.imag)
        mem.speed_ready = True
    w_error = cfg.w_M_ref - w_M
    wish = cfg.k_t * w_error - damping * w_M + mem.torque_int
    torque = min(max(wish, -cfg.torque_max), cfg.torque_max)
    if cfg.mtpa != 0.0:
        # the smallest current that makes it
        i_q = _mtpa_q(cfg.mtpa, torque)
        c = 2.0 * cfg.mtpa
        d_0 = c - math.copysign(math.sqrt(c * c + i_q * i_q), c)
        if d_0 * d_0 + i_q * i_q > i_max * i_max:
            d_0 = mtpa_d(cfg.mtpa, i_max)
            i_q = math.copysign(math.sqrt(i_max * i_max - d_0 * d_0), i_q)
        i_d = min(max(i_d + d_0, -i_max), i_max)
    else:
        i_q = torque / max(_torque(cfg, i_d, 1.0), _FLUX_FOR_TORQUE)
    _set_reference(cfg, mem, i_max, i_d, i_q)
    made = _torque(cfg, mem.i_dq_ref.real, mem.i_dq_ref.imag)
    mem.torque_limited = abs(made) < _ALL * abs(wish)
    mem.torque_int += cfg.T_s * cfg.k_i * (w_error + (torque - wish + made - torque) / cfg.k_t)

"""Three-vector search: two adjacent active vectors and their dwell times.

The forced gradients are a linear map of the voltage, so that V1's and V2's, `G_1` and `G_2` (A per
period, rotor frame in the middle of the period), say all: V3 gives G_2 - G_1, V4 gives -G_1, and
so on. `x` is the forced increment that would bring the current onto its reference (method
section 4).
"""

from __future__ import annotations

from mfpcc_controller.vectors import cross, scaled, set_output, square
from pwm_node.compiled import kernel


@kernel
def correction(cfg, mem, i_1):
    """What the next period is to take off the error that the current i_1 (A) would leave.

    With a gain of 1 all of it, in one period (deadbeat); less is slower, quieter, and stands a
    wrong model better.
    """
    return scaled(cfg.gain[mem.active], mem.i_dq_ref - i_1)


@kernel
def by_dwell(x, G_1, G_2):
    """The one adjacent pair whose dwell times are both non-negative, on any machine.

    One solution of x = p G_1 + q G_2 names the sector.

    Returns
    -------
    (a, b, d_a, d_b)
    """
    det = cross(G_1, G_2)
    if det == 0.0:
        return 1, 2, 0.0, 0.0
    inverse = 1.0 / det
    p = inverse * cross(x, G_2)
    q = inverse * cross(G_1, x)
    r = p + q
    if q >= 0.0:
        if p >= 0.0:
            return 1, 2, p, q
        if r >= 0.0:
            return 2, 3, r, -p
        return 3, 4, q, -r
    if p <= 0.0:
        return 4, 5, -p, -q
    if r <= 0.0:
        return 5, 6, -r, p
    return 6, 1, -q, r


@kernel
def corner(j, G_1, G_2):
    """Forced gradient of vector j, 1..6."""
    if j == 1:
        return G_1
    if j == 2:
        return G_2
    if j == 3:
        return G_2 - G_1
    if j == 4:
        return -G_1
    if j == 5:
        return -G_2
    return G_1 - G_2


@kernel
def by_ranking(x, G_1, G_2):
    """The paper's search: rank the costs of V1, V3, V5; best and second best name the sector.

    Right only where the six gradients are equally long. A negative dwell time is set to zero.
    """
    c_1 = square(x - G_1)
    c_3 = square(x - G_2 + G_1)
    c_5 = square(x + G_2)
    if c_1 <= c_3 and c_1 <= c_5:
        a = 1 if c_3 <= c_5 else 6
    elif c_3 <= c_5:
        a = 2 if c_1 <= c_5 else 3
    else:
        a = 4 if c_3 <= c_1 else 5
    b = a % 6 + 1
    G_a, G_b = corner(a, G_1, G_2), corner(b, G_1, G_2)
    det = cross(G_a, G_b)
    if det == 0.0:
        return a, b, 0.0, 0.0
    return a, b, max(cross(x, G_b) / det, 0.0), max(cross(G_a, x) / det, 0.0)


@kernel
def _onto_edge(x, u, v):
    """Share t of v in the point (1 - t) u + t v of the edge u..v nearest to x, and its cost."""
    edge = v - u
    length = square(edge)
    if length == 0.0:
        return 0.0, square(x - u)
    w = x - u
    t = (w.real * edge.real + w.imag * edge.imag) / length
    t = min(max(t, 0.0), 1.0)
    return t, square(w - scaled(t, edge))


@kernel
def onto_hexagon(x, G_1, G_2, a):
    """The point of the hexagon nearest to x; x lies outside, in the sector that begins with a.

    On a stretched hexagon it may lie on a neighbouring edge, so those are looked at too.
    """
    best_cost, best_a, best_t = -1.0, a, 0.0
    for shift in range(-1, 2):
        e_a = (a + 5 + shift) % 6 + 1
        t, cost = _onto_edge(x, corner(e_a, G_1, G_2), corner(e_a % 6 + 1, G_1, G_2))
        if best_cost < 0.0 or cost < best_cost:
            best_cost, best_a, best_t = cost, e_a, t
    return best_a, best_a % 6 + 1, 1.0 - best_t, best_t


@kernel
def choose(cfg, x, G_1, G_2, out):
    """Write the output for the forced increment x (A) into `out`, within the period."""
    if cfg.rank_sectors:
        a, b, d_a, d_b = by_ranking(x, G_1, G_2)
    else:
        a, b, d_a, d_b = by_dwell(x, G_1, G_2)
    total = d_a + d_b
    if total > 1.0:
        if cfg.project:
            a, b, d_a, d_b = onto_hexagon(x, G_1, G_2, a)
        else:
            d_a /= total
            d_b = 1.0 - d_a
    set_output(out, a, b, d_a, d_b)


@kernel
def nearest_vector(x, G_1, G_2):
    """The vector, 0..6, whose forced gradient is nearest to x."""
    best, best_cost = 0, square(x)
    for j in range(1, 7):
        cost = square(x - corner(j, G_1, G_2))
        if cost < best_cost:
            best, best_cost = j, cost
    return best

"""Three-vector search: two adjacent active vectors and their dwell times.

`G` holds the six forced gradients V1..V6 in the rotor frame in the middle of the period, G[1] to
G[6]; `x` is the forced increment that would bring the current onto its reference (method
section 4).
"""

from __future__ import annotations

from pwm_node.compiled import kernel


@kernel
def _cross(u, v):
    return u.real * v.imag - u.imag * v.real


@kernel
def _square(x):
    return x.real * x.real + x.imag * x.imag


@kernel
def by_dwell(x, G):
    """The one adjacent pair whose dwell times are both non-negative.

    The gradients are a linear map of the voltage: G3 = G2 - G1, G4 = -G1, and so on. So one
    solution x = p G1 + q G2 names the sector, for any machine.

    Returns
    -------
    (a, b, d_a, d_b)
    """
    det = _cross(G[1], G[2])
    if det == 0.0:
        return 1, 2, 0.0, 0.0
    p = _cross(x, G[2]) / det
    q = _cross(G[1], x) / det
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
def by_ranking(x, G):
    """The paper's search: rank the costs of V1, V3, V5; best and second best name the sector.

    Right only where the six |G_j| are equal.
    """
    c_1 = _square(x - G[1])
    c_3 = _square(x - G[3])
    c_5 = _square(x - G[5])
    if c_1 <= c_3 and c_1 <= c_5:
        a = 1 if c_3 <= c_5 else 6
    elif c_3 <= c_5:
        a = 2 if c_1 <= c_5 else 3
    else:
        a = 4 if c_3 <= c_1 else 5
    b = a % 6 + 1
    det = _cross(G[a], G[b])
    if det == 0.0:
        return a, b, 0.0, 0.0
    return a, b, max(_cross(x, G[b]) / det, 0.0), max(_cross(G[a], x) / det, 0.0)


@kernel
def _onto_edge(x, u, v):
    """Share t of v in the point (1 - t) u + t v of the edge u..v nearest to x, and its cost."""
    edge = v - u
    length = _square(edge)
    if length == 0.0:
        return 0.0, _square(x - u)
    w = x - u
    t = (w.real * edge.real + w.imag * edge.imag) / length
    t = min(max(t, 0.0), 1.0)
    return t, _square(w - t * edge)


@kernel
def onto_hexagon(x, G, a):
    """The point of the hexagon nearest to x; x lies outside, in the sector that begins with a.

    On a stretched hexagon it may lie on a neighbouring edge, so those are looked at too.
    """
    best_cost, best_a, best_t = -1.0, a, 0.0
    for shift in range(-1, 2):
        e_a = (a - 1 + shift) % 6 + 1
        e_b = e_a % 6 + 1
        t, cost = _onto_edge(x, G[e_a], G[e_b])
        if best_cost < 0.0 or cost < best_cost:
            best_cost, best_a, best_t = cost, e_a, t
    return best_a, best_a % 6 + 1, 1.0 - best_t, best_t


@kernel
def choose(cfg, x, G, out):
    """Write the output for the forced increment x (A) into `out`, within the period."""
    if cfg.rank_sectors:
        a, b, d_a, d_b = by_ranking(x, G)
    else:
        a, b, d_a, d_b = by_dwell(x, G)
    total = d_a + d_b
    if total > 1.0:
        if cfg.project:
            a, b, d_a, d_b = onto_hexagon(x, G, a)
        else:
            d_a /= total
            d_b = 1.0 - d_a
    out.a, out.b, out.d_a, out.d_b = a, b, d_a, d_b

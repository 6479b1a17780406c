r"""Force and tangent of the elements, `LANES` of them at a time.

With :math:`g_a` the gradient of shape function a, :math:`h_a = F^{-T} g_a` and
:math:`J_{,u_a} = J h_a`, an invariant :math:`I = F A : F` has

.. math:: \tfrac12 (\varphi I)_{,u_a} = \varphi F A g_a + \tfrac12 J \varphi' I h_a ,

and the blocks of its second derivative are made of the same vectors: dyads
:math:`h_a \otimes h_b` (``straight``), :math:`h_b \otimes h_a` (``crossed``),
:math:`h \otimes F A g` and multiples of the unit matrix.

Blocks of elements are processed in scratch arrays whose last axis is the element,
and then transposed, so that each element adds its sixteen edges, twelve numbers at a
time, to the packed rows of the tangent (`workers.mechanics.fem.sparse_products`).
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.kernels_and_threads import CONTRACTED, Float32Array
from palpate.workers.mechanics.fem.element_energy import (
    J_SMALL,
    PHI0,
    PHI1,
    PHI2,
    ElementMaterial,
    Elements,
)
from palpate.workers.mechanics.fem.simd_vectors import (
    EDGE,
    LANES,
    Vector,
    add_edge,
    fetch_edge,
    load,
    rough_inverse_cube_root,
    store,
    store_interleaved,
    where_below,
)


class Scratch(NamedTuple):
    """Work arrays of a block of elements; the last axis is the element.

    Parameters
    ----------
    x, g : ndarray, shape (4, 3, LANES)
        Corners, and gradients of the shape functions.
    material : ndarray, shape (4, LANES)
        mu, c2, kappa and volume.
    pressure, root : ndarray, shape (4, LANES)
        At the corners.
    eta : ndarray, shape (families, LANES), and fibre : ndarray, shape (families, 3, LANES)
    F : ndarray, shape (3, 3, LANES)
    f, h, t, left : ndarray, shape (4, 3, LANES)
        F g, F^-T g and the left factors of `h` in the dyads of the tangent.
    diagonal : ndarray, shape (4, 4, LANES)
        Multiples of the unit matrix, above the diagonal only.
    r : ndarray, shape (families + 1, 4, 3, LANES), and rank_one : (families + 1, LANES)
        Rank-one terms.
    z : ndarray, shape (4, LANES)
        Gradients along the fibre.
    block : ndarray, shape (3, 3, LANES), and own : ndarray, shape (4, 3, 3, LANES)
        The block of one pair of corners, and the diagonal blocks of all corners.
    out : ndarray, shape (4, 3, LANES)
        Force on the corners.
    lines : ndarray, shape (LANES, 192)
        Sixteen packed edges of each element.
    """

    x: FloatArray
    g: FloatArray
    material: FloatArray
    pressure: FloatArray
    root: FloatArray
    eta: FloatArray
    fibre: FloatArray
    F: FloatArray
    f: FloatArray
    h: FloatArray
    t: FloatArray
    left: FloatArray
    diagonal: FloatArray
    r: FloatArray
    rank_one: FloatArray
    z: FloatArray
    block: FloatArray
    own: FloatArray
    out: FloatArray
    lines: Float32Array


@njit(**CONTRACTED)
def assemble(
    x: FloatArray,
    elements: Elements,
    material: ElementMaterial,
    pressure: FloatArray,
    root: FloatArray,
    edge: IntArray,
    convex: bool,
    positive: bool,
    force: FloatArray,
    rows: Float32Array,
) -> None:
    """Add the internal force, (n, 3) in N, and the tangent in packed rows, (edges, 12).

    `pressure` is ``kappa_n (v_n / V_n - gamma_n)`` per node and `root` is
    ``sqrt(kappa_n / V_n)``; `edge`, (m, 4, 4), is the row of each pair of nodes.
    `convex` omits the geometric stiffness of pressure and slack fibres, which may be
    negative; `positive` omits every part that can be negative. With empty rows only the
    force is added.
    """
    families = material.fibre.shape[1]
    s = Scratch(
        np.empty((4, 3, LANES)),
        np.empty((4, 3, LANES)),
        np.empty((4, LANES)),
        np.empty((4, LANES)),
        np.empty((4, LANES)),
        np.empty((families, LANES)),
        np.empty((families, 3, LANES)),
        np.empty((3, 3, LANES)),
        np.empty((4, 3, LANES)),
        np.empty((4, 3, LANES)),
        np.empty((4, 3, LANES)),
        np.empty((4, 3, LANES)),
        np.empty((4, 4, LANES)),
        np.empty((families + 1, 4, 3, LANES)),
        np.empty((families + 1, LANES)),
        np.empty((4, LANES)),
        np.empty((3, 3, LANES)),
        np.empty((4, 3, 3, LANES)),
        np.empty((4, 3, LANES)),
        np.empty((LANES, 16 * EDGE), np.float32),
    )
    m = elements.tets.shape[0]
    for first in range(0, m, LANES):
        last = min(first + LANES, m)
        stiffens = _gather(x, elements, material, pressure, root, first, s)
        if rows.shape[0]:
            for e in range(first, last):
                for a in range(4):
                    for b in range(4):
                        fetch_edge(rows, edge[e, a, b])
        ranks, crossed, share = _vectors(s, material, stiffens, convex, positive)
        for e in range(first, last):
            for a in range(4):
                for i in range(3):
                    force[elements.tets[e, a], i] += s.out[a, i, e - first]
        if rows.shape[0] == 0:
            continue
        _blocks(s, ranks, crossed, share)
        for e in range(first, last):
            for a in range(4):
                for b in range(4):
                    add_edge(rows, edge[e, a, b], s.lines, e - first, 4 * a + b)


@njit(inline="always", **CONTRACTED)
def _gather(
    x: FloatArray,
    elements: Elements,
    material: ElementMaterial,
    pressure: FloatArray,
    root: FloatArray,
    first: int,
    s: Scratch,
) -> bool:
    """Gather the data of elements from `first` on, padded with the last element.

    The result is True if one of them stiffens by Yeoh's law.
    """
    m = elements.tets.shape[0]
    stiffens = False
    for lane in range(LANES):
        e = min(first + lane, m - 1)
        for a in range(4):
            n = elements.tets[e, a]
            s.pressure[a, lane] = pressure[n]
            s.root[a, lane] = root[n]
            for i in range(3):
                s.x[a, i, lane] = x[n, i]
        for a in range(3):
            for i in range(3):
                s.g[a + 1, i, lane] = elements.gradients[e, a, i]
        s.material[0, lane] = material.mu[e]
        s.material[1, lane] = material.c2[e]
        stiffens = stiffens or material.c2[e] != 0.0
        s.material[2, lane] = material.kappa[e]
        s.material[3, lane] = elements.volumes[e]
        for q in range(s.eta.shape[0]):
            s.eta[q, lane] = material.eta[e, q]
            for i in range(3):
                s.fibre[q, i, lane] = material.fibre[e, q, i]
    return stiffens


@njit(inline="always", **CONTRACTED)
def _isochoric_factor(J: Vector) -> tuple[Vector, Vector, Vector]:
    """Return J^(-2/3) and its logarithmic derivatives J phi', J^2 phi''; see `element_energy`."""
    large = where_below(J, J_SMALL, J_SMALL, J)
    c = rough_inverse_cube_root(large)
    for _ in range(3):  # each iteration triples the number of digits
        miss = 1.0 - large * c * c * c
        c = c + c * miss * (1.0 / 3.0 + 2.0 / 9.0 * miss)
    phi = c * c
    s = J - J_SMALL
    slope = PHI1 + PHI2 * s
    return (
        where_below(J, J_SMALL, PHI0 + PHI1 * s + 0.5 * PHI2 * s * s, phi),
        where_below(J, J_SMALL, slope * J, -2.0 / 3.0 * phi),
        where_below(J, J_SMALL, PHI2 * J * J, 10.0 / 9.0 * phi),
    )


@njit(inline="always", **CONTRACTED)
def _kinematics(s: Scratch) -> tuple[Vector, Vector]:
    """Write F, f = F g and h = F^-T g of each corner; return J and I1."""
    g, F = s.g, s.F
    for i in range(3):
        store(g, i, 0.0 - load(g, 3 + i) - load(g, 6 + i) - load(g, 9 + i))
        o = load(s.x, i)
        d1, d2, d3 = load(s.x, 3 + i) - o, load(s.x, 6 + i) - o, load(s.x, 9 + i) - o
        for j in range(3):
            store(F, 3 * i + j, d1 * load(g, 3 + j) + d2 * load(g, 6 + j) + d3 * load(g, 9 + j))
    f00, f01, f02 = load(F, 0), load(F, 1), load(F, 2)
    f10, f11, f12 = load(F, 3), load(F, 4), load(F, 5)
    f20, f21, f22 = load(F, 6), load(F, 7), load(F, 8)
    h00, h01, h02 = f11 * f22 - f12 * f21, f12 * f20 - f10 * f22, f10 * f21 - f11 * f20
    h10, h11, h12 = f02 * f21 - f01 * f22, f00 * f22 - f02 * f20, f01 * f20 - f00 * f21
    h20, h21, h22 = f01 * f12 - f02 * f11, f02 * f10 - f00 * f12, f00 * f11 - f01 * f10
    J = f00 * h00 + f01 * h01 + f02 * h02
    size = where_below(J * J, 1e-300, 1.0, J)
    r = where_below(J * J, 1e-300, 0.0, 1.0 / size)
    for a in range(4):
        g0, g1, g2 = load(g, 3 * a), load(g, 3 * a + 1), load(g, 3 * a + 2)
        store(s.f, 3 * a, f00 * g0 + f01 * g1 + f02 * g2)
        store(s.f, 3 * a + 1, f10 * g0 + f11 * g1 + f12 * g2)
        store(s.f, 3 * a + 2, f20 * g0 + f21 * g1 + f22 * g2)
        store(s.h, 3 * a, r * (h00 * g0 + h01 * g1 + h02 * g2))
        store(s.h, 3 * a + 1, r * (h10 * g0 + h11 * g1 + h12 * g2))
        store(s.h, 3 * a + 2, r * (h20 * g0 + h21 * g1 + h22 * g2))
    I1 = f00 * f00 + f01 * f01 + f02 * f02 + f10 * f10 + f11 * f11 + f12 * f12
    return J, I1 + f20 * f20 + f21 * f21 + f22 * f22


@njit(inline="always", **CONTRACTED)
def _vectors(
    s: Scratch, material: ElementMaterial, stiffens: bool, convex: bool, positive: bool
) -> tuple[int, Vector, Vector]:
    """Write the force and the vectors that make up the tangent.

    Returns
    -------
    tuple
        Number of rank-one terms, ``crossed``, and a quarter of the present volume.
    """
    J, I1 = _kinematics(s)
    phi0, phi1, phi2 = _isochoric_factor(J)
    c2, v = load(s.material, 1), load(s.material, 3)
    weight = (load(s.material, 0) + 4.0 * c2 * (phi0 * I1 - 3.0)) * v
    m0, m1, m2 = weight * phi0, weight * phi1, weight * phi2
    p, stiffening = 0.0 * v, 0.0 * v
    for a in range(4):
        p = p + 0.25 * load(s.pressure, a)
    if material.plain:
        p = load(s.material, 2) * (J - 1.0)
        stiffening = load(s.material, 2) * J * J * v
    pJ = p * J * v
    normal = 0.5 * m1 * I1 + pJ
    for k in range(12):
        store(s.t, k, m1 * load(s.f, k))
        store(s.out, k, m0 * load(s.f, k) + normal * load(s.h, k))
    if convex:
        pJ = 0.0 * pJ
    straight = 0.5 * I1 * (m1 + m2) + pJ + stiffening
    crossed = -0.5 * m1 * I1 - pJ
    if positive:
        # A square: m0 |dF + (m1 / m0) F (F^-T : dF)|^2.
        straight = I1 * m1 * phi1 / phi0 + stiffening
        crossed = 0.0 * pJ
    for a in range(3):
        for b in range(a + 1, 4):
            product = load(s.g, 3 * a) * load(s.g, 3 * b)
            product = product + load(s.g, 3 * a + 1) * load(s.g, 3 * b + 1)
            product = product + load(s.g, 3 * a + 2) * load(s.g, 3 * b + 2)
            store(s.diagonal, 4 * a + b, m0 * product)
    ranks = 0
    if stiffens:
        store(s.rank_one, 0, 8.0 * c2 * v)
        for k in range(12):
            store(s.r, k, phi0 * load(s.f, k) + 0.5 * phi1 * I1 * load(s.h, k))
        ranks = 1
    for q in range(s.eta.shape[0]):
        p0, p1, p2 = 0.0 * v + 1.0, 0.0 * v, 0.0 * v
        if material.isochoric_fibre:
            p0, p1, p2 = phi0, phi1, phi2
        factor = p0, p1, p2
        more_straight, more_crossed = _family(
            s, q, ranks, factor, material.tension_only, convex, positive
        )
        straight, crossed = straight + more_straight, crossed + more_crossed
        ranks += 1
    for k in range(12):
        store(s.left, k, straight * load(s.h, k) + load(s.t, k))
    return ranks, crossed, 0.25 * J * v


@njit(inline="always", **CONTRACTED)
def _family(
    s: Scratch,
    q: int,
    rank: int,
    factor: tuple[Vector, Vector, Vector],
    tension_only: bool,
    convex: bool,
    positive: bool,
) -> tuple[Vector, Vector]:
    """Add one family of fibres; return its share in ``straight`` and ``crossed``."""
    p0, p1, p2 = factor
    v, eta = load(s.material, 3), load(s.eta, q)
    a0, a1, a2 = load(s.fibre, 3 * q), load(s.fibre, 3 * q + 1), load(s.fibre, 3 * q + 2)
    w0 = load(s.F, 0) * a0 + load(s.F, 1) * a1 + load(s.F, 2) * a2
    w1 = load(s.F, 3) * a0 + load(s.F, 4) * a1 + load(s.F, 5) * a2
    w2 = load(s.F, 6) * a0 + load(s.F, 7) * a1 + load(s.F, 8) * a2
    I4 = w0 * w0 + w1 * w1 + w2 * w2
    stretch = p0 * I4 - 1.0
    if tension_only:
        eta = where_below(stretch, 0.0, 0.0, eta)
    c = 2.0 * eta * v * stretch
    held = where_below(c, 0.0, 0.0, c) if convex else c
    half = 0.5 * p1 * I4
    store(s.rank_one, rank, 4.0 * eta * v)
    for a in range(4):
        g0, g1, g2 = load(s.g, 3 * a), load(s.g, 3 * a + 1), load(s.g, 3 * a + 2)
        z = g0 * a0 + g1 * a1 + g2 * a2
        store(s.z, a, z)
        for i, w in enumerate((w0, w1, w2)):
            k = 3 * a + i
            r = p0 * z * w + half * load(s.h, k)
            store(s.r, 12 * rank + k, r)
            store(s.out, k, load(s.out, k) + c * r)
            store(s.t, k, load(s.t, k) + held * p1 * z * w)
    for a in range(3):
        for b in range(a + 1, 4):
            k = 4 * a + b
            both = load(s.z, a) * load(s.z, b)
            store(s.diagonal, k, load(s.diagonal, k) + held * p0 * both)
    if positive:
        return I4 * held * p1 * p1 / p0, 0.0 * half
    return 0.5 * I4 * held * (p1 + p2), 0.0 - held * half


@njit(inline="always", **CONTRACTED)
def _blocks(s: Scratch, ranks: int, crossed: Vector, share: Vector) -> None:
    """Write the sixteen packed edges of each element into ``lines``."""
    for k in range(36):
        store(s.own, k, 0.0 * share)
    for a in range(3):
        for b in range(a + 1, 4):
            for i in range(3):
                left, swapped = load(s.left, 3 * a + i), crossed * load(s.h, 3 * b + i)
                for k in range(3):
                    value = left * load(s.h, 3 * b + k) + load(s.h, 3 * a + i) * load(
                        s.t, 3 * b + k
                    )
                    value = value + swapped * load(s.h, 3 * a + k)
                    for q in range(ranks):
                        r = load(s.rank_one, q) * load(s.r, 12 * q + 3 * a + i)
                        value = value + r * load(s.r, 12 * q + 3 * b + k)
                    if i == k:
                        value = value + load(s.diagonal, 4 * a + b)
                    store(s.block, 3 * i + k, value)
                    # Rigid translations cost no energy: rows of the element sum to zero.
                    here, there = 9 * a + 3 * i + k, 9 * b + 3 * k + i
                    store(s.own, here, load(s.own, here) - value)
                    store(s.own, there, load(s.own, there) - value)
            for i in range(3):
                k = 3 * i
                p = share * load(s.h, 3 * a + i) * load(s.root, b)
                row = load(s.block, k), load(s.block, k + 1), load(s.block, k + 2)
                store_interleaved(s.lines, 3 * (4 * a + b) + i, row[0], row[1], row[2], p)
                p = share * load(s.h, 3 * b + i) * load(s.root, a)
                row = load(s.block, i), load(s.block, i + 3), load(s.block, i + 6)
                store_interleaved(s.lines, 3 * (4 * b + a) + i, row[0], row[1], row[2], p)
    for a in range(4):
        for i in range(3):
            k = 9 * a + 3 * i
            p = share * load(s.h, 3 * a + i) * load(s.root, a)
            row = load(s.own, k), load(s.own, k + 1), load(s.own, k + 2)
            store_interleaved(s.lines, 15 * a + i, row[0], row[1], row[2], p)

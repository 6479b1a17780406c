"""Products and smoothing with the tangent: SpMV for one right-hand side, SpMM for `LANES`.

The tangent is ``K + B diag(D) B^T``: K in 3 x 3 blocks over the edges of the mesh, B
(the derivatives ``d v_j / d u_i`` of the nodal volumes) in 3-vectors over the same
edges, D = kappa_n / V_n per node.

An edge i-j is packed into twelve numbers, three rows of ``(K, K, K, B)`` with
``B sqrt(D_j)`` in the last place, and a vector has four at a node: ``(x, y, z, p)``
with ``p = sqrt(D) B^T x``, its *pressure*. A row of the product ``(K + B D B^T) x``
is then one sum of ``edge * (x, y, z, p)`` over the neighbours.

A vector has shape (n, 4) or, for several right-hand sides, (n, 4, LANES): then one
read of an edge serves all of them. A kernel is compiled for either shape; where the
fastest loop is another one, there are two, and the compiler chooses by the shape.

A smoothing sweep reads the matrix once: when node i has its new step, its share
in the pressure of the neighbours is scattered from the same packed edges. It needs block Jacobi,
the inverse 3 x 3 diagonal blocks of the tangent, which are computed from the packed rows. `free`,
(n, 3), is 1 where a displacement is unknown and 0 where it is held.

Demands on memory and processor, at 14.4 edges and 5.5 tetrahedra a node, and the
performance reached by one thread of a Zen 5 at 90k nodes:

======================= ============= ============ ======= ====================
work                    bytes a node  flops a node ms      reached
======================= ============= ============ ======= ====================
product                 750           350          2.6     26 GB/s, 12 Gflop/s
smoothing sweep         870           460          3.9     20 GB/s, 11 Gflop/s
product, 8 together     970           2,800        7.2     12 GB/s, 35 Gflop/s
sweep, 8 together       1,700         3,700        14      11 GB/s, 23 Gflop/s
assembly                2,600         5,000        60      4 GB/s, 8 Gflop/s
======================= ============= ============ ======= ====================

A product waits for memory at 90k nodes; at 20k its 14 MB stay in the cache and
it takes 0.23 ms. Assembly spends a third of its time on the force, a third on the
blocks and a third on adding each element's sixteen edges to the rows.
"""

from collections.abc import Callable

import numpy as np
from numba import njit, types
from numba.extending import overload

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.kernels_and_threads import CONTRACTED, AnyFloatArray, Float32Array, IndexArray
from palpate.workers.mechanics.fem.simd_vectors import (
    Vector,
    edge_add,
    edge_sums,
    edge_zero,
    lanes_of,
    load,
    store,
    zero,
)

Number = float | Vector
"""One number, or one for each right-hand side."""


Kernel = Callable[..., object]
_COMPILED = "only compiled code calls this, and runs one of the two below instead"


def _choose_by_shape(called: Kernel, of_one: Kernel, of_several: Kernel) -> None:
    """Dispatch compiled calls of `called` to one of two kernels by the shape of the vectors."""

    @overload(called, inline="always", strict=False)
    def choose(*arguments: types.Type) -> Kernel:
        several = any(isinstance(a, types.Array) and a.ndim == 3 for a in arguments)
        return of_several if several else of_one


def component(x: AnyFloatArray, i: int, a: int) -> Number:
    """Return component `a` of a vector at node `i`."""
    raise NotImplementedError(_COMPILED)


def _component_of_one(x: AnyFloatArray, i: int, a: int) -> float:
    return x[i, a]


def _component_of_several(x: AnyFloatArray, i: int, a: int) -> Vector:
    return load(x, 4 * i + a)


_choose_by_shape(component, _component_of_one, _component_of_several)


def set_component(x: AnyFloatArray, i: int, a: int, value: Number) -> None:
    """Set component `a` of a vector at node `i`."""
    raise NotImplementedError(_COMPILED)


def _set_component_of_one(x: AnyFloatArray, i: int, a: int, value: float) -> None:
    x[i, a] = value


def _set_component_of_several(x: AnyFloatArray, i: int, a: int, value: Vector) -> None:
    store(x, 4 * i + a, value)


_choose_by_shape(set_component, _set_component_of_one, _set_component_of_several)


@njit(**CONTRACTED)
def clear_held_rows(start: IntArray, free: Float32Array, rows: Float32Array) -> None:
    """Clear the rows of prescribed displacements, where `free`, (n, 3), is zero."""
    for i in range(free.shape[0]):
        for a in range(3):
            if free[i, a] == 0:
                for q in range(start[i], start[i + 1]):
                    rows[q, 4 * a : 4 * a + 4] = 0


def _row_product(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, i: int, x: AnyFloatArray
) -> tuple[Number, Number, Number]:
    """Return row i of the product; the pressure of `x` is set."""
    raise NotImplementedError(_COMPILED)


def _row_product_of_one(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, i: int, x: AnyFloatArray
) -> tuple[float, float, float]:
    total = edge_zero(x)
    for q in range(start[i], start[i + 1]):
        total = edge_add(total, rows, q, x, neighbour[q])
    return edge_sums(total)


def _row_product_of_several(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, i: int, x: AnyFloatArray
) -> tuple[Vector, Vector, Vector]:
    s0 = zero(x)
    s1 = zero(x)
    s2 = zero(x)
    for q in range(start[i], start[i + 1]):
        j = 4 * neighbour[q]
        x0, x1, x2, p = load(x, j), load(x, j + 1), load(x, j + 2), load(x, j + 3)
        s0 = s0 + rows[q, 0] * x0 + rows[q, 1] * x1 + rows[q, 2] * x2 + rows[q, 3] * p
        s1 = s1 + rows[q, 4] * x0 + rows[q, 5] * x1 + rows[q, 6] * x2 + rows[q, 7] * p
        s2 = s2 + rows[q, 8] * x0 + rows[q, 9] * x1 + rows[q, 10] * x2 + rows[q, 11] * p
    return s0, s1, s2


_choose_by_shape(_row_product, _row_product_of_one, _row_product_of_several)


def _scatter_pressure(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, i: int, x: AnyFloatArray
) -> None:
    """Add node i's share to the pressure of its neighbours."""
    raise NotImplementedError(_COMPILED)


def _scatter_pressure_of_one(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, i: int, x: AnyFloatArray
) -> None:
    x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
    for q in range(start[i], start[i + 1]):
        x[neighbour[q], 3] += rows[q, 3] * x0 + rows[q, 7] * x1 + rows[q, 11] * x2


def _scatter_pressure_of_several(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, i: int, x: AnyFloatArray
) -> None:
    x0, x1, x2 = load(x, 4 * i), load(x, 4 * i + 1), load(x, 4 * i + 2)
    for q in range(start[i], start[i + 1]):
        j = 4 * neighbour[q] + 3
        store(x, j, load(x, j) + rows[q, 3] * x0 + rows[q, 7] * x1 + rows[q, 11] * x2)


_choose_by_shape(_scatter_pressure, _scatter_pressure_of_one, _scatter_pressure_of_several)


@njit(**CONTRACTED)
def set_pressure(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, x: AnyFloatArray
) -> None:
    """Set the pressure of `x`, whose prescribed displacements are zero."""
    x[:, 3] = 0
    for i in range(x.shape[0]):
        _scatter_pressure(start, neighbour, rows, i, x)


@njit(**CONTRACTED)
def multiply(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, x: AnyFloatArray, y: AnyFloatArray
) -> None:
    """Set y = tangent times x, except for the pressure of `y`."""
    for i in range(x.shape[0]):
        s0, s1, s2 = _row_product(start, neighbour, rows, i, x)
        set_component(y, i, 0, s0)
        set_component(y, i, 1, s1)
        set_component(y, i, 2, s2)


@njit(**CONTRACTED)
def subtract_product(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, x: AnyFloatArray, r: AnyFloatArray
) -> None:
    """Subtract tangent times x from `r`."""
    for i in range(x.shape[0]):
        s0, s1, s2 = _row_product(start, neighbour, rows, i, x)
        set_component(r, i, 0, component(r, i, 0) - s0)
        set_component(r, i, 1, component(r, i, 1) - s1)
        set_component(r, i, 2, component(r, i, 2) - s2)


@njit(**CONTRACTED)
def first_step(
    start: IndexArray,
    neighbour: IndexArray,
    rows: Float32Array,
    inverse: Float32Array,
    scale: np.float32,
    r: Float32Array,
    step: Float32Array,
) -> None:
    """Set step = scale * inverse r with its pressure; `inverse` is block Jacobi, (n, 9)."""
    step[:, 3] = 0
    for i in range(r.shape[0]):
        r0, r1, r2 = component(r, i, 0), component(r, i, 1), component(r, i, 2)
        for a in range(3):
            z = inverse[i, 3 * a] * r0 + inverse[i, 3 * a + 1] * r1 + inverse[i, 3 * a + 2] * r2
            set_component(step, i, a, scale * z)
        _scatter_pressure(start, neighbour, rows, i, step)


@njit(**CONTRACTED)
def smoothing_sweep(
    start: IndexArray,
    neighbour: IndexArray,
    rows: Float32Array,
    inverse: Float32Array,
    momentum: np.float32,
    scale: np.float32,
    r: Float32Array,
    x: Float32Array,
    old: Float32Array,
    new: Float32Array,
    with_pressure: bool,
) -> None:
    """Take the step `old` and compute the next one.

    ``r -= tangent old``, ``new = momentum * old + scale * inverse r``, ``x += new``;
    the pressure of `new` only if `with_pressure`.
    """
    new[:, 3] = 0
    for i in range(x.shape[0]):
        s0, s1, s2 = _row_product(start, neighbour, rows, i, old)
        r0 = component(r, i, 0) - s0
        r1 = component(r, i, 1) - s1
        r2 = component(r, i, 2) - s2
        set_component(r, i, 0, r0)
        set_component(r, i, 1, r1)
        set_component(r, i, 2, r2)
        for a in range(3):
            z = inverse[i, 3 * a] * r0 + inverse[i, 3 * a + 1] * r1 + inverse[i, 3 * a + 2] * r2
            z = momentum * component(old, i, a) + scale * z
            set_component(new, i, a, z)
            set_component(x, i, a, component(x, i, a) + z)
        if with_pressure:
            _scatter_pressure(start, neighbour, rows, i, new)


def _add_rank_one(
    index: IndexArray, coupling: FloatArray, factor: float, x: AnyFloatArray, y: AnyFloatArray
) -> None:
    """Add factor * c (c . x) to `y`, with c = `coupling`, (c, 3), on the nodes `index`."""
    raise NotImplementedError(_COMPILED)


def _add_rank_one_to_one(
    index: IndexArray, coupling: FloatArray, factor: float, x: AnyFloatArray, y: AnyFloatArray
) -> None:
    s = 0.0
    for q in range(index.shape[0]):
        i = index[q]
        s += coupling[q, 0] * x[i, 0] + coupling[q, 1] * x[i, 1] + coupling[q, 2] * x[i, 2]
    s *= factor
    for q in range(index.shape[0]):
        i = index[q]
        for a in range(3):
            y[i, a] += s * coupling[q, a]


def _add_rank_one_to_several(
    index: IndexArray, coupling: FloatArray, factor: float, x: AnyFloatArray, y: AnyFloatArray
) -> None:
    s = zero(x)
    for q in range(index.shape[0]):
        for a in range(3):
            s = s + coupling[q, a] * load(x, 4 * index[q] + a)
    for q in range(index.shape[0]):
        for a in range(3):
            k = 4 * index[q] + a
            store(y, k, load(y, k) + factor * coupling[q, a] * s)


_choose_by_shape(_add_rank_one, _add_rank_one_to_one, _add_rank_one_to_several)


@njit(**CONTRACTED)
def add_rank_one(
    index: IndexArray, coupling: FloatArray, factor: float, x: AnyFloatArray, y: AnyFloatArray
) -> None:
    """Add factor * c (c . x) to `y`, with c = `coupling`, (c, 3), on the nodes `index`."""
    _add_rank_one(index, coupling, factor, x, y)


@njit(**CONTRACTED)
def dot(a: AnyFloatArray, b: AnyFloatArray) -> float:
    """Return a . b, both (n, 4), without the pressures, in double precision."""
    s0, s1, s2 = 0.0, 0.0, 0.0
    for i in range(a.shape[0]):
        s0 += a[i, 0] * b[i, 0]
        s1 += a[i, 1] * b[i, 1]
        s2 += a[i, 2] * b[i, 2]
    return s0 + s1 + s2


@njit(**CONTRACTED)
def dots(a: FloatArray, b: FloatArray, sums: FloatArray) -> None:
    """Set `sums`, (LANES,), to the products a . b of two blocks without their pressures."""
    s = zero(a)
    for i in range(a.shape[0]):
        for k in range(3):
            s = s + load(a, 4 * i + k) * load(b, 4 * i + k)
    store(sums, 0, s)


@njit(**CONTRACTED)
def take_step(
    alpha: float | FloatArray, p: FloatArray, y: FloatArray, x: FloatArray, r: FloatArray
) -> None:
    """Add alpha p to `x` and subtract alpha y from `r`; `alpha` is a number or (LANES,)."""
    length = lanes_of(alpha)
    for i in range(x.shape[0]):
        for a in range(3):
            set_component(x, i, a, component(x, i, a) + length * component(p, i, a))
            set_component(r, i, a, component(r, i, a) - length * component(y, i, a))


@njit(**CONTRACTED)
def update_direction(beta: float | FloatArray, z: AnyFloatArray, p: FloatArray) -> None:
    """Set p = z + beta p; `beta` is a number or (LANES,)."""
    share = lanes_of(beta)
    for i in range(p.shape[0]):
        for a in range(3):
            set_component(p, i, a, component(z, i, a) + share * component(p, i, a))


@njit(**CONTRACTED)
def invert_diagonal(
    start: IntArray,
    diagonal: IntArray,
    rows: Float32Array,
    free: Float32Array,
    inverse: Float32Array,
) -> None:
    """Set `inverse`, (n, 9), to inverse diagonal blocks, made positive; zero where held."""
    n = start.shape[0] - 1
    m = np.empty((3, 3))
    for i in range(n):
        q = diagonal[i]
        for a in range(3):
            for b in range(3):
                m[a, b] = 0.5 * (rows[q, 4 * a + b] + rows[q, 4 * b + a])
        for q in range(start[i], start[i + 1]):
            for a in range(3):
                for b in range(3):
                    m[a, b] += rows[q, 4 * a + 3] * rows[q, 4 * b + 3]
        shift = 1e-3 * (abs(m[0, 0]) + abs(m[1, 1]) + abs(m[2, 2])) / 3.0
        for a in range(3):
            m[a, a] = abs(m[a, a]) + shift
            if free[i, a] == 0:
                for b in range(3):
                    m[a, b] = 0.0
                    m[b, a] = 0.0
                m[a, a] = 1.0
        _invert_positive(m, shift)
        for a in range(3):
            for b in range(3):
                held = free[i, a] == 0 or free[i, b] == 0
                inverse[i, 3 * a + b] = 0.0 if held else m[a, b]


@njit(inline="always", **CONTRACTED)
def _invert_positive(m: FloatArray, shift: float) -> None:
    """Invert a symmetric 3 x 3 matrix in place, damping off-diagonals until it is positive."""
    for _ in range(40):
        c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
        c01 = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
        c02 = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
        det = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
        minor = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
        if minor > 0.0 and det > 1e-6 * m[0, 0] * m[1, 1] * m[2, 2]:
            break
        for a in range(3):
            for b in range(3):
                if a != b:
                    m[a, b] *= 0.7
    r = 1.0 / det
    i00, i01, i02 = c00 * r, (m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]) * r, 0.0
    i02 = (m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]) * r
    i11 = (m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]) * r
    i12 = (m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2]) * r
    i22 = minor * r
    m[0, 0], m[1, 1], m[2, 2] = i00, i11, i22
    m[0, 1], m[1, 0] = i01, i01
    m[0, 2], m[2, 0] = i02, i02
    m[1, 2], m[2, 1] = i12, i12


@njit(**CONTRACTED)
def apply_diagonal(inverse: Float32Array, r: Float32Array, z: Float32Array) -> None:
    """Set z = inverse r, block by block; both (n, 4)."""
    for i in range(r.shape[0]):
        r0, r1, r2 = r[i, 0], r[i, 1], r[i, 2]
        z[i, 0] = inverse[i, 0] * r0 + inverse[i, 1] * r1 + inverse[i, 2] * r2
        z[i, 1] = inverse[i, 3] * r0 + inverse[i, 4] * r1 + inverse[i, 5] * r2
        z[i, 2] = inverse[i, 6] * r0 + inverse[i, 7] * r1 + inverse[i, 8] * r2

"""Factorisation of the tangent of a long, thin body within its envelope.

A section of a cornea is about a hundred elements long and a few thick. With nodes ordered along
it (reverse Cuthill-McKee), every row of the tangent extends only to its neighbours, and
elimination causes no fill beyond them. The envelope is stored in tiles of 8 x 8, one tile row
after another, and eliminated tile by tile with short vectors. The load stiffness of a pressure
is not symmetric, hence L U; there is no pivoting, so a vanishing pivot is reported, not
avoided.

Measured on 960 triangles (4,302 unknowns): 1.0 ms, compared with 16 ms for SuperLU; a solution
takes 0.17 ms.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.kernels_and_threads import CONTRACTED
from palpate.workers.mechanics.fem.simd_vectors import LANES, load, store, zero

# A pivot this much smaller than the largest entry of its column has no accurate digits.
SMALLEST_PIVOT = 1e-14


class Envelope(NamedTuple):
    """The storage layout of a matrix.

    Parameters
    ----------
    first, last : ndarray of int32, shape (t,)
        Range of tile columns in tile row i; neither ever decreases.
    tile_starts : ndarray of int32, shape (t + 1,)
        Start of tile row i in the values, in LANES numbers.
    row_starts : ndarray of int32, shape (8 t,)
        Entry (i, j) is ``values[row_starts[i] + j]``.
    """

    first: IntArray
    last: IntArray
    tile_starts: IntArray
    row_starts: IntArray


def node_order(triangles: IntArray, n_nodes: int) -> IntArray:
    """Return the nodes in an order that keeps neighbours close."""
    rows = np.repeat(triangles, triangles.shape[1], axis=1).ravel()
    columns = np.tile(triangles, triangles.shape[1]).ravel()
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), (n_nodes, n_nodes))
    return np.asarray(reverse_cuthill_mckee(graph.tocsr(), symmetric_mode=True), dtype=np.int32)


def envelope_of(groups: IntArray, n: int) -> Envelope:
    """Return the envelope of a matrix of n unknowns.

    Parameters
    ----------
    groups : ndarray of int32, shape (m, k)
        Coupled unknowns; -1 for none.
    """
    tiles = -(-n // LANES)
    low = np.where(groups < 0, n, groups).min(axis=1) // LANES
    high = groups.max(axis=1) // LANES
    some = high >= 0
    last = np.arange(tiles)
    np.maximum.at(last, low[some], high[some])
    last = np.maximum.accumulate(last)
    first = np.searchsorted(last, np.arange(tiles))
    width = last - first + 1
    tile_starts = np.concatenate([[0], np.cumsum(width * LANES)])
    row = np.arange(tiles * LANES)
    tile = row // LANES
    row_starts = LANES * (tile_starts[tile] + (row % LANES) * width[tile] - first[tile])
    return Envelope(*(a.astype(np.int32) for a in (first, last, tile_starts, row_starts)))


@dataclass(frozen=True, eq=False)
class Factors:
    """The factors L and U of a matrix.

    Parameters
    ----------
    envelope : Envelope
    values : ndarray
    n : int
        Number of unknowns.
    negative_pivots : int
        For a symmetric matrix, the number of its negative eigenvalues.
    singular : bool
        Elimination met a pivot without accurate digits, or a number that is not finite.
    """

    envelope: Envelope
    values: FloatArray
    n: int
    negative_pivots: int
    singular: bool

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve for one right-hand side, (n,), or several, (k, n)."""
        padded = np.zeros((*right.shape[:-1], len(self.envelope.row_starts)))
        padded[..., : self.n] = right
        for b in padded.reshape(-1, padded.shape[-1]):
            _substitute(self.envelope, self.values, b)
        return padded[..., : self.n].copy()


def new_values(envelope: Envelope) -> FloatArray:
    """Return zeros for the entries of a matrix."""
    return np.zeros(int(envelope.tile_starts[-1]) * LANES)


def factorise(envelope: Envelope, values: FloatArray, n: int) -> Factors:
    """Factorise in place; the factors take over the values."""
    for i in range(n, len(envelope.row_starts)):
        values[envelope.row_starts[i] + i] = 1.0
    negative, singular = _eliminate(envelope, values)
    return Factors(envelope, values, n, negative, singular)


@njit(**CONTRACTED)
def _eliminate_tile(
    envelope: Envelope, a: FloatArray, t: int, inverse: FloatArray
) -> tuple[int, bool]:
    """Eliminate within tile row t and invert its upper triangle into `inverse`, (8, 8)."""
    width = envelope.last[t] - envelope.first[t] + 1
    diagonal = t - envelope.first[t]
    negative, singular = 0, False
    for p in range(LANES):
        row = t * LANES + p
        top = envelope.tile_starts[t] + p * width
        pivot = a[envelope.row_starts[row] + row]
        largest = abs(pivot)
        for i in range(row + 1, (t + 1) * LANES):
            largest = max(largest, abs(a[envelope.row_starts[i] + row]))
        if not abs(pivot) > SMALLEST_PIVOT * largest:
            singular = True
        negative += pivot < 0.0
        for i in range(row + 1, (t + 1) * LANES):
            factor = a[envelope.row_starts[i] + row] / pivot
            below = envelope.tile_starts[t] + (i - t * LANES) * width
            a[envelope.row_starts[i] + row] = factor
            for j in range(row + 1, (t + 1) * LANES):
                a[envelope.row_starts[i] + j] -= factor * a[envelope.row_starts[row] + j]
            for s in range(diagonal + 1, width):
                store(a, below + s, load(a, below + s) - factor * load(a, top + s))
    for column in range(LANES):
        for p in range(LANES):
            inverse[p, column] = 0.0
        for p in range(column, -1, -1):
            start = envelope.row_starts[t * LANES + p] + t * LANES
            value = 1.0 if p == column else 0.0
            for k in range(p + 1, column + 1):
                value -= a[start + k] * inverse[k, column]
            inverse[p, column] = value / a[start + p]
    return negative, singular


@njit(**CONTRACTED)
def _eliminate(envelope: Envelope, a: FloatArray) -> tuple[int, bool]:
    """Eliminate tile by tile; return the number of negative pivots and whether one vanished."""
    inverse = np.empty((LANES, LANES))
    flat = inverse.reshape(-1)
    L = np.empty((LANES, LANES))
    lower = L.reshape(-1)
    negatives, singular = 0, False
    for t in range(len(envelope.first)):
        negative, vanished = _eliminate_tile(envelope, a, t, inverse)
        negatives += negative
        singular |= vanished
        width = envelope.last[t] - envelope.first[t] + 1
        top = envelope.tile_starts[t] - envelope.first[t]
        for r in range(t + 1, envelope.last[t] + 1):
            wide = envelope.last[r] - envelope.first[r] + 1
            row = envelope.tile_starts[r] - envelope.first[r]
            for i in range(LANES):
                offset = row + i * wide + t
                v = a[offset * LANES] * load(flat, 0)
                for k in range(1, LANES):
                    v = v + a[offset * LANES + k] * load(flat, k)
                store(a, offset, v)
                store(lower, i, v)
            for s in range(t + 1, envelope.last[t] + 1):
                offset = row + s
                a0, a1 = load(a, offset), load(a, offset + wide)
                a2, a3 = load(a, offset + 2 * wide), load(a, offset + 3 * wide)
                a4, a5 = load(a, offset + 4 * wide), load(a, offset + 5 * wide)
                a6, a7 = load(a, offset + 6 * wide), load(a, offset + 7 * wide)
                for k in range(LANES):
                    u = load(a, top + k * width + s)
                    a0 = a0 - L[0, k] * u
                    a1 = a1 - L[1, k] * u
                    a2 = a2 - L[2, k] * u
                    a3 = a3 - L[3, k] * u
                    a4 = a4 - L[4, k] * u
                    a5 = a5 - L[5, k] * u
                    a6 = a6 - L[6, k] * u
                    a7 = a7 - L[7, k] * u
                store(a, offset, a0)
                store(a, offset + wide, a1)
                store(a, offset + 2 * wide, a2)
                store(a, offset + 3 * wide, a3)
                store(a, offset + 4 * wide, a4)
                store(a, offset + 5 * wide, a5)
                store(a, offset + 6 * wide, a6)
                store(a, offset + 7 * wide, a7)
    return negatives, singular


@njit(**CONTRACTED)
def _substitute(envelope: Envelope, a: FloatArray, b: FloatArray) -> None:
    """Overwrite b, padded to whole tiles, with the solution."""
    tiles = len(envelope.first)
    products = np.empty((LANES, LANES))
    flat = products.reshape(-1)
    for t in range(tiles):
        _tile_row_product(envelope, a, b, t, envelope.first[t], t, flat)
        for i in range(LANES):
            row = t * LANES + i
            total = 0.0
            for k in range(LANES):
                total += products[i, k]
            for j in range(t * LANES, row):
                total += a[envelope.row_starts[row] + j] * b[j]
            b[row] -= total
    for t in range(tiles - 1, -1, -1):
        _tile_row_product(envelope, a, b, t, t + 1, envelope.last[t] + 1, flat)
        for i in range(LANES - 1, -1, -1):
            row = t * LANES + i
            total = 0.0
            for k in range(LANES):
                total += products[i, k]
            for j in range(row + 1, (t + 1) * LANES):
                total += a[envelope.row_starts[row] + j] * b[j]
            b[row] = (b[row] - total) / a[envelope.row_starts[row] + row]


@njit(**CONTRACTED)
def _tile_row_product(
    envelope: Envelope, a: FloatArray, b: FloatArray, t: int, begin: int, end: int, out: FloatArray
) -> None:
    """Write the products of the rows of a tile row with b, lane by lane, into out, (64,)."""
    wide = envelope.last[t] - envelope.first[t] + 1
    v0 = v1 = v2 = v3 = v4 = v5 = v6 = v7 = zero(b)
    for s in range(begin, end):
        offset = envelope.tile_starts[t] + s - envelope.first[t]
        x = load(b, s)
        v0 = v0 + load(a, offset) * x
        v1 = v1 + load(a, offset + wide) * x
        v2 = v2 + load(a, offset + 2 * wide) * x
        v3 = v3 + load(a, offset + 3 * wide) * x
        v4 = v4 + load(a, offset + 4 * wide) * x
        v5 = v5 + load(a, offset + 5 * wide) * x
        v6 = v6 + load(a, offset + 6 * wide) * x
        v7 = v7 + load(a, offset + 7 * wide) * x
    store(out, 0, v0)
    store(out, 1, v1)
    store(out, 2, v2)
    store(out, 3, v3)
    store(out, 4, v4)
    store(out, 5, v5)
    store(out, 6, v6)
    store(out, 7, v7)

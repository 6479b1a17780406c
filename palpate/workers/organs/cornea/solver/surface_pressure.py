r"""Pressure on a deforming curved surface, with its load stiffness.

A surface runs from left to right along quadratic edges. With the tangent
:math:`t = \sum_m N_m' x_m` and Q a quarter turn to the left, a pressure p against the left
normal gives the nodal forces

.. math:: f_n = - \int p \, N_n \, Q t \, d\xi \quad (\text{times } r \text{ per radian}).

The pressure acts on a piece of the undeformed surface. An edge partly covered by a jet is
integrated over the covered part only, and an edge that contains a corner of the profile is
integrated piecewise, so the force has no quadrature error.

References: K. Schweizerhof and E. Ramm, Comput. Struct. 18 (1984) 1099-1114.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.compile_flags import CONTRACTED
from palpate.workers.organs.cornea.material.load import CorneaLoad
from palpate.workers.organs.cornea.solver.envelope_lu import Envelope

# Four points: degree 7, for N (2), t (1), r (2) and a linear pressure (2).
_GAUSS, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(4)
# Edges are cut no closer to their ends than this fraction of their length.
_NEGLIGIBLE = 1e-12
_NEGLIGIBLE_MM = 1e-9


class SurfacePoints(NamedTuple):
    """Quadrature points of a pressed surface.

    Parameters
    ----------
    nodes : ndarray of int32, shape (k, 3)
        Start, middle and end of the edge.
    shape, slope : ndarray, shape (k, 3)
        Shape functions and their derivatives in xi.
    weights : ndarray, shape (k,)
        Fraction of the pressure times the weight of the point; negative if the pressure acts
        along the left normal.
    side : ndarray, shape (k,)
        Sign of the radius, or zero in a plane.
    """

    nodes: IntArray
    shape: FloatArray
    slope: FloatArray
    weights: FloatArray
    side: FloatArray


def edges_along(surface: IntArray) -> IntArray:
    """Return the edges (start, middle, end), (k, 3), of a row of nodes."""
    return np.stack([surface[:-2:2], surface[1:-1:2], surface[2::2]], axis=1)


def posterior_points(nodes_mm: FloatArray, surface: IntArray, axisymmetric: bool) -> SurfacePoints:
    """Return the points of a surface under a pressure along its left normal."""
    edges = edges_along(surface)
    pieces = [(e, -1.0, 1.0) for e in range(len(edges))]
    points = _points(nodes_mm, edges, pieces, axisymmetric)
    return points._replace(weights=-points.weights)


def jet_points(
    nodes_mm: FloatArray, surface: IntArray, load: CorneaLoad, axisymmetric: bool
) -> SurfacePoints:
    """Return the points of a surface under an air jet.

    Raises
    ------
    InputError
        If the jet extends beyond the surface.
    """
    profile = load.profile
    r_mm = np.asarray(profile.r_mm)
    left, right = load.jet_centre_mm - r_mm[-1], load.jet_centre_mm + r_mm[-1]
    x = nodes_mm[surface, 0]
    # An axisymmetric section may be only one half.
    begin = left if not axisymmetric else max(left, min(x[0], 0.0))
    if begin < x[0] - _NEGLIGIBLE_MM or right > x[-1] + _NEGLIGIBLE_MM:
        raise InputError(
            f"The air jet covers {left:.3f} to {right:.3f} mm, the anterior surface only "
            f"{x[0]:.3f} to {x[-1]:.3f} mm. Give a smaller diameter or another centre."
        )
    if axisymmetric and load.jet_centre_mm != 0:
        raise InputError(
            "The jet on an axisymmetric cornea must be centred, got the centre "
            f"{load.jet_centre_mm:g} mm. Choose plane stress or plane strain to move it."
        )
    edges = edges_along(surface)
    knots = np.unique(np.concatenate([load.jet_centre_mm - r_mm, load.jet_centre_mm + r_mm]))
    pieces = []
    for e, (start, middle, end) in enumerate(nodes_mm[edges, 0].tolist()):
        if end <= left or start >= right:
            continue
        inside = knots[(knots > start) & (knots < end)].tolist()
        cuts = [_where_on_edge(start, middle, end, knot) for knot in inside]
        for a, b in zip([-1.0, *cuts], [*cuts, 1.0], strict=True):
            shape = _shape(np.array([(a + b) / 2]))[0]
            if b - a > _NEGLIGIBLE and left < shape @ (start, middle, end) < right:
                pieces.append((e, a, b))
    points = _points(nodes_mm, edges, pieces, axisymmetric)
    distance = np.abs((points.shape * nodes_mm[points.nodes, 0]).sum(axis=1) - load.jet_centre_mm)
    return points._replace(weights=points.weights * profile.at(distance))


def _shape(xi: FloatArray) -> FloatArray:
    """Return the shape functions of an edge, (k, 3)."""
    return np.stack([xi * (xi - 1) / 2, 1 - xi**2, xi * (xi + 1) / 2], axis=1)


def _where_on_edge(start: float, middle: float, end: float, x: float) -> float:
    """Return xi at which an edge with ascending x crosses x."""
    # a xi^2 + b xi + c = 0, in a form without cancellation for a straight edge.
    a, b, c = (start + end) / 2 - middle, (end - start) / 2, middle - x
    return -2 * c / (b + math.sqrt(b * b - 4 * a * c))


def _points(
    nodes_mm: FloatArray,
    edges: IntArray,
    pieces: list[tuple[int, float, float]],
    axisymmetric: bool,
) -> SurfacePoints:
    """Return the Gauss points of pieces (edge, from xi, to xi)."""
    which = np.array([e for e, _, _ in pieces])
    a, b = (np.array([piece[k] for piece in pieces])[:, None] for k in (1, 2))
    xi = ((a + b) / 2 + (b - a) / 2 * _GAUSS).ravel()
    weights = ((b - a) / 2 * _GAUSS_WEIGHTS).ravel()
    nodes = np.repeat(edges[which], len(_GAUSS), axis=0)
    shape = _shape(xi)
    slope = np.stack([xi - 0.5, -2 * xi, xi + 0.5], axis=1)
    side = np.sign((shape * nodes_mm[nodes, 0]).sum(axis=1)) * axisymmetric
    return SurfacePoints(nodes.astype(np.int32), shape, slope, weights, side)


@njit(**CONTRACTED)
def add_pressure(
    x: FloatArray,
    points: SurfacePoints,
    pressure: float,
    equations: IntArray,
    residual: FloatArray,
    envelope: Envelope,
    values: FloatArray,
) -> None:
    """Subtract the force of a pressure from the residual, and its stiffness from the tangent.

    Parameters
    ----------
    x : ndarray, shape (n, 2)
        Deformed nodes in mm.
    points : SurfacePoints
    pressure : float
        MPa.
    equations, residual, envelope, values
        As in `t6_assembly.assemble`.
    """
    with_tangent = len(values) > 0
    for k in range(len(points.weights)):
        t1, t2, r = 0.0, 0.0, 0.0
        for n in range(3):
            node = points.nodes[k, n]
            t1 += points.slope[k, n] * x[node, 0]
            t2 += points.slope[k, n] * x[node, 1]
            r += points.shape[k, n] * x[node, 0]
        side = points.side[k]
        radius = 1.0 if side == 0.0 else side * r
        w = pressure * points.weights[k]
        for n in range(3):
            wn = w * points.shape[k, n]
            row1 = equations[points.nodes[k, n], 0]
            row2 = equations[points.nodes[k, n], 1]
            # The force is -w N Q t r, Q t = (-t2, t1); the residual is internal minus external.
            if row1 >= 0:
                residual[row1] -= wn * t2 * radius
            if row2 >= 0:
                residual[row2] += wn * t1 * radius
            if not with_tangent:
                continue
            for m in range(3):
                column1 = equations[points.nodes[k, m], 0]
                column2 = equations[points.nodes[k, m], 1]
                turn = wn * points.slope[k, m] * radius
                widen = wn * points.shape[k, m] * side
                if row1 >= 0 and column1 >= 0:
                    values[envelope.row_starts[row1] + column1] -= widen * t2
                if row1 >= 0 and column2 >= 0:
                    values[envelope.row_starts[row1] + column2] -= turn
                if row2 >= 0 and column1 >= 0:
                    values[envelope.row_starts[row2] + column1] += turn + widen * t1

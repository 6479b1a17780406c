r"""Forces and tangents of 6-node triangles, and of a pressure on their curved edges.

Triangles are total Lagrangian. An element is described relative to its stress-free state. With the
gradient :math:`F_0` from that state to the one in the image (1 without pre-stretch), the total
gradient is :math:`F = F_0 + \sum_n u_n \otimes \tilde G_n`, :math:`\tilde G_n = G_n F_0`,
where G are gradients in the image; except for weights :math:`w / \det F_0` nothing else
changes. The stress may have an initial part, :math:`S = S(F) + S_0`.

With the nominal stress P = F S and its slope

.. math:: A_{iJkL} = F_{iM} D_{MJNL} F_{kN} + \delta_{ik} S_{JL} ,

the force of node n is :math:`w P_{iJ} G_{nJ}` and the tangent between nodes n and m
:math:`w G_{nJ} A_{iJkL} G_{mL}`. An axisymmetric section has the hoop as a fifth component,
with N/R as its gradient. The six nodes of a triangle are contiguous in a short vector.

A surface under pressure runs from left to right along quadratic edges and deforms, so it has a load
stiffness. With the tangent :math:`t = \sum_m N_m' x_m` and Q a quarter turn to the left, a
pressure p against the left normal gives the nodal forces

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
from palpate.workers.kernels_and_threads import CONTRACTED
from palpate.workers.mechanics.fem.simd_vectors import LANES, load, store
from palpate.workers.organs.cornea.corneal_model import CorneaLoad, OgdenLaw
from palpate.workers.organs.cornea.corneal_ogden import AXISYMMETRIC, second_piola
from palpate.workers.organs.cornea.envelope_lu import Envelope

NOTHING = np.empty(0)


class Elements(NamedTuple):
    """Triangles and their stress-free state.

    Parameters
    ----------
    triangles : ndarray of int32, shape (m, 6)
    gradients : ndarray, shape (m, q, 2, 8)
        Gradients of the six shape functions in the stress-free state, in 1/mm.
    hoop : ndarray, shape (m, q, 8)
        Shape functions over the stress-free radius in 1/mm.
    weights : ndarray, shape (m, q)
        Stress-free measure of a point.
    prestretch : ndarray, shape (m, q, 4)
        F11, F12, F21, F22 at zero displacement.
    out_of_plane : ndarray, shape (m, q)
        Hoop stretch at zero displacement.
    initial_stress : ndarray, shape (m, q, 4)
        S11, S22, S12, S33 in MPa.
    stiffness : ndarray, shape (m,)
        Factor of the moduli.
    """

    triangles: IntArray
    gradients: FloatArray
    hoop: FloatArray
    weights: FloatArray
    prestretch: FloatArray
    out_of_plane: FloatArray
    initial_stress: FloatArray
    stiffness: FloatArray


@njit(inline="always", **CONTRACTED)
def _deformation(
    u: FloatArray, elements: Elements, e: int, q: int
) -> tuple[float, float, float, float, float]:
    """Return F11, F12, F21, F22 and the hoop stretch."""
    f11, f12 = elements.prestretch[e, q, 0], elements.prestretch[e, q, 1]
    f21, f22 = elements.prestretch[e, q, 2], elements.prestretch[e, q, 3]
    f33 = elements.out_of_plane[e, q]
    for n in range(6):
        node = elements.triangles[e, n]
        g1, g2 = elements.gradients[e, q, 0, n], elements.gradients[e, q, 1, n]
        u1, u2 = u[node, 0], u[node, 1]
        f11 += u1 * g1
        f12 += u1 * g2
        f21 += u2 * g1
        f22 += u2 * g2
        f33 += u1 * elements.hoop[e, q, n]
    return f11, f12, f21, f22, f33


@njit(**CONTRACTED)
def _nominal_slope(
    f11: float,
    f12: float,
    f21: float,
    f22: float,
    f33: float,
    S: FloatArray,
    D: FloatArray,
    A: FloatArray,
) -> None:
    """Write the derivatives of P11, P12, P21, P22, P33 in the components of F into A, (5, 5)."""
    # Rows: derivatives of (E11, E22, 2 E12, E33) in each component of F.
    columns = ((f11, 0.0, f12), (0.0, f12, f11), (f21, 0.0, f22), (0.0, f22, f21))
    for i in range(4):
        a, b, c = columns[i]
        d0 = a * D[0, 0] + b * D[1, 0] + c * D[2, 0]
        d1 = a * D[0, 1] + b * D[1, 1] + c * D[2, 1]
        d2 = a * D[0, 2] + b * D[1, 2] + c * D[2, 2]
        for j in range(i, 4):
            x, y, z = columns[j]
            A[i, j] = d0 * x + d1 * y + d2 * z
            A[j, i] = A[i, j]
        A[i, 4] = f33 * (a * D[0, 3] + b * D[1, 3] + c * D[2, 3])
        A[4, i] = A[i, 4]
    A[4, 4] = f33 * f33 * D[3, 3] + S[3]
    for i in (0, 2):
        A[i, i] += S[0]
        A[i + 1, i + 1] += S[1]
        A[i, i + 1] += S[2]
        A[i + 1, i] += S[2]


@njit(**CONTRACTED)
def _add_tangent(
    elements: Elements, e: int, q: int, A: FloatArray, kind: int, tangent: FloatArray
) -> None:
    """Add ``w G A G`` of one point to the tangent, (2, 6, 2, 8): component and node, twice."""
    gradients, hoop = elements.gradients, elements.hoop
    w = elements.weights[e, q]
    point = e * elements.weights.shape[1] + q
    g1, g2 = w * load(gradients, 2 * point), w * load(gradients, 2 * point + 1)
    # Columns by the x and the y components of the nodes, for each row of A.
    x0, y0 = A[0, 0] * g1 + A[0, 1] * g2, A[0, 2] * g1 + A[0, 3] * g2
    x1, y1 = A[1, 0] * g1 + A[1, 1] * g2, A[1, 2] * g1 + A[1, 3] * g2
    x2, y2 = A[2, 0] * g1 + A[2, 1] * g2, A[2, 2] * g1 + A[2, 3] * g2
    x3, y3 = A[3, 0] * g1 + A[3, 1] * g2, A[3, 2] * g1 + A[3, 3] * g2
    if kind == AXISYMMETRIC:
        h = w * load(hoop, point)
        x0, x1, x2, x3 = x0 + A[0, 4] * h, x1 + A[1, 4] * h, x2 + A[2, 4] * h, x3 + A[3, 4] * h
        x4 = A[4, 0] * g1 + A[4, 1] * g2 + A[4, 4] * h
        y4 = A[4, 2] * g1 + A[4, 3] * g2
        for n in range(6):
            hn = hoop[e, q, n]
            store(tangent, 2 * n, load(tangent, 2 * n) + hn * x4)
            store(tangent, 2 * n + 1, load(tangent, 2 * n + 1) + hn * y4)
    for n in range(6):
        a, b = gradients[e, q, 0, n], gradients[e, q, 1, n]
        x, y = 2 * n, 12 + 2 * n
        store(tangent, x, load(tangent, x) + a * x0 + b * x1)
        store(tangent, x + 1, load(tangent, x + 1) + a * y0 + b * y1)
        store(tangent, y, load(tangent, y) + a * x2 + b * x3)
        store(tangent, y + 1, load(tangent, y + 1) + a * y2 + b * y3)


@njit(**CONTRACTED)
def _scatter(
    rows: IntArray,
    force: FloatArray,
    tangent: FloatArray,
    residual: FloatArray,
    envelope: Envelope,
    values: FloatArray,
) -> None:
    """Add force and tangent of one triangle; its unknowns in x, then in y, are `rows`, (2, 6)."""
    for i in range(2):
        for n in range(6):
            row = rows[i, n]
            if row < 0:
                continue
            residual[row] += force[i, n]
            if len(values) == 0:
                continue
            start = envelope.row_starts[row]
            for j in range(2):
                for m in range(6):
                    if rows[j, m] >= 0:
                        values[start + rows[j, m]] += tangent[i, n, j, m]


@njit(**CONTRACTED)
def assemble(
    u: FloatArray,
    elements: Elements,
    law: OgdenLaw,
    kind: int,
    equations: IntArray,
    residual: FloatArray,
    envelope: Envelope,
    values: FloatArray,
) -> float:
    """Add the internal force and, if `values` is not empty, the tangent.

    Parameters
    ----------
    u : ndarray, shape (n, 2)
        Displacement in mm from the state of the prestretch.
    elements : Elements
    law : OgdenLaw
    kind : int
        See `ogden_stress`.
    equations : ndarray of int32, shape (n, 2)
        Unknown of each component, -1 if it is held.
    residual : ndarray, shape (unknowns,)
        In N per mm of thickness, or N per radian.
    envelope : Envelope
    values : ndarray

    Returns
    -------
    float
        Smallest volume ratio; zero, with the other results meaningless, if a triangle is
        inverted.
    """
    S, D, A = np.empty(4), np.empty((4, 4)), np.empty((5, 5))
    powers = np.empty((len(law.exponent), 3))
    force, tangent = np.empty((2, 6)), np.empty((2, 6, 2, LANES))
    rows = np.empty((2, 6), dtype=np.int32)
    with_tangent = len(values) > 0
    smallest = np.inf
    for e in range(elements.triangles.shape[0]):
        force[:] = 0.0
        if with_tangent:
            tangent[:] = 0.0
        for q in range(elements.weights.shape[1]):
            f11, f12, f21, f22, f33 = _deformation(u, elements, e, q)
            if not (f11 * f22 - f12 * f21 > 0.0 and f33 > 0.0):
                return 0.0
            J = second_piola(
                f11 * f11 + f21 * f21,
                f12 * f12 + f22 * f22,
                f11 * f12 + f21 * f22,
                f33,
                law,
                elements.stiffness[e],
                kind,
                with_tangent,
                powers,
                S,
                D,
            )
            smallest = min(smallest, J)
            for a in range(4):
                S[a] += elements.initial_stress[e, q, a]
            w = elements.weights[e, q]
            p11, p12 = w * (f11 * S[0] + f12 * S[2]), w * (f11 * S[2] + f12 * S[1])
            p21, p22 = w * (f21 * S[0] + f22 * S[2]), w * (f21 * S[2] + f22 * S[1])
            p33 = w * f33 * S[3]
            for n in range(6):
                g1, g2 = elements.gradients[e, q, 0, n], elements.gradients[e, q, 1, n]
                force[0, n] += p11 * g1 + p12 * g2 + p33 * elements.hoop[e, q, n]
                force[1, n] += p21 * g1 + p22 * g2
            if with_tangent:
                _nominal_slope(f11, f12, f21, f22, f33, S, D, A)
                _add_tangent(elements, e, q, A, kind, tangent)
        for n in range(6):
            rows[0, n] = equations[elements.triangles[e, n], 0]
            rows[1, n] = equations[elements.triangles[e, n], 1]
        _scatter(rows, force, tangent, residual, envelope, values)
    return smallest


@njit(**CONTRACTED)
def deformed_state(
    u: FloatArray, elements: Elements, law: OgdenLaw, kind: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the total gradient, the out-of-plane stretch and the total stress.

    Returns
    -------
    gradient : ndarray, shape (m, q, 4)
        F11, F12, F21, F22 from the stress-free state.
    out_of_plane : ndarray, shape (m, q)
    stress : ndarray, shape (m, q, 4)
        S11, S22, S12, S33 in MPa, including the initial stress.
    """
    m, points = elements.weights.shape
    gradient, stress = np.empty((m, points, 4)), np.empty((m, points, 4))
    out_of_plane = np.empty((m, points))
    powers = np.empty((len(law.exponent), 3))
    S, D = np.empty(4), np.empty((4, 4))
    for e in range(m):
        for q in range(points):
            f11, f12, f21, f22, f33 = _deformation(u, elements, e, q)
            J = second_piola(
                f11 * f11 + f21 * f21,
                f12 * f12 + f22 * f22,
                f11 * f12 + f21 * f22,
                f33,
                law,
                elements.stiffness[e],
                kind,
                False,
                powers,
                S,
                D,
            )
            gradient[e, q, 0], gradient[e, q, 1] = f11, f12
            gradient[e, q, 2], gradient[e, q, 3] = f21, f22
            out_of_plane[e, q] = J / (f11 * f22 - f12 * f21)
            for a in range(4):
                stress[e, q, a] = S[a] + elements.initial_stress[e, q, a]
    return gradient, out_of_plane, stress


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
    points = _edge_points(nodes_mm, edges, pieces, axisymmetric)
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
            shape = _edge_shape(np.array([(a + b) / 2]))[0]
            if b - a > _NEGLIGIBLE and left < shape @ (start, middle, end) < right:
                pieces.append((e, a, b))
    points = _edge_points(nodes_mm, edges, pieces, axisymmetric)
    distance = np.abs((points.shape * nodes_mm[points.nodes, 0]).sum(axis=1) - load.jet_centre_mm)
    return points._replace(weights=points.weights * profile.at(distance))


def _edge_shape(xi: FloatArray) -> FloatArray:
    """Return the shape functions of an edge, (k, 3)."""
    return np.stack([xi * (xi - 1) / 2, 1 - xi**2, xi * (xi + 1) / 2], axis=1)


def _where_on_edge(start: float, middle: float, end: float, x: float) -> float:
    """Return xi at which an edge with ascending x crosses x."""
    # a xi^2 + b xi + c = 0, in a form without cancellation for a straight edge.
    a, b, c = (start + end) / 2 - middle, (end - start) / 2, middle - x
    return -2 * c / (b + math.sqrt(b * b - 4 * a * c))


def _edge_points(
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
    shape = _edge_shape(xi)
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
        As in `assemble`.
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

"""Support of a cornea at its limbus: clamped, elastic, or moving with the eye."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.organs.cornea.material.load import CorneaLoad
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh
from palpate.workers.organs.cornea.section.rigid_motion import RigidMotion
from palpate.workers.organs.cornea.solver.surface_pressure import edges_along

# A node this close to x = 0 is on the axis of an axisymmetric section.
AXIS_TOLERANCE_MM = 1e-6
# Integral of the products of an edge's shape functions over xi in [-1, 1].
_EDGE_MASS = np.array([[4.0, 2.0, -1.0], [2.0, 16.0, 2.0], [-1.0, 2.0, 4.0]]) / 15


@dataclass(frozen=True, eq=False)
class Limbus:
    """The two edges of a section.

    Parameters
    ----------
    nodes : ndarray of int32, shape (k,)
    position_mm : ndarray, shape (k, 2)
        Positions in the image.
    mass : ndarray, shape (k, k)
        Integral of the product of two shape functions over the edges, in mm, or mm² per
        radian.
    """

    nodes: IntArray
    position_mm: FloatArray
    mass: FloatArray

    def motion(
        self, load: CorneaLoad, fraction: float, points_mm: FloatArray | None = None
    ) -> FloatArray:
        """Return the displacement at a fraction of the motion of the eye, (k, 2) in mm.

        Returned for the limbus, or for other points that move with it as a rigid body.
        """
        points_mm = self.position_mm if points_mm is None else points_mm
        x, y = load.eye_shift_mm
        centre_x, centre_y = self.position_mm.mean(axis=0).tolist()
        motion = RigidMotion(
            shift_mm=(fraction * x, fraction * y),
            tilt_rad=fraction * load.eye_tilt_rad,
            centre_mm=(centre_x, centre_y),
        )
        return motion.of_points(points_mm) - points_mm


def limbus_of(mesh: T6Mesh, axisymmetric: bool) -> Limbus:
    """Return the edges of a section, except one on the axis of revolution."""
    edges = np.concatenate([edges_along(mesh.left), edges_along(mesh.right)])
    if axisymmetric:
        on_axis = np.abs(mesh.nodes_mm[edges, 0]) < AXIS_TOLERANCE_MM
        edges = edges[~on_axis.all(axis=1)]
    nodes, places = np.unique(edges, return_inverse=True)
    places = places.reshape(edges.shape)
    mass = np.zeros((len(nodes), len(nodes)))
    for edge, place in zip(edges, places, strict=True):
        start, middle, end = mesh.nodes_mm[edge]
        half_length = np.linalg.norm(end - start) / 2
        radius = abs(middle[0]) if axisymmetric else 1.0
        mass[np.ix_(place, place)] += _EDGE_MASS * half_length * radius
    return Limbus(nodes.astype(np.int32), mesh.nodes_mm[nodes], mass)


def axis_nodes(mesh: T6Mesh) -> IntArray:
    """Return the nodes on the axis of revolution.

    Raises
    ------
    InputError
        If a triangle extends across the axis.
    """
    x = mesh.nodes_mm[:, 0]
    corners = x[mesh.triangles]
    across = (corners.min(axis=1) < -AXIS_TOLERANCE_MM) & (corners.max(axis=1) > AXIS_TOLERANCE_MM)
    if across.any():
        raise InputError(
            f"{across.sum()} triangles of the axisymmetric section extend across its axis. "
            "Mesh the section with nodes at x = 0 mm."
        )
    return np.flatnonzero(np.abs(x) < AXIS_TOLERANCE_MM).astype(np.int32)

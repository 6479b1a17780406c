"""Data that depend only on a mesh and a model's options, shared by many candidates."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.organs.cornea.material.model import CorneaModel
from palpate.workers.organs.cornea.material.ogden_stress import (
    AXISYMMETRIC,
    PLANE_STRAIN,
    PLANE_STRESS,
)
from palpate.workers.organs.cornea.material.stiffness_gradient import stiffness_factors
from palpate.workers.organs.cornea.mesh.t6_geometry import PointGeometry, point_geometry
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh
from palpate.workers.organs.cornea.solver.envelope_lu import Envelope, envelope_of, node_order
from palpate.workers.organs.cornea.solver.limbus import Limbus, axis_nodes, limbus_of
from palpate.workers.organs.cornea.solver.surface_pressure import SurfacePoints, posterior_points

KIND_CODES = {
    "plane stress": PLANE_STRESS,
    "plane strain": PLANE_STRAIN,
    "axisymmetric": AXISYMMETRIC,
}


@dataclass(frozen=True, eq=False)
class PreparedMesh:
    """A mesh, its unknowns and the storage of their tangent.

    Parameters
    ----------
    mesh : T6Mesh
    model : CorneaModel
    kind : int
        See `ogden_stress`.
    equations : ndarray of int32, shape (n, 2)
        Unknown of each component of the displacement, -1 if it is held.
    free : tuple of ndarray
        Nodes and components of the unknowns, in their order.
    envelope : Envelope
    geometry : PointGeometry
        Geometry of the section in the image.
    stiffness : ndarray, shape (m,)
    limbus : Limbus
    posterior : SurfacePoints
    apex : int
        The highest node of the anterior surface.
    clamped : bool
        Whether the limbus is held, or moves with the eye.
    """

    mesh: T6Mesh
    model: CorneaModel
    kind: int
    equations: IntArray
    free: tuple[IntArray, IntArray]
    envelope: Envelope
    geometry: PointGeometry
    stiffness: FloatArray
    limbus: Limbus
    posterior: SurfacePoints
    apex: int
    clamped: bool

    @property
    def unknowns(self) -> int:
        """Return the number of unknowns."""
        return len(self.free[0])

    @property
    def axisymmetric(self) -> bool:
        """Return True if the section is revolved."""
        return self.kind == AXISYMMETRIC

    def spread(self, values: FloatArray) -> FloatArray:
        """Return values of the unknowns, (..., unknowns), as nodal values, (..., n, 2)."""
        at_nodes = np.zeros((*values.shape[:-1], *self.equations.shape))
        at_nodes[..., self.free[0], self.free[1]] = values
        return at_nodes


def prepare(mesh: T6Mesh, model: CorneaModel, held: BoolArray | None = None) -> PreparedMesh:
    """Prepare a mesh for `solve_prepared`.

    Parameters
    ----------
    mesh : T6Mesh
    model : CorneaModel
    held : ndarray of bool, shape (n, 2), optional
        Components of the displacement that are zero, instead of the limbus; for planes of
        symmetry, for instance.

    Raises
    ------
    InputError
        If a triangle is inverted or extends across the axis of an axisymmetric section, or
        nothing holds the cornea.
    """
    kind = KIND_CODES[model.kind]
    axisymmetric = kind == AXISYMMETRIC
    limbus = limbus_of(mesh, axisymmetric)
    if held is None and len(limbus.nodes) == 0:
        raise InputError("The mesh of the cornea has no limbus nodes that could hold it.")
    clamped = held is None and model.limbus_mpa_per_mm is None
    held = np.zeros((len(mesh.nodes_mm), 2), dtype=bool) if held is None else held.copy()
    if axisymmetric:
        held[axis_nodes(mesh), 0] = True
    if clamped:
        held[limbus.nodes] = True
    order = node_order(mesh.triangles, len(mesh.nodes_mm))
    equations = np.full((len(mesh.nodes_mm), 2), -1, dtype=np.int32)
    places = np.argwhere(~held[order])
    nodes, components = order[places[:, 0]], places[:, 1].astype(np.int32)
    equations[nodes, components] = np.arange(len(nodes))
    groups = equations[mesh.triangles].reshape(len(mesh.triangles), -1)
    return PreparedMesh(
        mesh=mesh,
        model=model,
        kind=kind,
        equations=equations,
        free=(nodes, components),
        envelope=envelope_of(groups, len(nodes)),
        geometry=point_geometry(mesh, mesh.nodes_mm, model.quadrature_points, axisymmetric),
        stiffness=stiffness_factors(mesh, model),
        limbus=limbus,
        posterior=posterior_points(mesh.nodes_mm, mesh.posterior, axisymmetric),
        apex=int(mesh.anterior[np.argmax(mesh.nodes_mm[mesh.anterior, 1])]),
        clamped=clamped,
    )

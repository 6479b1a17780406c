"""The solver's input: a prepared mesh, and a candidate of constants and loads on it.

A `PreparedMesh` holds what depends only on a mesh and a model's options and is shared by many
candidates: shape functions and undeformed gradients, pressed edges, the support at the limbus
(clamped, elastic, or moving with the eye), and the gradients of stiffness through the depth and
from side to side. `MeshForModels` keeps the latest one for the candidates of one process. A
`Candidate` follows from the constants of a study, or from another one with one parameter changed.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.mechanics.fem.simd_vectors import LANES
from palpate.workers.mechanics.triangles import shape_functions
from palpate.workers.organs.cornea.cornea_keys import TERMS, CorneaCase
from palpate.workers.organs.cornea.corneal_model import (
    QUADRATURE,
    CorneaConstants,
    CorneaLoad,
    CorneaModel,
)
from palpate.workers.organs.cornea.corneal_ogden import AXISYMMETRIC, PLANE_STRAIN, PLANE_STRESS
from palpate.workers.organs.cornea.envelope_lu import Envelope, envelope_of, node_order
from palpate.workers.organs.cornea.section_mesh import T6Mesh
from palpate.workers.organs.cornea.section_outline import RigidMotion, Section
from palpate.workers.organs.cornea.t6_elements import SurfacePoints, edges_along, posterior_points


class PointGeometry(NamedTuple):
    """Undeformed triangles at their quadrature points.

    Parameters
    ----------
    gradients : ndarray, shape (m, q, 2, 8)
        Derivatives of the six shape functions in x and y, in 1/mm; padded with zeros for SIMD.
    hoop : ndarray, shape (m, q, 8)
        Shape function over radius in 1/mm; zero in a plane.
    weights : ndarray, shape (m, q)
        Area in mm², or volume per radian in mm³.
    """

    gradients: FloatArray
    hoop: FloatArray
    weights: FloatArray


def point_geometry(
    mesh: T6Mesh, nodes_mm: FloatArray, n_points: int, axisymmetric: bool
) -> PointGeometry:
    """Return the geometry of a mesh with nodes at `nodes_mm`.

    Raises
    ------
    InputError
        If a triangle is inverted.
    """
    points, weights = QUADRATURE[n_points]
    N, slopes = shape_functions(points)
    corners = nodes_mm[mesh.triangles]
    # jacobian[e, q, i, j] = d x_i / d xi_j
    jacobian = np.matmul(corners.transpose(0, 2, 1)[:, None], slopes[None])
    a, b = jacobian[..., 0, 0], jacobian[..., 0, 1]
    c, d = jacobian[..., 1, 0], jacobian[..., 1, 1]
    area = a * d - b * c
    if not (area > 0).all():
        bad = int(np.argmin(area.min(axis=1)))
        raise InputError(
            f"Triangle {bad} of the corneal mesh is inverted or badly distorted. Nodes run "
            "counter-clockwise, corners first; check that the two surfaces do not cross."
        )
    by_x = d[..., None] * slopes[..., 0] - c[..., None] * slopes[..., 1]
    by_y = a[..., None] * slopes[..., 1] - b[..., None] * slopes[..., 0]
    gradients = np.zeros((*area.shape, 2, LANES))
    gradients[..., :6] = np.stack([by_x, by_y], axis=-2) / area[..., None, None]
    hoop = np.zeros((*area.shape, LANES))
    weights = area * weights
    if axisymmetric:
        radius = corners[:, :, 0] @ N.T
        hoop[..., :6] = N / radius[..., None]
        weights = weights * np.abs(radius)
    return PointGeometry(gradients, hoop, weights)


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


def stiffness_factors(mesh: T6Mesh, model: CorneaModel) -> FloatArray:
    """Return the factor of the moduli of each triangle, shape (m,).

    The factor is ``exp(depth_gradient d + side_gradient s)``, with d from the anterior (-1/2)
    to the posterior surface (1/2), s from the left (-1/2) to the right edge (1/2).
    """
    if model.depth_gradient == 0 and model.side_gradient == 0:
        return np.ones(len(mesh.triangles))
    centres = mesh.nodes_mm[mesh.triangles[:, :3]].mean(axis=1)
    above = _distances_to_surface(centres, mesh.nodes_mm, mesh.anterior)
    below = _distances_to_surface(centres, mesh.nodes_mm, mesh.posterior)
    depth = above / (above + below) - 0.5
    x = mesh.nodes_mm[:, 0]
    side = (centres[:, 0] - x.min()) / (x.max() - x.min()) - 0.5
    return np.exp(model.depth_gradient * depth + model.side_gradient * side)


def _distances_to_surface(
    points: FloatArray, nodes_mm: FloatArray, surface: IntArray
) -> FloatArray:
    """Return the distances of points from a polyline of nodes."""
    start, end = nodes_mm[surface[:-1]], nodes_mm[surface[1:]]
    along = end - start
    arm = points[:, None] - start
    fraction = np.clip((arm * along).sum(-1) / (along**2).sum(-1), 0, 1)
    return np.linalg.norm(arm - fraction[..., None] * along, axis=-1).min(axis=1)


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


class MeshForModels:
    """A mesh that is prepared for a model on first use, and again for another model.

    Candidates of a search share one preparation unless an option of the model varies.

    Parameters
    ----------
    mesh : T6Mesh
    """

    def __init__(self, mesh: T6Mesh) -> None:
        self.mesh = mesh
        self._last: PreparedMesh | None = None

    def prepared(self, model: CorneaModel) -> PreparedMesh:
        """Return the mesh prepared for a model.

        Raises
        ------
        InputError
            As for `workers.organs.cornea.cornea_problem.prepare`.
        """
        last = self._last
        if last is None or last.model != model:
            last = self._last = prepare(self.mesh, model)
        return last


# Smallest scale for changes in a pressure.
SMALLEST_PRESSURE_SCALE_MPA = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A mesh prepared for a model, constants and a load."""

    prepared: PreparedMesh
    constants: CorneaConstants
    load: CorneaLoad


def parameter_names(candidate: Candidate) -> tuple[str, ...]:
    """Return the parameters with respect to which a candidate can be differentiated.

    Ogden terms are numbered from 1: mu1_mpa, alpha1, mu2_mpa, ...
    """
    terms = range(1, len(candidate.constants.mu_mpa) + 1)
    ogden = [name for i in terms for name in (f"mu{i}_mpa", f"alpha{i}")]
    elastic = candidate.prepared.model.limbus_mpa_per_mm is not None
    model = [name for name in _OF_MODEL if elastic or name != "limbus_mpa_per_mm"]
    return (*ogden, "bulk_mpa", *_OF_LOAD, *_OF_EYE, *model)


def scale_of(candidate: Candidate, name: str) -> float:
    """Return a significant change in a parameter, in its unit; difference steps are relative to it.

    Raises
    ------
    InputError
        If the parameter is unknown.
    """
    constants, load = candidate.constants, candidate.load
    if name not in parameter_names(candidate):
        raise InputError(
            f"A cornea has no parameter {name!r}. It has {', '.join(parameter_names(candidate))}."
        )
    if name == "bulk_mpa":
        return constants.bulk_mpa
    if name.startswith("mu"):
        return abs(constants.mu_mpa[_term_index(name)])
    if name.startswith("alpha"):
        return abs(constants.alpha[_term_index(name)])
    if name in ("iop_mpa", "jet_pressure_mpa", "iop_rise_mpa"):
        return max(abs(getattr(load, name)), SMALLEST_PRESSURE_SCALE_MPA)
    if name == "limbus_mpa_per_mm":
        return float(candidate.prepared.model.limbus_mpa_per_mm or 1.0)
    return 1.0


def changed(candidate: Candidate, name: str, by: float) -> Candidate:
    """Return a candidate with one parameter increased.

    Raises
    ------
    InputError
        If the parameter is unknown, or cannot be changed that far.
    """
    scale_of(candidate, name)
    constants, load = candidate.constants, candidate.load
    if name == "bulk_mpa":
        return replace(candidate, constants=replace(constants, bulk_mpa=constants.bulk_mpa + by))
    if name.startswith("mu"):
        mu = _increased(constants.mu_mpa, _term_index(name), by)
        return replace(candidate, constants=replace(constants, mu_mpa=mu))
    if name.startswith("alpha"):
        alpha = _increased(constants.alpha, _term_index(name), by)
        return replace(candidate, constants=replace(constants, alpha=alpha))
    if name in _OF_LOAD:
        return replace(candidate, load=replace(load, **{name: getattr(load, name) + by}))
    if name in _OF_EYE:
        return replace(candidate, load=_OF_EYE[name](load, by))
    return replace(candidate, prepared=_with_model(candidate.prepared, name, by))


_OF_LOAD = ("iop_mpa", "jet_pressure_mpa", "jet_centre_mm", "jet_width_factor", "iop_rise_mpa")
_OF_MODEL = ("limbus_mpa_per_mm", "depth_gradient", "side_gradient")
_OF_EYE: dict[str, Callable[[CorneaLoad, float], CorneaLoad]] = {
    "eye_shift_x_mm": lambda load, by: replace(
        load, eye_shift_mm=(load.eye_shift_mm[0] + by, load.eye_shift_mm[1])
    ),
    "eye_shift_y_mm": lambda load, by: replace(
        load, eye_shift_mm=(load.eye_shift_mm[0], load.eye_shift_mm[1] + by)
    ),
    "eye_tilt_rad": lambda load, by: replace(load, eye_tilt_rad=load.eye_tilt_rad + by),
}


def _with_model(prepared: PreparedMesh, name: str, by: float) -> PreparedMesh:
    model = replace(prepared.model, **{name: getattr(prepared.model, name) + by})
    return replace(prepared, model=model, stiffness=stiffness_factors(prepared.mesh, model))


def _term_index(name: str) -> int:
    return int(name.removeprefix("mu").removeprefix("alpha").removesuffix("_mpa")) - 1


def _increased(values: tuple[float, ...], k: int, by: float) -> tuple[float, ...]:
    return (*values[:k], values[k] + by, *values[k + 1 :])


def candidate_of(
    meshes: MeshForModels, case: CorneaCase, values: Mapping[str, float], middle_mm: float
) -> Candidate:
    """Return the candidate for given parameter values.

    Parameters
    ----------
    meshes : MeshForModels
    case : CorneaCase
    values : mapping of str to float
        Every parameter in `workers.organs.cornea.cornea_keys.CORNEA`, in internal units.
    middle_mm : float
        See `middle_of`.

    Raises
    ------
    InputError
        If constants or load are inconsistent.
    """
    return Candidate(
        prepared=meshes.prepared(model_of(case, values)),
        constants=constants_of(case, values),
        load=load_of(case, values, middle_mm),
    )


def model_of(case: CorneaCase, values: Mapping[str, float]) -> CorneaModel:
    """Return the options of the simulation."""
    compliance = values["limbus_compliance"]
    return CorneaModel(
        kind=case.model.kind,
        prestress=case.model.prestress,
        limbus_mpa_per_mm=1 / compliance if compliance > 0 else None,
        depth_gradient=values["depth_gradient"],
        side_gradient=values["side_gradient"],
    )


def constants_of(case: CorneaCase, values: Mapping[str, float]) -> CorneaConstants:
    """Return the law; terms with a zero modulus are left out, unless all are zero."""
    numbers = [n for n in range(1, TERMS + 1) if values[f"mu{n}"] > 0] or [1]
    return CorneaConstants(
        mu_mpa=tuple(values[f"mu{n}"] for n in numbers),
        alpha=tuple(values[f"alpha{n}"] for n in numbers),
        bulk_mpa=values["bulk"],
        convention=case.model.convention,
    )


def load_of(case: CorneaCase, values: Mapping[str, float], middle_mm: float) -> CorneaLoad:
    """Return pressures and motion of the eye."""
    jet = case.load.jet
    return CorneaLoad(
        iop_mpa=values["iop"],
        jet_pressure_mpa=values["jet_pressure"],
        jet_centre_mm=middle_mm + values["jet_centre"],
        jet_diameter_mm=jet.diameter_mm,
        jet_profile=None if jet.profile is None else jet.profile.profile,
        jet_width_factor=values["jet_width"],
        iop_rise_mpa=values["iop_rise"],
        eye_shift_mm=(values["eye_shift_x"], values["eye_shift_y"]),
        eye_tilt_rad=float(np.radians(values["eye_tilt"])),
    )


def middle_of(section: Section) -> float:
    """Return the x midway between the ends of the anterior surface, in mm."""
    return float(section.anterior_mm[[0, -1], 0].mean())


def jet_nodes_x_mm(section: Section, case: CorneaCase) -> tuple[float, ...]:
    """Return the required nodes of the mesh: edges and centre of the jet, and the middle."""
    middle, jet = middle_of(section), case.load.jet
    centre = middle + jet.centre_mm
    return tuple(sorted({middle, centre, centre - jet.reach_mm, centre + jet.reach_mm}))

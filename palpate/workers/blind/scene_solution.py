"""Solutions of a scene under a sequence of loads.

Tissue varies within an element: each of its four points gets the mean modulus of the quarter of the
element around it, sampled from the voxels.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from palpate.storage.values import FloatArray, Tissue, Volume
from palpate.workers.blind.breast_scene import WALL_SPRING_KPA_PER_MM, Anatomy, Scene
from palpate.workers.blind.random_case import Load
from palpate.workers.blind.solver.plate_contact import EDGE_FADE_MM, Plate, Skin
from palpate.workers.blind.solver.plate_equilibrium import (
    FORCE_TOLERANCE,
    Newton,
    NoEquilibriumError,
    State,
    System,
    Topology,
    Wall,
)
from palpate.workers.blind.solver.quadratic_mesh import (
    FACE_WEIGHTS,
    QuadraticMesh,
    face_shapes,
    points_in_cells,
)
from palpate.workers.blind.solver.tissue_energy import ElementMaterials, sheet_of

SAMPLES = 64  # per element


def _spread(count: int) -> FloatArray:
    """Return barycentric coordinates (count, 4) of points spread evenly in a tetrahedron.

    Sorted gaps between three uniform numbers are uniform in the simplex (L. Devroye,
    Non-uniform Random Variate Generation, 1986, chapter V.2); the seed is part of the
    method.
    """
    cuts = np.sort(np.random.default_rng(1).random((count, 3)), axis=1)
    return np.diff(np.hstack([np.zeros((count, 1)), cuts, np.ones((count, 1))]), axis=1)


def is_glandular(labels: Volume, points: FloatArray) -> FloatArray:
    """Return 1.0 at points (k, 3) in glandular voxels, else 0."""
    index = np.rint((points - np.asarray(labels.origin_mm)) / labels.spacing_mm).astype(np.intp)
    x, y, z = np.clip(index, 0, np.array(labels.shape_xyz) - 1).T
    return (labels.values[z, y, x] == Tissue.GLANDULAR).astype(np.float64)


def materials_of(scene: Scene, mesh: QuadraticMesh, labels: Volume) -> ElementMaterials:
    """Return the constants at the four points of every element.

    Parameters
    ----------
    scene : Scene
    mesh : QuadraticMesh
        Mesh of m elements.
    labels : Volume
        `Tissue` labels of the undeformed body.
    """
    positions = points_in_cells(mesh)
    weights = _spread(SAMPLES)
    owner = weights.argmax(axis=1)
    corners = mesh.nodes[mesh.cells[:, :4]]
    shape = positions.shape[:2]
    young, eta, stretch = np.zeros(shape), np.zeros(shape), np.ones(shape)
    fat, gland = scene.constants.E_fat_kpa / 1e3, scene.constants.E_gl_kpa / 1e3
    for q in range(4):
        mine = weights[owner == q]
        points = np.einsum("sa,mai->msi", mine, corners).reshape(-1, 3)
        glandular = is_glandular(labels, points)
        factor = np.exp(sum((f(points) for f in scene.ln_stiffness), np.zeros(len(points))))
        grown = sum((g(points, glandular) for g in scene.growth), np.zeros(len(points)))
        young[:, q] = _means((fat + (gland - fat) * glandular) * factor, len(mine))
        fibres = scene.constants.eta_kpa / 1e3 * factor
        if scene.ln_gland_fibres is not None:
            fibres = fibres * np.exp(glandular * scene.ln_gland_fibres(points))
        eta[:, q] = _means(fibres, len(mine))
        stretch[:, q] += _means(grown, len(mine))
    flat = positions.reshape(-1, 3)
    fibre = np.tile([0.0, 0.0, 1.0], (len(flat), 1)) if scene.fibres is None else scene.fibres(flat)
    return ElementMaterials(
        mu=young / (2 * (1 + scene.nu)),
        kappa=young / (3 * (1 - 2 * scene.nu)),
        eta=eta,
        fung=np.full(shape, scene.fung),
        growth=stretch,
        fibre=np.ascontiguousarray(fibre.reshape(positions.shape)),
    )


def _means(values: FloatArray, count: int) -> FloatArray:
    return np.asarray(values.reshape(-1, count).mean(axis=1))


SAG_ARM_MM = 50.0
TOUCH_MM = 0.3  # the plates start a little closer than the body, so that they touch it
FRICTION_STEPS = 3
STEPS = (1, 4, 12)  # without friction, tried one after the other
# Like `plate_equilibrium.FORCE_TOLERANCE`, with friction: at the loads, and between them.
FRICTION_TOLERANCE, FRICTION_TOLERANCE_BETWEEN = 3e-4, 1.5e-3
IN_AXES = {"y": ((1, 0, 0), (0, 0, 1), (0, 1, 0)), "x": ((0, -1, 0), (0, 0, 1), (1, 0, 0))}


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of one loaded scan: displacement (n, 3) and travel of the upper plate, in mm."""

    load: Load
    displacement_mm: FloatArray
    travel_mm: float


def plate_starts(anatomy: Anatomy, axis: str) -> tuple[float, float]:
    """Return the initial positions of the lower and the upper plate, in mm along the axis."""
    if axis == "x":
        return -anatomy.lower_mm, anatomy.upper_mm
    return -anatomy.half_width_mm, anatomy.half_width_mm


def solve_scene(
    scene: Scene, topology: Topology, labels: Volume, loads: Sequence[Load]
) -> list[Solution]:
    """Find the equilibria of all loads, along each axis in order, each from the previous one.

    Raises
    ------
    NoEquilibriumError
        If an equilibrium is not found, even in small steps.
    """
    materials = materials_of(scene, topology.mesh, labels)
    solutions: list[Solution] = []
    for axis, group in groupby(loads, key=lambda load: load.axis):
        system = _system(scene, topology, materials, axis)
        solutions.extend(_load_sequence(system, scene, list(group)))
    return solutions


def _system(scene: Scene, topology: Topology, materials: ElementMaterials, axis: str) -> System:
    mesh = topology.mesh
    flat = topology.skin.places.reshape(-1, 3)
    friction = sum((f(flat) for f in scene.friction), np.zeros(len(flat)))
    return System(
        topology,
        materials,
        wall_of(scene, mesh),
        plates_of(scene, axis),
        friction.reshape(topology.skin.areas.shape),
        np.asarray(scene.gravity_g),
        sheet_of(mesh, scene.skin_n_per_m / 1e3) if scene.skin_n_per_m else None,
        tether_of(scene, topology.skin),
    )


def tether_of(scene: Scene, skin: Skin) -> FloatArray | None:
    """Return the springs at the points of the skin in MPa/mm, shape (k, 6), or None."""
    if scene.skin_grip is None:
        return None
    return scene.skin_grip(skin.places.reshape(-1, 3)).reshape(skin.areas.shape) / 1e3


def wall_of(scene: Scene, mesh: QuadraticMesh) -> Wall:
    """Return the chest wall of a scene."""
    places = np.einsum("qa,kai->kqi", face_shapes(), mesh.nodes[mesh.wall]).reshape(-1, 3)
    spring = np.zeros((len(places), 3))
    spring[:, :2] = WALL_SPRING_KPA_PER_MM * scene.wall_spring_factor
    if scene.wall_grip is not None:
        spring[:, :2] += scene.wall_grip(places)[:, None]
    if scene.wall_compliance is not None:
        spring[:, 2] = 1 / scene.wall_compliance(places)
    by_face = spring.reshape(-1, len(FACE_WEIGHTS), 3) / 1e3
    rise = None
    if scene.wall_rise_mm is not None:
        rise = scene.wall_rise_mm(mesh.nodes) * (1 - mesh.nodes[:, 2] / mesh.nodes[:, 2].max())
    return Wall(by_face, held=scene.wall_compliance is None, rise_mm=rise)


def plates_of(scene: Scene, axis: str) -> tuple[Plate, Plate]:
    """Return the lower and the upper plate before compression."""
    frame = np.array(IN_AXES[axis], dtype=np.float64)
    pivot = np.asarray(scene.anatomy.centre_mm)
    lower, upper = plate_starts(scene.anatomy, axis)
    depth, across = np.tan(np.radians(scene.tilt_deg))
    # Rotations about the in-plane axes follow the right-hand rule.
    slopes = np.array([across, -depth])
    edge = scene.plate_edge_mm
    level = Plate(frame, pivot, lower, -1.0, np.zeros(2), 0.0, SAG_ARM_MM, edge)
    return level, Plate(frame, pivot, upper, 1.0, slopes, scene.sag_mm, SAG_ARM_MM, edge)


def _load_sequence(system: System, scene: Scene, loads: list[Load]) -> Iterable[Solution]:
    newton = Newton(system)
    state = State(np.zeros_like(system.topology.mesh.nodes), _first_contact_travel(system))
    before = 0.0
    for load in loads:
        force = load.force_n * scene.force_factor
        state = _load(newton, state, before, force)
        before = force
        yield Solution(load, state.u, state.travel)


def _first_contact_travel(system: System) -> float:
    """Return a travel slightly beyond the first contact of the upper plate with the body."""
    plate, places = system.plates[1], system.topology.skin.places.reshape(-1, 3)
    places = places[places @ plate.frame[1] > plate.edge_mm + EDGE_FADE_MM]
    s1, s2 = ((places - plate.pivot_mm) @ plate.frame[:2].T).T
    height = plate.slopes[0] * s1 + plate.slopes[1] * s2
    height += 0.5 * plate.sag_mm * (1 - np.cos(np.pi * s1 / plate.length_mm))
    return float((plate.start_mm + height - places @ plate.frame[2]).min()) + TOUCH_MM


def _load(newton: Newton, state: State, before: float, force: float) -> State:
    """Load from one force to a larger one; with friction, or if one step fails, in several steps.

    Tissue growth and the rise of the chest wall are applied gradually with the first force: applied
    all at once, they may have no equilibrium.
    """
    counts = (FRICTION_STEPS,) if newton.system.has_friction else STEPS
    for count in counts:
        try:
            return _steps(newton, state, (before, force), count)
        except NoEquilibriumError:
            if count == counts[-1]:
                raise
    raise AssertionError("unreachable")


def _steps(newton: Newton, state: State, ends: tuple[float, float], count: int) -> State:
    """Go from one force to another in `count` equal steps."""
    system = newton.system
    for part in np.linspace(0, 1, count + 1)[1:].tolist():
        tolerance = FORCE_TOLERANCE
        if system.has_friction:
            tolerance = FRICTION_TOLERANCE if part == 1 else FRICTION_TOLERANCE_BETWEEN
        if ends[0] == 0:
            system.grow(part)
            state = system.raised(state, 1 / count)
        force = ends[0] + part * (ends[1] - ends[0])
        state, _ = newton.equilibrium(state, force, tolerance)
        system.end_step(state)
    return state

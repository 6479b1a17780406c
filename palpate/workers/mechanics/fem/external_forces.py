"""External forces on the nodes of a mesh, springs and prescribed displacements."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.mechanics.fem.boundary_value_problem import GRAVITY_MM_PER_S2, Problem
from palpate.workers.mechanics.fem.discretisation import LevelModel
from palpate.workers.mechanics.fem.loads_and_regions import Attachment, NoPlates, Pressure, nodes_in
from palpate.workers.mechanics.fem.plate_contact import PENALTY_N_PER_MM3

# Frictionless plates leave the body free to drift; springs this weak
# (5 mN per mm of drift for a litre) hold it without a noticeable force.
DRIFT_SPRING_N_PER_MM4 = 5e-9
# A rigid motion with less than this fraction of the largest resistance counts as free.
LOOSE = 1e-6


@dataclass(frozen=True, eq=False)
class DirichletConditions:
    """Mask of prescribed displacement components, (n, 3), and their values, (n, 3) in mm."""

    held: BoolArray
    displacement_mm: FloatArray


def spring_stiffness(model: LevelModel, problem: Problem) -> FloatArray:
    """Return the stiffness of the springs that hold each node, shape (n, 3) in N/mm.

    These are the springs of the problem, and weak ones along axes in which nothing else holds
    the body. Where the chest wall or a hold does, weak ones would carry a part of the load.
    """
    wall, load = problem.wall, problem.load
    loose = np.ones(3)
    if not isinstance(load, NoPlates):
        loose -= np.abs(load.device.axis) / np.linalg.norm(load.device.axis)
    if len(model.wall):
        loose[np.logical_or(wall.held, np.greater(wall.spring_mpa_per_mm, 0))] = 0.0
    if problem.holds and loose.any():
        loose *= _axes_of_rigid_motions(model, problem)
    drift = DRIFT_SPRING_N_PER_MM4 * model.nodal_volumes[:, None] * loose
    return np.asarray(drift + stated_springs(model, problem))


def _axes_of_rigid_motions(model: LevelModel, problem: Problem) -> BoolArray:
    """Find the axes along which the whole body may move despite its supports, shape (3,)."""
    away = model.nodes - model.nodes.mean(axis=0)
    away /= np.sqrt((away**2).sum(axis=1).mean())
    turns = [np.cross(axis, away) for axis in np.eye(3)]
    moves = [np.broadcast_to(axis, away.shape) for axis in np.eye(3)]
    modes = np.stack([*moves, *turns], axis=-1)
    stops = modes[dirichlet_conditions(model, problem).held]
    if not isinstance(problem.load, NoPlates):
        axis = np.asarray(problem.load.device.axis) / np.linalg.norm(problem.load.device.axis)
        across = np.eye(3) - np.outer(axis, axis)
        plates = np.block([[np.outer(axis, axis), np.zeros((3, 3))], [np.zeros((3, 3)), across]])
        stops = np.concatenate([stops, plates])
    stiffness, mode = np.linalg.eigh(stops.T @ stops / len(stops))
    rigid = modes @ mode[:, stiffness < LOOSE * stiffness[-1]]
    return np.asarray((np.abs(rigid) > LOOSE).any(axis=(0, 2)))


def stated_springs(model: LevelModel, problem: Problem) -> FloatArray:
    """Return the springs of the chest wall and of attachments, shape (n, 3) in N/mm."""
    springs = model.wall_areas[:, None] * np.asarray(problem.wall.spring_mpa_per_mm)
    for attachment in problem.attachments:
        springs = springs + _attachment_springs(model, attachment)
    return np.asarray(springs)


def _attachment_springs(model: LevelModel, attachment: Attachment) -> FloatArray:
    areas = model.wall_areas.copy()
    areas[model.contact_nodes.index] += model.contact_nodes.stiffness / PENALTY_N_PER_MM3
    return np.outer(areas * attachment.weight(model.nodes), attachment.spring_mpa_per_mm)


def dead_load(model: LevelModel, problem: Problem, density: FloatArray) -> FloatArray:
    """Return gravity and forces of constant direction, shape (n, 3) in N.

    Parameters
    ----------
    density : ndarray, shape (m,)
        Of the elements, in t/mm^3.
    """
    force = np.zeros_like(model.nodes)
    if any(problem.gravity_g):
        weight = density * model.elements.volumes * (GRAVITY_MM_PER_S2 / 4)
        share = np.bincount(model.elements.tets.ravel(), np.repeat(weight, 4), len(force))
        force += share[:, None] * np.asarray(problem.gravity_g)
    for dead in problem.forces:
        inside = nodes_in(dead.region, model.nodes, model.edge_mm)
        force[inside] += np.asarray(dead.force_n) / inside.sum()
    return force


def dirichlet_conditions(model: LevelModel, problem: Problem) -> DirichletConditions:
    """Collect the prescribed displacements of the chest wall and of all holds."""
    held = np.zeros(model.nodes.shape, np.bool_)
    displacement = np.zeros_like(model.nodes)
    for axis, fixed in enumerate(problem.wall.held):
        if fixed:
            held[model.wall, axis] = True
    for hold in problem.holds:
        inside = nodes_in(hold.region, model.nodes, model.edge_mm)
        prescribed = hold.at(model.nodes[inside])
        for axis, fixed in enumerate(hold.axes):
            if fixed:
                held[inside, axis] = True
                displacement[inside, axis] = prescribed[:, axis]
    return DirichletConditions(held, displacement)


def pressure_forces(
    model: LevelModel, x: FloatArray, pressures: tuple[Pressure, ...]
) -> FloatArray:
    """Return the forces of follower pressure at positions `x`, shape (n, 3) in N.

    A third of pressure times area acts on each corner of a triangle, against its
    present outward normal.
    """
    triangles = model.sheet.triangles
    corners = x[triangles]
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    share = (-_pressure_mpa(model, pressures) / 3)[:, None] * area
    return _add_to_corners(model, share)


def pressure_derivative(
    model: LevelModel, x: FloatArray, pressures: tuple[Pressure, ...], u: FloatArray
) -> FloatArray:
    """Return the derivative of `pressure_forces` in the direction `u`, shape (n, 3)."""
    triangles = model.sheet.triangles
    corners, du = x[triangles], u[triangles]
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    d1, d2 = du[:, 1] - du[:, 0], du[:, 2] - du[:, 0]
    change = 0.5 * (np.cross(d1, e2) + np.cross(e1, d2))
    return _add_to_corners(model, (-_pressure_mpa(model, pressures) / 3)[:, None] * change)


def _pressure_mpa(model: LevelModel, pressures: tuple[Pressure, ...]) -> FloatArray:
    """Return the pressure on each triangle of the free surface, shape (k,)."""
    centroids = model.nodes[model.sheet.triangles].mean(axis=1)
    total = np.zeros(len(centroids))
    for pressure in pressures:
        total += pressure.pressure_mpa * pressure.region.contains(centroids)
    return total


def _add_to_corners(model: LevelModel, share: FloatArray) -> FloatArray:
    """Add `share`, (k, 3), to each corner of the triangles; shape (n, 3)."""
    force = np.zeros_like(model.nodes)
    for corner in range(3):
        np.add.at(force, model.sheet.triangles[:, corner], share)
    return force

"""What loads and boundaries exert on the nodes of a mesh."""

from dataclasses import dataclass

import numpy as np

from storage.values import BoolArray, FloatArray
from workers.fem.loads import Load, NoPlates, Pressure, Wall
from workers.fem.model import LevelModel
from workers.fem.problem import GRAVITY_MM_PER_S2, Problem
from workers.fem.regions import nodes_in

# Frictionless plates leave the body free to drift; springs this weak
# (5 mN per mm of drift for a litre) hold it without being felt.
DRIFT_SPRING_N_PER_MM4 = 5e-9


@dataclass(frozen=True, eq=False)
class Places:
    """Which displacement components are held, (n, 3), and at what, (n, 3) in mm."""

    held: BoolArray
    displacement_mm: FloatArray


def springs(model: LevelModel, wall: Wall, load: Load) -> FloatArray:
    """Stiffness of the springs that hold each node to its place, shape (n, 3) in N/mm.

    Along axes in which the chest wall holds the body there are none: they would carry
    a part of its weight.
    """
    loose = np.ones(3)
    if not isinstance(load, NoPlates):
        loose -= np.abs(load.device.axis) / np.linalg.norm(load.device.axis)
    if len(model.wall):
        loose[np.logical_or(wall.held, np.greater(wall.spring_mpa_per_mm, 0))] = 0.0
    drift = DRIFT_SPRING_N_PER_MM4 * model.nodal_volumes[:, None] * loose
    return np.asarray(drift + model.wall_areas[:, None] * np.asarray(wall.spring_mpa_per_mm))


def dead_forces(model: LevelModel, problem: Problem, density: FloatArray) -> FloatArray:
    """Gravity and forces that keep their direction, shape (n, 3) in N.

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


def held_places(model: LevelModel, problem: Problem) -> Places:
    """The chest wall and whatever else is held."""
    held = np.zeros(model.nodes.shape, np.bool_)
    displacement = np.zeros_like(model.nodes)
    for axis, fixed in enumerate(problem.wall.held):
        if fixed:
            held[model.wall, axis] = True
    for hold in problem.holds:
        inside = nodes_in(hold.region, model.nodes, model.edge_mm)
        for axis, fixed in enumerate(hold.axes):
            if fixed:
                held[inside, axis] = True
                displacement[inside, axis] = hold.displacement_mm[axis]
    return Places(held, displacement)


def pressure_forces(
    model: LevelModel, x: FloatArray, pressures: tuple[Pressure, ...]
) -> FloatArray:
    """Follower pressure at positions `x`, shape (n, 3) in N.

    A third of pressure times area acts on each corner of a triangle, against its
    outward normal as it is now.
    """
    triangles = model.sheet.triangles
    at = x[triangles]
    area = 0.5 * np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])
    share = (-_pressure(model, pressures) / 3)[:, None] * area
    return _to_corners(model, share)


def pressure_derivative(
    model: LevelModel, x: FloatArray, pressures: tuple[Pressure, ...], u: FloatArray
) -> FloatArray:
    """Derivative of `pressure_forces` in the direction `u`, shape (n, 3)."""
    triangles = model.sheet.triangles
    at, du = x[triangles], u[triangles]
    e1, e2 = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    d1, d2 = du[:, 1] - du[:, 0], du[:, 2] - du[:, 0]
    change = 0.5 * (np.cross(d1, e2) + np.cross(e1, d2))
    return _to_corners(model, (-_pressure(model, pressures) / 3)[:, None] * change)


def _pressure(model: LevelModel, pressures: tuple[Pressure, ...]) -> FloatArray:
    centroids = model.nodes[model.sheet.triangles].mean(axis=1)
    total = np.zeros(len(centroids))
    for pressure in pressures:
        total += pressure.pressure_mpa * pressure.region.contains(centroids)
    return total


def _to_corners(model: LevelModel, share: FloatArray) -> FloatArray:
    force = np.zeros_like(model.nodes)
    for corner in range(3):
        np.add.at(force, model.sheet.triangles[:, corner], share)
    return force

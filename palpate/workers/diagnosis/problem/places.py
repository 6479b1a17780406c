"""Grids of candidate places for localised effects."""

import numpy as np
from scipy.spatial import KDTree

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.mechanics.effects.base import Effect


def places_of(inverse: InverseProblem, effect: Effect) -> FloatArray:
    """Return the grid of places at which an effect is evaluated.

    Parameters
    ----------
    inverse : InverseProblem
    effect : Effect

    Returns
    -------
    ndarray, shape (g, 3) or (g, 4)
        Offsets from the middle of the body in mm, followed by radii in mm if several are tried;
        empty for an effect that acts everywhere.
    """
    where, centre = effect.place, np.asarray(inverse.frame.centre_mm)
    if where is None:
        return np.empty((0, 3))
    if where.on == "inside":
        return _inside(inverse) - centre
    grid_mm = SETTINGS.sensitivities.boundary_grid_mm
    if not where.radii_mm:
        return _on_boundary(inverse, grid_mm) - centre
    least = min(where.radii_mm)
    found = []
    for radius in where.radii_mm:
        offsets = _on_boundary(inverse, grid_mm * radius / least) - centre
        found.append(np.column_stack([offsets, np.full(len(offsets), radius)]))
    return np.concatenate(found)


def starting_places(effect: Effect, places: FloatArray, log_bayes_factors: FloatArray) -> list[int]:
    """Return the indices of places from which to start the fit of an effect, the best first.

    Neighbours on the grid lead to the same optimum, so they are skipped, as are unlikely places.

    Parameters
    ----------
    effect : Effect
    places : ndarray, shape (g, 3) or (g, 4)
        See `places_of`.
    log_bayes_factors : ndarray, shape (g,)
        Log Bayes factor of the effect at each place.
    """
    settings, grid = SETTINGS.joint_fits, SETTINGS.sensitivities
    inside = effect.place is not None and effect.place.on == "inside"
    apart_mm = settings.places_apart * (grid.inside_grid_mm if inside else grid.boundary_grid_mm)
    found: list[int] = []
    for i in map(int, np.argsort(-log_bayes_factors, kind="stable")):
        if found and log_bayes_factors[found[0]] - log_bayes_factors[i] > settings.places_behind:
            break
        if all(np.linalg.norm(places[i, :3] - places[j, :3]) > apart_mm for j in found):
            found.append(i)
        if len(found) == settings.place_starts:
            break
    return found


def _inside(inverse: InverseProblem) -> FloatArray:
    """Return points inside the body with a spacing of `inside_grid_mm` in the settings."""
    settings = SETTINGS.sensitivities
    nodes = inverse.model.finest.nodes
    spacing = settings.inside_grid_mm
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    axes = [np.arange(a + spacing / 2, b, spacing) for a, b in zip(low, high, strict=True)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    outline = inverse.points.points[inverse.points.interface == 0]
    away, near = (KDTree(points).query(centres)[0] for points in (outline, nodes))
    return np.asarray(centres[(away > settings.inside_depth_mm) & (near < spacing / 2)])


def _on_boundary(inverse: InverseProblem, spacing_mm: float) -> FloatArray:
    """Return nodes on the skin and chest wall, one in each cube of the given edge length.

    It is the node closest to the mean of all nodes in the cube.
    """
    level = inverse.model.finest
    on = level.wall_areas > 0
    on[level.contact_nodes.index] = True
    nodes = level.nodes[on]
    cell = ((nodes - nodes.min(axis=0)) // spacing_mm).astype(int)
    _, of = np.unique(cell, axis=0, return_inverse=True)
    of = of.ravel()
    count = np.bincount(of)
    middle = np.column_stack([np.bincount(of, x) / count for x in nodes.T])
    away = np.linalg.norm(nodes - middle[of], axis=1)
    order = np.lexsort((away, of))
    first = np.unique(of[order], return_index=True)[1]
    return np.asarray(nodes[order[first]])

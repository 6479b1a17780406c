"""Surfaces of a study's body: at rest, under load, and their distance from the target."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, TetMesh, Volume
from palpate.workers.comparison.observation.interface import GLANDULAR, OUTLINE, Interface
from palpate.workers.comparison.observation.point_interpolation import interpolation
from palpate.workers.comparison.observation.signed_distance import signed_distance
from palpate.workers.diagnosis.problem.shapes import shape

INTERFACES: Sequence[Interface] = (OUTLINE, GLANDULAR)
# Points this close to the chest wall are where the image was cut, not on an interface.
WALL_MARGIN_MM = 3.0
# Larger distances are drawn as this one.
BAND_MM = 12.0


@dataclass(frozen=True, eq=False)
class StudySurface:
    """One interface of a study's body.

    Parameters
    ----------
    name : str
    vertices : ndarray, shape (n, 3)
        At rest, in mm.
    triangles : ndarray of int32, shape (m, 3)
    moved : ndarray, shape (n, 3), or None
        Positions under load for the best candidate.
    gap_mm : ndarray, shape (n,), or None
        Distance from the interface of the target, positive outside; nan at the chest wall.
    """

    name: str
    vertices: FloatArray
    triangles: IntArray
    moved: FloatArray | None = None
    gap_mm: FloatArray | None = field(default=None)


def study_surfaces(
    reference: Volume,
    mesh: TetMesh | None,
    displacement_mm: FloatArray | None,
    target: Volume | None,
) -> tuple[StudySurface, ...]:
    """Return the outlines of a body and of its gland, if they exist.

    Parameters
    ----------
    reference : Volume
        `Tissue` labels at rest.
    mesh : TetMesh or None
        Mesh of n nodes.
    displacement_mm : ndarray, shape (n, 3), or None
        Displacement of the best candidate.
    target : Volume or None
        `Tissue` labels of the target.
    """
    found = []
    reference = _in_air(reference)
    for interface in INTERFACES:
        try:
            drawn = shape(reference, interface.inside)
        except InputError:
            continue  # the tissue is missing or too small
        moved = gap = None
        if mesh is not None and displacement_mm is not None:
            try:
                moved = drawn.vertices + interpolation(mesh, drawn.vertices) @ displacement_mm
            except InputError:
                moved = None  # the mesh belongs to another body
        if moved is not None and target is not None:
            gap = _gap(interface, drawn.vertices, moved, target)
        found.append(StudySurface(interface.name, drawn.vertices, drawn.triangles, moved, gap))
    return tuple(found)


def _in_air(labels: Volume) -> Volume:
    """Return a body padded with air except below the chest wall, to close its surface."""
    around = ((0, 1), (1, 1), (1, 1))
    (dx, dy, _), (x, y, z) = labels.spacing_mm, labels.origin_mm
    values = np.pad(labels.values, around)
    return replace(labels, values=values, origin_mm=(x - dx, y - dy, z))


def _gap(
    interface: Interface, rest: FloatArray, moved: FloatArray, target: Volume
) -> FloatArray | None:
    try:
        observed = signed_distance(_in_air(target), interface.inside, band_mm=BAND_MM)
        apart, _ = observed.at(moved)
    except InputError:
        return None
    at_wall = rest[:, 2] < rest[:, 2].min() + WALL_MARGIN_MM
    unknown = at_wall | (np.abs(apart) >= BAND_MM)
    return np.asarray(np.where(unknown, np.nan, apart))

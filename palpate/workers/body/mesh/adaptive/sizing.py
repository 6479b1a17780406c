"""Sizes of the cells of a graded lattice: small along surfaces."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, find_objects

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, Tissue, Volume
from palpate.workers.body.mesh.adaptive.octree import Levels, graded_levels
from palpate.workers.body.mesh.outline import Outline


@dataclass(frozen=True)
class Sizes:
    """Sizes of lattice cells; edges are 0.87 to 1 times as long.

    All but the first are rounded down to `smallest_mm` times 1, 2, 4, ...

    Parameters
    ----------
    smallest_mm : float
        Size where the tissue inside, or a gap in it, is thinner than cells of `surface_mm`.
    surface_mm : float, optional
        Size elsewhere along its surface; `smallest_mm` if not given.
    skin_mm : float
        Size at the outline of the body.
    largest_mm : float
        Size away from surfaces.
    layers : int
        Least number of cells of one size between smaller and larger cells.

    Raises
    ------
    InputError
        If the sizes are not 0 < smallest <= surface <= skin <= largest.
    """

    smallest_mm: float
    surface_mm: float | None = None
    skin_mm: float = 2.5
    largest_mm: float = 5.0
    layers: int = 1

    def __post_init__(self) -> None:
        ordered = (0, self.smallest_mm, self.at_surface_mm, self.skin_mm, self.largest_mm)
        ascending = all(a <= b for a, b in pairwise(ordered))
        if not (ascending and self.smallest_mm > 0 and self.layers >= 1):
            raise InputError(
                "An adaptive mesh needs 0 < smallest <= surface <= skin <= largest size and at "
                f"least one layer, got {', '.join(f'{s:g}' for s in ordered[1:])} mm and "
                f"{self.layers} layers."
            )

    @property
    def at_surface_mm(self) -> float:
        """Size along the surface away from thin places."""
        return self.smallest_mm if self.surface_mm is None else self.surface_mm

    def level_of(self, size_mm: float) -> int:
        """Return the largest level of cells not larger than a size."""
        return int(np.floor(np.log2(size_mm / self.smallest_mm) + 1e-9))


def cell_levels(
    labels: Volume, tissue: Tissue, outline: Outline, sizes: Sizes
) -> tuple[Levels, FloatArray]:
    """Return the levels of the smallest cells around a body, and the lowest corner of the first.

    Parameters
    ----------
    labels : Volume
    tissue : Tissue
        Tissue whose surface gets the smallest cells.
    outline : Outline
        Outline of the body.
    sizes : Sizes
    """
    h, top = sizes.smallest_mm, sizes.level_of(sizes.largest_mm)
    block = 2**top
    extent = outline.upper_mm - outline.lower_mm
    blocks = np.ceil(extent / (h * block)).astype(np.int64) + 2
    blocks[2] -= 1  # nothing is needed below the wall
    count = blocks * block
    corner = 0.5 * (outline.lower_mm + outline.upper_mm) - 0.5 * count * h
    corner[2] = outline.wall_z_mm
    largest = np.full((int(count[2]), int(count[1]), int(count[0])), top, np.uint8)

    inside = labels.values == tissue
    at_surface = sizes.level_of(sizes.at_surface_mm)
    marks = [
        (_faces_mm(labels, labels.values != Tissue.AIR), sizes.level_of(sizes.skin_mm)),
        (_faces_mm(labels, inside), at_surface),
    ]
    if at_surface:
        marks.append((_thin_mm(labels, inside, sizes.at_surface_mm), 0))
    for places, level in marks:
        cells = _cells_at(places, corner, h * 2**level, [n // 2**level for n in largest.shape])
        size = 2**level
        near = _grown(cells, 1).repeat(size, 0).repeat(size, 1).repeat(size, 2)
        largest[near] = np.minimum(largest[near], level)
    return graded_levels(largest, sizes.layers), corner


def _grown(cells: BoolArray, by: int) -> BoolArray:
    return np.asarray(binary_dilation(cells, np.ones((3, 3, 3), np.bool_), iterations=by))


def _cells_at(places: FloatArray, corner: FloatArray, h: float, shape: list[int]) -> BoolArray:
    """Return a mask of the cells of size h that contain one of the points."""
    found = np.zeros(shape, np.bool_)
    cell = np.floor((places - corner) / h).astype(np.int64)
    cell = cell[((cell >= 0) & (cell < np.array(shape)[::-1])).all(axis=1)]
    found[cell[:, 2], cell[:, 1], cell[:, 0]] = True
    return found


def _faces_mm(labels: Volume, inside: BoolArray) -> FloatArray:
    """Return the centres of the voxel faces between inside and outside, shape (k, 3)."""
    padded = np.pad(inside, 1)
    padded[0] = padded[1]  # the tissue is continued through the wall
    found = []
    for axis in range(3):
        at = np.argwhere(np.diff(padded.view(np.int8), axis=axis))[:, ::-1] - 1.0
        at[:, 2 - axis] += 0.5
        found.append(at)
    origin, step = np.asarray(labels.origin_mm), np.asarray(labels.spacing_mm)
    return np.asarray(origin + np.concatenate(found) * step)


def _thin_mm(labels: Volume, inside: BoolArray, thickness_mm: float) -> FloatArray:
    """Return the voxels where the tissue or a gap in it is thinner than a ball of this diameter.

    These are the voxels changed by closing and opening with the ball.
    """
    box = find_objects(inside.view(np.int8))[0]
    room = [int(np.ceil(2 * thickness_mm / s)) for s in labels.spacing_mm[::-1]]
    first = [max(0, b.start - r) for b, r in zip(box, room, strict=True)]
    part = tuple(slice(a, b.stop + r) for a, b, r in zip(first, box, room, strict=True))
    tissue = inside[part]
    radius, step = thickness_mm / 2, labels.spacing_mm[::-1]

    def eroded(mask: BoolArray) -> BoolArray:
        return np.asarray(distance_transform_edt(mask, step) > radius)

    def opened(mask: BoolArray) -> BoolArray:
        deep = eroded(np.pad(mask, ((room[0], 0), (0, 0), (0, 0)), mode="edge"))
        return np.asarray(distance_transform_edt(~deep, step) <= radius)[room[0] :]

    thin = (tissue & ~opened(tissue)) | (~tissue & ~opened(~tissue))
    at = (np.argwhere(thin) + first)[:, ::-1]
    return np.asarray(np.asarray(labels.origin_mm) + at * np.asarray(labels.spacing_mm))

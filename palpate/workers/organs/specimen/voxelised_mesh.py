"""Bodies of mesh files as labelled voxels, meshed like a scan."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, Volume
from palpate.workers.kernels_and_threads import CONTRACTED
from palpate.workers.organs.specimen.mesh_file import MeshFile, read_mesh_file
from palpate.workers.organs.specimen.specimen_body_keys import BodySpec
from palpate.workers.organs.specimen.specimen_keys import SpecimenSpec

# Cell data with the groups of Gmsh, the default of label_array.
PHYSICAL = "gmsh:physical"
LEAST_VOXELS, MOST_VOXELS = 8, 2e8
# Relative differences between the volumes of a mesh and its voxels: refused, and noted.
MOST_OFF, NOTED_OFF = 0.15, 0.02
# Pieces and cavities below this fraction of the body are due to rounding.
SPECK = 1e-3
WHOLE = 1e-3  # distance of a label from a whole number
# Offset of rays from the centres of voxels, in voxels, so that none runs along an edge.
BESIDE = np.array([1.3e-4, 0.7e-4])
ON_A_FACE = 1e-9  # barycentric weight that still counts as inside


def filled(spec: SpecimenSpec, path: Path) -> Volume:
    """Return the voxels of a body; see `body_of_file`."""
    return body_of_file(spec, path)[0]


def body_of_file(spec: SpecimenSpec, path: Path) -> tuple[Volume, tuple[str, ...]]:
    """Return the voxels of a body, and notes on parts of the file that were left out.

    Parameters
    ----------
    spec : SpecimenSpec
        Experiment whose body is a mesh.
    path : Path
        The mesh file.

    Raises
    ------
    InputError
        If the file cannot be read or contains neither volume cells nor a closed surface, or its
        body has loose pieces or encloses a cavity.
    """
    mesh, voxels = _mesh_and_voxels(spec, path)
    return voxels, (*mesh.notes, *_volume_note(path, mesh, voxels))


def size_of_file(spec: SpecimenSpec, path: Path) -> str:
    """Return the size and the volume of the body of a file, and of its voxels, as text."""
    mesh, voxels = _mesh_and_voxels(spec, path)
    size = " x ".join(f"{side:.4g}" for side in mesh.size_mm)
    volume = "" if mesh.volume_mm3 is None else f", {mesh.volume_mm3 / 1000:.4g} ml"
    return (
        f"{size} mm{volume}; {_volume_mm3(voxels) / 1000:.4g} ml in voxels of "
        f"{voxels.spacing_mm[0]:g} mm"
    )


def _mesh_and_voxels(spec: SpecimenSpec, path: Path) -> tuple[MeshFile, Volume]:
    body = spec.body
    mesh, voxel = read_mesh_file(path, body.mm_per_unit), body.voxel_mm
    if voxel is None:
        raise AssertionError("a mesh comes with the size of its voxels")
    low, count = _grid(path, mesh.corners.reshape(-1, 3), voxel)
    values = np.zeros(tuple(count[::-1]), np.uint8)
    origin = low + voxel / 2
    if mesh.is_solid:
        _fill(mesh.corners, _tissues(spec, mesh, path), origin, voxel, values)
    else:
        if body.labels is not None:
            raise InputError(f"{path} is a surface and has no cells to label. Remove body.labels.")
        crossings = np.zeros(values.shape[1:], np.int64)
        beside = origin - np.append(BESIDE, 0.0) * voxel
        _cross(mesh.corners, beside, voxel, values, crossings)
        _closed(crossings, path)
        values *= int(spec.tissue_of(next(iter(spec.materials))))
    x, y, z = map(float, origin)
    voxels = Volume(values, (voxel, voxel, voxel), (x, y, z))
    if mesh.is_solid:
        _check_volume(path, mesh, voxels)
    _check_whole(path, values > 0, voxel)
    if not mesh.is_solid:
        _check_volume(path, mesh, voxels)
    return mesh, voxels


def _grid(path: Path, points: FloatArray, voxel: float) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the lowest corner and the whole numbers of voxels that fit the box best."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.array2string(high - low, precision=4, separator=", ")
    units = "Check body.mm_per_unit: 1000 for a file in metres, 0.001 for one in micrometres."
    if np.prod((high - low) / voxel) > MOST_VOXELS:
        raise InputError(
            f"Voxels of {voxel:g} mm are too small for the body of {path}, {size} mm: at most "
            f"{MOST_VOXELS:g} fit in memory. {units}"
        )
    count = np.maximum(1, np.rint((high - low) / voxel)).astype(np.int64)
    if count.min() < LEAST_VOXELS:
        raise InputError(
            f"Voxels of {voxel:g} mm are too large for the body of {path}, {size} mm: its "
            f"thinnest part needs {LEAST_VOXELS}. Set body.voxel_mm to "
            f"{(high - low).min() / 10:.2g}. {units}"
        )
    return (low + high - count * voxel) / 2, count


def _volume_mm3(voxels: Volume) -> float:
    return int((voxels.values > 0).sum()) * voxels.voxel_mm3


def _check_volume(path: Path, mesh: MeshFile, voxels: Volume) -> None:
    """Refuse cells that overlap or that voxels do not resolve."""
    stated, filled_mm3 = mesh.volume_mm3, _volume_mm3(voxels)
    if stated is None or abs(filled_mm3 - stated) <= MOST_OFF * stated:
        return
    what, how = (
        ("The cells of {} add up to", "overlap, or are thinner than the voxels")
        if mesh.is_solid
        else ("The facets of {} enclose", "overlap, face inwards in parts, or are too close")
    )
    raise InputError(
        f"{what.format(path)} {stated / 1000:.4g} ml, but fill {filled_mm3 / 1000:.4g} ml: they "
        f"{how}. Repair the mesh, or set a smaller body.voxel_mm."
    )


def _volume_note(path: Path, mesh: MeshFile, voxels: Volume) -> Iterator[str]:
    """Yield a note if the voxels are noticeably larger or smaller than the body."""
    stated, filled_mm3 = mesh.volume_mm3, _volume_mm3(voxels)
    if stated is not None and abs(filled_mm3 - stated) > NOTED_OFF * stated:
        sides = np.array(voxels.values.shape[::-1]) * voxels.spacing_mm
        mesh_size, voxel_size = (
            " x ".join(f"{side:.4g}" for side in size) for size in (mesh.size_mm, sides)
        )
        yield (
            f"Voxels of {voxels.spacing_mm[0]:g} mm hold {filled_mm3 / 1000:.4g} ml, "
            f"{filled_mm3 / stated - 1:+.1%} against the {stated / 1000:.4g} ml of {path.name}: "
            f"{voxel_size} mm in voxels, {mesh_size} mm in the file. The stiffness is off by as "
            "much or more; set a body.voxel_mm that is smaller or divides the sides."
        )


def _check_whole(path: Path, inside: BoolArray, voxel: float) -> None:
    """Refuse loose pieces, which the mesher would drop, and cavities, which it would fill."""
    total = int(inside.sum())
    for what, empty, wish in (
        ("has loose pieces", False, "Join them, or export one body per file."),
        ("encloses a cavity", True, "Closed cavities are not supported: open or fill it."),
    ):
        regions, count = ndimage.label(
            np.pad(~inside, 1, constant_values=True) if empty else inside
        )
        sizes = np.bincount(regions.ravel())[1:] if count else np.zeros(0, np.int64)
        # The largest piece is the body; the piece of air at the corner is outside.
        main = int(regions[0, 0, 0]) - 1 if empty else int(sizes.argmax())
        rest = int(np.delete(sizes, main).sum())
        if rest > SPECK * total:
            raise InputError(
                f"The body of {path} {what} of {rest * voxel**3 / 1000:.4g} ml; its total volume "
                f"is {total * voxel**3 / 1000:.4g} ml. {wish}"
            )


def _tissues(spec: SpecimenSpec, mesh: MeshFile, path: Path) -> NDArray[np.uint8]:
    """Return the label that voxels take in each tetrahedron."""
    body = spec.body
    if body.labels is None:
        return np.full(len(mesh.cell), int(spec.tissue_of(next(iter(spec.materials)))), np.uint8)
    labels = _labels(mesh, body, path)
    stated = np.zeros(len(labels), np.uint8)
    for label, material in body.labels.items():
        stated[labels == label] = int(spec.tissue_of(material))
    # A cell in several groups takes the one that body.labels names.
    own = np.zeros(len(labels), np.uint8)
    np.maximum.at(own, mesh.same, stated)
    both = (stated > 0) & (stated != own[mesh.same])
    if both.any():
        cell = int(np.flatnonzero(both)[0])
        groups = sorted(set(labels[mesh.same == mesh.same[cell]].tolist()) & set(body.labels))
        raise InputError(
            f"{path}: cell {cell}, counted from 0, has the labels {groups}, which are of different "
            "materials in body.labels. Name there only one label of each cell."
        )
    tissues = own[mesh.cell]
    unknown = sorted(set(labels[mesh.cell[tissues == 0]].tolist()))
    if unknown:
        raise InputError(f"{path} has the labels {unknown}, which are missing in body.labels.")
    return tissues


def _labels(mesh: MeshFile, body: BodySpec, path: Path) -> IntArray:
    known = mesh.labels
    only = next(iter(known)) if len(known) == 1 else None
    name = body.label_array or (PHYSICAL if PHYSICAL in known else only)
    if name not in known:
        raise InputError(
            f"{path}: body.label_array must name one of the cell data arrays, found "
            f"{body.label_array!r}; the file has {', '.join(known) or 'none'}."
        )
    values = np.asarray(known[name], np.float64)
    whole = np.rint(values)
    if not np.isfinite(values).all() or np.abs(values - whole).max() > WHOLE:
        raise InputError(f"{path}: the cell data {name} are not labels: not all are integers.")
    return whole.astype(np.int32)


def _closed(crossings: NDArray[np.int64], path: Path) -> None:
    """Refuse a surface that some ray enters without leaving."""
    if not crossings.any() or (crossings % 2).any():
        raise InputError(
            f"{path} is not a closed surface: {int((crossings % 2).sum())} of "
            f"{int((crossings > 0).sum())} rays through it end inside. Close its holes."
        )


@njit(**CONTRACTED)
def _fill(
    corners: FloatArray,
    tissue: NDArray[np.uint8],
    origin: FloatArray,
    voxel: float,
    values: NDArray[np.uint8],
) -> None:
    """Assign the tissue of each tetrahedron to the voxels whose centres are inside."""
    nz, ny, nx = values.shape
    for m in range(len(corners)):
        base = corners[m, 0]
        inverse = np.linalg.inv((corners[m, 1:] - base).T)
        first, last = np.empty(3, np.int64), np.empty(3, np.int64)
        for c in range(3):
            first[c] = max(0, int(np.floor((corners[m, :, c].min() - origin[c]) / voxel)))
            last[c] = int(np.ceil((corners[m, :, c].max() - origin[c]) / voxel))
        for k in range(first[2], min(last[2] + 1, nz)):
            for j in range(first[1], min(last[1] + 1, ny)):
                for i in range(first[0], min(last[0] + 1, nx)):
                    dx = origin[0] + i * voxel - base[0]
                    dy = origin[1] + j * voxel - base[1]
                    dz = origin[2] + k * voxel - base[2]
                    least, total = 1.0, 0.0
                    for c in range(3):
                        w = inverse[c, 0] * dx + inverse[c, 1] * dy + inverse[c, 2] * dz
                        least = min(least, w)
                        total += w
                    if min(least, 1.0 - total) >= -ON_A_FACE:
                        values[k, j, i] = tissue[m]


@njit(**CONTRACTED)
def _cross(
    triangles: FloatArray,
    origin: FloatArray,
    voxel: float,
    values: NDArray[np.uint8],
    crossings: NDArray[np.int64],
) -> None:
    """Toggle the voxels above each crossing of a ray along z, and count crossings."""
    nz, ny, nx = values.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        low_x, high_x = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        low_y, high_y = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
        i0, i1 = max(0, int((low_x - origin[0]) / voxel)), int((high_x - origin[0]) / voxel) + 2
        j0, j1 = max(0, int((low_y - origin[1]) / voxel)), int((high_y - origin[1]) / voxel) + 2
        for j in range(j0, min(j1, ny)):
            y = origin[1] + j * voxel
            for i in range(i0, min(i1, nx)):
                x = origin[0] + i * voxel
                u = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
                v = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
                if u < 0.0 or v < 0.0 or u + v > 1.0:
                    continue
                z = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
                crossings[j, i] += 1
                for k in range(nz):
                    if origin[2] + k * voxel > z:
                        values[k, j, i] ^= 1

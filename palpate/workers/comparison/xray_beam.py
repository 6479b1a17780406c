"""The X-ray beam of a mammography unit: spectrum, attenuation, geometry and paths through tissue.

Spectra and attenuation are small tables shipped with the package; the first lines of each name
its source. The geometry gives the positions of the focal spot, the body and the pixels of the
detector (cone-beam mammograms of labelled voxels, thesis section 4.4). The path lengths of rays
in each tissue are exact (Siddon's line integrals).
"""

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Final, Literal, get_args

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Tissue, Triple, Volume
from palpate.workers.kernels_and_threads import EXACT, EXACT_UNCHECKED


@lru_cache(maxsize=32)
def xray_table(name: str) -> FloatArray:
    """Read a table of two columns, shape (rows, 2), ascending in the first column.

    Parameters
    ----------
    name : str
        Name of a file in ``xray_tables/``, without its suffix.
    """
    text = files("palpate.workers.comparison").joinpath("xray_tables", f"{name}.csv").read_text()
    rows = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
    values = np.array(rows[1:], dtype=np.float64)  # the first row names the columns
    values.setflags(write=False)  # cached and shared
    return values


Beam = Literal["mo_mo", "rh_rh", "w_rh"]
BEAMS: tuple[Beam, ...] = get_args(Beam)
TABLE_DISTANCE_MM = 1000.0
# Bins with a smaller fraction of all photons are omitted.
NEGLIGIBLE = 1e-7


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Spectrum of the photons that reach the body.

    Parameters
    ----------
    energies_kev : ndarray, shape (k,)
        Photon energies, ascending.
    photons_per_mm2_mas : ndarray, shape (k,)
        Photons in each bin per mAs, 1000 mm from the focal spot.

    Raises
    ------
    InputError
        If the arrays differ in shape, or contain no photons.
    """

    energies_kev: FloatArray
    photons_per_mm2_mas: FloatArray

    def __post_init__(self) -> None:
        energies, photons = self.energies_kev, self.photons_per_mm2_mas
        if energies.shape != photons.shape or energies.ndim != 1:
            raise InputError(
                "A spectrum needs one photon count for each energy, got shapes "
                f"{energies.shape} and {photons.shape}."
            )
        if not photons.sum() > 0:
            raise InputError("A spectrum needs at least one photon, but all counts are 0.")


def spectrum_of(beam: Beam) -> Spectrum:
    """Return the spectrum of an anode and a filter at 28 kVp, behind a compression plate.

    Parameters
    ----------
    beam : {"mo_mo", "rh_rh", "w_rh"}
        Anode and filter: molybdenum, rhodium, or tungsten with rhodium.

    Raises
    ------
    InputError
        If the beam is unknown.
    """
    if beam not in BEAMS:
        raise InputError(f"The beam must be one of {', '.join(BEAMS)}, got {beam!r}.")
    energies, photons = xray_table(f"{beam}_28kvp").T
    kept = photons > NEGLIGIBLE * photons.sum()
    return Spectrum(energies[kept], photons[kept])


# Cooper's ligaments are fibrous like the stroma of the gland.
TABLES: Final = {
    Tissue.FAT: "adipose",
    Tissue.GLANDULAR: "glandular",
    Tissue.SKIN: "skin",
    Tissue.MUSCLE: "muscle",
    Tissue.LIGAMENT: "glandular",
}


def attenuation_per_mm(tissue: Tissue, energies_kev: FloatArray) -> FloatArray:
    """Return the linear attenuation coefficient, including scatter, in 1/mm.

    Parameters
    ----------
    tissue : Tissue
        Tissue; air does not attenuate.
    energies_kev : ndarray
        Energies from 5 to 40 keV; logarithms are interpolated between the rows of the table.

    Raises
    ------
    InputError
        If an energy is outside the table.

    Examples
    --------
    >>> mu = attenuation_per_mm(Tissue.GLANDULAR, np.array([20.0]))
    >>> round(float(mu[0]), 3)
    0.08
    """
    energies = np.asarray(energies_kev, np.float64)
    if tissue == Tissue.AIR:
        return np.zeros_like(energies)
    known, values = xray_table(TABLES[tissue]).T
    if energies.size and not (known[0] <= energies.min() and energies.max() <= known[-1]):
        raise InputError(
            f"Attenuation is known from {known[0]:g} to {known[-1]:g} keV, but {energies.min():g} "
            f"to {energies.max():g} keV was requested. Use a mammography spectrum."
        )
    return np.asarray(np.exp(np.interp(np.log(energies), np.log(known), np.log(values))))


def attenuation_table(energies_kev: FloatArray) -> FloatArray:
    """Return coefficients of all tissues, in the order of `Tissue`, (tissues, energies), 1/mm."""
    return np.stack([attenuation_per_mm(tissue, energies_kev) for tissue in Tissue])


CC_AXIS: Triple = (0.0, 1.0, 0.0)


def mlo_axis(oblique_deg: float = 45.0) -> Triple:
    """Return the direction from the lower to the upper plate in a mediolateral oblique view."""
    angle = np.radians(oblique_deg)
    return -float(np.sin(angle)), float(np.cos(angle)), 0.0


@dataclass(frozen=True)
class Unit:
    """A mammography unit.

    Parameters
    ----------
    source_mm : float
        Distance from the focal spot to the plane of the detector.
    gap_mm : float
        Distance from the detector to the plate under the body.
    pixel_mm : float
        Edge length of a pixel.

    Raises
    ------
    InputError
        If a length is not positive, or the plate is beyond the focal spot.
    """

    source_mm: float = 650.0
    gap_mm: float = 20.0
    pixel_mm: float = 0.2

    def __post_init__(self) -> None:
        if not (0 <= self.gap_mm < self.source_mm and self.pixel_mm > 0):
            raise InputError(
                "A mammography unit needs pixels > 0 mm and 0 <= gap < source distance, got "
                f"pixels of {self.pixel_mm:g} mm, a gap of {self.gap_mm:g} mm and a focal spot at "
                f"{self.source_mm:g} mm."
            )


@dataclass(frozen=True, eq=False)
class Geometry:
    """Rays from a point to the centres of pixels.

    Parameters
    ----------
    source_mm : ndarray, shape (3,)
        The focal spot.
    first_mm : ndarray, shape (3,)
        Centre of the pixel [0, 0].
    down_mm, right_mm : ndarray, shape (3,)
        Steps from a pixel to the next row and to the next column.
    rows, columns : int
    """

    source_mm: FloatArray
    first_mm: FloatArray
    down_mm: FloatArray
    right_mm: FloatArray
    rows: int
    columns: int

    @property
    def pixels_mm(self) -> FloatArray:
        """Centres of all pixels, shape (rows, columns, 3)."""
        row, column = np.mgrid[: self.rows, : self.columns]
        return np.asarray(
            self.first_mm + row[..., None] * self.down_mm + column[..., None] * self.right_mm
        )


def geometry_of(
    body: Volume, axis: Triple = CC_AXIS, unit: Unit = Unit(), support_mm: float | None = None
) -> Geometry:
    """Place a compressed body on the detector.

    The focal spot is above the chest-wall edge, at the z of the lowest voxel faces, and above the
    middle of the body along the wall; no pixel is behind the wall. Rows run along the wall, columns
    from the wall to the nipple.

    Parameters
    ----------
    body : Volume
        Labels; 0 is air.
    axis : tuple of float
        Direction from the lower to the upper plate, perpendicular to z.
    unit : Unit
    support_mm : float, optional
        Position of the lower plate's upper face along the axis; by default, the start of the body.

    Raises
    ------
    InputError
        If the volume is all air, the axis is not perpendicular to z, or the body reaches the
        focal spot.
    """
    up = np.asarray(axis, np.float64)
    if not (np.linalg.norm(up) > 0 and abs(up[2]) < 1e-9 * np.linalg.norm(up)):
        raise InputError(f"The axis of compression must be perpendicular to z, got {axis}.")
    up = up / np.linalg.norm(up)
    out = np.array([0.0, 0.0, 1.0])
    along = np.cross(up, out)
    corners = _corners(body)
    heights = corners @ up
    floor = float(heights.min()) if support_mm is None else support_mm
    plane = floor - unit.gap_mm
    if heights.max() >= plane + unit.source_mm:
        raise InputError(
            f"The body reaches {heights.max() - plane:.4g} mm above the detector, beyond the "
            f"focal spot at {unit.source_mm:g} mm. Check that the volume is the compressed body, "
            "in mm."
        )
    wall = float(corners[:, 2].min())
    middle = float((corners @ along).min() + (corners @ along).max()) / 2
    source = (plane + unit.source_mm) * up + middle * along + wall * out
    # Shadows of the corners on the plane of the detector.
    rays = corners - source
    shadow = source + rays * (unit.source_mm / -(rays @ up))[:, None]
    h = unit.pixel_mm
    half = int(np.ceil(np.abs((shadow - source) @ along).max() / h))
    columns = int(np.ceil((shadow[:, 2] - wall).max() / h))
    first = plane * up + (middle + (0.5 - half) * h) * along + (wall + 0.5 * h) * out
    return Geometry(source, first, h * along, h * out, 2 * half, columns)


def _corners(body: Volume) -> FloatArray:
    """Return the corners of the columns of voxels along z that contain tissue, shape (k, 3).

    All columns span the z range of the whole body, so that its shadow is inside the shadow of the
    corners.
    """
    tissue = body.values != Tissue.AIR
    y, x = np.nonzero(tissue.any(axis=0))
    if not len(y):
        raise InputError("The volume contains only air. Check its labels.")
    z = np.flatnonzero(tissue.any(axis=(1, 2)))
    origin, step = np.asarray(body.origin_mm), np.asarray(body.spacing_mm)
    ends = []
    for dz in (z[0] - 0.5, z[-1] + 0.5):
        for dy in (-0.5, 0.5):
            for dx in (-0.5, 0.5):
                corners = np.column_stack([x + dx, y + dy, np.full(len(x), dz)])
                ends.append(origin + corners * step)
    return np.concatenate(ends)


N_TISSUES = len(Tissue)
# Pixels are processed in square tiles: their rays share cache lines.
TILE = 32


def path_lengths_mm(body: Volume, geometry: Geometry) -> NDArray[np.float32]:
    """Return the length of each ray in each tissue.

    A ray goes from the focal spot to the centre of a pixel and from voxel to voxel at its
    intersections with the planes between them [1]_; there are no steps inside a voxel, so the
    lengths are exact for these voxels.

    Parameters
    ----------
    body : Volume
        Labels of `Tissue`.
    geometry : Geometry

    Returns
    -------
    ndarray of float32, shape (rows, columns, tissues)
        In mm. For air, only the length inside the box of `body`.

    Raises
    ------
    InputError
        If a value is not a label.

    References
    ----------
    .. [1] R. L. Siddon, Fast calculation of the exact radiological path for a
       three-dimensional CT array, Med. Phys. 12 (1985) 252.
    .. [2] J. Amanatides, A. Woo, A fast voxel traversal algorithm, Eurographics 1987.
    """
    values = body.values
    if values.dtype.kind not in "biu" or int(values.max(initial=0)) >= N_TISSUES:
        raise InputError(
            f"Tissue labels must be whole numbers from 0 to {N_TISSUES - 1}, got {values.dtype} "
            f"up to {values.max(initial=0)}. Relabel the volume first."
        )
    labels = np.ascontiguousarray(values, dtype=np.uint8)
    spacing = np.asarray(body.spacing_mm, np.float64)
    corner = np.asarray(body.origin_mm, np.float64) - 0.5 * spacing
    lengths = np.zeros((geometry.rows, geometry.columns, N_TISSUES), np.float32)
    _follow(
        labels,
        corner,
        spacing,
        geometry.source_mm,
        geometry.first_mm,
        geometry.down_mm,
        geometry.right_mm,
        lengths,
    )
    return lengths


@njit(**EXACT)
def _follow(
    labels: NDArray[np.uint8],
    corner: FloatArray,
    spacing: FloatArray,
    source: FloatArray,
    first: FloatArray,
    down: FloatArray,
    right: FloatArray,
    out: NDArray[np.float32],
) -> None:
    rows, columns, _ = out.shape
    count = np.array((labels.shape[2], labels.shape[1], labels.shape[0]))
    flat = labels.reshape(-1)
    stride = np.array((1, count[0], count[0] * count[1]))
    start = (source - corner) / spacing  # in voxels
    way = np.empty(3)
    total = np.empty(N_TISSUES)
    for row0 in range(0, rows, TILE):
        for column0 in range(0, columns, TILE):
            for row in range(row0, min(row0 + TILE, rows)):
                for column in range(column0, min(column0 + TILE, columns)):
                    length = 0.0
                    for c in range(3):
                        way[c] = first[c] + row * down[c] + column * right[c] - source[c]
                        length += way[c] * way[c]
                        way[c] /= spacing[c]
                    total[:] = 0.0
                    _one_ray(flat, count, stride, start, way, total)
                    length = np.sqrt(length)
                    for t in range(N_TISSUES):
                        out[row, column, t] = total[t] * length


@njit(**EXACT_UNCHECKED)
def _one_ray(
    flat: NDArray[np.uint8],
    count: NDArray[np.int64],
    stride: NDArray[np.int64],
    start: FloatArray,
    way: FloatArray,
    total: FloatArray,
) -> None:
    """Add the part of a ray from ``start`` (0) to ``start + way`` (1) in each label."""
    enter, leave = 0.0, 1.0
    for c in range(3):
        if way[c] == 0.0:
            if start[c] < 0.0 or start[c] >= count[c]:
                return
        else:
            a, b = -start[c] / way[c], (count[c] - start[c]) / way[c]
            enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    if not enter < leave:
        return
    # Ray parameter at the next plane along each axis, and from plane to plane.
    cx, sx, tx, dx = _first_plane(start[0], way[0], enter, count[0])
    cy, sy, ty, dy = _first_plane(start[1], way[1], enter, count[1])
    cz, sz, tz, dz = _first_plane(start[2], way[2], enter, count[2])
    voxel = cx + stride[1] * cy + stride[2] * cz
    hop_x, hop_y, hop_z = sx, sy * stride[1], sz * stride[2]
    left_x = count[0] - cx if sx > 0 else cx + 1
    left_y = count[1] - cy if sy > 0 else cy + 1
    left_z = count[2] - cz if sz > 0 else cz + 1
    since = enter  # start of the current label
    label = flat[voxel]
    while True:
        if tx <= ty and tx <= tz:
            now = tx
            tx += dx
            voxel += hop_x
            left_x -= 1
            over = left_x == 0
        elif ty <= tz:
            now = ty
            ty += dy
            voxel += hop_y
            left_y -= 1
            over = left_y == 0
        else:
            now = tz
            tz += dz
            voxel += hop_z
            left_z -= 1
            over = left_z == 0
        if over or now >= leave:
            total[label] += max(leave - since, 0.0)
            return
        if flat[voxel] != label:
            total[label] += max(now - since, 0.0)
            label = flat[voxel]
            since = max(now, since)


@njit(**EXACT_UNCHECKED)
def _first_plane(
    start: float, way: float, enter: float, count: int
) -> tuple[int, int, float, float]:
    """Return the entry voxel, direction, ray parameter at its far plane, and between planes."""
    at = min(max(int(np.floor(start + enter * way)), 0), count - 1)
    if way > 0.0:
        return at, 1, (at + 1 - start) / way, 1.0 / way
    if way < 0.0:
        return at, -1, (at - start) / way, -1.0 / way
    return at, 1, np.inf, np.inf

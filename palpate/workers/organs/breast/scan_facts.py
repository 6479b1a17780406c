"""Facts about the scans and loads of a breast, for its plausibility checks and its noise.

A segmented body is one piece without holes, surrounded by air. Extents are along an axis
perpendicular to z. `study_noise` is the default noise of the interfaces of label volumes, for
studies and diagnoses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from palpate.storage.values import BoolArray, FloatArray, Tissue, Triple, Volume
from palpate.workers.body.images.named_labels import box_words
from palpate.workers.body.images.tissue_labels import crop_to_body, label_counts, resample_labels
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.mechanics.fem.boundary_value_problem import Constants

# Width of the added air, larger than the blur of an interface.
AIR_VOXELS = 4


def one_body(labels: Volume, filling: Tissue = Tissue.FAT) -> Volume:
    """Keep the largest connected piece of tissue and fill its enclosed air.

    Air inside a breast and tissue outside it are segmentation errors; each would
    be an interface that the other scans of the body lack.

    Parameters
    ----------
    labels : Volume
        `Tissue` labels.
    filling : Tissue
        Tissue that replaces enclosed air.

    Returns
    -------
    Volume
        On the same lattice; the volume itself if there is nothing to do.
    """
    tissue = labels.values != Tissue.AIR
    pieces, count = label(tissue)
    body = tissue
    if count > 1:
        body = pieces == int(np.argmax(np.bincount(pieces[tissue])))
    # Holes open to the chest wall, where the scan was cut, are kept.
    whole = _filled(body)
    if count <= 1 and np.array_equal(whole, tissue):
        return labels
    values = np.where(body, labels.values, labels.values.dtype.type(Tissue.AIR))
    values[whole & ~body] = filling
    return replace(labels, values=values)


def _filled(body: BoolArray) -> BoolArray:
    """Return the body and all air inside it that is not connected to the outside by faces."""
    # Four times as fast as `binary_fill_holes`, which dilates the outside step by step.
    pieces, _ = label(np.pad(~body, 1, constant_values=True))
    return np.asarray(pieces[1:-1, 1:-1, 1:-1] != pieces[0, 0, 0])


@dataclass(frozen=True)
class EnclosedAir:
    """Air inside a body: its volume, share of the body and number of places, and the largest one.

    `box` is the first and the last voxel of the largest place, in words.
    """

    ml: float
    share: float
    places: int
    box: str


def enclosed_air(labels: Volume) -> EnclosedAir | None:
    """Return the air that a body encloses, by faces of voxels; None if there is none."""
    body = np.asarray(labels.values != Tissue.AIR)
    air = _filled(body) & ~body
    voxels = int(np.count_nonzero(air))
    if not voxels:
        return None
    pieces, count = label(air)
    largest = pieces == 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
    share = voxels / int(np.count_nonzero(body))
    ml = voxels * labels.voxel_mm3 / 1000
    return EnclosedAir(ml, share, count, box_words(labels, largest))


def in_air(labels: Volume) -> Volume:
    """Return the body in a box with air around it, except at the chest wall, where it is cut.

    A volume may end where the body touches a plate; its surface there is not a cut.

    Raises
    ------
    InputError
        If the volume is all air.
    """
    tight = crop_to_body(labels, margin_voxels=0)
    more = AIR_VOXELS
    values = np.pad(tight.values, ((0, more), (more, more), (more, more)))
    x, y, z = tight.origin_mm
    dx, dy, _ = tight.spacing_mm
    return replace(tight, values=values, origin_mm=(x - more * dx, y - more * dy, z))


def in_coarser_voxels(volume: Volume, spacing_mm: float) -> Volume:
    """Resample a volume over the same box at a coarser spacing, by nearest neighbour.

    A volume whose voxels are already (almost) that large is returned unchanged.
    """
    if max(volume.spacing_mm) > spacing_mm * (1 - 1e-6):
        return volume
    spacing = np.asarray(volume.spacing_mm)
    size = spacing * np.asarray(volume.shape_xyz)
    nx, ny, nz = (int(n) for n in np.ceil(size / spacing_mm - 1e-6))
    ox, oy, oz = (float(o) for o in volume.origin_mm - spacing / 2 + spacing_mm / 2)
    three = (spacing_mm, spacing_mm, spacing_mm)
    return resample_labels(volume, Volume(np.empty((nz, ny, nx), np.uint8), three, (ox, oy, oz)))


def unit_axis(axis: Triple) -> Triple:
    """Return the unit vector of an axis perpendicular to z."""
    length = float(np.linalg.norm(axis))
    return axis[0] / length, axis[1] / length, 0.0


def extent_mm(labels: Volume, axis: Triple) -> tuple[float, float]:
    """Return the extent of the body, to its voxel faces, along an axis perpendicular to z."""
    along = np.asarray(axis[:2]) / np.linalg.norm(axis)
    y, x = _row_ends((labels.values != Tissue.AIR).any(axis=0))
    spacing = np.asarray(labels.spacing_mm[:2])
    places = np.asarray(labels.origin_mm[:2]) + spacing * np.column_stack([x, y])
    heights = places @ along
    half = float(np.abs(along) @ spacing) / 2
    return float(heights.min()) - half, float(heights.max()) + half


def _row_ends(there: BoolArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return row and column of the first and the last voxel of each nonempty row."""
    rows = np.flatnonzero(there.any(axis=1))
    first = there[rows].argmax(axis=1)
    last = there.shape[1] - 1 - there[rows, ::-1].argmax(axis=1)
    return np.concatenate([rows, rows]), np.concatenate([first, last])


def plate_frame(axis: Triple) -> FloatArray:
    """Return unit vectors perpendicular to the compression, along it and along z, as rows."""
    x, y, _ = unit_axis(axis)
    return np.array([[y, -x, 0.0], [x, y, 0.0], [0.0, 0.0, 1.0]])


# Maximum number of sampled voxels of a scan, to limit the time of the checks.
ENOUGH_VOXELS = 400_000
AXES = "xyz"
Tissues = Mapping[Tissue, Constants]


@dataclass(frozen=True, eq=False)
class Scan:
    """One scan of a breast.

    Parameters
    ----------
    file : str
        Name in messages.
    force_n : float or None
        Force on the plates; 0 at rest, None if only their distance is known.
    axis : tuple of float
        Direction from the lower to the upper plate.
    labels : Volume
        `Tissue` labels, above the chest wall.
    whole : Volume, optional
        Labels including the tissue below the chest wall.
    cut_cm2 : mapping of str to float, optional
        Section of the body on each face of its image that cuts it, if the labels no longer have
        the border of the image; see `scan_border.cut_cm2`.
    filled : EnclosedAir, optional
        Air that was filled in the labels.
    """

    file: str
    force_n: float | None
    axis: Triple
    labels: Volume
    whole: Volume | None = None
    cut_cm2: Mapping[str, float] | None = None
    filled: EnclosedAir | None = None

    @cached_property
    def body(self) -> BoolArray:
        """Return the mask of the body, ``[z, y, x]``."""
        return np.asarray(self.labels.values != Tissue.AIR)

    @cached_property
    def ml(self) -> float:
        """Return the volume of the body in ml."""
        return float(np.count_nonzero(self.body)) * self.labels.voxel_mm3 / 1000

    @cached_property
    def _lines(self) -> tuple[BoolArray, BoolArray, BoolArray]:
        """Return the masks of the slices with tissue along x, y and z."""
        flat: BoolArray = np.any(self.body, axis=0)
        return np.any(flat, axis=0), np.any(flat, axis=1), np.any(self.body, axis=(1, 2))

    @cached_property
    def box(self) -> list[tuple[int, int]]:
        """Return the first and the last voxel of the body along x, y and z."""
        indices = [np.flatnonzero(line) for line in self._lines]
        return [(int(i[0]), int(i[-1])) for i in indices]

    @cached_property
    def sides_mm(self) -> list[float]:
        """Return the lengths of the body along x, y and z in mm."""
        spacing = self.labels.spacing_mm
        return [(b - a + 1) * s for (a, b), s in zip(self.box, spacing, strict=True)]

    @cached_property
    def extent_mm(self) -> tuple[float, float]:
        """Return the extent of the body along the axis of compression in mm."""
        return extent_mm(self.labels, self.axis)

    @property
    def thickness_mm(self) -> float:
        """Return the greatest thickness between the plates in mm."""
        low, high = self.extent_mm
        return high - low

    @cached_property
    def median_thickness_mm(self) -> float:
        """Return the median thickness of the slices in mm.

        Behind the edge of a plate, a compressed body bulges.
        """
        return self.median_thickness_along(self.axis)

    def median_thickness_along(self, axis: Triple) -> float:
        """Return the median thickness of the slices along an axis in mm."""
        there = np.flatnonzero(self.body.any(axis=(1, 2)))
        slices = (replace(self.labels, values=self.labels.values[z : z + 1]) for z in there)
        extents = (extent_mm(one, axis) for one in slices)
        return float(np.median([high - low for low, high in extents]))

    @cached_property
    def voxels(self) -> dict[Tissue, int]:
        """Return the number of voxels of each tissue that the body has."""
        counts = label_counts(self.labels)
        return {Tissue(n): count for n, count in counts.items() if n != Tissue.AIR}

    @property
    def voxel_mm(self) -> float:
        """Return the longest side of a voxel in mm."""
        return max(self.labels.spacing_mm)

    @property
    def sides(self) -> str:
        """Return the sides of a voxel, as a text."""
        return " x ".join(f"{s:g}" for s in self.labels.spacing_mm) + " mm"

    @cached_property
    def pieces_ml(self) -> list[float]:
        """Return the volumes of the connected pieces in ml, largest first."""
        (x0, x1), (y0, y1), (z0, z1) = self.box
        pieces, count = label(self.body[z0 : z1 + 1, y0 : y1 + 1, x0 : x1 + 1])
        if count < 2:
            return [self.ml]
        voxels = np.sort(np.bincount(pieces.ravel())[1:])[::-1]
        return [float(n) * self.labels.voxel_mm3 / 1000 for n in voxels]

    @cached_property
    def air(self) -> EnclosedAir | None:
        """Return the air that the body encloses in its image."""
        return self.filled or enclosed_air(self.labels)

    @cached_property
    def empty_slices(self) -> dict[str, list[int]]:
        """Return the empty slices inside the body by axis, counted from 1."""
        found: dict[str, list[int]] = {}
        for axis, line, (first, last) in zip(AXES, self._lines, self.box, strict=True):
            empty = [int(i) + 1 for i in np.flatnonzero(~line) if first < i < last]
            if empty:
                found[axis] = empty
        return found

    @cached_property
    def sample(self) -> tuple[FloatArray, np.ndarray, FloatArray]:
        """Return centres of voxels of the body, their labels, and the step between them.

        Centres have shape (n, 3) and are (x, y, z) in mm; fine scans are sampled at every second
        or third voxel along each axis.
        """
        step = max(1, int(np.ceil((np.count_nonzero(self.body) / ENOUGH_VOXELS) ** (1 / 3))))
        coarse = self.labels.values[step // 2 :: step, step // 2 :: step, step // 2 :: step]
        index = np.argwhere(coarse != Tissue.AIR)
        spacing = np.asarray(self.labels.spacing_mm)
        origin = np.asarray(self.labels.origin_mm) + (step // 2) * spacing
        return origin + step * spacing * index[:, ::-1], coarse[tuple(index.T)], step * spacing


@dataclass(frozen=True)
class PlateLoad:
    """Load between two plates, as given in a file.

    Parameters
    ----------
    where : str
        Key in the file, for messages.
    axis : tuple of float
        Direction from the lower to the upper plate.
    force_n : float or None
    starts_mm : (str, float, float) or None
        Key in the file, and initial positions of the plates along the axis; None if they are
        taken from the scan at rest.
    initial_mm, distance_mm : float or None
        Given distances between the plates, before and under compression.
    ends_mm : (float, float) or None
        Given positions of the plates under compression.
    fixed : {"lower", "middle", "none"}
        End of the body that a force does not move.
    """

    where: str
    axis: Triple
    force_n: float | None = None
    starts_mm: tuple[str, float, float] | None = None
    initial_mm: float | None = None
    distance_mm: float | None = None
    ends_mm: tuple[float, float] | None = None
    fixed: str = "lower"


@dataclass(frozen=True, eq=False)
class BreastFacts:
    """Input of the checks of a study or a diagnosis.

    Parameters
    ----------
    rest : Scan or None
        The undeformed body; None if it is not available.
    pressed : sequence of (Scan, PlateLoad)
        The scans under load.
    loads : sequence of PlateLoad
        All loads, including those whose scans are not available.
    least_nu : float
        Least Poisson's ratio of the model.
    E_mpa : (float, float)
        Least and greatest Young's modulus of the softest tissue.
    align_key : str
        The key that aligns the scans.
    aligned : bool
        Whether the scans were aligned, so that their original frames do not matter.
    swelling : float
        Share by which the volume of the body may have changed between the scans.
    rigid_is_refused : bool
        Whether a rigid motion between the scans contradicts the model; otherwise the model may
        cause it.
    softest, stiffest : mapping of Tissue to Constants
        Constants of fat and gland at the lower and at the upper bounds of the search. `stiffest`
        is empty if more than the tissues resists, such as skin.
    """

    rest: Scan | None
    pressed: Sequence[tuple[Scan, PlateLoad]]
    loads: Sequence[PlateLoad]
    least_nu: float
    E_mpa: tuple[float, float]
    align_key: str
    aligned: bool
    swelling: float
    rigid_is_refused: bool
    softest: Tissues
    stiffest: Tissues

    @property
    def scans(self) -> list[Scan]:
        """Return all available scans."""
        return [*([] if self.rest is None else [self.rest]), *(scan for scan, _ in self.pressed)]


# Error of a segmented image: half a voxel, the accuracy of labels at a boundary, correlated over
# 4 mm, an assumption. A second segmentation of the scan at rest measures both.
DRAWN_VOXELS, DRAWN_LENGTH_MM = 0.5, 4.0
# The same for labels moved by the model: their voxels, and the rim of the body outside the mesh
# (0.07 mm for a body of 1 mm voxels and 1,500 nodes).
WARPED_VOXELS, WARPED_LENGTH_VOXELS = 0.25, 2.0
NUGGET_VOXELS = 0.08


def study_noise(reference: Volume, *loaded: Volume, imaged: bool) -> SegmentationNoise:
    """Return the assumed noise of images, or the voxel error of simulated scans.

    Parameters
    ----------
    imaged : bool
        Whether the loaded scans are images rather than simulated by the model.
    """
    voxel = max(side for scan in (reference, *loaded) for side in scan.spacing_mm)
    nugget = NUGGET_VOXELS * voxel
    if imaged:
        drawn = DRAWN_VOXELS * voxel
        return SegmentationNoise(drawn, DRAWN_LENGTH_MM, drawn, nugget)
    return SegmentationNoise(WARPED_VOXELS * voxel, WARPED_LENGTH_VOXELS * voxel, 0.0, nugget)

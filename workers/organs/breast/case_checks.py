"""Whether the scans of a case can be one body in several states, before anything is fitted.

What is refused would be fitted well or badly, and explained by a wrong cause either way.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from storage.errors import InputError
from storage.values import BoolArray, FloatArray, Tissue, Triple, Volume
from workers.body.images.labels import resample_labels
from workers.comparison.similarity.overlap import jaccard
from workers.organs.breast.case_spec import ALONG_Y
from workers.organs.breast.scanned_case import ScannedCase, extent_mm

# Living tissue hardly changes its volume; segmentations differ by some per cent.
VOLUME_SHARE = 0.15
# Decimal logarithm of a ratio of spacings that another unit explains rather than another scan.
OTHER_UNIT = 0.7
# Of the smaller body that must lie inside the other one.
OVERLAP_SHARE = 0.1
# By how much a body may be thicker under the larger force: segmentation and voxels.
THICKNESS_VOXELS = 2.0
# Glandular shares this far apart are compared with those of exchanged labels.
GLAND_SHARE = 0.1
# Outline made of glandular voxels, above which fat and gland are taken for each other.
GLAND_OUTSIDE = 0.75
# Left-right differences of two scans correlate with 0.9 or so, with -0.9 if one is mirrored.
MIRRORED = -0.5
# Root mean square of those differences, of a glandular share, below which sides are alike.
ALIKE = 0.02
# Jaccard of the glandular tissue in two segmentations of one scan, at least.
SAME_GLAND = 0.5
# Cells along x and z in which tissue is counted.
CELLS = (32, 16)


class Scan(NamedTuple):
    file: str
    force_n: float | None
    axis: Triple
    labels: Volume


def check_case(case: ScannedCase) -> None:
    """See whether the scans fit together.

    Parameters
    ----------
    case : ScannedCase

    Raises
    ------
    InputError
        If a scan shows no body or no glandular tissue, volumes or places of the bodies
        differ too much, fat and gland look exchanged, a scan looks mirrored, or the more
        compressed scan has the smaller force.
    """
    scans = list(_scans(case))
    if case.repeat is not None:
        _check_repeat(case.reference, case.repeat, case.file.scans.reference_repeat)
    for scan in scans:
        _check_tissue(scan)
    check_outline(scans[0])
    for scan in scans[1:]:
        check_volume(scans[0], scan)
        check_place(scans[0], scan)
        check_shares(scans[0], scan)
        check_side(scans[0], scan)
    _check_loads(scans)


def _scans(case: ScannedCase) -> Iterator[Scan]:
    yield Scan(case.file.scans.reference, 0.0, ALONG_Y, case.reference)
    for load, labels in zip(case.loads, case.deformed, strict=True):
        yield Scan(load.file, load.force_n, load.axis, case.above_wall(labels))


def _check_tissue(scan: Scan) -> None:
    for tissue in (Tissue.FAT, Tissue.GLANDULAR):
        if not (scan.labels.values == tissue).any():
            raise InputError(
                f"{scan.file} has no voxel labelled {tissue.name.lower()} ({int(tissue)}) above "
                "the chest wall, expected both fat (1) and glandular tissue (2). Segment them, or "
                "write an origin into its header that puts the chest wall at the z of the case."
            )


def _check_repeat(first: Volume, second: Volume, file: str | None) -> None:
    here = first.values == Tissue.GLANDULAR
    there = resample_labels(second, first).values == Tissue.GLANDULAR
    found = jaccard(int((here & there).sum()), int(here.sum()), int(there.sum()))
    if found < SAME_GLAND:
        raise InputError(
            f"The glandular tissue in {file} overlaps that of the reference scan with a Jaccard "
            f"of {found:.2f}; two segmentations of the same scan reach {SAME_GLAND} or more. "
            "Segment the reference scan again, or leave scans.reference_repeat out."
        )


def check_volume(rest: Scan, scan: Scan) -> None:
    before, after = _ml(rest.labels), _ml(scan.labels)
    ratio = after / before
    if abs(ratio - 1) <= VOLUME_SHARE:
        return
    sides = np.log10(np.divide(scan.labels.spacing_mm, rest.labels.spacing_mm))
    if (np.abs(sides) > OTHER_UNIT).any():
        cause = (
            "The spacing of one of the files looks wrong, as by a factor of 10: found "
            f"{_sides(rest)} in {rest.file} and {_sides(scan)} in {scan.file}. Write the spacing "
            "in mm into its header."
        )
    else:
        cause = "Is it the same body, segmented to the same chest wall? Give scans of one body."
    raise InputError(
        f"The body has {before:.3g} ml in {rest.file} and {after:.3g} ml in {scan.file}; tissue "
        f"keeps its volume, so at most {VOLUME_SHARE:.0%} of difference was expected. {cause}"
    )


def check_place(rest: Scan, scan: Scan) -> None:
    here = rest.labels.values != Tissue.AIR
    there = resample_labels(scan.labels, rest.labels).values != Tissue.AIR
    smaller = min(_ml(rest.labels), _ml(scan.labels)) * 1000 / rest.labels.voxel_mm3
    share = np.count_nonzero(here & there) / smaller
    if share < OVERLAP_SHARE:
        raise InputError(
            f"The bodies of {rest.file} and {scan.file} overlap in {share:.0%} of their volume, "
            f"expected at least {OVERLAP_SHARE:.0%}: they lie at {_middle(rest)} and "
            f"{_middle(scan)} mm. Write origins into the headers that put both scans into the "
            "frame of the plates."
        )


def check_outline(rest: Scan) -> None:
    body = rest.labels.values != Tissue.AIR
    inside = binary_erosion(np.pad(body, ((0, 0), (1, 1), (1, 1))), iterations=2)
    outside = body & ~inside[:, 1:-1, 1:-1]
    gland = rest.labels.values == Tissue.GLANDULAR
    share, whole = gland[outside].mean(), gland[body].mean()
    if share > max(GLAND_OUTSIDE, whole):
        raise InputError(
            f"In {rest.file} {share:.0%} of the outline is glandular tissue (label 2), expected "
            f"less than {GLAND_OUTSIDE:.0%}: fat lies outside. Fat (1) and glandular tissue (2) "
            "look exchanged: exchange the labels in all scans."
        )


def check_shares(rest: Scan, scan: Scan) -> None:
    before, after = _gland_share(rest.labels), _gland_share(scan.labels)
    if abs(after - before) > max(GLAND_SHARE, abs(after - (1 - before))):
        raise InputError(
            f"Glandular tissue (label 2) is {before:.0%} of the body in {rest.file}, but "
            f"{after:.0%} in {scan.file}, where fat (label 1) is {1 - after:.0%}; about equal "
            f"shares were expected. Exchange labels 1 and 2 in {scan.file}."
        )


def check_side(rest: Scan, scan: Scan) -> None:
    """Refuse a scan whose two sides, along the compression, differ the other way round."""
    across = 1 if abs(scan.axis[0]) > abs(scan.axis[1]) else 0
    before, after = _lopsided(rest.labels, across), _lopsided(scan.labels, across)
    agreement = _agreement(before, after)
    if np.sqrt(np.nanmean(before**2)) > ALIKE and agreement < MIRRORED:
        along = "xy"[across]
        raise InputError(
            f"{scan.file} looks like a mirror image of {rest.file}: along {along}, what differs "
            f"between the two sides of the glandular tissue correlates with {agreement:.2f}, "
            f"expected near 1. Flip {scan.file} along {along}, or write the right direction into "
            "its header."
        )


def _check_loads(scans: list[Scan]) -> None:
    """Refuse scans of which the body gets no thinner from the smallest force to the largest."""
    for axis in dict.fromkeys(scan.axis for scan in scans[1:]):
        known = [(s.force_n, s) for s in scans[1:] if s.axis == axis and s.force_n is not None]
        pressed = sorted([(0.0, scans[0]), *known], key=lambda one: one[0])
        measured = [(force_n, scan, _thickness_mm(scan.labels, axis)) for force_n, scan in pressed]
        for (less_n, less, thick), (more_n, more, thin) in pairwise(measured):
            slack = THICKNESS_VOXELS * max(*less.labels.spacing_mm[:2], *more.labels.spacing_mm[:2])
            if thin > thick + slack and less_n < more_n:
                raise InputError(
                    f"The body is {thick:.1f} mm thick in its median slice under {less_n:g} N "
                    f"({less.file}), but {thin:.1f} mm under {more_n:g} N ({more.file}); the "
                    "larger force was expected to press it thinner. Exchange the two files, or "
                    "their forces, in the case."
                )


def _ml(labels: Volume) -> float:
    return _voxels(labels) * labels.voxel_mm3 / 1000


def _gland_share(labels: Volume) -> float:
    return float(np.count_nonzero(labels.values == Tissue.GLANDULAR) / _voxels(labels))


def _voxels(labels: Volume) -> int:
    return int(np.count_nonzero(labels.values != Tissue.AIR))


def _thickness_mm(labels: Volume, axis: Triple) -> float:
    """Return the median of all slices: behind the edge of a plate a body bulges as it is pressed.

    The wall's slices may be thicker under the larger force there, most are not.
    """
    body = np.flatnonzero((labels.values != Tissue.AIR).any(axis=(1, 2)))
    slices = (replace(labels, values=labels.values[z : z + 1]) for z in body)
    return float(np.median([high - low for low, high in (extent_mm(s, axis) for s in slices)]))


def _lopsided(labels: Volume, across: int) -> FloatArray:
    """Return the glandular share of columns along the compression less that of their images.

    Columns are counted across it: along x (0) or y (1), and along z. Cells follow the box of
    the body, which may become longer and wider; nan where one of the two is outside.
    """
    body = _sums(labels.values != Tissue.AIR, across)
    gland = _sums(labels.values == Tissue.GLANDULAR, across)
    z, line = np.nonzero(body)
    cells = _cell(line, CELLS[0]) + CELLS[0] * _cell(z, CELLS[1])
    size = CELLS[0] * CELLS[1]
    count = np.bincount(cells, body[z, line], minlength=size)
    count[count == 0] = np.nan
    share = (np.bincount(cells, gland[z, line], minlength=size) / count).reshape(CELLS[::-1])
    return np.asarray(share - share[:, ::-1], np.float64)


def _sums(there: BoolArray, across: int) -> NDArray[np.int32]:
    """Count voxels along the compression, for each slice and each line across it."""
    return np.asarray(there.sum(axis=1 + across, dtype=np.int32))


def _cell(index: np.ndarray, cells: int) -> np.ndarray:
    first, last = index.min(), index.max()
    return np.asarray((index - first) * cells // (last - first + 1))


def _agreement(a: FloatArray, b: FloatArray) -> float:
    """Return correlation over the cells that both have; 0 where one is even."""
    both = np.isfinite(a) & np.isfinite(b)
    u, v = a[both] - a[both].mean(), b[both] - b[both].mean()
    size = np.sqrt((u @ u) * (v @ v))
    return float(u @ v / size) if size > 0 else 0.0


def _middle(scan: Scan) -> str:
    index = np.argwhere(scan.labels.values != Tissue.AIR).mean(axis=0)[::-1]
    place = np.asarray(scan.labels.origin_mm) + np.asarray(scan.labels.spacing_mm) * index
    return str(tuple(place.round(1).tolist()))


def _sides(scan: Scan) -> str:
    return " x ".join(f"{s:g}" for s in scan.labels.spacing_mm) + " mm"

"""Plausibility checks of a breast at rest and the same breast under load.

A mirror image is a compressed breast that fits the one at rest better when flipped. For it, the
position of the glandular tissue is compared relative to the plates and to the bounding box of the
body. This relative position hardly depends on the amount of compression.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.ndimage import binary_erosion

from palpate.storage.values import FloatArray, Tissue, Triple
from palpate.workers.body.images.tissue_labels import resample_labels
from palpate.workers.organs.breast.scan_alignment import RigidMotion, motion_between
from palpate.workers.organs.breast.scan_border import cut_text
from palpate.workers.organs.breast.scan_facts import AXES, BreastFacts, PlateLoad, Scan, plate_frame
from palpate.workers.organs.plausibility_rule import Finding

# Cells perpendicular to the compression, along it, and from the chest wall to the nipple.
CELLS = (16, 6, 10)
# Margin by which the sum of two correlations must be better for a mirror image. In simulated pairs,
# the right orientation is better by 0.13 or more if a flip can be detected at all, and never worse
# by more than 0.01; the same holds for the pair of shared/data/breast_bct_niftysim.
MARGIN = 0.08
# Minimum sum of both correlations for two scans to count as one body.
ALIKE = 1.0

Flip = tuple[bool, bool, bool]
SAME: Flip = (False, False, False)


def mirrored(rest: Scan, scan: Scan) -> Flip:
    """Return the flips across, along and from wall to nipple under which a scan fits better.

    All are False if it fits as it is, or if the flips cannot be distinguished.
    """
    fits = likeness(rest, scan)
    best = max(fits, key=lambda flip: fits[flip])
    clear = fits[best] > fits[SAME] + MARGIN and fits[best] > ALIKE
    return best if clear else SAME


def likeness(rest: Scan, scan: Scan) -> dict[Flip, float]:
    """Return the sum of two correlations for each flip: of glandular shares and of outlines."""
    count, gland = _cells(rest, scan.axis)
    there, its_gland = _cells(scan, scan.axis)
    fits: dict[Flip, float] = {}
    for flip in product((False, True), (False, True), (False, True)):
        axes = tuple(number for number, flipped in enumerate(flip) if flipped)
        n, g = np.flip(there, axes), np.flip(its_gland, axes)
        both = np.minimum(count, n)
        outlines = _correlation(count.sum(axis=1), n.sum(axis=1), np.ones(count.shape[::2]))
        fits[flip] = _correlation(gland, g, both) + outlines
    return fits


def _cells(scan: Scan, axis: Triple) -> tuple[FloatArray, FloatArray]:
    """Return the share of the body and the glandular share of each cell."""
    points, labels, step = scan.sample
    frame = plate_frame(axis)
    u, along, z = (points @ frame.T).T
    width_u, width_along, _ = np.abs(frame) @ step
    nu, na, nz = CELLS
    column = _index(u, u.min(), np.ptp(u), width_u, nu) * nz
    column += _index(z, z.min(), np.ptp(z), step[2], nz)
    low, high = np.full(nu * nz, np.inf), np.full(nu * nz, -np.inf)
    np.minimum.at(low, column, along)
    np.maximum.at(high, column, along)
    cell = column * na
    cell += _index(along, low[column], (high - low)[column], width_along, na)
    size = nu * nz * na
    count = np.bincount(cell, minlength=size)
    gland = np.bincount(cell, labels == Tissue.GLANDULAR, minlength=size)
    shape = nu, nz, na
    n = count.reshape(shape).transpose(0, 2, 1) / len(points)
    share = (gland / np.maximum(count, 1)).reshape(shape).transpose(0, 2, 1)
    return np.asarray(n), np.asarray(share)


def _index(
    values: FloatArray, low: FloatArray | float, span: FloatArray | float, step: float, cells: int
) -> np.ndarray:
    share = (values - low + step / 2) / (span + step)
    return np.minimum((share * cells).astype(np.intp), cells - 1)


def _correlation(a: FloatArray, b: FloatArray, weight: FloatArray) -> float:
    """Return a weighted correlation; 0 if one of the two is constant."""
    if not weight.any():
        return 0.0
    u = a - np.average(a, weights=weight)
    v = b - np.average(b, weights=weight)
    size = np.sqrt((weight * u**2).sum() * (weight * v**2).sum())
    return float((weight * u * v).sum() / size) if size > 1e-12 else 0.0


# Share of the volume by which two segmentations of one body may differ. A systematic error of half
# a voxel of 1 mm on the whole outline of 450 ml would be 4 %.
SEGMENTED = 0.04
# Simulated pairs lose 0.5 to 1.05 times 3 (1 - 2 nu) ln(thickness before / after) of their volume
# under the plates, 1.5 to 5 % at nu = 0.49; the pair of shared/data/breast_bct_niftysim 1 %.
COMPRESSED = 1.25
# Decimal logarithm of a ratio of spacings above which another unit is the likely cause.
OTHER_UNIT = 0.7
# Share of the smaller body that must be inside the other one.
OVERLAP_SHARE = 0.1
# Share of voxels with the same label above which nothing has moved.
NOT_MOVED = 0.98
# Logarithmic shrinkage along another axis, over that along the stated one, above which a body was
# pressed along the other; and the cosine above which two axes are the same.
OTHER_AXIS, ALONG = 1.5, 0.7
# Tolerance for a body that is thicker under the larger force: segmentation and voxels.
THICKNESS_VOXELS = 2.0
# Difference of glandular shares above which swapped labels are considered.
GLAND_SHARE = 0.1
# Share of glandular voxels in the outline above which fat and gland look swapped.
GLAND_OUTSIDE = 0.75
# Smaller shifts and rotations cannot be distinguished from compression and voxel errors.
LEAST_SHIFT_MM, LEAST_SHIFT_VOXELS, LEAST_TURN_DEG = 2.5, 1.5, 1.0


def check_places(facts: BreastFacts) -> Iterator[Finding]:
    """Reject scans that have no known common frame of reference."""
    if facts.rest is None or facts.aligned:
        return
    for scan, _ in facts.pressed:
        text = _no_common_place(facts.rest, scan)
        if text:
            yield Finding(
                "implausible",
                f"{text} Their relative position is unknown, and it determines the result. Export "
                "both in one frame, or register them first, or let Palpate align them: "
                f"{facts.align_key}: rigid.",
            )


def _no_common_place(rest: Scan, scan: Scan) -> str:
    unknown = [member.file for member in (rest, scan) if not member.labels.place_known]
    if unknown:
        names = " and ".join(dict.fromkeys(unknown))
        return f"{names} {'does' if len(set(unknown)) == 1 else 'do'} not give the body's position."
    here, there = rest.labels.frame_uid, scan.labels.frame_uid
    if here and there and here != there:
        return (
            f"{rest.file} and {scan.file} have different frames of reference "
            f"(FrameOfReferenceUID {here} and {there})."
        )
    return ""


def check_volumes(facts: BreastFacts) -> Iterator[Finding]:
    """Reject a pair whose volumes differ by more than compression and segmentation explain."""
    for rest, scan, _ in _pairs(facts):
        lost = COMPRESSED * 3 * (1 - 2 * facts.least_nu) * _strain(rest, scan)
        most = SEGMENTED + facts.swelling
        least = -most - lost
        whole = scan if scan.whole is None else Scan(scan.file, None, scan.axis, scan.whole)
        change, after = min(
            ((body.ml / rest.ml - 1, body.ml) for body in (scan, whole)),
            key=lambda pair: max(pair[0] - most, least - pair[0]),
        )
        if least <= change <= most:
            continue
        sides = np.log10(np.divide(scan.labels.spacing_mm, rest.labels.spacing_mm))
        if (np.abs(sides) > OTHER_UNIT).any():
            cause = (
                "The spacing of one of the files looks wrong, perhaps by a factor of 10: found "
                f"{rest.sides} in {rest.file} and {scan.sides} in {scan.file}. Write the spacing "
                "in mm into its header."
            )
        elif cut := cut_text(rest) or cut_text(scan):
            cause = f"{cut} Export it with all of the breast and some air around it."
        else:
            scale = (1 + change) ** (1 / 3)
            cause = (
                "Check that both scans show the same body down to the same chest wall, and that "
                f"both spacings are right (a scale of {scale:.3f} would explain it)."
            )
        yield Finding(
            "implausible",
            f"The body has a volume of {rest.ml:.4g} ml in {rest.file} and {after:.4g} ml in "
            f"{scan.file}, {change:+.1%}; tissue nearly keeps its volume, so {least:+.1%} to "
            f"{most:+.1%} was expected. {cause}",
        )


def check_thickness(facts: BreastFacts) -> Iterator[Finding]:
    """Reject a body that is thicker under load, or was pressed along another axis."""
    for rest, scan, _ in _pairs(facts):
        other = _pressed_axis(rest, scan)
        if other is not None:
            before, after = rest.sides_mm[other], scan.sides_mm[other]
            yield Finding(
                "implausible",
                f"The body is {_extent(rest, scan):.1f} mm thick along the compression in "
                f"{rest.file} and {scan.thickness_mm:.1f} mm in {scan.file}, but {before:.1f} and "
                f"{after:.1f} mm along {AXES[other]}: it was pressed along {AXES[other]}. Give "
                "axes that make it y, or the axis of the load.",
            )
            continue
        slack = THICKNESS_VOXELS * max(rest.voxel_mm, scan.voxel_mm)
        thick, thin = _extent(rest, scan), scan.thickness_mm
        if thin > thick + slack and scan.median_thickness_mm > slack + _median(rest, scan):
            yield Finding(
                "implausible",
                f"The body is {thick:.1f} mm thick between the plates in {rest.file} at rest, but "
                f"{thin:.1f} mm in {scan.file} under load; compression was expected to make it "
                "thinner. Reference and target look swapped.",
            )


def check_moved(facts: BreastFacts) -> Iterator[Finding]:
    """Reject a scan under load that shows the body at rest."""
    for rest, scan, load in _pairs(facts):
        there = resample_labels(scan.labels, rest.labels).values
        body = rest.body | (there != Tissue.AIR)
        same = np.count_nonzero((there == rest.labels.values) & body) / np.count_nonzero(body)
        if same > NOT_MOVED and abs(_extent(rest, scan) - scan.thickness_mm) < scan.voxel_mm:
            under = "a load" if load.force_n is None else f"{load.force_n:g} N"
            yield Finding(
                "implausible",
                f"{scan.file} agrees with {rest.file} in {same:.1%} of the body's voxels: "
                f"nothing moved under {under}, so the stiffness cannot be found. Give the scan "
                "under load.",
            )


def check_overlap(facts: BreastFacts) -> Iterator[Finding]:
    """Reject bodies that are far apart."""
    for rest, scan, _ in _pairs(facts):
        if not facts.aligned and _no_common_place(rest, scan):
            continue
        there = resample_labels(scan.labels, rest.labels).values != Tissue.AIR
        smaller = min(rest.ml, scan.ml) * 1000 / rest.labels.voxel_mm3
        share = np.count_nonzero(rest.body & there) / smaller
        if share < OVERLAP_SHARE:
            yield Finding(
                "implausible",
                f"The bodies of {rest.file} and {scan.file} overlap in {share:.0%} of their "
                f"volume, expected at least {OVERLAP_SHARE:.0%}: their centres are at "
                f"{_middle(rest)} and {_middle(scan)} mm. Write origins into the headers that put "
                f"both scans into the frame of the plates, or set {facts.align_key}: rigid.",
            )


def check_outline(facts: BreastFacts) -> Iterator[Finding]:
    """Reject a body whose outline is mostly gland: its labels look swapped."""
    if facts.rest is None:
        return
    rest = facts.rest
    inside = binary_erosion(np.pad(rest.body, ((0, 0), (1, 1), (1, 1))), iterations=2)
    outside = rest.body & ~inside[:, 1:-1, 1:-1]
    gland = rest.labels.values == Tissue.GLANDULAR
    share, whole = gland[outside].mean(), gland[rest.body].mean()
    if share > max(GLAND_OUTSIDE, whole):
        yield Finding(
            "implausible",
            f"In {rest.file} {share:.0%} of the outline is glandular tissue (label 2), expected "
            f"less than {GLAND_OUTSIDE:.0%}, because fat is outside. Fat (1) and glandular tissue "
            "(2) look swapped: swap the labels in all scans.",
        )


def check_shares(facts: BreastFacts) -> Iterator[Finding]:
    """Reject a pair in which the labels of fat and gland are swapped in one scan."""
    for rest, scan, _ in _pairs(facts):
        before, after = _gland_share(rest), _gland_share(scan)
        if abs(after - before) > max(GLAND_SHARE, abs(after - (1 - before))):
            yield Finding(
                "implausible",
                f"Glandular tissue (label 2) is {before:.0%} of the body in {rest.file}, but "
                f"{after:.0%} in {scan.file}, where fat (label 1) is {1 - after:.0%}; about equal "
                f"shares were expected. Swap labels 1 and 2 in {scan.file}.",
            )


def check_mirror_image(facts: BreastFacts) -> Iterator[Finding]:
    """Reject a scan that is mirrored along one or more axes."""
    for rest, scan, _ in _pairs(facts):
        flips = mirrored(rest, scan)
        if not any(flips):
            continue
        frame = plate_frame(scan.axis)
        names = [
            AXES[int(np.argmax(np.abs(direction)))]
            for direction, flipped in zip(frame, flips, strict=True)
            if flipped
        ]
        along = " and ".join(sorted(dict.fromkeys(names)))
        yield Finding(
            "implausible",
            f"{scan.file} looks like a mirror image of {rest.file} along {along}: outline and "
            "glandular tissue agree much better after a flip. Flip "
            f"{scan.file} along {along}, or write the correct directions into its header.",
        )


def check_rigid_motion(facts: BreastFacts) -> Iterator[Finding]:
    """Report the rigid motion that would align a scan with the scan at rest."""
    for rest, scan, load in _pairs(facts):
        if not facts.aligned and _no_common_place(rest, scan):
            continue
        motion = motion_between(rest, scan, load)
        if _is_small(motion, rest, scan):
            continue
        other = motion_between(rest, scan, replace(load, fixed="middle"))
        moving = load.force_n is not None and _is_small(other, rest, scan)
        remedy = (
            "The middle of the body does not move: if both plates move, set case.load.moving: both."
            if moving and facts.rigid_is_refused
            else f"Check both origins, or let Palpate align them: {facts.align_key}: rigid."
        )
        yield Finding(
            "implausible" if facts.rigid_is_refused else "warning",
            f"{scan.file} does not fit {rest.file} in its present position: moving it by "
            f"{motion.words} would improve the fit of the chest wall, the plates and the centre of "
            "the body. "
            f"{remedy}",
        )


def _is_small(motion: RigidMotion, rest: Scan, scan: Scan) -> bool:
    """Return True if compression and voxels explain a motion."""
    voxel = max(rest.voxel_mm, scan.voxel_mm)
    least_mm = max(LEAST_SHIFT_MM, LEAST_SHIFT_VOXELS * voxel)
    return motion.shift <= least_mm and motion.turn <= LEAST_TURN_DEG


def check_order_of_loads(facts: BreastFacts) -> Iterator[Finding]:
    """Reject scans in which the body gets thicker under a larger force."""
    if facts.rest is None:
        return
    for axis in dict.fromkeys(scan.axis for scan, _ in facts.pressed):
        known = [s for s, _ in facts.pressed if s.axis == axis and s.force_n is not None]
        pressed = sorted([facts.rest, *known], key=lambda scan: scan.force_n or 0.0)
        thickness = [scan.median_thickness_along(axis) for scan in pressed]
        for number in range(1, len(pressed) - 1):
            less, more = pressed[number], pressed[number + 1]
            thick, thin = thickness[number], thickness[number + 1]
            sides = (*less.labels.spacing_mm[:2], *more.labels.spacing_mm[:2])
            if thin > thick + THICKNESS_VOXELS * max(sides) and less.force_n != more.force_n:
                yield Finding(
                    "implausible",
                    f"The body is {thick:.1f} mm thick in its median slice under "
                    f"{less.force_n:g} N ({less.file}), but {thin:.1f} mm under {more.force_n:g} N "
                    f"({more.file}); the larger force was expected to press it thinner. Swap the "
                    "two files, or their forces, in the case.",
                )


def _pairs(facts: BreastFacts) -> Iterator[tuple[Scan, Scan, PlateLoad]]:
    if facts.rest is not None:
        for scan, load in facts.pressed:
            yield facts.rest, scan, load


def _extent(rest: Scan, scan: Scan) -> float:
    return Scan(rest.file, 0.0, scan.axis, rest.labels).thickness_mm


def _pressed_axis(rest: Scan, scan: Scan) -> int | None:
    """Return the axis of compression of a body if it is not the given one.

    The body is much thinner along it, and its size changes less along every other axis.
    """
    change = np.log(np.divide(scan.sides_mm, rest.sides_mm))
    most = int(np.abs(change).argmax())
    slack = THICKNESS_VOXELS * max(rest.voxel_mm, scan.voxel_mm)
    along = math.log(scan.thickness_mm / _extent(rest, scan))
    thinner = rest.sides_mm[most] - scan.sides_mm[most] > slack
    much = -change[most] > max(along, -OTHER_AXIS * along)
    return most if thinner and much and abs(scan.axis[most]) < ALONG else None


def _median(rest: Scan, scan: Scan) -> float:
    return rest.median_thickness_along(scan.axis)


def _strain(rest: Scan, scan: Scan) -> float:
    """Return the logarithm of the thickness at rest over the thickness under load."""
    return max(0.0, math.log(_extent(rest, scan) / scan.thickness_mm))


def _gland_share(scan: Scan) -> float:
    gland = np.count_nonzero(scan.labels.values == Tissue.GLANDULAR)
    return float(gland / np.count_nonzero(scan.body))


def _middle(scan: Scan) -> str:
    return str(tuple(scan.sample[0].mean(axis=0).round(1).tolist()))

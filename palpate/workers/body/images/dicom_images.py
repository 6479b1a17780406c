"""DICOM images, read with pydicom: a folder with one series of slices, or one SEG file.

Slices are sorted by ImagePositionPatient along the normal of their plane, never by file name or
instance number. The frame is LPS, as in the standard. DICOM gives each slice its own position
(PS3.3, C.7.6.2.1.1 and C.7.6.16.2.3); whether they form a regular stack has to be checked.

A segmentation is one file with many frames (PS3.3, A.51 and C.8.20). BINARY frames (one segment
at one position each; the label is the segment number) and LABELMAP frames (labels unchanged) are
supported. Frames without any voxel of a segment are usually missing from the file; they stay 0.
"""

import warnings
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.errors import InvalidDicomError
from pydicom.uid import DeflatedExplicitVRLittleEndian

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.body.images.claimed_size import claimed_bytes, pixel_bytes
from palpate.workers.body.images.scan_orientation import Scan
from palpate.workers.body.images.tissue_labels import tissue_in

STATED_TOLERANCE = 0.01
"""Allowed relative difference between the distance of neighbouring slices and its tag."""
MOST_SLOTS = 100_000
"""Largest number of slice positions between two neighbours."""
GAP_TOLERANCE = 0.05
"""Allowed deviation of a slice from its position in the stack, in gaps; positions are rounded."""


@dataclass(frozen=True, eq=False)
class Planes:
    """A regular stack of slices.

    Parameters
    ----------
    slots : ndarray of int, shape (n,)
        Position of each slice in the stack, 0 for the lowest along the normal.
    step_mm : ndarray, shape (3,)
        Step from the first row and column of one slice to those of the next.
    origin_mm : ndarray, shape (3,)
        Centre of the first pixel of slot 0.
    """

    slots: NDArray[np.intp]
    step_mm: FloatArray
    origin_mm: FloatArray


def stack(
    positions_mm: FloatArray, orientation: FloatArray, what: str, *, may_skip: bool = False
) -> Planes:
    """Sort slices along their normal, with distances computed from their positions alone.

    Parameters
    ----------
    positions_mm : ndarray, shape (n, 3)
        ImagePositionPatient of each slice. Slices may share one.
    orientation : ndarray, shape (6,)
        ImageOrientationPatient: direction of a row, then of a column.
    what : str
        Name of the image in messages.
    may_skip : bool, optional
        Allow empty slots (segmentations omit empty slices).

    Raises
    ------
    InputError
        If there are fewer than two positions, or they are not evenly spaced on a line.
    """
    normal = np.cross(orientation[:3], orientation[3:])
    depth = positions_mm @ normal
    order = np.argsort(depth, kind="stable")
    gaps = np.diff(depth[order])
    apart = gaps[gaps > max(GAP_TOLERANCE * gaps.max(initial=0.0), 1e-6)]
    if not apart.size:
        raise InputError(
            f"{what} has slices at one position only; a volume needs two or more. "
            "Give the folder with the whole series."
        )
    gap_mm = float(apart.min() if may_skip else np.median(apart))
    if not np.isfinite(gaps).all() or gaps.max() > MOST_SLOTS * gap_mm:
        raise InputError(
            f"{what} has slices {gaps.max():.4g} mm apart and others {gap_mm:.4g} mm apart, so "
            "it is not a stack of slices. Export it again."
        )
    jumps = np.rint(gaps / gap_mm).astype(np.intp)
    slots = np.zeros(depth.size, dtype=np.intp)
    slots[order[1:]] = np.cumsum(jumps)
    count = max(int(slots[order[-1]]), 1)
    even = (depth[order[-1]] - depth[order[0]]) / count
    shift = np.abs(depth - depth[order[0]] - slots * even)
    odd = abs(even - gap_mm) > GAP_TOLERANCE * gap_mm
    if odd or shift.max() > GAP_TOLERANCE * even or (jumps.max() > 1 and not may_skip):
        _refuse_gaps(gaps, gap_mm, what)

    origin = positions_mm[order[0]]
    step = (positions_mm[order[-1]] - origin) / count
    off = np.linalg.norm(positions_mm - origin - slots[:, None] * step, axis=1)
    if off.max() > GAP_TOLERANCE * even:
        raise InputError(
            f"{what} has slices that are not on one line ({off.max():.3g} mm off). "
            "Resample it on a regular grid first."
        )
    return Planes(slots, step, origin)


def _refuse_gaps(gaps: FloatArray, gap_mm: float, what: str) -> None:
    worst = int(np.argmax(np.abs(gaps - gap_mm)))
    raise InputError(
        f"{what} has uneven gaps: slices {worst + 1} and {worst + 2} along the normal are "
        f"{gaps[worst]:.4g} mm apart, expected {gap_mm:.4g} mm. A slice is missing, or "
        "two series are mixed; complete the series, or resample it on a regular grid."
    )


def check_stated_gap(planes: Planes, tags: Any, what: str) -> None:
    """Raise InputError if SpacingBetweenSlices contradicts the distance of slice positions.

    Parameters
    ----------
    planes : Planes
    tags : pydicom.Dataset
        Data set of PixelMeasures, or of a slice.
    what : str
        Name of the image in messages.
    """
    gap = float(np.linalg.norm(planes.step_mm))
    stated = _length_mm(tags, "SpacingBetweenSlices")
    if stated and abs(gap - stated) > STATED_TOLERANCE * stated:
        raise InputError(
            f"{what} is inconsistent: its slices are {gap:.4g} mm apart according to their "
            f"positions, expected {stated:.4g} mm according to its SpacingBetweenSlices. Export it "
            "again, or correct the one that is wrong."
        )


def thickness_remarks(planes: Planes, tags: Any) -> tuple[str, ...]:
    """Return a remark if slices are thicker or thinner than their distance.

    SliceThickness is how much of the body a slice shows: slices may overlap or leave gaps.

    Parameters
    ----------
    planes : Planes
    tags : pydicom.Dataset
        Data set of PixelMeasures, or of a slice.
    """
    gap, thickness = float(np.linalg.norm(planes.step_mm)), _length_mm(tags, "SliceThickness")
    if not thickness or abs(gap - thickness) <= STATED_TOLERANCE * thickness:
        return ()
    way = "overlap" if thickness > gap else "leave gaps"
    return (
        f"Slices are {gap:.4g} mm apart according to their positions, which is the spacing used, "
        f"and {thickness:.4g} mm thick (SliceThickness), so they {way}.",
    )


def _length_mm(tags: Any, name: str) -> float:
    return abs(float(tags.get(name) or 0))  # some scanners write a negative one


def plane_scan(
    values: NDArray[Any], planes: Planes, orientation: FloatArray, pixel_spacing: Any
) -> Scan:
    """Return the scan of a stack.

    Parameters
    ----------
    values : ndarray, shape (slots, rows, columns)
    pixel_spacing : sequence of two numbers, or None
        DICOM's PixelSpacing: distance between rows, then between columns, in mm.
    """
    rows, columns = (np.nan, np.nan) if pixel_spacing is None else map(float, pixel_spacing)
    gap = float(np.linalg.norm(planes.step_mm))
    spacing = np.array([columns, rows, gap])
    spacing[~(np.isfinite(spacing) & (spacing > 0))] = np.nan
    directions = np.column_stack([orientation[:3], orientation[3:], planes.step_mm / gap])
    return Scan(values.transpose(), spacing, directions, planes.origin_mm)


def check_orientation(values: Any, what: str) -> FloatArray:
    """Return ImageOrientationPatient as six numbers: two unit vectors at right angles.

    Raises
    ------
    InputError
        If they are missing or invalid.
    """
    orientation = np.array([] if values is None else values, dtype=float)
    if orientation.size == 6:
        row, column = orientation[:3], orientation[3:]
        frame = np.array([row @ row - 1, column @ column - 1, row @ column])
        if np.all(np.abs(frame) < 1e-3):
            return orientation
    raise InputError(
        f"{what} has the image orientation {orientation.tolist()}, expected the direction "
        "cosines of rows and columns. Export the series again with its geometry."
    )


def is_multi_frame(dataset: Any) -> bool:
    """Return True if a data set has functional groups for each frame, or several frames."""
    return (
        "PerFrameFunctionalGroupsSequence" in dataset or int(dataset.get("NumberOfFrames") or 1) > 1
    )


def read_segmentation(path: Path, dataset: Any) -> Scan:
    """Read a segmentation from an open data set.

    Raises
    ------
    InputError
        If the file has frames but is not a segmentation, contains fractions, or its
        segments overlap.
    """
    kind = str(dataset.get("SegmentationType", ""))
    if kind not in ("BINARY", "LABELMAP"):
        named = kind or dataset.get("Modality", "unknown")
        raise InputError(
            f"{path} is a multi-frame DICOM file of type {named}; only segmentations of type "
            "BINARY or LABELMAP are read. Export the label map as a series of single slices, as "
            "NRRD or as NIfTI."
        )
    frames = [_Frame(item) for item in dataset.PerFrameFunctionalGroupsSequence]
    shared = dataset.get("SharedFunctionalGroupsSequence") or [None]
    measures = _group(shared[0], frames[0].item, "PixelMeasuresSequence", path)
    plane = _group(shared[0], frames[0].item, "PlaneOrientationSequence", path)
    orientation = check_orientation(plane.get("ImageOrientationPatient"), str(path))
    positions = np.array([frame.position(path) for frame in frames], dtype=float)
    planes = stack(positions, orientation, str(path), may_skip=True)
    check_stated_gap(planes, measures, str(path))
    slots = int(planes.slots.max()) + 1
    claimed_bytes((slots, dataset.Rows, dataset.Columns), np.uint16().itemsize, str(path))

    pixels = np.asarray(_decoded(dataset))
    if pixels.ndim != 3 or len(pixels) != len(frames):
        raise InputError(
            f"{path} has pixels of shape {pixels.shape} for {len(frames)} frames; it is damaged. "
            "Export it again."
        )
    values = np.zeros((slots, *pixels.shape[1:]), np.uint16)
    for frame, slot, plane_pixels in zip(frames, planes.slots, pixels, strict=True):
        inside = plane_pixels != 0
        if values[slot][inside].any():
            raise InputError(
                f"{path} has segments that overlap (slice {slot + 1}); a voxel can have one label "
                "only. Export it as a label map."
            )
        values[slot][inside] = (
            frame.segment(path) if kind == "BINARY" else plane_pixels[inside].astype(np.uint16)
        )
    return replace(
        plane_scan(values, planes, orientation, measures.get("PixelSpacing")),
        frame_uid=str(dataset.get("FrameOfReferenceUID") or ""),
        names=_names(dataset, path),
        remarks=thickness_remarks(planes, measures),
    )


def _names(dataset: Any, path: Path) -> dict[int, str]:
    """Return the name of each segment: its label, or its coded type if only that names a tissue.

    Raises
    ------
    InputError
        If label and coded type of a segment name different tissues.
    """
    names: dict[int, str] = {}
    for segment in dataset.get("SegmentSequence") or []:
        number, label = int(segment.SegmentNumber), str(segment.get("SegmentLabel") or "").strip()
        codes = segment.get("SegmentedPropertyTypeCodeSequence") or []
        coded = str(codes[0].get("CodeMeaning") or "").strip() if codes else ""
        ours, theirs = tissue_in(label), tissue_in(coded)
        if None not in (ours, theirs) and ours != theirs:
            raise InputError(
                f"{path}: segment {number} is labelled {label!r}, but its property type is "
                f"{coded!r}. Correct one of them."
            )
        name = coded if ours is None and theirs is not None else label or coded
        if name:
            names[number] = name
    return names


class _Frame:
    """One item of PerFrameFunctionalGroupsSequence."""

    def __init__(self, item: Any) -> None:
        self.item = item

    def position(self, path: Path) -> Any:
        return _group(None, self.item, "PlanePositionSequence", path).ImagePositionPatient

    def segment(self, path: Path) -> int:
        group = _group(None, self.item, "SegmentIdentificationSequence", path)
        return int(group.ReferencedSegmentNumber)


def _group(shared: Any, own: Any, name: str, path: Path) -> Any:
    """Return the single item of a functional group, from this frame or shared by all."""
    for item in (own, shared):
        if item is not None and item.get(name):
            return item.get(name)[0]
    raise InputError(f"{path} has no {name}, so the position of its frames is unknown.")


_BESIDES = {".txt", ".md", ".json", ".xml", ".csv", ".pdf", ".png", ".jpg", ".jpeg", ".html"}
"""Suffixes of other files that a folder of slices may contain."""


def read_dicom(path: Path) -> Scan:
    """Read the series in a folder, or a multi-frame segmentation."""
    paths = sorted(path.iterdir()) if path.is_dir() else [path]
    images = [(p, d) for p in paths if _may_be_slice(p) and (d := _dataset(p)) is not None]
    if not images:
        raise InputError(
            f"{path} contains no DICOM image. Give the folder whose files are the slices of one "
            "series (folders inside it are not searched)."
        )
    if any(is_multi_frame(dataset) for _, dataset in images):
        if len(images) > 1:
            raise InputError(
                f"{path} mixes a multi-frame file with {len(images) - 1} other images. "
                "Give the file itself."
            )
        return read_segmentation(*images[0])
    if len(images) == 1:
        raise InputError(
            f"{images[0][0]} is one slice, a 2-D image. Give the folder with the whole series."
        )
    return _series(images, str(path))


def _may_be_slice(path: Path) -> bool:
    return (
        path.is_file()
        and not path.name.startswith(".")
        and path.name.upper() != "DICOMDIR"
        and path.suffix.lower() not in _BESIDES
    )


def _dataset(path: Path) -> Any:
    """Return the data set of an image; None for DICOM that is not an image (a report, a plan)."""
    try:
        syntax = pydicom.filereader.read_file_meta_info(path).get("TransferSyntaxUID")
        if syntax == DeflatedExplicitVRLittleEndian:  # pydicom would expand all of it
            raise InputError(f"{path} is a deflated DICOM file. Export it uncompressed.")
        dataset = pydicom.dcmread(path)
    except InvalidDicomError as error:
        raise InputError(
            f"{path} is not a DICOM file, or is damaged. Remove it from the folder, or export "
            "the series again."
        ) from error
    if "Rows" in dataset and "PixelData" not in dataset:
        raise InputError(f"{path} has no pixels; it is cut short. Export the series again.")
    if "Rows" not in dataset:
        return None
    pixel_bytes(path, dataset)
    return dataset


def _series(images: list[tuple[Path, Any]], what: str) -> Scan:
    _refuse_mixed(images, what)
    first = images[0][1]
    orientation = check_orientation(first.get("ImageOrientationPatient"), what)
    for path, dataset in images:
        if dataset.get("ImagePositionPatient") is None:
            raise InputError(f"{path} has no ImagePositionPatient, so its position is unknown.")
        other = check_orientation(dataset.get("ImageOrientationPatient"), str(path))
        if not np.allclose(other, orientation, atol=1e-4):
            raise InputError(f"{path} differs from {images[0][0].name} in orientation.")
    positions = np.array([d.ImagePositionPatient for _, d in images], dtype=float)
    planes = stack(positions, orientation, what)
    for _, dataset in images:
        check_stated_gap(planes, dataset, what)
    shared = np.bincount(planes.slots)[planes.slots] > 1
    twice = [path.name for (path, _), other in zip(images, shared, strict=True) if other]
    if twice:
        raise InputError(
            f"{what} has several slices at one position: {', '.join(twice[:4])}. Two series or "
            "time points are mixed; keep one."
        )
    each = pixel_bytes(images[0][0], first)[1]
    claimed_bytes((len(images), first.Rows, first.Columns), each, what)
    values: NDArray[Any] | None = None
    for slot, (path, dataset) in zip(planes.slots, images, strict=True):
        pixels = _pixels(path, dataset)
        if values is None:
            values = np.empty((len(images), *pixels.shape), pixels.dtype)
        if pixels.dtype != values.dtype:
            values = values.astype(np.promote_types(pixels.dtype, values.dtype))
        values[slot] = pixels
    assert values is not None
    return replace(
        plane_scan(values, planes, orientation, first.get("PixelSpacing")),
        frame_uid=str(first.get("FrameOfReferenceUID") or ""),
        scaling=next(filter(None, (_scaling(dataset) for _, dataset in images)), ""),
        remarks=next(filter(None, (thickness_remarks(planes, d) for _, d in images)), ()),
    )


def _refuse_mixed(images: list[tuple[Path, Any]], what: str) -> None:
    """Require one series, one frame of reference, one size and one pixel spacing."""
    series = Counter(str(d.get("SeriesInstanceUID", "none")) for _, d in images)
    if len(series) > 1:
        listed = "; ".join(f"{uid}: {count} slices" for uid, count in series.most_common(4))
        raise InputError(f"{what} has {len(series)} series ({listed}). Give one folder for each.")
    frames = Counter(str(d.get("FrameOfReferenceUID") or "none") for _, d in images)
    if len(frames) > 1:
        listed = "; ".join(f"{uid}: {count} slices" for uid, count in frames.most_common(4))
        raise InputError(
            f"{what} has slices from {len(frames)} frames of reference ({listed}), whose positions "
            "cannot be compared. Give one folder for each."
        )
    for name in ("Rows", "Columns", "PixelSpacing"):
        values = Counter(str(d.get(name)) for _, d in images)
        if len(values) > 1:
            raise InputError(
                f"{what} has slices of different {name}: {', '.join(sorted(values))}. "
                "Keep only the slices of one image."
            )


def _pixels(path: Path, dataset: Any) -> NDArray[Any]:
    """Return the rescaled pixels; integers if slope and intercept are integers."""
    if dataset.get("SamplesPerPixel", 1) != 1:
        raise InputError(f"{path} is a colour image; labels need one number per pixel.")
    try:
        pixels = _decoded(dataset)
    except Exception as error:  # pydicom and its decoders raise nearly anything
        raise InputError(
            f"{path}: the pixels cannot be read ({error}). The file is cut short, or is "
            "compressed in a way that needs a decoder; export it uncompressed."
        ) from error
    slope, intercept = _rescale(dataset)
    if slope == 1 and intercept == 0:
        return pixels
    scaled = slope * pixels.astype(np.float64) + intercept
    return scaled.astype(np.int32) if slope.is_integer() and intercept.is_integer() else scaled


def _decoded(dataset: Any) -> NDArray[Any]:
    """Return the stored pixels; compressed ones must be as many as the header states."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The pixel data is")  # its padding is checked
        warnings.filterwarnings("error", message="The decoded RLE segment")
        pixels: NDArray[Any] = dataset.pixel_array
    return pixels


def _rescale(dataset: Any) -> tuple[float, float]:
    """Return the slope and the intercept by which stored pixels are scaled."""
    slope = float(dataset.get("RescaleSlope", 1) or 1)
    return slope, float(dataset.get("RescaleIntercept", 0) or 0)


def _scaling(dataset: Any) -> str:
    slope, intercept = _rescale(dataset)
    unscaled = (slope, intercept) == (1, 0)
    return "" if unscaled else f"RescaleSlope {slope:.6g} and RescaleIntercept {intercept:.6g}"

"""DICOM images, read with pydicom: a folder with one series of slices, or one SEG file.

Slices are sorted by ImagePositionPatient along the normal of their plane, never
by file name or instance number. The frame is LPS, as in the standard.
"""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.errors import InvalidDicomError
from pydicom.uid import DeflatedExplicitVRLittleEndian

from palpate.storage.errors import InputError
from palpate.workers.body.images.claimed_size import claimed_bytes
from palpate.workers.body.images.dicom.pixel_size import pixel_bytes
from palpate.workers.body.images.dicom.planes import (
    check_orientation,
    check_stated_gap,
    plane_scan,
    stack,
)
from palpate.workers.body.images.dicom.segmentation import is_multi_frame, read_segmentation
from palpate.workers.body.images.scan import Scan

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
    scan = plane_scan(values, planes, orientation, first.get("PixelSpacing"))
    return replace(scan, frame_uid=str(first.get("FrameOfReferenceUID") or ""))


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
        pixels: NDArray[Any] = dataset.pixel_array
    except Exception as error:  # pydicom and its decoders raise nearly anything
        raise InputError(
            f"{path}: the pixels cannot be read ({error}). The file is cut short, or is "
            "compressed in a way that needs a decoder; export it uncompressed."
        ) from error
    slope = float(dataset.get("RescaleSlope", 1) or 1)
    intercept = float(dataset.get("RescaleIntercept", 0) or 0)
    if slope == 1 and intercept == 0:
        return pixels
    scaled = slope * pixels.astype(np.float64) + intercept
    return scaled.astype(np.int32) if slope.is_integer() and intercept.is_integer() else scaled

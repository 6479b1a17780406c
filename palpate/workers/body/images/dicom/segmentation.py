"""DICOM segmentations: one file with many frames (PS3.3, A.51 and C.8.20).

BINARY frames (one segment at one position each; the label is the segment
number) and LABELMAP frames (labels unchanged) are supported. Frames without any voxel of a segment
are usually missing from the file; they stay 0.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.storage.errors import InputError
from palpate.workers.body.images.claimed_size import claimed_bytes
from palpate.workers.body.images.dicom.planes import (
    check_orientation,
    check_stated_gap,
    plane_scan,
    stack,
)
from palpate.workers.body.images.scan import Scan
from palpate.workers.body.images.tissue_names import tissue_in


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

    pixels = np.asarray(dataset.pixel_array)
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

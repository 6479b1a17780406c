"""NRRD images; `workers.body.images.nrrd_header` reads the file itself.

The header's ``space`` names the frame; LPS, RAS and LAS are converted to LPS.
Spaces without anatomy (``scanner-xyz``, ``3D-right-handed``, ``space dimension:
3`` or none) are used unchanged. Without ``space directions`` the index axes
are x, y, z at the header's ``spacings``, and the position is unknown; a header that
nevertheless has an origin is refused.

Names of labels follow 3D Slicer's segmentations (``.seg.nrrd``).
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.body.images.nrrd_header import read_nrrd_file
from palpate.workers.body.images.scan import RAS_TO_LPS, SPACING_TOLERANCE, Scan, three_axes

_FRAMES: dict[str, FloatArray] = {
    "left-posterior-superior": np.eye(3),
    "lps": np.eye(3),
    "right-anterior-superior": RAS_TO_LPS,
    "ras": RAS_TO_LPS,
    "left-anterior-superior": np.diag([1.0, -1.0, 1.0]),
    "las": np.diag([1.0, -1.0, 1.0]),
    "scanner-xyz": np.eye(3),
    "3d-right-handed": np.eye(3),
    "": np.eye(3),
}
_ANATOMICAL = {name for name in _FRAMES if name.startswith(("left", "right", "lps", "ras", "las"))}
_SEGMENT = re.compile(r"Segment(\d+)_(Name|ID|LabelValue|Layer)")
FRAME_KEY, PLACE_KEY = "palpate_frame_uid", "palpate_place_known"
"""Keys used by `service.export` for data without an NRRD field."""
_UNIT_MM = {"": 1.0, "mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "µm": 1e-3, "micron": 1e-3}


def read_nrrd(path: Path) -> Scan:
    """Read an ``.nrrd`` file, or ``.nhdr`` with a separate data file."""
    what = str(path)
    values, header = read_nrrd_file(path)
    segments = _segments(header)
    _refuse_layers(segments, values.shape, what)
    scan = (
        _without_directions(values, header, what)
        if header.get("space directions") is None
        else _with_directions(values, header, what)
    )
    return replace(
        scan,
        frame_uid=str(header.get(FRAME_KEY, "")),
        place_known=scan.place_known and header.get(PLACE_KEY) != "false",
        names=_names(segments, what),
    )


def _without_directions(values: NDArray[Any], header: Mapping[str, Any], what: str) -> Scan:
    given = [key for key in ("space origin", "axis mins", "axis maxs") if key in header]
    if given:
        raise InputError(
            f"{what} has {' and '.join(given)} but no space directions, so the position of its "
            "voxels is ambiguous. Save it with space directions (3D Slicer and ITK always do), or "
            f"remove {' and '.join(given)} from the header."
        )
    sizes = values.shape
    spacing = np.asarray(header.get("spacings", np.full(len(sizes), np.nan)), dtype=float)
    values = three_axes(values, what)
    if spacing.size > 3:
        spacing = spacing[np.array(sizes) > 1]
    unit = _unit_mm(header, what)
    return Scan.without_frame(values, unit * spacing if spacing.size == 3 else None)


def _with_directions(values: NDArray[Any], header: dict[str, Any], what: str) -> Scan:
    steps = np.asarray(header["space directions"], dtype=float)
    spatial = _spatial_axes(steps, header, values.shape, what)
    values = values.squeeze(tuple(a for a in range(values.ndim) if a not in spatial))
    _refuse_other_spacings(steps[spatial], header.get("spacings"), spatial, what)
    unit = _unit_mm(header, what)
    origin = np.asarray(header.get("space origin", np.full(3, np.nan)), dtype=float)
    frame = _frame(header, what)
    scan = Scan.with_steps(values, unit * steps[spatial].T, unit * origin, frame)
    return replace(scan, anatomical=_space(header) in _ANATOMICAL)


def _refuse_other_spacings(steps: FloatArray, spacings: Any, spatial: list[int], what: str) -> None:
    """Raise InputError if the header also has ``spacings`` that contradict the directions."""
    if spacings is None:
        return
    stated = np.asarray(spacings, dtype=float)[spatial]
    length = np.linalg.norm(steps, axis=1)
    both = np.isfinite(stated) & np.isfinite(length)
    if np.any(np.abs(stated - length)[both] > SPACING_TOLERANCE * length[both]):
        raise InputError(
            f"{what} is inconsistent: voxels measure {_listed(length)} according to its space "
            f"directions, but {_listed(stated)} according to its spacings. "
            "Save it again with space directions alone."
        )


def _listed(lengths: FloatArray) -> str:
    return " x ".join(f"{length:.4g}" for length in lengths)


def _segments(header: Mapping[str, Any]) -> dict[int, dict[str, str]]:
    """Return the fields of each segment of a ``.seg.nrrd``, by segment number."""
    segments: dict[int, dict[str, str]] = {}
    for key, value in header.items():
        if match := _SEGMENT.fullmatch(key):
            segments.setdefault(int(match[1]), {})[match[2]] = str(value).strip()
    return segments


def _refuse_layers(
    segments: Mapping[int, Mapping[str, str]], shape: tuple[int, ...], what: str
) -> None:
    layers = {segment.get("Layer", "0") for segment in segments.values()}
    if segments and (len(layers) > 1 or (len(shape) == 4 and shape[0] > 1)):
        raise InputError(
            f"{what} has segments in {max(len(layers), shape[0])} layers, because they overlap; a "
            "voxel can have one label only. In 3D Slicer, set masking to 'Overwrite: all' or "
            "remove the overlap (Logical operators: subtract), then export it as a label map: "
            "Segment Editor, Segmentations, 'Export visible segments to binary labelmap', and "
            "save that as .nrrd with its colour table (give it with --labels FILE.ctbl)."
        )


def _names(segments: Mapping[int, Mapping[str, str]], what: str) -> dict[int, str]:
    """Return the name of each label value."""
    names: dict[int, str] = {}
    for number, segment in sorted(segments.items()):
        name = segment.get("Name") or segment.get("ID", "")
        value = segment.get("LabelValue", "1" if len(segments) == 1 else "")
        if not value.lstrip("-").isdecimal():
            raise InputError(
                f"{what}: Segment{number}_LabelValue is {value!r}, expected the label of the "
                f"segment {name!r}. Save the segmentation again with 3D Slicer 4.11 or later."
            )
        if names.setdefault(int(value), name) != name:
            raise InputError(
                f"{what} has two segments with label {value}, {names[int(value)]!r} and "
                f"{name!r}. Save the segmentation again."
            )
    return {value: name for value, name in names.items() if name}


def _spatial_axes(
    steps: FloatArray, header: dict[str, Any], shape: tuple[int, ...], what: str
) -> list[int]:
    """Return the three spatial axes; an axis without a direction must have one voxel."""
    if steps.shape != (len(shape), 3):
        raise InputError(
            f"{what} is not a 3-D image: it has {len(shape)} axes of sizes {shape} in a space of "
            f"{steps.shape[1]} dimensions; three of each are needed."
        )
    kinds = header.get("kinds", ["domain"] * len(shape))
    spatial = [axis for axis, kind in enumerate(kinds) if kind in ("domain", "space", "???")]
    if len(shape) == 3 and len(spatial) == 3:
        return spatial  # a missing direction becomes a spacing to ask for
    spatial = [axis for axis in spatial if not np.isnan(steps[axis]).all()]
    others = [size for axis, size in enumerate(shape) if axis not in spatial]
    if len(spatial) != 3 or any(size != 1 for size in others):
        raise InputError(
            f"{what} has {len(spatial)} axes in space, shape {shape}; a volume has 3, and one "
            "value per voxel. Save one channel and one time point of it."
        )
    return spatial


def _frame(header: dict[str, Any], what: str) -> FloatArray:
    space = _space(header)
    if space not in _FRAMES:
        raise InputError(
            f"{what} is in the space {space!r}, which is unknown or mirrored. "
            "Save it as left-posterior-superior (LPS)."
        )
    return _FRAMES[space]


def _space(header: Mapping[str, Any]) -> str:
    return str(header.get("space", "")).lower().removesuffix("-time")


def _unit_mm(header: Mapping[str, Any], what: str) -> float:
    units = {str(unit).strip().lower() for unit in header.get("space units", [])} or {""}
    if len(units) > 1 or not units <= _UNIT_MM.keys():
        raise InputError(
            f"{what} has the space units {sorted(units)}, expected one of mm, cm, m, um."
        )
    return _UNIT_MM[units.pop()]

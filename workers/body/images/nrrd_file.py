"""Read NRRD, with pynrrd.

The header's ``space`` names the frame; LPS, RAS and LAS are brought to LPS.
Spaces without anatomy (``scanner-xyz``, ``3D-right-handed``, ``space dimension:
3`` or none) are taken as they are. Without ``space directions`` the index axes
are x, y, z at the header's ``spacings``.
"""

from pathlib import Path
from typing import Any

import nrrd
import numpy as np

from storage.errors import InputError
from storage.values import FloatArray
from workers.body.images.scan import RAS_TO_LPS, Scan, three_axes

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
_UNIT_MM = {"": 1.0, "mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "µm": 1e-3, "micron": 1e-3}


def read_nrrd(path: Path) -> Scan:
    """Read an ``.nrrd`` file, or ``.nhdr`` with its data beside it."""
    values, header = nrrd.read(str(path), index_order="F")
    steps = header.get("space directions")
    if steps is None:
        sizes = values.shape
        spacing = np.asarray(header.get("spacings", np.full(len(sizes), np.nan)), dtype=float)
        values = three_axes(values, str(path))
        if spacing.size > 3:
            spacing = spacing[np.array(sizes) > 1]
        return Scan.without_frame(values, spacing if spacing.size == 3 else None)

    steps = np.asarray(steps, dtype=float)
    spatial = _spatial_axes(steps, header, values.shape, str(path))
    values = values.squeeze(tuple(a for a in range(values.ndim) if a not in spatial))
    unit = _unit_mm(header, str(path))
    origin = np.asarray(header.get("space origin", np.zeros(3)), dtype=float)
    frame = _frame(header, str(path))
    return Scan.with_steps(values, unit * steps[spatial].T, unit * origin, frame)


def _spatial_axes(
    steps: FloatArray, header: dict[str, Any], shape: tuple[int, ...], what: str
) -> list[int]:
    """Return the three axes that lie in space; one without a direction must have one voxel."""
    if steps.shape != (len(shape), 3):
        raise InputError(
            f"{what} is not a 3-D image: it has {len(shape)} axes of sizes {shape} in a space of "
            f"{steps.shape[1]} dimensions; three of each are needed."
        )
    kinds = header.get("kinds", ["domain"] * len(shape))
    spatial = [axis for axis, kind in enumerate(kinds) if kind in ("domain", "space", "???")]
    if len(shape) == 3 and len(spatial) == 3:
        return spatial  # one that has no direction after all is a spacing to ask for
    spatial = [axis for axis in spatial if not np.isnan(steps[axis]).all()]
    others = [size for axis, size in enumerate(shape) if axis not in spatial]
    if len(spatial) != 3 or any(size != 1 for size in others):
        raise InputError(
            f"{what} has {len(spatial)} axes in space, shape {shape}; a volume has 3, and one "
            "value in each voxel. Save one channel and one time point of it."
        )
    return spatial


def _frame(header: dict[str, Any], what: str) -> FloatArray:
    space = str(header.get("space", "")).lower().removesuffix("-time")
    if space not in _FRAMES:
        raise InputError(
            f"{what} lies in the space {space!r}, which is not known here or is mirrored. "
            "Save it as left-posterior-superior (LPS)."
        )
    return _FRAMES[space]


def _unit_mm(header: dict[str, Any], what: str) -> float:
    units = {str(unit).strip().lower() for unit in header.get("space units", [])} or {""}
    if len(units) > 1 or not units <= _UNIT_MM.keys():
        raise InputError(
            f"{what} has the space units {sorted(units)}, expected one of mm, cm, m, um."
        )
    return _UNIT_MM[units.pop()]

"""Arrays packed into a page for its viewers."""

import base64
import json
import zlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from palpate.storage.values import Triple, Volume

# Larger volumes are subsampled: four million labels take about 300 kB in a page.
MOST_VOXELS = 6_000_000
TYPES: dict[str, np.dtype[Any]] = {
    "u1": np.dtype("u1"),
    "u2": np.dtype("<u2"),
    "u4": np.dtype("<u4"),
    "f4": np.dtype("<f4"),
}

Json = dict[str, Any]


def packed(values: NDArray[Any], kind: str) -> Json:
    """Return an array for the script's `unpack`: base64 of a zlib stream.

    Parameters
    ----------
    values : ndarray
        Of any shape; the script receives it flat.
    kind : {"u1", "u2", "u4", "f4"}
    """
    raw = np.ascontiguousarray(values, TYPES[kind]).tobytes()
    # Labels are long runs: searching only for runs takes a tenth of the time and gives a seventh
    # more bytes.
    strategy = zlib.Z_RLE if kind == "u1" else zlib.Z_DEFAULT_STRATEGY
    stream = zlib.compressobj(9, strategy=strategy)
    data = stream.compress(raw) + stream.flush()
    return {"type": kind, "data": base64.b64encode(data).decode()}


def packed_triangles(triangles: NDArray[np.integer]) -> Json:
    """Return triangles in the smallest integer type for their number of vertices."""
    return packed(triangles, "u2" if triangles.max(initial=0) < 2**16 else "u4")


def packed_points(points: NDArray[np.floating]) -> Json:
    """Return points rounded to 0.01 mm, which compresses better."""
    return packed(np.round(points, 2), "f4")


def packed_volume(volume: Volume, most: int = MOST_VOXELS) -> Json:
    """Return a label volume, subsampled if it is too large for a page.

    Parameters
    ----------
    volume : Volume
        Labels up to 255.
    most : int
        Voxels.
    """
    thin = thinned(volume, most)
    return {
        "shape": list(thin.shape_xyz),
        "spacing": list(thin.spacing_mm),
        "origin": list(thin.origin_mm),
        "labels": packed(thin.values, "u1"),
    }


def thinned(volume: Volume, most: int = MOST_VOXELS) -> Volume:
    """Return every nth voxel along each axis, for at most `most` voxels."""
    step = 1
    while np.prod([-(-n // step) for n in volume.values.shape]) > most:
        step += 1
    if step == 1:
        return volume
    dx, dy, dz = volume.spacing_mm
    spacing: Triple = (step * dx, step * dy, step * dz)
    values = volume.values[::step, ::step, ::step]
    return replace(volume, values=values, spacing_mm=spacing)


def body_box_mm(volume: Volume) -> tuple[Triple, Triple]:
    """Return the lowest and highest corners of the body's box, (x, y, z) in mm."""
    low, high = [], []
    solid = volume.values != 0
    for axis in range(3):
        there = np.flatnonzero(solid.any(axis=tuple(a for a in range(3) if a != 2 - axis)))
        first, last = (there[0], there[-1]) if there.size else (0, solid.shape[2 - axis] - 1)
        step, origin = volume.spacing_mm[axis], volume.origin_mm[axis]
        low.append(float(origin + (first - 0.5) * step))
        high.append(float(origin + (last + 0.5) * step))
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def script(name: str, told: Mapping[str, Any]) -> Markup:
    """Return data as a page element that the script finds by name."""
    text = json.dumps(told, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    head = Markup('<script type="application/json" id="{}-data">').format(name)
    return head + Markup(text.replace("</", "<\\/")) + Markup("</script>")

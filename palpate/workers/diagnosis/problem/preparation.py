"""Parts of an inverse problem, as named arrays, which any process can prepare in advance.

::

    points    points on the interfaces of the scan at rest
    body      the volume to be meshed
    scan N    distances to the interfaces of a loaded scan, and their areas
    shapes    interfaces of the scan at rest, as shown on a page
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import Volume
from palpate.workers.comparison.observation.interface import InterfacePoints
from palpate.workers.comparison.observation.residual import Observed
from palpate.workers.comparison.observation.signed_distance import SignedDistance

Prepared = dict[str, NDArray[Any]]
ReadPrepared = Callable[[str], Prepared]
"""Returns the arrays of a named preparation."""

POINTS, BODY, SHAPES = "points", "body", "shapes"
_PLACE, _AREAS = "place", "interface_mm2"


def scan_preparation(number: int) -> str:
    """Return the name of the preparation with the distances of one loaded scan."""
    return f"scan {number}"


def preparations_of(scans: int) -> tuple[str, ...]:
    """Return the names of all preparations for `scans` loaded scans, the slowest first."""
    return (POINTS, *map(scan_preparation, range(scans)), BODY, SHAPES)


def arrays_of_volume(volume: Volume) -> Prepared:
    """Return a volume as arrays."""
    return {"values": volume.values, _PLACE: _place(volume)}


def volume_of(arrays: Prepared) -> Volume:
    """Return the volume from the arrays of `arrays_of_volume`."""
    return Volume(arrays["values"], *_spacing_and_origin(arrays))


def arrays_of_points(points: InterfacePoints) -> Prepared:
    """Return interface points as arrays."""
    return {
        "points": points.points,
        "normals": points.normals,
        "interface": points.interface,
        "area_mm2": points.area_mm2,
        "part": points.part,
    }


def points_of(arrays: Prepared) -> InterfacePoints:
    """Return the points from the arrays of `arrays_of_points`."""
    return InterfacePoints(**arrays)


def arrays_of_distances(observed: Observed) -> Prepared:
    """Return the distances to all interfaces of a scan as arrays."""
    values = {f"distance_{n}": one.values for n, one in enumerate(observed.distances)}
    areas = np.array([one.interface_mm2 for one in observed.distances])
    return {**values, _AREAS: areas, _PLACE: _place(observed.distances[0])}


def distances_of(arrays: Prepared) -> Observed:
    """Return the distances from the arrays of `arrays_of_distances`."""
    spacing, origin = _spacing_and_origin(arrays)
    return Observed(
        tuple(
            SignedDistance(arrays[f"distance_{n}"], spacing, origin, float(area))
            for n, area in enumerate(arrays[_AREAS])
        )
    )


def _place(lattice: Volume | SignedDistance) -> NDArray[np.float64]:
    return np.array([lattice.spacing_mm, lattice.origin_mm])


def _spacing_and_origin(arrays: Prepared) -> Sequence[Any]:
    return [tuple(map(float, row)) for row in arrays[_PLACE]]

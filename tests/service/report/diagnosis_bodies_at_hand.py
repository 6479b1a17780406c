"""A diagnosis with bodies: an egg between plates, once along y and once along x."""

from typing import Any

import numpy as np

from palpate.service.diagnosis.diagnosis_run import FinishedDiagnosis
from palpate.storage.json_digests import to_json
from palpate.storage.values import FloatArray, Volume
from palpate.workers.comparison.observation.interface_residual import (
    GLANDULAR,
    OUTLINE,
    interface_points,
    observe,
)
from palpate.workers.diagnosis.outcome.body_pictures import (
    bodies,
    causes,
    loudest_place,
    overlap_rows,
)
from palpate.workers.diagnosis.outcome.residual_maps import CauseMap
from palpate.workers.diagnosis.problem.prepared_parts import shapes
from tests.service.report.diagnosis_at_hand import summary, typed

SCANS = ("40 N", "40 N along x")
HALF_AXES_MM = np.array([24.0, 16.0, 14.0])
# Constants of the egg between the plates.
PRESSED_MM = (np.array([27.0, 12.0, 15.0]), np.array([18.0, 20.0, 15.0]))
# The nominal model is compressed too little.
NOMINAL_MM = (np.array([26.0, 13.5, 15.0]), np.array([19.5, 19.0, 15.0]))
LUMP_MM = (8.0, -4.0, 2.0)


def egg(half_axes_mm: FloatArray) -> Volume:
    """Return fat with a gland in its middle, in voxels of 1.5 mm on one lattice."""
    z, y, x = (a * 1.5 for a in np.mgrid[-12:13, -15:16, -20:21])
    a, b, c = half_axes_mm
    r = np.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2)
    values = (r < 1).astype(np.uint8) + (r < 0.55)
    return Volume(values, (1.5, 1.5, 1.5), (-30.0, -22.5, -18.0))


def found(named: bool = True, **changes: Any) -> FinishedDiagnosis:
    """Return the egg's diagnosis; `changes` are applied to its summary."""
    reference = egg(HALF_AXES_MM)
    points = interface_points(reference, (OUTLINE, GLANDULAR), 5.0, 2.0)
    k = len(points)
    observed = [egg(half) for half in PRESSED_MM]
    predicted = {"before": [egg(half) for half in NOMINAL_MM]}
    along = points.points / HALF_AXES_MM
    apart = np.stack(
        [
            ((nominal - pressed) * along * points.normals).sum(axis=1)
            for nominal, pressed in zip(NOMINAL_MM, PRESSED_MM, strict=True)
        ]
    )
    maps: dict[str, Any] = {
        "points": points.points,
        "interface": points.interface,
        "before": apart,
        "noise": np.full((2, k), 0.3),
        "local_before": apart,
        "local_before_sd": np.full((2, k), 0.1),
    }
    if named:
        predicted["after"] = observed
        maps |= {"after": 0 * apart, "local_after": 0 * apart}
        maps["local_after_sd"] = maps["local_before_sd"]
    places = np.array([LUMP_MM, (-8.0, 4.0, 2.0), (0.0, 0.0, 0.0)])
    cause = CauseMap(
        places,
        np.array([6.2, -3.0, 1.0]),
        np.array([0.9, -0.4, 0.1]),
        np.full(3, 0.2),
        np.ones(3, bool),
        3.3,
    )
    result = summary(**changes) if named else summary(primary=[], **changes)
    residuals = {when: maps[when] for when in predicted}
    seen = [observe(one, (OUTLINE, GLANDULAR)).distances for one in observed]
    areas = [[one.interface_mm2 for one in distances] for distances in seen]
    rows = overlap_rows(
        SCANS, areas, observed, predicted, residuals, maps["noise"], points.interface
    )
    result["overlap"] = to_json(rows)
    result["cause_map"] = {"before": to_json(loudest_place(cause))}
    maps |= bodies(reference, observed, predicted) | shapes(reference, (OUTLINE, GLANDULAR))
    maps |= causes({"before": cause}, reference)
    return FinishedDiagnosis(typed(result), maps, SCANS)

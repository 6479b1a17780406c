"""Findings about a fitted eye that decide which of its values may be quoted."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.comparison.identifiability import (
    shear_modulus_slope,
    stress_slope,
    uniaxial_stress_mpa,
)
from palpate.workers.organs.cornea.findings.mesh_shift import PART_SEEN
from palpate.workers.organs.cornea.findings.notes import NOT_MEASURED, UNKNOWN_FROM
from palpate.workers.organs.cornea.material.constants import CorneaConstants

# Standard deviation of a shift due to the mesh, relative to it. With a half, 90 % of the intervals
# of G0 and stress cover the truth; see tests/benchmarks/cornea_coverage.py.
SHIFT_KNOWN_TO = 0.5
# Stretches at which the stress is reported, as fractions of the way from rest to the largest one.
PARTS_OF_LARGEST = (0.25, 0.5, 0.75, 1.0)


def derived(
    numbers: Mapping[str, Any],
    constants: CorneaConstants,
    refitted: CorneaConstants | None = None,
) -> list[dict[str, Any]]:
    """Return the values derived from the constants: G0, and stress at attained stretches.

    Parameters
    ----------
    numbers : mapping
        See `workers.organs.cornea.findings.study`.
    constants : CorneaConstants
    refitted : CorneaConstants, optional
        See `workers.organs.cornea.findings.mesh_shift`.

    Returns
    -------
    list of dict
        ``name``; ``value`` in ``unit``; ``slope``, the derivatives of its logarithm in the
        logarithms of the constants; ``mesh_shift`` and ``mesh_sd``, the relative increase due
        to the mesh and its standard deviation, None if unknown; ``against``, clauses against
        quoting it; and ``stretch`` of a stress.
    """

    def shift(value: Callable[[CorneaConstants], float]) -> float | None:
        if refitted is None:
            return None
        return float(np.log(value(refitted) / value(constants)) / PART_SEEN)

    assumed, names = _assumed(numbers), [n.removesuffix("_mpa") for n in numbers["constants"]]
    found: list[dict[str, Any]] = [
        {
            "name": "G0",
            "value": 1000 * constants.shear_modulus_mpa,
            "slope": _named(names, shear_modulus_slope(constants)),
            "mesh_shift": shift(lambda law: law.shear_modulus_mpa),
        }
    ]
    largest = numbers["attained_stretches"][1]
    for part in PARTS_OF_LARGEST:
        stretch = 1 + part * (largest - 1)
        at = np.array([stretch])
        found.append(
            {
                "name": f"stress at a stretch of {stretch:.3f}",
                "value": 1000 * _stress_mpa(constants, at),
                "slope": _named(names, stress_slope(constants, stretch)),
                "mesh_shift": shift(partial(_stress_mpa, stretch=at)),
                "stretch": stretch,
            }
        )
    sds = _mesh_sds([one["mesh_shift"] for one in found])
    return [
        one | {"unit": "kPa", "mesh_sd": sd, "against": assumed}
        for one, sd in zip(found, sds, strict=True)
    ]


def _mesh_sds(shifts: Sequence[float | None]) -> list[float | None]:
    """Return the standard deviation of each shift due to the mesh.

    A shift of zero is uncertain if those of other stretches are not zero, so half of the
    square is averaged over all of them.
    """
    known = [shift for shift in shifts if shift is not None]
    if len(known) < len(shifts):
        return [None] * len(shifts)
    mean = float(np.mean(np.square(known)))
    return [SHIFT_KNOWN_TO * float(np.sqrt((shift**2 + mean) / 2)) for shift in known]


def _stress_mpa(law: CorneaConstants, stretch: FloatArray) -> float:
    return float(uniaxial_stress_mpa(law, stretch)[0])


def _named(names: Sequence[str], slope: FloatArray) -> dict[str, float]:
    return dict(zip(names, slope.tolist(), strict=True))


def against(numbers: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the reasons not to quote each constant, as clauses."""
    bounds, noise = numbers["bounds"]["model"], numbers["noises"]["model"]
    found = {}
    for name, bound in bounds.items():
        loose = bound > UNKNOWN_FROM
        clause = f"errors of model and image of {noise} leave it uncertain by more than half"
        found[name.removesuffix("_mpa")] = [*_assumed(numbers), *([clause] if loose else [])]
    return found


def _assumed(numbers: Mapping[str, Any]) -> list[str]:
    missing = [NOT_MEASURED[one] for one in numbers["not_measured"]]
    verb = "is" if len(missing) == 1 else "are"
    return [f"{' and '.join(missing)} {verb} assumed, not measured"] if missing else []

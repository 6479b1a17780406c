"""Plausibility checks of a bench experiment: its points, its body and its fitted constants.

See `workers.organs.plausibility_rule` for the effect of a finding.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.model_parameters import KPA
from palpate.workers.organs.plausibility_rule import Finding
from palpate.workers.organs.specimen.marker_and_field_data import Observed
from palpate.workers.organs.specimen.specimen_keys import SpecimenSpec
from palpate.workers.organs.specimen.specimen_problem import (
    compressibility_name,
    shape_name,
    young_name,
)

# Points that span less than this fraction of the body are in another unit.
LEAST_SPAN = 0.01
# Largest distance of a point from the box of the body: in mm, plus a fraction of its diagonal.
FARTHEST_MM, FARTHEST_PART = 3.0, 0.05
# Displacements whose mean square is less than this many variances of the noise, and whose
# largest is less than this many standard deviations, are noise.
LEAST_VARIANCE, LEAST_LARGEST = 1.5, 5.0
# A constant this close to an end of its interval, as a fraction of its logarithmic width, is at
# the end.
AT_END = 1e-3


def findings(
    observed: Observed, spec: SpecimenSpec, low_mm: FloatArray, high_mm: FloatArray
) -> Iterator[Finding]:
    """Yield the reasons why an experiment cannot be diagnosed.

    Parameters
    ----------
    observed : Observed
    spec : SpecimenSpec
    low_mm, high_mm : ndarray, shape (3,)
        Corners of the box around the body.
    """
    for text in (
        _span(observed, low_mm, high_mm),
        _outside(observed, low_mm, high_mm),
        _too_large(observed, spec, low_mm, high_mm),
        _nothing(observed),
        _scatter(observed, spec),
    ):
        if text:
            yield Finding("impossible", text)


def _span(observed: Observed, low_mm: FloatArray, high_mm: FloatArray) -> str:
    diagonal = float(np.linalg.norm(high_mm - low_mm))
    span = float(np.ptp(observed.points_mm, axis=0).max())
    if len(observed.points_mm) < 2 or span >= LEAST_SPAN * diagonal:
        return ""
    return (
        f"The {len(observed.points_mm)} points span {span:.2g} mm, but the body is "
        f"{_sizes(low_mm, high_mm)} mm. Positions are in mm in the frame of the body: check "
        "whether they are in metres."
    )


def _outside(observed: Observed, low_mm: FloatArray, high_mm: FloatArray) -> str:
    points = observed.points_mm
    away = np.linalg.norm(points - np.clip(points, low_mm, high_mm), axis=1)
    limit = FARTHEST_MM + FARTHEST_PART * float(np.linalg.norm(high_mm - low_mm))
    worst = int(away.argmax())
    if away[worst] <= limit:
        return ""
    return (
        f"{int((away > limit).sum())} of {len(points)} points are outside the body, "
        f"{observed.names[worst]} by {away[worst]:.4g} mm; the body reaches from "
        f"{_corner(low_mm)} to {_corner(high_mm)} mm. Give positions in mm in the frame of the "
        "body, and check mm_per_unit of a mesh file."
    )


def _too_large(
    observed: Observed, spec: SpecimenSpec, low_mm: FloatArray, high_mm: FloatArray
) -> str:
    diagonal = float(np.linalg.norm(high_mm - low_mm))
    size = np.linalg.norm(np.nan_to_num(observed.moved_mm), axis=2)
    state, point = np.unravel_index(int(size.argmax()), size.shape)
    if size[state, point] <= diagonal:
        return ""
    return (
        f"{observed.names[point]} moves by {size[state, point]:.4g} mm in the state "
        f"{spec.states[state].name}, farther than the size of the body ({diagonal:.4g} mm). Check "
        "the unit (mm_per_unit), and whether the marker was lost."
    )


def _nothing(observed: Observed) -> str:
    moved = np.abs(observed.moved_mm[np.isfinite(observed.moved_mm)])
    noise = observed.sd_mm
    if (moved**2).mean() >= LEAST_VARIANCE * noise**2 or moved.max() >= LEAST_LARGEST * noise:
        return ""
    return (
        f"No state moves the points by more than the noise: {np.sqrt((moved**2).mean()):.2g} mm on "
        f"average, {moved.max():.2g} mm at most, where the noise of a component is {noise:.2g} mm. "
        "Nothing was measured. Check the unit of the displacements, the windows and sd_mm."
    )


def _scatter(observed: Observed, spec: SpecimenSpec) -> str:
    stated = spec.markers or spec.field
    if not observed.scatter or (stated is not None and stated.noise_confirmed):
        return ""
    key = "markers" if spec.markers is not None else "field"
    return (
        f"{observed.scatter} Check the recordings; if they are right, correct {key}.sd_mm, or "
        f"confirm it with {key}.noise_confirmed: true."
    )


def confirmed_scatter(observed: Observed) -> tuple[str, ...]:
    """Return a note for the start of the result if the file confirms excessive scatter."""
    if not observed.scatter:
        return ()
    return (f"{observed.scatter} The file confirms it, and the larger scatter is used.",)


def outside_intervals(spec: SpecimenSpec, values: Mapping[str, float]) -> tuple[str, ...]:
    """Return a warning for each fitted constant that is outside or at an end of its interval.

    Parameters
    ----------
    spec : SpecimenSpec
    values : mapping of str to float
        Fitted constants; see `workers.organs.specimen.specimen_problem.free_constants`.
    """
    warnings = []
    for name, material in spec.materials.items():
        young = young_name(spec, name)
        warnings.append(_beyond(young, KPA.to_door(values[young]), material.E_kpa, " kPa"))
        if isinstance(material.nu, tuple):
            nu = (1.0 - values[compressibility_name(spec, name)]) / 2.0
            warnings.append(_beyond(young.replace("E", "nu", 1), nu, material.nu, ""))
        for inside, ends in material.shape_free.items():
            shape = shape_name(spec, name, inside)
            warnings.append(_beyond(shape, values[shape], ends, ""))
    return tuple(filter(None, warnings))


def _beyond(name: str, value: float, interval: tuple[float, float], unit: str) -> str:
    low, high = interval
    near = AT_END * float(np.log(high / low))
    within = f"{low:g} to {high:g}{unit}"
    if abs(np.log(value / low)) <= near or abs(np.log(value / high)) <= near:
        return f"{name} is at the end of its interval: {value:.3g}{unit}, stated {within}."
    if low < value < high:
        return ""
    return (
        f"{name} is outside its interval: {value:.3g}{unit}, stated {within}. Check "
        "units and loads, and do not rely on this value."
    )


def _corner(corner_mm: FloatArray) -> str:
    return "(" + ", ".join(f"{c:g}" for c in np.round(corner_mm, 2)) + ")"


def _sizes(low_mm: FloatArray, high_mm: FloatArray) -> str:
    return " x ".join(f"{c:g}" for c in np.round(high_mm - low_mm, 2))

"""Doubts about the constants of a fitted eye: their profiles, the error of the mesh, and words.

The profile of a constant shows how far the other constants compensate for its error.

For the error due to the mesh, the eye is solved again with its constants on a mesh of `MESH_TIMES`
as many elements, and the constants are refitted to that contour on the study's own mesh. Their
change is the part of the study's constants that compensates for its mesh.

Both refits are descents on the residuals of a fit (`workers.organs.trust_region_descent`), which
follow the curved valley of the sum of squares, unlike a single Gauss step.

`derived` and `against` decide which values may be quoted; `notes` says it in sentences.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from palpate.storage.values import FloatArray, FreeParameter
from palpate.workers.organs.cornea.cornea_keys import CorneaCase
from palpate.workers.organs.cornea.cornea_problem import (
    Candidate,
    MeshForModels,
    candidate_of,
    jet_nodes_x_mm,
)
from palpate.workers.organs.cornea.corneal_model import CorneaConstants
from palpate.workers.organs.cornea.identifiability import (
    law_names,
    plain_name,
    shear_modulus_slope,
    stepped,
    stress_slope,
    uniaxial_stress_mpa,
)
from palpate.workers.organs.cornea.prestressed_equilibrium import solve_prepared
from palpate.workers.organs.cornea.section_comparison import (
    CandidateOf,
    SurfaceObservation,
    fit_surfaces,
    observe_surfaces,
)
from palpate.workers.organs.cornea.section_mesh import deformed_section, mesh_section
from palpate.workers.organs.cornea.section_outline import Section, cropped_section
from palpate.workers.organs.normal_equations import NormalEquations
from palpate.workers.organs.organ_protocol import logarithmic
from palpate.workers.organs.trust_region_descent import (
    FIRST_RADIUS,
    Box,
    Tolerance,
    descend,
    with_held,
)

NOT_MEASURED = {
    "iop": "the pressure of the eye",
    "pachymetry": "the thickness of the cornea",
    "jet_pressure": "the pressure of the jet",
}
# Above this bound a constant is no better known than its searched interval.
UNKNOWN_FROM = 0.5


def notes(numbers: Mapping[str, Any], case: CorneaCase) -> list[str]:
    """Return sentences on identifiable values, limitations, and the order of the terms."""
    return [
        *_missing(numbers, case),
        _shear_modulus(numbers),
        _constants(numbers),
        *_several(numbers),
        _order(case),
    ]


def _missing(numbers: Mapping[str, Any], case: CorneaCase) -> list[str]:
    """Return a sentence on the usable results if something was assumed without measurement."""
    missing = numbers["not_measured"]
    if not missing:
        return []
    *others, last = [NOT_MEASURED[assumption] for assumption in missing]
    what = f"{', '.join(others)} and {last}" if others else last
    verb = "was" if len(missing) == 1 else "were"
    sentence = (
        f"{what[0].upper()}{what[1:]} {verb} not measured with these images but {verb} assumed "
        f"(IOP {case.load.iop_mmhg:g} mmHg, jet {1000 * case.load.jet.pressure_mpa:g} kPa). "
        "Contours, displacements, the similarity, and comparisons of this eye with itself may be "
        "used. Mu, alpha, G0 and the stress-stretch curve may not be used as properties "
        "of the tissue; they hold under these assumptions only."
    )
    known = numbers["assumptions"]
    changed = [known[assumption] for assumption in missing if assumption in known]
    if not changed:
        return [sentence]
    parts = ", ".join(
        f"{change['by']} changes G0 by {100 * change['shear_modulus_part']:+.1f} % and the stress "
        f"at the best known stretch by {100 * change['stress_part']:+.1f} %"
        for change in changed
    )
    return [sentence, f"Influence of these assumptions, with refitted constants: {parts}."]


def _shear_modulus(numbers: Mapping[str, Any]) -> str:
    bounds, names = numbers["shear_modulus_bounds"], numbers["noises"]
    return (
        "An image determines G0 = 1/2 Σ μα and the stress at the stretches that the eye attains, "
        f"up to {numbers['attained_stretches'][1]:.3f}; their 90 % intervals are listed with the "
        f"estimates. With an error of model or segmentation of {names['model']}, one such image "
        f"{_fixes(bounds['model'])} (one standard deviation, Cramer-Rao)."
    )


def _fixes(bound: float) -> str:
    return f"determines G0 to {_percent(bound)}" if bound < 1 else "does not determine G0"


def _percent(part: float) -> str:
    """Return a fraction as a percentage with two digits or more."""
    return f"{100 * part:.2g} %" if part < 0.1 else f"{100 * part:.0f} %"


def _constants(numbers: Mapping[str, Any]) -> str:
    values = numbers["singular_values_um"]
    bounds = numbers["bounds"]["model"]
    loose = [name for name, bound in bounds.items() if bound > UNKNOWN_FROM]
    strong = sum(value > 1.0 for value in values)
    text = f"{strong} of {len(values)} combinations of the constants move the contour by more "
    text += "than 1 µm when they grow by a factor of e. "
    if len(loose) == len(bounds):
        return text + "No single constant is known to better than half its value."
    known = ", ".join(plain_name(name) for name in bounds if name not in loose)
    return text + f"Only these constants are known to better than half their value: {known}."


def _several(numbers: Mapping[str, Any]) -> list[str]:
    several, repeated = (
        numbers["bounds_of_several_pressures"],
        numbers["bounds_of_one_pressure_repeated"],
    )
    if several is None:
        return []
    gains = ", ".join(
        f"{plain_name(name)} {repeated[name] / several[name]:.1f}" for name in several
    )
    count = len(numbers["jet_fractions"])
    return [
        f"{count} frames of one puff, at {count} pressures of the jet, would determine the "
        f"constants better than as many images at the present pressure, by these factors: {gains}."
    ]


def _order(case: CorneaCase) -> str:
    by = case.model.order_terms_by
    if by == "nothing":
        return (
            "Swapping the two terms of the law does not change the cornea, and they are listed "
            "as they were found: compare G0 and the curve, not the constants."
        )
    return (
        "Swapping the two terms of the law does not change the cornea. They are sorted by "
        f"{by} in ascending order, so that constants of several eyes can be compared."
    )


# A refit ends when a step promises less than this, or after so many evaluations.
REFIT_TOLERANCE = Tolerance(1.0, part=0.01)
REFIT_EVALUATIONS = 20
# The other constants stay within this logarithm of their fitted values.
PROFILE_REACH = 3.0


@dataclass(frozen=True, eq=False)
class Profile:
    """The smallest misfit of a contour with one constant held.

    Parameters
    ----------
    name : str
    factor : ndarray, shape (n,)
        Ratio of the held value to the fitted one.
    misfit_um : ndarray, shape (n,)
        Root mean square along the normal, the other constants refitted; nan where a
        simulation did not converge.
    """

    name: str
    factor: FloatArray
    misfit_um: FloatArray


def profile_of(
    candidate: Candidate,
    displacement_mm: FloatArray,
    name: str,
    logarithms: FloatArray,
    window_mm: tuple[float, float] | None = None,
) -> Profile:
    """Return the misfits with a constant held at given values and the others refitted.

    Parameters
    ----------
    candidate : Candidate
        The fitted candidate; its own contour is the data, so only the constants differ.
    displacement_mm : ndarray, shape (n, 2)
        Displacement of the candidate.
    name : str
        Name of the constant.
    logarithms : ndarray
        Logarithms of the factors, ascending; zero is the fit itself.
    window_mm : tuple of float, optional
        The part of the contour that the image shows.
    """
    names, mesh = law_names(candidate.constants), candidate.prepared.mesh
    index = names.index(name)
    others = [i for i in range(len(names)) if i != index]
    x = mesh.nodes_mm + displacement_mm
    contour = Section(anterior_mm=x[mesh.anterior], posterior_mm=x[mesh.posterior])
    shown = contour if window_mm is None else cropped_section(contour, *window_mm)
    observation = observe_surfaces(mesh, shown, imaged=False)
    # Factors of the constants; all are positive.
    box = Box(np.full(len(names), -PROFILE_REACH), np.full(len(names), PROFILE_REACH))
    free: list[FreeParameter] = [
        {"name": n, "lower": float(np.exp(low)), "upper": float(np.exp(high))}
        for n, low, high in zip(names, *box, strict=True)
    ]

    def candidate_at(factors: Mapping[str, float]) -> Candidate:
        return stepped(candidate, {n: float(np.log(factor)) for n, factor in factors.items()})

    equations = _equations(candidate_at, {}, free, observation)

    def refitted(before: FloatArray, held: float) -> tuple[FloatArray, float] | None:
        here = equations(before)
        if here is None:
            return None
        at = with_held(here, before, index, held, FIRST_RADIUS, box)

        def of_others(trial: FloatArray) -> NormalEquations | None:
            at[others] = trial
            there = equations(at)
            return None if there is None else there.part(others)

        end = descend(of_others, at[others], box.part(others), REFIT_TOLERANCE, REFIT_EVALUATIONS)
        at[others] = end.at
        return None if end.here is None else (at, end.here.cost)

    misfit = np.full(len(logarithms), np.nan)
    for side in (1, -1):
        at = np.zeros(len(names))
        for i in np.argsort(np.abs(logarithms)):
            if side * logarithms[i] < 0:
                continue
            refit = refitted(at, float(logarithms[i]))
            if refit is None:
                break
            at, cost = refit
            misfit[i] = 1e3 * np.sqrt(cost / (observation.weight @ observation.weight))
    return Profile(name, np.exp(logarithms), misfit)


MESH_TIMES = 4
# The error falls with the square of the element size, so this fraction of it is observed.
PART_SEEN = 1 - 1 / MESH_TIMES


def refitted_constants(
    model: MeshForModels,
    case: CorneaCase,
    body: Section,
    constants: Mapping[str, float],
    middle_mm: float,
    free: Sequence[FreeParameter],
) -> dict[str, float] | None:
    """Return the constants with which the study's mesh reproduces the contour of a finer one.

    Parameters
    ----------
    model : MeshForModels
        The study's own mesh.
    case : CorneaCase
    body : Section
    constants : mapping of str to float
        All constants of the best candidate, in internal names and units.
    middle_mm : float
        See `workers.organs.cornea.cornea_problem.middle_of`.
    free : sequence of FreeParameter
        The searched parameters; those fitted as logarithms are refitted.

    Returns
    -------
    dict of str to float or None
        None if a simulation does not converge.
    """
    finer = _on_finer_mesh(case, body, constants, middle_mm)
    if finer is None:
        return None
    observation = observe_surfaces(model.mesh, finer, imaged=False)
    logs = [p for p in free if logarithmic(p)]

    def candidate_at(values: Mapping[str, float]) -> Candidate:
        return candidate_of(model, case, values, middle_mm)

    equations = _equations(candidate_at, constants, logs, observation)
    box = Box(np.log([p["lower"] for p in logs]), np.log([p["upper"] for p in logs]))
    start = np.log([constants[p["name"]] for p in logs])
    end = descend(equations, start, box, REFIT_TOLERANCE, REFIT_EVALUATIONS)
    return None if end.here is None else _with_logarithms(constants, logs, end.at)


def _equations(
    candidate_at: CandidateOf,
    constants: Mapping[str, float],
    free: Sequence[FreeParameter],
    observation: SurfaceObservation,
) -> Callable[[FloatArray], NormalEquations | None]:
    """Return the normal equations of a contour as a function of logarithms; None if diverged."""

    def equations(logarithms: FloatArray) -> NormalEquations | None:
        values = _with_logarithms(constants, free, logarithms)
        residuals = fit_surfaces(candidate_at, values, free, observation).residuals
        return None if residuals is None else residuals.equations

    return equations


def _with_logarithms(
    constants: Mapping[str, float], free: Sequence[FreeParameter], logarithms: FloatArray
) -> dict[str, float]:
    names = [p["name"] for p in free]
    return {**constants, **dict(zip(names, np.exp(logarithms).tolist(), strict=True))}


def _on_finer_mesh(
    case: CorneaCase, body: Section, constants: Mapping[str, float], middle_mm: float
) -> Section | None:
    """Return the deformed section on a mesh of `MESH_TIMES` as many elements."""
    mesh = mesh_section(body, MESH_TIMES * case.mesh.elements, jet_nodes_x_mm(body, case))
    finer = candidate_of(MeshForModels(mesh), case, constants, middle_mm)
    solution = solve_prepared(finer.prepared, finer.constants, finer.load)
    if not solution.converged:
        return None
    return deformed_section(body, mesh, solution.displacement_mm)


# Standard deviation of a shift due to the mesh, relative to it. With a half, 90 % of the intervals
# of G0 and stress cover the truth; see tests/benchmarks/cornea_coverage.py.
SHIFT_KNOWN_TO = 0.5
# Stretches at which the stress is reported, as fractions of the way from rest to the largest one.
PARTS_OF_LARGEST = (0.25, 0.5, 0.75, 1.0)


def derived(
    numbers: Mapping[str, Any], constants: CorneaConstants, refitted: CorneaConstants | None = None
) -> list[dict[str, Any]]:
    """Return the values derived from the constants: G0, and stress at attained stretches.

    Parameters
    ----------
    numbers : mapping
        See `workers.organs.cornea.cornea_findings`.
    constants : CorneaConstants
    refitted : CorneaConstants, optional
        See `workers.organs.cornea.constant_doubts`.

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

    assumed, names = _assumed(numbers), [plain_name(n) for n in numbers["constants"]]
    quantities: list[dict[str, Any]] = [
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
        stretches = np.array([stretch])
        quantities.append(
            {
                "name": f"stress at a stretch of {stretch:.3f}",
                "value": 1000 * _stress_mpa(constants, stretches),
                "slope": _named(names, stress_slope(constants, stretch)),
                "mesh_shift": shift(partial(_stress_mpa, stretch=stretches)),
                "stretch": stretch,
            }
        )
    sds = _mesh_sds([quantity["mesh_shift"] for quantity in quantities])
    return [
        quantity | {"unit": "kPa", "mesh_sd": sd, "against": assumed}
        for quantity, sd in zip(quantities, sds, strict=True)
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
        found[plain_name(name)] = [*_assumed(numbers), *([clause] if loose else [])]
    return found


def _assumed(numbers: Mapping[str, Any]) -> list[str]:
    missing = [NOT_MEASURED[one] for one in numbers["not_measured"]]
    verb = "is" if len(missing) == 1 else "are"
    return [f"{' and '.join(missing)} {verb} assumed, not measured"] if missing else []

"""Doubts about the constants of a fitted eye: their profiles, the error of the mesh, and words.

The profile of a constant shows how far the other constants compensate for its error.

For the error due to the mesh, the eye is solved again with its constants on a mesh of `MESH_TIMES`
as many elements, and the constants are refitted to that contour on the study's own mesh. Their
change is the part of the study's constants that compensates for its mesh. The fit follows the
curved valley of the sum of squares, unlike a single Gauss step, which gives 22 % where 1.0 % is
correct (eye 3 of Table 5.2, 240 elements; the fit: 1.0 %).

`derived` and `against` decide which values may be quoted; `notes` says it in sentences.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

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
    FittedContour,
    fitted_contour,
    shear_modulus_slope,
    stepped,
    stress_slope,
    uniaxial_stress_mpa,
)
from palpate.workers.organs.cornea.prestressed_equilibrium import solve_prepared
from palpate.workers.organs.cornea.section_comparison import (
    SurfaceObservation,
    fit_surfaces,
    observe_surfaces,
)
from palpate.workers.organs.cornea.section_mesh import deformed_section, mesh_section
from palpate.workers.organs.cornea.section_outline import Section
from palpate.workers.organs.normal_equations import NormalEquations
from palpate.workers.organs.organ_protocol import logarithmic

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
    known = ", ".join(_plain(name) for name in bounds if name not in loose)
    return text + f"Only these constants are known to better than half their value: {known}."


def _several(numbers: Mapping[str, Any]) -> list[str]:
    several, repeated = (
        numbers["bounds_of_several_pressures"],
        numbers["bounds_of_one_pressure_repeated"],
    )
    if several is None:
        return []
    gains = ", ".join(f"{_plain(name)} {repeated[name] / several[name]:.1f}" for name in several)
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


def _plain(name: str) -> str:
    return name.removesuffix("_mpa")


# Gauss-Newton steps of the others at every value, each starting from the previous value.
PROFILE_STEPS = 3
# Directions that move the contour by less than this fraction of the strongest are not changed.
PROFILE_CUTOFF = 1e-5
LARGEST_PROFILE_STEP = 0.5


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
    fitted: FittedContour,
    name: str,
    logarithms: FloatArray,
    window_mm: tuple[float, float] | None = None,
) -> Profile:
    """Return the misfits with a constant held at given values and the others refitted.

    Parameters
    ----------
    candidate : Candidate
        The fitted candidate; its own contour is the data, so only the constants differ.
    fitted : FittedContour
        Contour of the candidate.
    name : str
        Name of the constant.
    logarithms : ndarray
        Logarithms of the factors, ascending; zero is the fit itself.
    window_mm : tuple of float, optional
        As for `fitted_contour`.
    """
    misfit = np.full(len(logarithms), np.nan)
    for side in (1, -1):
        state: _ProfilePoint | None = _ProfilePoint(dict.fromkeys(fitted.names, 0.0), fitted, 0.0)
        places = [i for i in np.argsort(np.abs(logarithms)) if side * logarithms[i] >= 0]
        for i in places:
            assert state is not None
            state = _next_profile_point(
                candidate, fitted, name, float(logarithms[i]), state, window_mm
            )
            if state is None:
                break
            misfit[i] = state.misfit_um
    return Profile(name, np.exp(logarithms), misfit)


class _ProfilePoint(NamedTuple):
    """Logarithms of the factors of all constants, the contour there, and its misfit."""

    at: dict[str, float]
    contour: FittedContour
    misfit_um: float


def _next_profile_point(
    candidate: Candidate,
    fitted: FittedContour,
    name: str,
    held: float,
    state: _ProfilePoint,
    window_mm: tuple[float, float] | None,
) -> _ProfilePoint | None:
    """Hold a constant at a new value and refit the others, starting from their last values."""
    weight = np.sqrt(fitted.length_mm / fitted.length_mm.sum())
    best: _ProfilePoint | None = None
    for _ in range(1 + PROFILE_STEPS):
        start = best or state
        gap = 1e3 * ((start.contour.position_mm - fitted.position_mm) * fitted.normal).sum(axis=1)
        free = [k for k, other in enumerate(fitted.names) if other != name]
        ahead = held - start.at[name]
        wanted = gap + ahead * start.contour.shift_um[:, fitted.names.index(name)]
        columns = weight[:, None] * start.contour.shift_um[:, free]
        step = np.linalg.lstsq(columns, -weight * wanted, rcond=PROFILE_CUTOFF)[0]
        step *= min(1.0, LARGEST_PROFILE_STEP / max(float(np.abs(step).max()), 1e-12))
        logarithms = start.at | {name: held}
        for k, ds in zip(free, step, strict=True):
            logarithms[fitted.names[k]] += float(ds)
        contour = fitted_contour(stepped(candidate, logarithms), window_mm)
        if contour is None:
            break
        off = 1e3 * ((contour.position_mm - fitted.position_mm) * fitted.normal).sum(axis=1)
        misfit = float(np.linalg.norm(weight * off))
        if best is not None and misfit >= best.misfit_um:
            break
        best = _ProfilePoint(logarithms, contour, misfit)
    return best


MESH_TIMES = 4
# The error falls with the square of the element size, so this fraction of it is observed.
PART_SEEN = 1 - 1 / MESH_TIMES
REFIT_EVALUATIONS = 10
LARGEST_REFIT_STEP = 0.7
FIRST_DAMPING, DAMPING_FACTOR = 1e-6, 10.0
# The fit stops when a step gains less than this fraction of the sum of squares.
LEAST_GAIN = 0.02


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
    logs = [p for p in free if logarithmic(p)]

    def candidate_at(values: Mapping[str, float]) -> Candidate:
        return candidate_of(model, case, values, middle_mm)

    def equations(values: Mapping[str, float]) -> NormalEquations | None:
        found = fit_surfaces(candidate_at, values, logs, observation).residuals
        return None if found is None else found.equations

    observation: SurfaceObservation = observe_surfaces(model.mesh, finer, imaged=False)
    estimate, here = dict(constants), equations(constants)
    if here is None:
        return None
    damping = FIRST_DAMPING
    for _ in range(REFIT_EVALUATIONS):
        ahead = _stepped_constants(estimate, logs, _refit_step(here, damping))
        there = equations(ahead)
        if there is None or there.cost >= here.cost:
            damping *= DAMPING_FACTOR
            continue
        gained, estimate, here = here.cost - there.cost, ahead, there
        damping /= DAMPING_FACTOR
        if gained < LEAST_GAIN * here.cost:
            break
    return estimate


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


def _refit_step(here: NormalEquations, damping: float) -> FloatArray:
    count = len(here.gradient)
    damped = here.hessian + damping * np.trace(here.hessian) / count * np.eye(count)
    step = -np.linalg.solve(damped, here.gradient)
    return np.asarray(step * min(1.0, LARGEST_REFIT_STEP / max(float(np.abs(step).max()), 1e-12)))


def _stepped_constants(
    at: Mapping[str, float], free: Sequence[FreeParameter], step: FloatArray
) -> dict[str, float]:
    moved = dict(at)
    for p, by in zip(free, step, strict=True):
        moved[p["name"]] = float(np.clip(at[p["name"]] * np.exp(by), p["lower"], p["upper"]))
    return moved


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

    assumed, names = _assumed(numbers), [n.removesuffix("_mpa") for n in numbers["constants"]]
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
        found[name.removesuffix("_mpa")] = [*_assumed(numbers), *([clause] if loose else [])]
    return found


def _assumed(numbers: Mapping[str, Any]) -> list[str]:
    missing = [NOT_MEASURED[one] for one in numbers["not_measured"]]
    verb = "is" if len(missing) == 1 else "are"
    return [f"{' and '.join(missing)} {verb} assumed, not measured"] if missing else []

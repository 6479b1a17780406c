"""The error of a fitted eye's constants due to the mesh.

The eye is solved again with its constants on a mesh of `TIMES` as many elements, and the constants
are refitted to that contour on the study's own mesh. Their change is the part of the study's
constants that compensates for its mesh. The fit follows the curved valley of the sum of squares,
unlike a single Gauss step, which gives 22 % where 1.0 % is correct (eye 3 of Table 5.2, 240
elements; the fit: 1.0 %).
"""

from collections.abc import Mapping, Sequence

import numpy as np

from palpate.storage.records.tasks import FreeParameter
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.comparison.surface_fit import (
    SurfaceObservation,
    fit_surfaces,
    observe_surfaces,
)
from palpate.workers.organs.cornea.mesh.deformed_section import deformed_section
from palpate.workers.organs.cornea.mesh.section_mesh import mesh_section
from palpate.workers.organs.cornea.problem import candidate_of, jet_nodes_x_mm
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.solver.candidate import Candidate
from palpate.workers.organs.cornea.solver.model_cache import MeshForModels
from palpate.workers.organs.cornea.solver.solve import solve_prepared
from palpate.workers.organs.cornea.spec import CorneaCase
from palpate.workers.organs.normal_equations import NormalEquations
from palpate.workers.organs.organ import logarithmic

TIMES = 4
# The error falls with the square of the element size, so this fraction of it is observed.
PART_SEEN = 1 - 1 / TIMES
EVALUATIONS = 10
LARGEST_STEP = 0.7
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
        See `workers.organs.cornea.problem.middle_of`.
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
    at, here = dict(constants), equations(constants)
    if here is None:
        return None
    damping = FIRST_DAMPING
    for _ in range(EVALUATIONS):
        ahead = _moved(at, logs, _step(here, damping))
        there = equations(ahead)
        if there is None or there.cost >= here.cost:
            damping *= DAMPING_FACTOR
            continue
        gained, at, here = here.cost - there.cost, ahead, there
        damping /= DAMPING_FACTOR
        if gained < LEAST_GAIN * here.cost:
            break
    return at


def _on_finer_mesh(
    case: CorneaCase, body: Section, constants: Mapping[str, float], middle_mm: float
) -> Section | None:
    """Return the deformed section on a mesh of `TIMES` as many elements."""
    mesh = mesh_section(body, TIMES * case.mesh.elements, jet_nodes_x_mm(body, case))
    finer = candidate_of(MeshForModels(mesh), case, constants, middle_mm)
    solution = solve_prepared(finer.prepared, finer.constants, finer.load)
    if not solution.converged:
        return None
    return deformed_section(body, mesh, solution.displacement_mm)


def _step(here: NormalEquations, damping: float) -> FloatArray:
    count = len(here.gradient)
    damped = here.hessian + damping * np.trace(here.hessian) / count * np.eye(count)
    step = -np.linalg.solve(damped, here.gradient)
    return np.asarray(step * min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), 1e-12)))


def _moved(
    at: Mapping[str, float], free: Sequence[FreeParameter], step: FloatArray
) -> dict[str, float]:
    moved = dict(at)
    for p, by in zip(free, step, strict=True):
        moved[p["name"]] = float(np.clip(at[p["name"]] * np.exp(by), p["lower"], p["upper"]))
    return moved

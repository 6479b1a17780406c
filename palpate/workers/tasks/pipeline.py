"""The stages of an evaluation: solve, deform, score.

This module uses neither the store nor the cluster; `workers.tasks.study_tasks` loads its inputs and
saves its results.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.storage.values import FitJson, FreeParameter
from palpate.workers.common_keys import CaseSpec
from palpate.workers.comparison.score_objective import GSF, Measure, Objective
from palpate.workers.organs.normal_equations import NormalEquations
from palpate.workers.organs.organ_protocol import (
    Organ,
    Residuals,
    Scorer,
    Scores,
    Solution,
    logarithmic,
)


@dataclass(frozen=True, eq=False)
class Setup:
    """Inputs shared by all candidates of a study.

    Parameters
    ----------
    organ : Organ
    case : CaseSpec
    body, mesh, model
        Mesh and model of the undeformed body; see `Organ`.
    landmarks
        Landmarks of the undeformed body.
    target
        The target body; None if nothing is compared.
    target_landmarks
        Landmarks of an imaged target; None for a simulated one.
    scorer : Scorer or None
        Compares deformed bodies with the target.
    observation
        Data of body and target needed for residuals; None if residuals are not requested.
    objective : Objective
        Ranks the candidates.
    measure : callable or None
        The objective's measure of a deformed body, in addition to the organ's own score.
    """

    organ: Organ[Any, Any, Any]
    case: CaseSpec
    body: Any
    mesh: Any
    model: Any
    landmarks: Any
    target: Any | None
    target_landmarks: Any | None
    scorer: Scorer[Any] | None
    observation: Any | None = None
    objective: Objective = GSF
    measure: Measure | None = None


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A simulated candidate.

    Parameters
    ----------
    solution : Solution
    deformed
        The deformed body; None if the simulation diverged.
    scores : dict or None
        ``jc``, ``mhd_mm``, ``mhd_voxels``, ``gsf`` and the objective; None if the simulation
        diverged or is not compared.
    fit : dict or None
        Its least-squares problem; None if the simulation diverged or the fit was not requested.
    """

    solution: Solution
    deformed: Any | None
    scores: Scores | None
    fit: FitJson | None = None


class Watch:
    """Stopwatch that adds up the seconds spent in each stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the enclosed block."""
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            self.seconds[name] = self.seconds.get(name, 0.0) + spent


def evaluate(
    setup: Setup, constants: Mapping[str, float], watch: Watch, free: Sequence[FreeParameter] = ()
) -> Evaluation:
    """Simulate one candidate and compare it with the target.

    Parameters
    ----------
    setup : Setup
    constants : mapping of str to float
        Values of all parameters, in internal names and units; see `CaseSpec.complete`.
    watch : Watch
        Receives the seconds of the stages ``solve``, ``deform`` and ``score``.
    free : sequence of FreeParameter
        Parameters with respect to which residuals are differentiated.
    """
    organ = setup.organ
    fit: FitJson | None = None
    with watch.stage("solve"):
        if free:
            fitted = organ.fit(
                setup.model,
                setup.case,
                constants,
                free,
                setup.landmarks,
                setup.target_landmarks,
                setup.observation,
            )
            solution = fitted.solution
            if fitted.residuals is not None:
                fit = _normal_equations(fitted.residuals, constants, free)
        else:
            problem = organ.problem(
                setup.model, setup.case, constants, setup.landmarks, setup.target_landmarks
            )
            solution = organ.solve(setup.model, problem)
    if not solution.outcome.converged:
        return Evaluation(solution, None, None)
    with watch.stage("deform"):
        deformed = organ.deform(setup.body, setup.mesh, solution.displacement_mm, setup.target)
    if setup.scorer is None:
        return Evaluation(solution, deformed, None, fit)
    with watch.stage("score"):
        own = None if setup.measure is None else setup.measure(deformed)
        scores = setup.objective.complete(setup.scorer.score(deformed).as_dict(), own)
    return Evaluation(solution, deformed, scores, fit)


def _normal_equations(
    residuals: Residuals, constants: Mapping[str, float], free: Sequence[FreeParameter]
) -> FitJson:
    values = [float(constants.get(p["name"], 0.0)) for p in free]
    equations = with_priors(residuals.equations, values, free)
    return {
        "parameters": [p["name"] for p in free],
        "logarithmic": [logarithmic(p) for p in free],
        "values": values,
        "residuals": equations.residuals,
        "rms_mm": float(np.sqrt(np.mean(residuals.mm**2))),
        "cost": equations.cost,
        "gradient": [float(v) for v in equations.gradient],
        "hessian": [[float(v) for v in row] for row in equations.hessian],
        "noise": residuals.noise,
    }


def with_priors(
    equations: NormalEquations, values: Sequence[float], free: Sequence[FreeParameter]
) -> NormalEquations:
    """Add a residual (value - mean) / sd for each prior, with its derivative.

    Parameters
    ----------
    equations : NormalEquations
    values : sequence of float, p
        Values of the free parameters, in internal units.
    free : sequence of FreeParameter, p
    """
    gradient, hessian = equations.gradient.copy(), equations.hessian.copy()
    cost, count = equations.cost, equations.residuals
    for i, (value, parameter) in enumerate(zip(values, free, strict=True)):
        if (prior := parameter.get("prior")) is None:
            continue
        mean, sd = prior
        residual, slope = (value - mean) / sd, (value if logarithmic(parameter) else 1.0) / sd
        cost, count = cost + residual**2, count + 1
        gradient[i] += residual * slope
        hessian[i, i] += slope**2
    return NormalEquations(cost, gradient, hessian, count)

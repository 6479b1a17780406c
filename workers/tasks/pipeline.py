"""The order of an evaluation: solve, deform, score. Values in, values out.

Nothing here knows a store or a cluster; `workers.tasks.evaluation` loads what goes in and
saves what comes out.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from workers.organs.organ import Organ, Scorer, Scores, Solution
from workers.spec import CaseSpec


@dataclass(frozen=True, eq=False)
class Setup:
    """What all candidates of a study share.

    Parameters
    ----------
    organ : Organ
    case : CaseSpec
    body, mesh, model
        Of the undeformed body; see `Organ`.
    landmarks
        Of the undeformed body.
    target
        The body to be explained; None where nothing is compared.
    target_landmarks
        Of an imaged target; None for a simulated one.
    scorer : Scorer or None
        Compares deformed bodies with the target.
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


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A candidate that was simulated.

    Parameters
    ----------
    solution : Solution
    deformed
        The deformed body; None if the simulation diverged.
    scores : dict or None
        ``jc``, ``mhd_mm``, ``mhd_voxels``, ``gsf``; None if it diverged or is not compared.
    """

    solution: Solution
    deformed: Any | None
    scores: Scores | None


class Watch:
    """Adds up the seconds that are spent in each stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what happens inside."""
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            self.seconds[name] = self.seconds.get(name, 0.0) + spent


def evaluate(setup: Setup, constants: Mapping[str, float], watch: Watch) -> Evaluation:
    """Simulate one candidate and compare it with the target.

    Parameters
    ----------
    setup : Setup
    constants : mapping of str to float
        Every parameter, inside names and units; see `CaseSpec.complete`.
    watch : Watch
        Is told the seconds of the stages ``solve``, ``deform`` and ``score``.
    """
    organ = setup.organ
    with watch.stage("solve"):
        problem = organ.problem(
            setup.model, setup.case, constants, setup.landmarks, setup.target_landmarks
        )
        solution = organ.solve(setup.model, problem)
    if not solution.outcome.converged:
        return Evaluation(solution, None, None)
    with watch.stage("deform"):
        deformed = organ.deform(setup.body, setup.mesh, solution.displacement_mm, setup.target)
    if setup.scorer is None:
        return Evaluation(solution, deformed, None)
    with watch.stage("score"):
        scores = setup.scorer.score(deformed).as_dict()
    return Evaluation(solution, deformed, scores)

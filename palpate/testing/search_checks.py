"""Checks of search strategies and of the scores that a search can optimise."""

from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import numpy as np

from palpate.service.search.least_squares_search import FittedNames
from palpate.service.search.search_interface import Generation, Proposal, Search
from palpate.service.search.search_keys import SearchRequest, SearchSpec, Strategy
from palpate.storage.values import FitJson, FloatArray, Volume
from palpate.testing.plugin_claims import check_pickles, claim, small_breast
from palpate.workers.comparison.score_objective import Objective

BOUNDS = {"E_kpa": (5.0, 80.0), "eta_kpa": (50.0, 200.0)}
# One internal unit is 1000 in files.
NAMES = FittedNames(("E", "eta"), (1000.0, 1000.0))
TRUTH = np.array([33.0, 120.0])
STRETCHES = np.linspace(0.1, 1.0, 12)
NOISE = 0.05


def check_search(strategy: Strategy, search: SearchSpec | None = None, seed: int = 5) -> None:
    """Check the contract of a search strategy on a spring with two unknown stiffnesses.

    It is a pure function of the previous generations: called again, or resumed from any of them,
    it proposes the same candidates, bit for bit, in whatever order scores arrive. Candidates are
    within their bounds; one that fails does not stop the search; the search ends within the number
    of evaluations that it declares, and improves on its first generation.

    Parameters
    ----------
    strategy : Strategy
    search : SearchSpec, optional
        Settings. Default: a population of 12 and 5 generations.
    seed : int

    Raises
    ------
    AssertionError
        Naming the first violated condition.
    """
    name = strategy.name
    settings = search or SearchSpec(parameters=BOUNDS, population=12, generations=5, elite=1)
    claim(set(settings.parameters) == set(BOUNDS), f"The spring has the parameters {list(BOUNDS)}.")
    asked = SearchRequest(settings, NAMES, 0, seed)
    check_pickles(strategy.make(asked), f"The search of {name}")
    history, proposals = _followed(strategy.make(asked), strategy, asked, fails=())
    _check_fold(strategy, asked, history, proposals)
    improved = min(g.scores.min() for g in history) < history[0].scores.min()
    closer = np.median(history[-1].scores) < np.median(history[0].scores)
    claim(improved or closer, f"{name} does not improve on its first generation.")
    _followed(strategy.make(asked), strategy, asked, fails=(1, 3))


def _check_fold(
    strategy: Strategy,
    asked: SearchRequest,
    history: Sequence[Generation],
    proposals: Sequence[Proposal],
) -> None:
    space = asked.search.space
    low, high = np.array(space.lower), np.array(space.upper)
    for k, proposal in enumerate(proposals):
        genes = proposal.genes
        inside = bool(((genes >= low) & (genes <= high)).all())
        claim(inside, f"{strategy.name} proposes candidates outside the bounds in generation {k}.")
        claim(
            proposal.derivatives <= strategy.by_derivatives,
            f"{strategy.name} asks for derivatives but does not set by_derivatives.",
        )
        again = strategy.make(asked).propose(history[:k])
        same = isinstance(again, Proposal) and np.array_equal(again.genes, genes)
        claim(same, f"{strategy.name} resumed before generation {k} proposes different candidates.")


def _followed(
    search: Search, strategy: Strategy, asked: SearchRequest, fails: Sequence[int]
) -> tuple[list[Generation], list[Proposal]]:
    """Run a search to its end; evaluations whose numbers are in `fails` get no score."""
    most = strategy.most_evaluations(asked)
    history: list[Generation] = []
    proposals: list[Proposal] = []
    count = 0
    while isinstance(proposal := search.propose(history), Proposal):
        claim(
            proposal.to_evaluate, f"{strategy.name} proposes no new candidates but does not stop."
        )
        scores, fits = {}, {}
        for i in proposal.to_evaluate:
            fit = None if count in fails else _fit(proposal.genes[i])
            scores[i] = np.inf if fit is None else float(np.log(fit["cost"] + 1e-12))
            fits[i] = fit if proposal.derivatives else None
            count += 1
        backwards = dict(reversed(scores.items()))
        history.append(proposal.complete(backwards, history, fits))
        proposals.append(proposal)
        claim(count <= most, f"{strategy.name} has evaluated more than {most} candidates.")
    claim(proposal.reason, f"{strategy.name} gives no reason for stopping.")
    return history, proposals


def _forces(genes: FloatArray) -> FloatArray:
    return np.asarray(genes[0] * STRETCHES + genes[1] * STRETCHES**3)


def _fit(genes: FloatArray) -> FitJson:
    residuals = (_forces(genes) - _forces(TRUTH)) / NOISE
    # By logarithms, in the order (eta, E), which a search must not confuse.
    jacobian = np.stack([genes[1] * STRETCHES**3, genes[0] * STRETCHES], axis=1) / NOISE
    return {
        "parameters": ["eta", "E"],
        "logarithmic": [True, True],
        "values": [float(genes[1]) / 1000, float(genes[0]) / 1000],
        "residuals": len(residuals),
        "rms_mm": 0.0,
        "cost": float(residuals @ residuals),
        "gradient": (jacobian.T @ residuals).tolist(),
        "hessian": (jacobian.T @ jacobian).tolist(),
        "noise": "",
    }


def check_score(
    objective: Objective, target: Any = None, candidates: Sequence[Any] | None = None
) -> None:
    """Check the contract of a score.

    It can be pickled; its name is an identifier and its direction known; a body that equals the
    target has the best score; a body moved farther away does not score better; the same bodies
    have the same score; and bodies are not changed.

    Parameters
    ----------
    objective : Objective
        Score with a `measure`.
    target : object, optional
        A body of the organ. Default: a small breast of labelled voxels.
    candidates : sequence, optional
        Bodies in order of decreasing similarity to the target.

    Raises
    ------
    AssertionError
        Naming the first violated condition.
    """
    check_pickles(objective, f"The score {objective.name}")
    claim(objective.name.isidentifier(), f"The name {objective.name!r} is not an identifier.")
    claim(objective.label, f"{objective.name} has no label.")
    claim(
        objective.direction in ("lower", "higher"),
        f"{objective.name}: the direction must be lower or higher, found {objective.direction!r}.",
    )
    if objective.measure is None:
        return
    body = small_breast() if target is None else target
    others = [_moved(body, k) for k in (1, 3, 6)] if candidates is None else list(candidates)
    before = deepcopy((body, others))
    measure = objective.measure(body)
    scores = [objective.minimised(float(measure(compared))) for compared in (body, *others)]
    again = [
        objective.minimised(float(objective.measure(body)(compared)))
        for compared in (body, *others)
    ]
    claim(scores == again, f"{objective.name} gives different values from one call to the next.")
    claim(_equal(before, (body, others)), f"{objective.name} changes the bodies that it compares.")
    claim(
        all(scores[0] <= compared for compared in scores[1:]) and scores[0] < scores[-1],
        f"{objective.name} does not score the target itself best: it minimises {scores[0]:g} "
        f"there, {', '.join(f'{s:g}' for s in scores[1:])} elsewhere. Is the direction right?",
    )
    claim(
        scores[1:] == sorted(scores[1:]),
        f"{objective.name} does not get worse with distance: {scores[1:]}.",
    )


def _moved(body: Volume, voxels: int) -> Volume:
    values = np.roll(body.values, voxels, axis=2)
    return Volume(values, body.spacing_mm, body.origin_mm)


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, Volume):
        return bool(np.array_equal(a.values, b.values))
    if isinstance(a, tuple | list):
        return all(_equal(p, q) for p, q in zip(a, b, strict=True))
    if isinstance(a, np.ndarray):
        return bool(np.array_equal(a, b))
    fields = getattr(a, "__dataclass_fields__", None)
    return all(_equal(getattr(a, f), getattr(b, f)) for f in fields) if fields else bool(a == b)

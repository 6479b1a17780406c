"""Checks of scores that a search can optimise."""

from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import numpy as np

from palpate.storage.values import Volume
from palpate.testing.bodies import small_breast
from palpate.testing.claims import check_pickles, claim
from palpate.workers.comparison.similarity.objective import Objective


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
    scores = [objective.minimised(float(measure(one))) for one in (body, *others)]
    again = [objective.minimised(float(objective.measure(body)(one))) for one in (body, *others)]
    claim(scores == again, f"{objective.name} gives different values from one call to the next.")
    claim(_equal(before, (body, others)), f"{objective.name} changes the bodies that it compares.")
    claim(
        all(scores[0] <= one for one in scores[1:]) and scores[0] < scores[-1],
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

"""Inequalities between searched parameters that every candidate satisfies."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.service.search.search_interface import (
    FloatArray,
    Generation,
    Proposal,
    Search,
    Space,
    Stopped,
)
from palpate.storage.errors import InputError

_FORM = re.compile(
    r"\s*(?P<left>[A-Za-z]\w*)\s*(?P<sign>>=?|<=?)\s*"
    r"(?:(?P<factor>\d+(?:\.\d*)?)\s*\*?\s*)?(?P<right>[A-Za-z]\w*)\s*"
)
# Cyclic projections onto a few half-spaces; two parallel ones need two.
MOST_ROUNDS = 200
# In units of the interval widths.
SLACK = 1e-12


@dataclass(frozen=True, slots=True)
class Constraint:
    """``larger >= factor * smaller``."""

    larger: str
    smaller: str
    factor: float = 1.0

    @classmethod
    def parse(cls, text: str) -> "Constraint":
        """Read an inequality such as ``E_glandular_kpa > 2 E_fat_kpa``.

        Raises
        ------
        InputError
            If the text has a different form.

        Examples
        --------
        >>> Constraint.parse("E_fat_kpa < E_glandular_kpa")
        Constraint(larger='E_glandular_kpa', smaller='E_fat_kpa', factor=1.0)
        """
        match = _FORM.fullmatch(text)
        if match is None:
            raise InputError(
                f"constraints: expected NAME > NAME or NAME > NUMBER * NAME, found {text!r}"
            )
        left, right, factor = match["left"], match["right"], float(match["factor"] or 1.0)
        if factor == 0 or left == right:
            raise InputError(f"constraints: {text!r} does not compare two parameters")
        if match["sign"].startswith(">"):
            return cls(left, right, factor)
        return cls(right, left, 1.0 / factor)


class Constraints:
    """Inequalities within a box.

    Parameters
    ----------
    space : Space
    constraints : sequence of Constraint

    Raises
    ------
    InputError
        If a name is not searched, or no point of the box satisfies all inequalities.
    """

    def __init__(self, space: Space, constraints: Sequence[Constraint]) -> None:
        self.space = space
        self._rows = [self._row(one) for one in constraints]
        middle = (np.asarray(space.lower) + np.asarray(space.upper)) / 2
        if not self.are_met(self.nearest(middle[None])).all():
            raise InputError("constraints: no candidate within the bounds satisfies all of them")

    def _row(self, one: Constraint) -> tuple[int, int, float]:
        for name in (one.larger, one.smaller):
            if name not in self.space.names:
                raise InputError(f"constraints: {name} is not searched")
        return self.space.names.index(one.larger), self.space.names.index(one.smaller), one.factor

    def are_met(self, genes: FloatArray) -> FloatArray:
        """Return a mask of the candidates (n, d) that satisfy all inequalities, shape (n,)."""
        slack = SLACK * float(self.space.span.max())
        met = [genes[:, a] - f * genes[:, b] >= -slack for a, b, f in self._rows]
        return np.logical_and.reduce(met)

    def nearest(self, genes: FloatArray) -> FloatArray:
        """Return candidates (n, d) projected onto the constraints, in units of the intervals.

        The inequalities and the bounds are enforced in turn; each moves violating candidates
        to its boundary by the shortest path. Feasible candidates are not changed.
        """
        candidates, span2 = np.array(genes, np.float64), self.space.span**2
        for _ in range(MOST_ROUNDS):
            if self.are_met(candidates).all():
                break
            for a, b, f in self._rows:
                lack = np.maximum(f * candidates[:, b] - candidates[:, a], 0.0)
                step = lack / (span2[a] + f**2 * span2[b])
                candidates[:, a] += step * span2[a]
                candidates[:, b] -= step * f * span2[b]
            candidates = np.clip(candidates, self.space.lower, self.space.upper)
        return candidates


class ConstrainedSearch:
    """A `Search` whose candidates are projected onto the constraints.

    Parameters
    ----------
    inner : Search
        Proposes candidates within the bounds only.
    constraints : Constraints
    """

    def __init__(self, inner: Search, constraints: Constraints) -> None:
        self.inner, self.constraints = inner, constraints

    def propose(self, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the population that follows `history`, or the reason to stop."""
        proposed = self.inner.propose(history)
        if isinstance(proposed, Stopped):
            return proposed
        return replace(proposed, genes=self.constraints.nearest(proposed.genes))

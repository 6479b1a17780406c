"""What a study can hold fixed or search, and an ask-and-tell interface to the strategies."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from palpate.service.search.least_squares_search import FittedNames
from palpate.service.search.search_interface import Generation, Proposal, Stopped
from palpate.service.search.search_keys import SearchRequest, SearchSpec, strategy_named
from palpate.storage.errors import InputError
from palpate.workers.common_keys import validated
from palpate.workers.mechanics.model_parameters import Parameter
from palpate.workers.organs.organ_plugins import DEFAULT, organ_spec


def parameters(organ: str = DEFAULT) -> dict[str, Parameter]:
    """Return the parameters of an organ's model by their names in a study, units included.

    Parameters
    ----------
    organ : str
        Name of the organ, such as ``"breast"``.

    Raises
    ------
    InputError
        If the organ is unknown.
    """
    return {parameter.door_name: parameter for parameter in organ_spec(organ).parameters}


class Search:
    """A search strategy for any function of some parameters.

    Candidates depend only on the settings, the seed and the scores.

    Parameters
    ----------
    parameters : mapping of str to (float, float)
        Bounds by name.
    strategy : str
        ``"genetic"``, ``"cma"`` or a plug-in's strategy that needs no derivatives.
    seed : int
        0 <= seed < 2**32.
    **settings
        Further keys under ``search`` of a study file, such as ``population``.

    Raises
    ------
    InputError
        If a key or a value is not valid, or the strategy needs derivatives.

    Examples
    --------
    >>> search = Search({"x": (0, 4), "y": (0, 4)}, population=20, generations=40)
    >>> while candidates := search.ask():
    ...     search.tell([(c["x"] - 1) ** 2 + (c["y"] - 3) ** 2 for c in candidates])
    >>> round(search.best["x"], 1), round(search.best["y"], 1)
    (1.0, 3.0)
    """

    def __init__(
        self,
        parameters: Mapping[str, Sequence[float]],
        strategy: str = "genetic",
        seed: int = 1,
        **settings: Any,
    ) -> None:
        given = {"parameters": dict(parameters), "strategy": strategy, **settings}
        self._spec = validated(SearchSpec, given, "The search")
        if self._spec.by_derivatives or self._spec.steady:
            raise InputError(
                "A search from scores alone supports neither derivatives nor mode: barrier. Use "
                "strategy genetic or cma, or a palpate.Study."
            )
        names = FittedNames(self._spec.space.names, (1.0,) * self._spec.space.dimension)
        asked = SearchRequest(self._spec, names, 0, seed)
        self._search = strategy_named(strategy).make(asked)
        self._history: list[Generation] = []
        self._proposed = self._search.propose(self._history)

    def ask(self) -> list[dict[str, float]]:
        """Return the next candidates by name; an empty list once the search has ended.

        The candidates stay the same until `tell` is called.
        """
        if isinstance(self._proposed, Stopped):
            return []
        space, genes = self._spec.space, self._proposed.genes
        return [space.as_dict(genes[i]) for i in self._proposed.to_evaluate]

    def tell(self, scores: Sequence[float]) -> None:
        """Set the scores of all candidates from the last `ask`, in the same order.

        Parameters
        ----------
        scores : sequence of float
            Lower is better; ``inf`` or ``nan`` for a candidate that failed.

        Raises
        ------
        InputError
            If there are more or fewer scores than candidates.
        """
        wanted = self._proposed.to_evaluate if isinstance(self._proposed, Proposal) else ()
        if len(scores) != len(wanted) or isinstance(self._proposed, Stopped):
            raise InputError(f"Expected {len(wanted)} scores, found {len(scores)}.")
        told = {i: _ranked(score) for i, score in zip(wanted, scores, strict=True)}
        self._history.append(self._proposed.complete(told, self._history))
        self._proposed = self._search.propose(self._history)

    @property
    def stopped(self) -> str:
        """The reason why the search ended; empty while it continues."""
        return self._proposed.reason if isinstance(self._proposed, Stopped) else ""

    @property
    def best(self) -> dict[str, float]:
        """The candidate with the lowest score so far, by name; empty before the first score."""
        if not self._history:
            return {}
        found = min(self._history, key=lambda generation: float(generation.scores.min()))
        return self._spec.space.as_dict(found.genes[found.best])

    @property
    def best_score(self) -> float:
        """The lowest score so far; ``inf`` before the first."""
        return min((float(g.scores.min()) for g in self._history), default=math.inf)


def _ranked(score: float) -> float:
    return math.inf if math.isnan(score) else float(score)

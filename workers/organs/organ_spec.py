"""What a study may state of an organ; it is read without the organ's solver."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from palpate.workers.mechanics.parameters import Vocabulary
from palpate.workers.organs.nuisances import Nuisance
from palpate.workers.spec import CaseSpec, ScoreSpec, TargetSpec


@dataclass(frozen=True, slots=True)
class OrganSpec:
    """The keys of an organ's studies, and the parameters behind them.

    Parameters
    ----------
    case, target, score : type
        What may be stated under ``case``, ``target`` and ``score``.
    parameters : Vocabulary
        All that a study may hold or search, effects of the model included.
    nuisances : callable, optional
        From a case, and whether its target is an image, to the parameters that intervals allow for
        in addition to those searched. The place, scale and force of a simulated target are exact.
        Default None: the organ has no derivatives, so its constants are not fitted by them.
    """

    case: type[CaseSpec]
    target: type[TargetSpec]
    score: type[ScoreSpec]
    parameters: Vocabulary
    nuisances: Callable[[Any, bool], Sequence[Nuisance]] | None = None


def no_derivatives(organ: str) -> str:
    """Return the sentence for an organ whose constants cannot be fitted by derivatives."""
    return f"the organ {organ} has no derivatives; use the strategy genetic or cma"

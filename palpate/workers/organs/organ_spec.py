"""Specification of an organ's study files, read without the organ's solver."""

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
        Models of the keys under ``case``, ``target`` and ``score``.
    parameters : Vocabulary
        All parameters that a study may hold or search, including effects of the model.
    nuisances : callable, optional
        Returns the unsearched parameters that intervals allow for, given a case and whether its
        target is an image. The place, scale and force of a simulated target are exact. Default
        None: the organ has no derivatives, so its constants are not fitted by them.
    """

    case: type[CaseSpec]
    target: type[TargetSpec]
    score: type[ScoreSpec]
    parameters: Vocabulary
    nuisances: Callable[[Any, bool], Sequence[Nuisance]] | None = None


def no_derivatives(organ: str) -> str:
    """Return the sentence for an organ whose constants cannot be fitted by derivatives."""
    return f"the organ {organ} has no derivatives; use the strategy genetic or cma"

"""Nuisance parameters: what a study does not search and an interval has to allow for."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from palpate.storage.records.tasks import FreeParameter
from palpate.workers.mechanics.parameters import Bounds

if TYPE_CHECKING:
    from palpate.workers.mechanics.effects.base import Effect


@dataclass(frozen=True, slots=True)
class Nuisance:
    """One nuisance parameter.

    Parameters
    ----------
    name : str
        As in the vocabulary of the organ, or of an effect on the observation.
    group : str
        What it belongs to, as a noun phrase: ``the place of the scan``.
    sd : float
        Standard deviation before data, inside units.
    lower, upper : float
        Interval by which its step is measured when residuals are differentiated.
    always : bool
        Whether it counts even where the model leaves no more than the noise: the residual cannot
        show it, as with an error of the force.
    """

    name: str
    group: str
    sd: float
    lower: float
    upper: float
    always: bool = False

    @property
    def free(self) -> FreeParameter:
        """Return the parameter as a request for derivatives names it."""
        return {"name": self.name, "lower": self.lower, "upper": self.upper}


@dataclass(frozen=True, slots=True)
class NuisanceEffect:
    """An effect whose parameters are nuisance parameters of every study that it concerns.

    Parameters
    ----------
    effect : Effect
    group : str
        See `Nuisance.group`.
    sd : float, optional
        Of each parameter, inside units; those of the effect unless stated.
    interval : (float, float), optional
        See `Nuisance.lower`; those of the parameters unless stated.
    of : {"model", "image", "force"}
        What is uncertain: the model of any target, the image of a target that was scanned, or
        the force that was measured with it.
    always : bool
        See `Nuisance.always`.
    """

    effect: "Effect"
    group: str
    sd: float | None = None
    interval: Bounds | None = None
    of: Literal["model", "image", "force"] = "model"
    always: bool = False

    @property
    def parameters(self) -> Iterator[Nuisance]:
        """The nuisance parameters, one for each parameter of the effect."""
        for p, sd in zip(self.effect.parameters, self.effect.prior_sd, strict=True):
            lower, upper = self.interval or (p.lower, p.upper)
            yield Nuisance(p.name, self.group, self.sd or sd, lower, upper, self.always)

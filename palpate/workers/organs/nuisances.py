"""Nuisance parameters: uncertain but not searched, and allowed for in intervals."""

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
        Its subject, as a noun phrase: ``the place of the scan``.
    sd : float
        Prior standard deviation, in internal units.
    lower, upper : float
        Interval that scales its step when residuals are differentiated.
    always : bool
        Whether it counts even if the residual is at the noise level, which cannot show it, as with
        an error of the force.
    """

    name: str
    group: str
    sd: float
    lower: float
    upper: float
    always: bool = False

    @property
    def free(self) -> FreeParameter:
        """Return the parameter in the form used to request derivatives."""
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
        Of each parameter, in internal units; default: the effect's.
    interval : (float, float), optional
        See `Nuisance.lower`; default: the parameters' own.
    of : {"model", "image", "force"}
        The uncertain quantity: the model of any target, the image of a scanned target, or the
        force measured with it.
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

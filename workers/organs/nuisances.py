"""Nuisance parameters: what a study does not search and an interval has to allow for."""

from dataclasses import dataclass

from palpate.storage.records.tasks import FreeParameter


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

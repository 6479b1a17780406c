"""Correlation of model errors between two states of a body.

Plates that press in another direction touch and bend other parts of the body, where a mesh error or
a missing cause produces a different displacement.
"""

from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray


@dataclass(frozen=True, slots=True)
class StateCorrelation:
    """Correlation of a displacement between two states.

    Parameters
    ----------
    along : float
        Correlation for two loads in the same direction, 0 to 1.
    across : float
        Correlation for two loads at right angles; no larger than `along`.

    Raises
    ------
    InputError
        If a number is out of range.
    """

    along: float
    across: float

    def __post_init__(self) -> None:
        if not 0 <= self.across <= self.along <= 1:
            raise InputError(
                "A correlation between states needs 0 <= across <= along <= 1, found "
                f"along = {self.along}, across = {self.across}."
            )

    def between(self, directions: FloatArray) -> FloatArray:
        """Return the correlations of all pairs of states, shape (s, s), with ones on the diagonal.

        Between parallel and perpendicular directions, it varies with the squared cosine, which
        keeps the matrix positive semi-definite.

        Parameters
        ----------
        directions : ndarray, shape (s, 3)
            Unit vectors of the load direction of each state.
        """
        squares = (directions @ directions.T) ** 2
        found = self.across + (self.along - self.across) * squares
        np.fill_diagonal(found, 1.0)
        return np.asarray(found)

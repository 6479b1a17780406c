r"""The posterior of the searched constants; the reported intervals are its central 90 %.

In the coordinates of `service.results.local_model` the errors of all sources are normal, with the
covariance :math:`\Sigma`. The interval of coordinate i is :math:`l_i` to :math:`u_i`, which is
wider than :math:`\pm 1.64 \sqrt{\Sigma_{ii}}` if the search is unfinished. The posterior keeps
the correlations and takes its centre and width from the interval:

.. math:: x \sim N(m, D \Sigma D), \qquad m_i = \frac{l_i + u_i}{2}, \qquad
          D_{ii} = \frac{u_i - l_i}{2 \cdot 1.64 \sqrt{\Sigma_{ii}}}.

Draws beyond the admissible values of a constant are clipped, as the intervals are.
"""

from collections.abc import Sequence

import numpy as np

from palpate.service.results.local_model import DEVIATIONS, LocalModel, SearchedConstants
from palpate.service.search.space import FloatArray


class Posterior:
    """The joint distribution of the searched constants.

    Parameters
    ----------
    local : LocalModel
        The least-squares problem at the best candidate.
    searched : SearchedConstants
    """

    def __init__(self, local: LocalModel, searched: SearchedConstants) -> None:
        self.local, self.searched = local, searched
        ends = np.array([local.coordinate_ends(i) for i in range(len(local.names))])
        root = local.error_root
        sd = np.linalg.norm(root, axis=1)
        half = np.ptp(ends, axis=1) / 2
        self.middle = ends.mean(axis=1)
        self.root = root * (half / (DEVIATIONS * np.where(sd > 0, sd, 1.0)))[:, None]

    def draw(self, names: Sequence[str], count: int, seed: int) -> list[FloatArray]:
        """Draw from the joint posterior of all constants.

        Parameters
        ----------
        names : sequence of str
            Internal names of the constants to return; all constants are drawn, so the draws
            of a constant do not depend on this choice.
        count : int
            Number of draws, > 0.
        seed : int

        Returns
        -------
        list of ndarray, shape (count,)
            For each name, in its external unit.
        """
        normal = np.random.default_rng(seed).standard_normal((count, self.root.shape[1]))
        coordinates = self.middle + normal @ self.root.T
        return [self._at_door(name, coordinates) for name in names]

    def _at_door(self, name: str, coordinates: FloatArray) -> FloatArray:
        i, parameter = self.local.names.index(name), self.searched.parameter(name)
        inside = np.clip(self.local.moved(i, coordinates[:, i]), *parameter.admissible)
        return np.asarray(inside * parameter.unit.to_door(1.0))

r"""Estimates at the physical limit of a constant, such as fibres of stiffness 0.

A search that ends at such a limit has found an answer: less is impossible, and the images need
none of it. The limit is part of the model, so the optimum and the errors keep to it:

.. math:: \delta = \arg\min_{\delta_A \ge l_A} |r + J\delta|^2, \qquad
          B = \Sigma_{iA} \Sigma_{AA}^{-1}, \qquad
          v_i = \Sigma_{ii} - B \Sigma_{AA} B'.

The constants A at their limits can err to one side. They move the end of another constant's
interval to the side of :math:`B_j` only, by :math:`1.64 |B_j| \sqrt{\Sigma_{jj}}`, which is added
to that of :math:`v_i` in squares. The interval then covers 88 to 92 %.
"""

import numpy as np

from palpate.service.number_formatting import at_edge
from palpate.service.search.search_interface import FloatArray

Bounds = tuple[float, float]
# Quantile of the normal distribution: 90 % are within this many standard deviations.
DEVIATIONS = 1.6449
# A direction with less than this fraction of the largest information is not identified.
UNSEEN = 1e-10


def at_limit(value: float, searched: Bounds, limit: float | None) -> bool:
    """Check whether a value rests at a physical limit from which it was searched.

    Examples
    --------
    >>> at_limit(0.1, (0.0, 100.0), 0.0), at_limit(5.0, (5.0, 20.0), 0.0)
    (True, False)
    """
    low, high = searched
    from_limit = limit is not None and low <= limit
    return from_limit and at_edge(value, searched) and low <= value < (low + high) / 2


def at_bound(value: float, searched: Bounds, limit: float | None) -> bool:
    """Check whether a value is at a bound of the search beyond which it could be."""
    return at_edge(value, searched) and not at_limit(value, searched, limit)


def limited_step(
    information: FloatArray, gradient: FloatArray, lowest: FloatArray
) -> tuple[FloatArray, float]:
    """Return the Gauss step above the limits, and its reduction of the sum of squares.

    Parameters
    ----------
    information : ndarray, shape (p, p)
        J'J.
    gradient : ndarray, shape (p,)
        J'r.
    lowest : ndarray, shape (p,)
        Least step of each coordinate, at most 0; -inf without a limit.

    Examples
    --------
    >>> step, fall = limited_step(np.eye(2), np.array([1.0, -2.0]), np.array([0.0, -np.inf]))
    >>> step.round(9).tolist(), round(fall, 9)
    ([0.0, 2.0], 4.0)
    """
    from scipy.optimize import lsq_linear  # slow to load, and few studies end at a limit

    values, vectors = np.linalg.eigh(information)
    seen = values > UNSEEN * max(float(values[-1]), 1e-300)
    size = np.sqrt(values[seen])
    root, goal = (vectors[:, seen] * size).T, -(vectors[:, seen].T @ gradient) / size
    step = lsq_linear(root, goal, (lowest, np.inf), method="bvls").x
    return step, float(goal @ goal - np.sum((root @ step - goal) ** 2))


def limited_reach(
    slope: FloatArray, variance: float, covariance: FloatArray, lowest: FloatArray
) -> tuple[float, float]:
    """Return the distances from a value to the lower and the upper end of its interval.

    Parameters
    ----------
    slope : ndarray, shape (p,)
        Derivatives of the value by the coordinates.
    variance : float
        Of the value, without limits.
    covariance : ndarray, shape (p, p)
        Of the coordinates, without limits.
    lowest : ndarray, shape (p,)
        Least step of each coordinate, at most 0; -inf without a limit.

    Examples
    --------
    >>> shared = np.array([[1.0, -0.8], [-0.8, 1.0]])
    >>> down, up = limited_reach(np.array([1.0, 0.0]), 1.0, shared, np.array([-np.inf, 0.0]))
    >>> round(down, 3), round(up, 3)
    (1.645, 0.987)
    """
    limited = np.isfinite(lowest)
    part = covariance[np.ix_(limited, limited)]
    response = slope @ covariance[:, limited] @ np.linalg.pinv(part, hermitian=True)
    rest = DEVIATIONS**2 * max(0.0, variance - float(response @ part @ response))
    upwards = DEVIATIONS * np.sqrt(np.diag(part))
    downwards = np.minimum(upwards, -lowest[limited])
    falls = np.where(response < 0, -response * upwards, response * downwards)
    rises = np.where(response < 0, -response * downwards, response * upwards)
    return float(np.sqrt(rest + falls @ falls)), float(np.sqrt(rest + rises @ rises))

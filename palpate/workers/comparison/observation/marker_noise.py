r"""Noise in the displacements of markers, estimated from repeats.

Component c of the displacement of marker i in repeat r scatters as

.. math:: d_{rci} = \mu_{ci} + a_{rc} + e_{rci}, \qquad a \sim N(0, \sigma_a^2),
          \quad e \sim N(0, \sigma_e^2):

an error common to all markers of a recording, and an error of each marker. An analysis of variance
of the repeats estimates both, but not an error that all repeats share.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray


@dataclass(frozen=True, slots=True)
class Scatter:
    """Standard deviations of one recording: of each marker's own error, and of the common error."""

    own_mm: float
    common_mm: float


def scatter_of(repeats: FloatArray) -> Scatter:
    """Estimate the standard deviations from repeats, shape (r, k, axes), r >= 2.

    Raises
    ------
    InputError
        If there is only one recording.
    """
    r, k, axes = repeats.shape
    if r < 2:
        raise InputError("Estimating the scatter needs at least two repeats of a state, found one.")
    away = repeats - repeats.mean(axis=0)
    shared = away.mean(axis=1, keepdims=True)
    common = float((shared**2).sum() / (axes * (r - 1)))
    if k < 2:
        return Scatter(float(np.sqrt(common)), 0.0)
    own = float(((away - shared) ** 2).sum() / (axes * (r - 1) * (k - 1)))
    return Scatter(float(np.sqrt(own)), float(np.sqrt(max(0.0, common - own / k))))


def component_covariance(
    scatters: Sequence[Scatter], points: int, repeats: Sequence[int], floor: Scatter
) -> FloatArray:
    """Return the covariance of the components of all states, shape (3 s k, 3 s k).

    Row ``3 (s k + i) + c`` is component c of point i in state s. Errors of single recordings
    average out over the repeats. Errors that all repeats share, such as a tilted base or a body
    that was not at rest, do not: they are assumed to be as large as the errors between repeats, and
    at least `floor`.

    Parameters
    ----------
    scatters : sequence of Scatter
        Scatter of one recording of each state.
    points : int
    repeats : sequence of int
        Number of repeats of each state.
    floor : Scatter
    """
    size = 3 * points
    whole = np.zeros((len(scatters) * size, len(scatters) * size))
    same_axis = np.kron(np.ones((points, points)), np.eye(3))
    for s, (scatter, r) in enumerate(zip(scatters, repeats, strict=True)):
        own = max(scatter.own_mm**2 / r, floor.own_mm**2)
        common = max(scatter.common_mm**2, floor.common_mm**2)
        rows = slice(s * size, (s + 1) * size)
        whole[rows, rows] = own * np.eye(size) + common * same_axis
    return whole

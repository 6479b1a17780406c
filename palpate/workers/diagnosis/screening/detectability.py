"""Detectability of effects, computed without the residuals.

Columns are whitened and per prior standard deviation, so that parameters with different units can
be added up.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import svd, svdvals
from scipy.special import ndtri

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.algebra.effect_sensitivity import EffectSensitivity
from palpate.workers.diagnosis.algebra.linearisation import Linearised
from palpate.workers.diagnosis.settings.values import SETTINGS

NONCENTRALITY = float(
    (ndtri(1 - SETTINGS.detectability.significance / 2) + ndtri(SETTINGS.detectability.power)) ** 2
)
"""11.7: a two-sided test at the 1 % level detects an effect of this strength with 80 % power."""


INVISIBLE = 1e-6  # share of an effect below which the projected part is only rounding error


def absorbed_share(problem: Linearised, whitened: FloatArray) -> float:
    """Return ``1 - |P B|^2 / |B|^2``, the share of an effect that nominal parameters absorb.

    Parameters
    ----------
    problem : Linearised
    whitened : ndarray, shape (m, q)
        See `EffectSensitivity.whitened`.

    Returns
    -------
    float
        Share from 0 to 1; also 1 for an effect without influence.
    """
    total = float((whitened**2).sum())
    return 1.0 - float((problem.project(whitened) ** 2).sum()) / total if total > 0 else 1.0


def hides(problem: Linearised, whitened: FloatArray) -> bool:
    """Return True if the nominal parameters absorb an effect, or leave too little of it to detect.

    Too little means that, on average over the parameters, the test of `NONCENTRALITY` would miss an
    effect of one prior standard deviation.

    Parameters
    ----------
    problem : Linearised
    whitened : ndarray, shape (m, q)
        See `EffectSensitivity.whitened`.
    """
    share = absorbed_share(problem, whitened)
    left = float((problem.project(whitened) ** 2).sum()) / whitened.shape[1]
    return share > SETTINGS.detectability.sunk_share or (
        share > SETTINGS.detectability.hidden_share and left < NONCENTRALITY
    )


def minimum_detectable(problem: Linearised, sensitivity: EffectSensitivity) -> FloatArray:
    """Return the magnitude of each parameter alone detected with 80 % power at 1 % false alarms.

    ``sqrt(11.7 / B'PB)``, in the units of the parameters.

    Returns
    -------
    ndarray, shape (q,)
        Medians over the places; inf for an invisible parameter.
    """
    information = np.array(
        [(B * problem.project(B)).sum(axis=0) for B in sensitivity.whitened(problem)]
    )
    with np.errstate(divide="ignore"):
        scaled = np.sqrt(NONCENTRALITY / np.maximum(information, 0.0))
    return np.median(scaled, axis=0) * sensitivity.prior_sd


def confusion(problem: Linearised, sensitivities: Sequence[EffectSensitivity]) -> FloatArray:
    """Return the largest similarity between the visible parts of each pair of effects.

    It is the largest canonical correlation of the projected columns, the cosine of the smallest
    principal angle (A. Bjorck and G. H. Golub, Math. Comput. 27 (1973) 579); for effects with
    places, the maximum over the places.

    Returns
    -------
    ndarray, shape (effects, effects)
        Similarities from 0 to 1, symmetric, with ones on the diagonal.
    """
    bases = [
        [_basis(problem, B) for B in sensitivity.whitened(problem)] for sensitivity in sensitivities
    ]
    cosines = np.eye(len(bases))
    for i, first in enumerate(bases):
        for j, second in enumerate(bases[:i]):
            cosines[i, j] = cosines[j, i] = max(_cosine(p, q) for p in first for q in second)
    return cosines


def _basis(problem: Linearised, whitened: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the visible part of an effect, shape (m, rank)."""
    u, s, _ = svd(problem.project(whitened), full_matrices=False)
    return np.asarray(u[:, s > INVISIBLE * np.linalg.norm(whitened)])


def _cosine(p: FloatArray, q: FloatArray) -> float:
    if p.shape[1] == 0 or q.shape[1] == 0:
        return 0.0
    return min(1.0, float(svdvals(p.T @ q)[0]))

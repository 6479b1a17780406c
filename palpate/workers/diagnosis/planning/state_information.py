r"""Detectability of effects in a set of states, and the separation of pairs of effects.

No residuals are used.

Two effects are separated by their evidence. If k acts at its prior scale, it beats j on average by
the Kullback-Leibler divergence between their predictions

.. math:: \tfrac12 [ \mathrm{tr}(\Sigma_j^{-1} \Sigma_k) - m + \ln|\Sigma_j| - \ln|\Sigma_k| ],
          \qquad \Sigma_k = P^{-1} + B_k S_k B_k',

in nats (the discrimination criterion of G. E. P. Box and W. J. Hill, Technometrics 9
(1967) 57). Bounds of one-sided parameters are ignored.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.algebra.effect_sensitivity import EffectSensitivity
from palpate.workers.diagnosis.algebra.linearisation import Linearised
from palpate.workers.diagnosis.screening.detectability import (
    absorbed_share,
    confusion,
    minimum_detectable,
)


@dataclass(frozen=True, slots=True, eq=False)
class Detectability:
    """Detectability of one effect.

    Parameters
    ----------
    name : str
    minimum : ndarray, shape (q,)
        Smallest magnitude of each parameter that is detected with 80 % power at 1 % false alarms.
    absorbed : float
        Share of the effect that the nominal parameters absorb; median over the places.
    nearest : str or None
        The effect with the most similar visible part.
    cosine : float
        Similarity to that effect, 0 to 1.
    """

    name: str
    minimum: FloatArray
    absorbed: float
    nearest: str | None
    cosine: float


def detectability(
    problem: Linearised, sensitivities: Sequence[EffectSensitivity]
) -> tuple[Detectability, ...]:
    """Return a row for each effect, in the order given."""
    cosines = confusion(problem, sensitivities) - np.eye(len(sensitivities))
    rows = []
    for sensitivity, cosine in zip(sensitivities, cosines, strict=True):
        shares = [absorbed_share(problem, B) for B in sensitivity.whitened(problem)]
        near = int(cosine.argmax())
        rows.append(
            Detectability(
                sensitivity.name,
                minimum_detectable(problem, sensitivity),
                float(np.median(shares)),
                sensitivities[near].name if cosine[near] > 0 else None,
                float(cosine[near]),
            )
        )
    return tuple(rows)


def separation(problem: Linearised, sensitivities: Sequence[EffectSensitivity]) -> FloatArray:
    """Return the expected log Bayes factor of an acting effect against each other effect.

    Returns
    -------
    ndarray, shape (effects, effects)
        Entry ``[k, j]`` is for k acting, in nats; median over the places of k, against the best
        place of j.
    """
    columns = [sensitivity.whitened(problem) for sensitivity in sensitivities]
    projected = [np.array([problem.project(B) for B in places]) for places in columns]
    found = np.zeros((len(columns), len(columns)))
    for k, acting in enumerate(columns):
        for j, other in enumerate(columns):
            if k != j:
                table = [
                    [
                        _divergence(b.T @ Pb, b.T @ Pc, c.T @ Pc)
                        for c, Pc in zip(other, projected[j], strict=True)
                    ]
                    for b, Pb in zip(acting, projected[k], strict=True)
                ]
                found[k, j] = np.median(np.min(table, axis=1))
    return found


def _divergence(kk: FloatArray, kj: FloatArray, jj: FloatArray) -> float:
    """Return the divergence, from inner products of effect k and its rival j in the metric P."""
    own, rival = np.eye(len(kk)) + kk, np.eye(len(jj)) + jj
    trace = np.trace(kk) - np.trace(kj @ np.linalg.solve(rival, kj.T))
    trace -= np.trace(np.linalg.solve(rival, jj))
    logs = np.linalg.slogdet(rival)[1] - np.linalg.slogdet(own)[1]
    return float(0.5 * (trace + logs))

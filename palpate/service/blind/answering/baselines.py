"""Simple rules for naming a cause, as baselines for the diagnosis.

1. The largest raw correlation: the effect with the fingerprint most nearly parallel to the
   residuals of the nominal model, at any place; nothing is whitened, and directions that the
   constants could hide are not projected out.
2. One refit at a time: the single effect that leaves the smallest distance between model and
   image when fitted together with the constants, regardless of its number of parameters.
3. Chance: any effect from the catalogue.

The first two always name an effect. For a fair comparison they are also scored with a threshold
below which they name no effect, chosen to raise as many false alarms as the diagnosis on bodies
without a missing effect.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from palpate.storage.values import FloatArray


def raw_correlation(columns: FloatArray, residual: FloatArray) -> float:
    """Return the largest cosine between the residuals and any column of a fingerprint.

    Parameters
    ----------
    columns : ndarray, shape (m, q) or (g, m, q)
        Derivatives of the residuals, in mm per unit; a stack for an effect with g places.
    residual : ndarray, shape (m,)
        In mm.

    Returns
    -------
    float
        From 0 to 1; 0 if the residual or all columns vanish.
    """
    length = np.linalg.norm(columns, axis=-2) * np.linalg.norm(residual)
    along = np.abs(np.einsum("...mq,m->...q", columns, residual))
    return float(np.max(along[length > 0] / length[length > 0], initial=0.0))


def largest(correlations: Mapping[str, float]) -> str | None:
    """Return the effect named by the first baseline; None without fingerprints."""
    return max(correlations, key=lambda name: correlations[name]) if correlations else None


def closest(left_mm: Mapping[str, float]) -> str | None:
    """Return the effect named by the second baseline; None without refits.

    Parameters
    ----------
    left_mm : mapping of str to float
        Root mean square residual of each single refit.
    """
    return min(left_mm, key=lambda name: left_mm[name]) if left_mm else None


def improvement(left_mm: Mapping[str, float], before_mm: float) -> float:
    """Return the second baseline's evidence: the log of the reduction by its best refit.

    Parameters
    ----------
    left_mm : mapping of str to float
        As in `closest`.
    before_mm : float
        Root mean square residual of the nominal model.
    """
    least = min(left_mm.values(), default=before_mm)
    return float(np.log(before_mm / least)) if least > 0 and before_mm > 0 else 0.0


def threshold(silent: Sequence[float], alarms: int) -> float:
    """Return the evidence that a baseline must exceed to name an effect.

    Parameters
    ----------
    silent : sequence of float
        Its evidence on each body without a missing effect.
    alarms : int
        Number of these bodies for which an effect may be named; more only in case of ties.
    """
    ranked = sorted(silent, reverse=True)
    return ranked[alarms] if alarms < len(ranked) else -np.inf

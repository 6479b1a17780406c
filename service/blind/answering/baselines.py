"""Names a cause in simpler ways, which a diagnosis has to beat.

1. The largest raw correlation: the effect one of whose fingerprints is most nearly parallel
   to the residuals of the nominal model, at any place; nothing is whitened, and what the
   constants would hide is not projected out.
2. One refit at a time: the single effect that leaves the smallest distance between model and
   image when it is fitted together with the constants, however many parameters it takes.
3. Chance: any effect of the catalogue.

The first two always accuse somebody. So that like is compared with like, they are also scored with
a threshold below which they stay silent: on bodies that lack nothing they then raise as many
alarms as the diagnosis does.
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
        From 0 to 1; 0 where nothing differs or nothing would change.
    """
    length = np.linalg.norm(columns, axis=-2) * np.linalg.norm(residual)
    along = np.abs(np.einsum("...mq,m->...q", columns, residual))
    return float(np.max(along[length > 0] / length[length > 0], initial=0.0))


def largest(correlations: Mapping[str, float]) -> str | None:
    """Return the effect accused by the first baseline; None without fingerprints."""
    return max(correlations, key=lambda name: correlations[name]) if correlations else None


def closest(left_mm: Mapping[str, float]) -> str | None:
    """Return the effect accused by the second baseline; None without refits.

    Parameters
    ----------
    left_mm : mapping of str to float
        Root mean square residual of each single refit.
    """
    return min(left_mm, key=lambda name: left_mm[name]) if left_mm else None


def improvement(left_mm: Mapping[str, float], before_mm: float) -> float:
    """Return how loudly the second baseline accuses: the ln of what its refit takes off.

    Parameters
    ----------
    left_mm : mapping of str to float
        As for `closest`.
    before_mm : float
        Root mean square residual of the nominal model.
    """
    least = min(left_mm.values(), default=before_mm)
    return float(np.log(before_mm / least)) if least > 0 and before_mm > 0 else 0.0


def threshold(silent: Sequence[float], alarms: int) -> float:
    """Return what a baseline must exceed to accuse.

    Parameters
    ----------
    silent : sequence of float
        How loudly it accuses on each body that lacks nothing.
    alarms : int
        So many of them may be accused; more only where several are equally loud.
    """
    ranked = sorted(silent, reverse=True)
    return ranked[alarms] if alarms < len(ranked) else -np.inf

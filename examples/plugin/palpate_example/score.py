"""A score: how far the glandular tissue is from where it should be."""

from collections.abc import Callable

import numpy as np

from palpate.storage.values import Tissue
from palpate.volumes import Volume
from palpate.workers.comparison.score_objective import Objective


def distance_to(target: Volume) -> Callable[[Volume], float]:
    """Return the function from a body to the distance of its gland's centroid in mm."""
    wanted = _centroid_mm(target)
    return lambda body: float(np.linalg.norm(_centroid_mm(body) - wanted))


def _centroid_mm(body: Volume) -> np.ndarray:
    z, y, x = np.nonzero(body.values == Tissue.GLANDULAR)
    if not len(x):
        return np.full(3, np.nan)
    places = np.array([x.mean(), y.mean(), z.mean()])
    return np.asarray(body.origin_mm) + places * np.asarray(body.spacing_mm)


CENTROID = Objective(name="centroid_mm", label="Centroid distance", unit="mm", measure=distance_to)

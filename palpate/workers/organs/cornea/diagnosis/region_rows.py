"""The gap in parts of the surfaces of a cornea, as rows of a summary."""

from collections.abc import Iterator

import numpy as np

from palpate.workers.diagnosis.algebra.linear_fit import LinearFit
from palpate.workers.diagnosis.outcome.region_gap import region_gap
from palpate.workers.diagnosis.schema.summary import RegionGap
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.diagnosis.verdict.diagnosis import Diagnosis

SURFACES = ("anterior surface", "posterior surface")


def region_rows(diagnosis: Diagnosis) -> Iterator[RegionGap]:
    """Yield the nominal model's gap on each surface: whole, left, middle and right."""
    inverse, fit = diagnosis.analysis.inverse, LinearFit(diagnosis.analysis.linear)
    x = inverse.frame.normalised(inverse.points.points)[:, 0]
    parts = {
        "all": np.ones(len(x), np.bool_),
        "left third": x < -1 / 3,
        "middle third": abs(x) <= 1 / 3,
        "right third": x > 1 / 3,
    }
    for number, surface in enumerate(SURFACES):
        for region, inside in parts.items():
            chosen = inside & (inverse.points.interface == number)
            if chosen.sum() >= SETTINGS.gap.fewest_residuals:
                yield region_gap(fit, chosen, inverse.scans[0].name, surface, region)

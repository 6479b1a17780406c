"""Gap on one part of an interface, as a row of a summary."""

import numpy as np

from palpate.storage.values import BoolArray
from palpate.workers.diagnosis.algebra.linear_fit import LinearFit
from palpate.workers.diagnosis.outcome.gap import gap
from palpate.workers.diagnosis.schema.summary import RegionGap
from palpate.workers.diagnosis.settings.values import SETTINGS


def region_gap(
    fit: LinearFit, chosen: BoolArray, scan: str, interface: str, region: str
) -> RegionGap:
    """Return the gap in a region, from the selected residuals of a fit, shape (m,)."""
    found, residual = gap(fit, chosen), fit.residual[chosen]
    return RegionGap(
        scan=scan,
        interface=interface,
        region=region,
        gap_mm=found.gap_mm,
        low_mm=found.low_mm,
        high_mm=found.high_mm,
        noise_mm=found.noise_mm,
        points=found.points,
        signed_mean_mm=float(residual.mean()),
        p50_mm=float(np.quantile(np.abs(residual), 0.5)),
        p95_mm=float(np.quantile(np.abs(residual), 0.95)),
        significant=bool(found.low_mm > SETTINGS.gap.nothing_mm),
    )

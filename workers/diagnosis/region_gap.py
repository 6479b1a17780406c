"""The gap of one part of an interface, as a row of a summary."""

import numpy as np

from storage.values import BoolArray
from workers.diagnosis.gap import gap
from workers.diagnosis.linear_fit import LinearFit
from workers.diagnosis.settings import SETTINGS
from workers.diagnosis.summary import RegionGap


def region_gap(
    fit: LinearFit, chosen: BoolArray, scan: str, interface: str, region: str
) -> RegionGap:
    """Return what the chosen residuals, shape (m,), of a fit say of their region."""
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

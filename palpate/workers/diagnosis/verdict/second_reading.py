"""Second estimate of the noise, at the points predicted by the best single effect.

The first estimate uses the points predicted by the nominal model. If that model is wrong by more
than the amplitude or correlation length of the noise, these points are off the interfaces or on
other parts of them, and the model error has been mistaken for noise. The best single effect is
closer to the truth even if it is not the true cause, so the noise is estimated again there, and all
hypotheses are weighed with the new estimate.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palpate.workers.diagnosis.fits.calibration import with_anchored_scans, with_learnt_noise
from palpate.workers.diagnosis.fits.gauss_newton import Fit, fit
from palpate.workers.diagnosis.problem.inverse_problem import Scan
from palpate.workers.diagnosis.problem.scan_poses import registered
from palpate.workers.diagnosis.problem.scan_prediction import (
    PredictedScan,
    compare_with_scan,
    compared_points,
    predict_scan,
)
from palpate.workers.diagnosis.screening.nominal_analysis import NominalAnalysis
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.diagnosis.verdict.joint_fit import JointFit
from palpate.workers.mechanics.fem.equilibrium.solve import Equilibrium
from palpate.workers.scan_threads import Each


def is_elsewhere(analysis: NominalAnalysis, best: Fit) -> bool:
    """Return True if a fit moves the points far enough to change the noise estimate.

    The root mean square shift from the nominal points is compared with the standard deviation of
    the noise across the interfaces and with its correlation length along them.
    """
    inverse, nominal = analysis.inverse, analysis.nominal
    if not inverse.is_segmented:
        return False
    at = nominal.residual(inverse) - best.residual(inverse)
    across = analysis.registered(at) / inverse.noise.sd_mm
    before, after = (np.concatenate([v.points for v in f.predictions]) for f in (nominal, best))
    normals, moves = np.concatenate([v.normals for v in nominal.predictions]), after - before
    sliding = moves - (moves * normals).sum(axis=1)[:, None] * normals
    along = np.linalg.norm(sliding, axis=1) / inverse.noise.correlation_mm
    return bool((across**2 + along**2).mean() > SETTINGS.noise.elsewhere**2)


def read_again(
    analysis: NominalAnalysis, singles: Sequence[JointFit], best: JointFit, each: Each = map
) -> NominalAnalysis:
    """Estimate the noise again at the best single effect, and refit the constants alone.

    Parameters
    ----------
    analysis : NominalAnalysis
    singles : sequence of JointFit
        All fitted single effects.
    best : JointFit
        Best of the single effects.
    each : callable
        Applies a function to every scan; see `workers.diagnosis.fits.gauss_newton.fit`.

    Returns
    -------
    NominalAnalysis
        The new analysis, with the sensitivities of the first analysis.
    """
    inverse, nominal = analysis.inverse, analysis.nominal
    begun = {one.names[0]: one.fit.values() for one in singles}
    u, z = best.fit.unknowns, best.fit.z

    def predicted(scan: Scan, start: Equilibrium) -> PredictedScan | None:
        return predict_scan(inverse, scan, u, z, start)

    found = list(each(predicted, inverse.scans, nominal.starts()))
    solved = [one for one in found if one is not None]
    if len(solved) < len(found):
        return replace(analysis, begun=begun)
    lying = registered(inverse, u, z, solved)
    anchors = [compared_points(inverse, u, z, one.points, one.pose) for one in lying]
    inverse = with_anchored_scans(inverse, anchors)
    compared = [
        compare_with_scan(inverse, scan, u, z, one.at, one.pose)
        for scan, one in zip(inverse.scans, lying, strict=True)
    ]
    inverse = with_learnt_noise(inverse, best.fit.jacobian * u.sd, compared)
    free = nominal.unknowns
    again = fit(inverse, free, nominal.z, nominal.starts(), nominal.poses(), each)
    if again is None:
        raise AssertionError("a fit that starts at the optimum of another fit must be simulable")
    return NominalAnalysis(inverse, again, analysis.sensitivities, begun)

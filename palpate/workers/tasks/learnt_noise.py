"""Conversion of a calibration's learnt noise to stored arrays and back."""

from dataclasses import replace

import numpy as np

from palpate.storage.stores.arrays import Arrays
from palpate.workers.diagnosis.fits.calibration import with_anchored_scans
from palpate.workers.diagnosis.noise.model import LearntNoise, NoiseParts, NoiseState
from palpate.workers.diagnosis.noise.uneven import with_factors
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.problem.noise_parts import noise_lengths, stated_covariances
from palpate.workers.diagnosis.problem.pressed_points import with_pressed_points


def noise_arrays(inverse: InverseProblem) -> Arrays:
    """Return the parts of the learnt noise not determined by the points and the given noise.

    Raises
    ------
    ValueError
        If the problem has not been calibrated.
    """
    learnt = inverse.learnt
    if learnt is None:
        raise ValueError("the noise is only known after the calibration")
    anchors = {"noise_anchors": np.stack(inverse.anchors)} if inverse.anchors else {}
    pressed = np.stack([inverse.followed(scan).pressed for scan in inverse.scans])
    uneven = {} if learnt.parts.uneven is None else {"noise_uneven": learnt.parts.uneven}
    return {
        **anchors,
        **uneven,
        "noise_pressed": pressed,
        "noise_fixed": learnt.parts.fixed,
        "noise_numerical": learnt.parts.numerical,
        "noise_state_lengths": np.array([s.length for s in learnt.states], np.int32),
        "noise_state_scales": np.stack([s.scales for s in learnt.states]),
        "noise_state_numerical": np.array([s.numerical for s in learnt.states]),
        "noise_state_log_weights": np.array([s.log_weight for s in learnt.states]),
        "noise_state_shares": np.array([s.share for s in learnt.states]),
    }


def with_stored_noise(inverse: InverseProblem, arrays: Arrays) -> InverseProblem:
    """Return a problem, already reduced to its calibrated points, with its stored noise."""
    inverse = with_pressed_points(inverse, list(arrays["noise_pressed"]))
    parts = NoiseParts(
        stated=stated_covariances(inverse),
        lengths=noise_lengths(inverse),
        groups=np.tile(inverse.points.interface, len(inverse.scans)),
        fixed=arrays["noise_fixed"],
        numerical=arrays["noise_numerical"],
    )
    if "noise_uneven" in arrays:
        parts = with_factors(parts, arrays["noise_uneven"])
    rows = zip(
        arrays["noise_state_lengths"].tolist(),
        arrays["noise_state_scales"],
        arrays["noise_state_numerical"].tolist(),
        arrays["noise_state_log_weights"].tolist(),
        arrays["noise_state_shares"].tolist(),
        strict=True,
    )
    learnt = LearntNoise(parts, tuple(NoiseState(*row) for row in rows))
    known = replace(inverse, learnt=learnt, covariance=learnt.covariance)
    return (
        with_anchored_scans(known, list(arrays["noise_anchors"])) if inverse.is_segmented else known
    )

"""Posterior of the parameters of a joint fit, averaged over uncertain noise and poses.

A fit assumes one noise state and the given prior for the poses. If the actual pose errors are
smaller, the fit underestimates an effect that moves the body as a pose does. The mean for each
noise state and pose scale is one Newton step away; the means are weighted by their evidence.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.algebra.evidence import posterior
from palpate.workers.diagnosis.noise.evidence import LinearHypothesis, NoiseModel, with_pose_scales
from palpate.workers.diagnosis.problem.inverse_problem import Unknowns


class ParameterPosterior(NamedTuple):
    """Mean and standard deviation of each unknown of a fit, shape (p,)."""

    mean: FloatArray
    sd: FloatArray


def parameter_posterior(noise: NoiseModel, at: LinearHypothesis, u: Unknowns) -> ParameterPosterior:
    """Return the posterior of the unknowns of a fit, given its linearisation `at`.

    The means are clipped to the bounds.
    """
    p = len(u.sd)
    q = with_pose_scales(noise.plain(noise.products(at.columns, at.residual)), at.is_pose)
    weights = softmax(at.log_marginal(q)).ravel()
    means, covariances = posterior(q, at.offset)
    means = means[..., :p].reshape(-1, p)
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)[..., :p].reshape(-1, p)
    mean = weights @ means
    sd = np.sqrt(weights @ (variances + (means - mean) ** 2)) * u.sd
    z = np.clip(u.mean + mean * u.sd, u.lower, u.upper)
    return ParameterPosterior(np.asarray(z), np.asarray(sd))

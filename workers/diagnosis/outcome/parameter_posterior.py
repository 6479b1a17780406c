"""Where the parameters of a joint fit lie, averaged over what is not known of noise and poses.

A fit is made with one noise, and with scans that may lie as far off as is stated. Where they are
seen to lie nearer, an effect that moves a body as a pose does is larger than that fit has it. The
mean is one step of Newton's method away for each noise and each size of the poses, and these are
weighed as the evidence weighs them.
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
    """Return the posterior of the unknowns of a fit, `at` which the model is linear.

    None is beyond its bounds.
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

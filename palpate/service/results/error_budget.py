r"""Errors of the fitted constants other than the noise of the image.

The best candidate is also evaluated with its derivatives with respect to the nuisance parameters,
and on a mesh of another size. A group b of nuisance parameters, :math:`b \sim N(0, P)`, shifts the
constants by :math:`-A^{-1} B b`, with the blocks A, B and D of J'J. Its posterior and its log Bayes
factor are

.. math:: M = \frac{D - B'A^{-1}B}{s^2} + P^{-1}, \qquad
          \hat b = -M^{-1} \frac{g_b - B'A^{-1}g}{s^2}, \qquad
          \ln K = \tfrac12 \hat b'M\hat b - \tfrac12 \ln |P M|.

The variance of a constant grows by :math:`\hat\delta^2 + \mathrm{var}` of the shift, times the
probability of the group (separate discrepancy model: M. C. Kennedy, A. O'Hagan, J. R. Stat.
Soc. B 63 (2001) 425). A group with decisive support from the residual contradicts the estimate.

The mesh error is estimated by the Gauss step between the two meshes. One shift is a single draw
from a distribution with the same relative width for all constants, so half of its square is
averaged over the constants in units of their noise.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.service.search.space import FloatArray
from palpate.storage.records.tasks import FitJson, MeshFit
from palpate.workers.organs.nuisances import Nuisance

# Prior probability of a group of nuisance parameters, against a correct model.
PRIOR_ODDS = 0.1
# Above this log Bayes factor (150 to 1) a group contradicts the estimates.
DECISIVE = 5.0
# Ratio of the study's mesh error to the step to the other mesh. Meshes of 2,000 and 6,000 nodes
# differ by scatter rather than by a trend; see tests/benchmarks/interval_coverage.py.
MESH_FACTOR = 1.0
IMAGE, MISFIT, MESH = "image", "misfit", "mesh"
IMAGE_AND_PRIOR = "image and prior"


@dataclass(frozen=True)
class LocalProblem:
    """The least-squares problem of the constants, in the coordinates of `LocalModel`.

    Parameters
    ----------
    names : tuple of str
    scale : ndarray, shape (p,)
        Coordinate units per unit of the fit's parameter.
    root : ndarray, shape (p, k)
        Root of the inverse of J'J, ``root @ root.T``, without unidentified directions.
    gradient : ndarray, shape (p,)
        J'r.
    noise_factor : float
        s.
    """

    names: tuple[str, ...]
    scale: FloatArray
    root: FloatArray
    gradient: FloatArray
    noise_factor: float

    @property
    def inverse(self) -> FloatArray:
        """Return the inverse of J'J, without unidentified directions."""
        return np.asarray(self.root @ self.root.T)


@dataclass(frozen=True)
class ErrorSource:
    """One source of error.

    Parameters
    ----------
    name : str
        As a noun phrase: ``mesh``, ``the place of the scan``.
    root : ndarray, shape (p, k)
        Root of the covariance of the coordinates, ``root @ root.T``.
    log_bayes_factor : float
        Its support from the residual, in nats; 0 if not computed.
    """

    name: str
    root: FloatArray
    log_bayes_factor: float = 0.0

    @property
    def sd(self) -> FloatArray:
        """Return the standard deviation of each coordinate due to this source, shape (p,)."""
        return np.asarray(np.sqrt((self.root**2).sum(axis=1)))

    def sd_along(self, slope: FloatArray) -> float:
        """Return the standard deviation of a value, given its derivatives in the coordinates."""
        return float(np.linalg.norm(slope @ self.root))

    @property
    def supported(self) -> bool:
        """Return True if the residual decisively supports this source."""
        return self.log_bayes_factor > DECISIVE


def nuisance_sources(
    local: LocalProblem, fit: FitJson, nuisances: Iterable[Nuisance]
) -> list[ErrorSource]:
    """Return a source of error for each group of nuisance parameters in `fit`."""
    groups: dict[str, list[Nuisance]] = {}
    for one in nuisances:
        if one.name in fit["parameters"]:
            groups.setdefault(one.group, []).append(one)
    return [_group(local, fit, name, members) for name, members in groups.items()]


def mesh_source(local: LocalProblem, meshes: Sequence[MeshFit]) -> ErrorSource | None:
    """Return the mesh error from the finest of the other meshes; None without other meshes."""
    if not meshes:
        return None
    finest = max(meshes, key=lambda one: one["nodes"])
    change = _gradient(local, finest["fit"]) - local.gradient
    step = -local.inverse @ change
    pooled = float(step @ np.linalg.pinv(local.inverse) @ step) / len(step)
    parts = np.column_stack([step, np.sqrt(pooled) * local.root])
    return ErrorSource(MESH, MESH_FACTOR * parts / np.sqrt(2))


def _group(
    local: LocalProblem, fit: FitJson, name: str, members: Sequence[Nuisance]
) -> ErrorSource:
    own = [fit["parameters"].index(n) for n in local.names]
    at = [fit["parameters"].index(one.name) for one in members]
    sd = np.array([one.sd for one in members])
    hessian, gradient = np.asarray(fit["hessian"]), np.asarray(fit["gradient"])
    shared = hessian[np.ix_(own, at)] * np.outer(local.scale, sd)
    response = local.inverse @ shared
    variance = local.noise_factor**2
    information = hessian[np.ix_(at, at)] * np.outer(sd, sd) - shared.T @ response
    precision = np.eye(len(at)) + information / variance
    pull = (gradient[at] * sd - response.T @ _gradient(local, fit)) / variance
    mean = -np.linalg.solve(precision, pull)
    gain = -0.5 * float(pull @ mean) - 0.5 * float(np.linalg.slogdet(precision)[1])
    always = any(one.always for one in members)
    # A source that is always possible needs no support; else log(1 + 1/odds) is -log(probability).
    odds = gain + np.log(PRIOR_ODDS)
    probability = 1.0 if always else float(np.exp(-np.logaddexp(0.0, -odds)))
    spread = np.linalg.cholesky(np.linalg.inv(precision))
    parts = np.column_stack([response @ mean, response @ spread])
    return ErrorSource(name, np.sqrt(probability) * parts, gain)


def _gradient(local: LocalProblem, fit: FitJson) -> FloatArray:
    order = [fit["parameters"].index(name) for name in local.names]
    return np.asarray(np.asarray(fit["gradient"], np.float64)[order] * local.scale)


def in_words(errors: Mapping[str, float], estimate: float) -> str:
    """Return the sources of an error as percentages of an estimate, the largest first.

    Sources below a tenth of the largest are omitted.

    Examples
    --------
    >>> in_words({"image": 0.03, "mesh": 0.11, "misfit": 0.002}, 10.0)
    'mesh 1.1 %, image 0.3 %'
    """
    largest = max(errors.values(), default=0.0)
    if not largest or not estimate:
        return ""
    ranked = sorted(errors.items(), key=lambda pair: -pair[1])
    return ", ".join(
        f"{name} {100 * sd / abs(estimate):.2g} %" for name, sd in ranked if sd >= largest / 10
    )

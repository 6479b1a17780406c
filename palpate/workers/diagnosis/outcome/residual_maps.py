r"""Maps of the residuals: their local means, and the stiffness changes that would explain them.

**Local means** show no noise of single points. The noise of a segmentation changes sign every few
millimetres; a gap does not. For weights w over the points of one interface with similar normals,

.. math:: \bar r = w'r, \qquad sd(\bar r)^2 = w' D w,

with D the covariance of the residuals, so that two standard deviations mean the same everywhere,
even near an edge of the interface.

**Causes.** For a lump at a place, with whitened column b and efficient residual (`Linearised`),

.. math:: z = -\frac{b' P \rho}{\sqrt{b' P b}}

is Rao's score, with unit variance: positive where a stiffer spot would explain the residuals,
negative where a softer spot would. This is the error estimator of model updating (L. Chamoin, P.
Ladeveze and J. Waeytens, Comput. Mech. 54 (2014) 1567) with one adjoint problem for all places,
less the part that the nominal constants absorb.

Places share most of their data, so a map is smooth; the maximum over many places exceeds a given
level by chance more often than a single value does. `reached_by_noise` is a level for the maximum
when the residuals are pure noise.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial import KDTree

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, Tissue, Volume
from palpate.workers.diagnosis.linearisation import EffectSensitivity, Linearised

AVERAGING_LENGTH_MM = 8.0


def local_mean(
    points: FloatArray,
    normals: FloatArray,
    interface: IntArray,
    residual: FloatArray,
    covariance: FloatArray,
    length_mm: float = AVERAGING_LENGTH_MM,
) -> tuple[FloatArray, FloatArray]:
    """Average residuals around each point.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Points of the body at rest, in mm.
    normals : ndarray, shape (k, 3)
        Unit normals there; opposite sides of a thin part are not mixed.
    interface : ndarray of int, shape (k,)
    residual : ndarray, shape (s, k)
        Residuals of each scan, in mm.
    covariance : ndarray, shape (s k, s k)
        Covariance of all residuals, with the scans concatenated, in mm^2.
    length_mm : float
        Standard deviation of the Gaussian weights; > 0.

    Returns
    -------
    mean, sd : ndarray, shape (s, k)
        Averages and their standard deviations in mm.

    Raises
    ------
    InputError
        If shapes do not match or the length is not positive.
    """
    s, k = residual.shape
    shapes = points.shape, normals.shape, interface.shape, covariance.shape
    if shapes != ((k, 3), (k, 3), (k,), (s * k, s * k)) or not length_mm > 0:
        raise InputError(
            f"Local means of {s} x {k} residuals need points and normals of shape ({k}, 3), "
            f"interfaces ({k},), a covariance ({s * k}, {s * k}) and a length > 0 mm, found "
            f"{shapes} and "
            f"{length_mm}."
        )
    squares = ((points[:, None] - points[None]) ** 2).sum(axis=2)
    weights = np.exp(-0.5 * squares / length_mm**2) * np.maximum(normals @ normals.T, 0.0)
    weights[interface[:, None] != interface] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    own = [covariance[i * k : (i + 1) * k, i * k : (i + 1) * k] for i in range(s)]
    variance = [((weights @ C) * weights).sum(axis=1) for C in own]
    return residual @ weights.T, np.sqrt(np.maximum(variance, 0.0))


DRAWS = 2000
# Fraction of draws of pure noise whose largest |z| stays below the level.
QUIET = 0.95
VOXEL_MM = 2.0
# Voxels farther than this from every place are not drawn: on the rim, no lump was tried.
FARTHEST_MM = 12.0


@dataclass(frozen=True, eq=False)
class CauseMap:
    """Scores for a stiffer spot at each place where a lump was tried.

    Parameters
    ----------
    places : ndarray, shape (g, 3)
        (x, y, z) in mm.
    z : ndarray, shape (g,)
        Score, positive for stiffer, with unit variance if only noise is left.
    estimate, sd : ndarray, shape (g,)
        Posterior mean of the log stiffness ratio and its standard deviation.
    seen : ndarray of bool, shape (g,)
        Whether the scans are more informative about the place than the prior.
    reached_by_noise : float
        Level that the largest |z| of pure noise exceeds with a probability of 5 %.
    """

    places: FloatArray
    z: FloatArray
    estimate: FloatArray
    sd: FloatArray
    seen: BoolArray
    reached_by_noise: float

    @property
    def loudest(self) -> int:
        """Index of the largest |z| among the `seen` places, or among all if none is seen."""
        among = self.seen if self.seen.any() else np.ones_like(self.seen)
        return int(np.where(among, np.abs(self.z), -1.0).argmax())


def cause_map(
    problem: Linearised, lump: EffectSensitivity, places: FloatArray, seed: int = 0
) -> CauseMap:
    """Compute the score at every place of a sensitivity.

    Parameters
    ----------
    problem : Linearised
        Linearisation at the nominal fit, or at a refit to map the residuals that remain with an
        effect.
    lump : EffectSensitivity
        Sensitivity to one parameter at g places.
    places : ndarray, shape (g, 3)
        Places of the sensitivity, (x, y, z) in mm.
    seed : int
        Seed of the noise draws.

    Raises
    ------
    InputError
        If the sensitivity has several parameters, or does not match places or residuals.
    """
    g, _, q = lump.places.shape
    if q != 1 or places.shape != (g, 3):
        raise InputError(
            f"A map of causes needs one parameter at each of its places, found {q} parameters at "
            f"{g} places for the effect {lump.name}, and places of shape {places.shape}."
        )
    B = np.ascontiguousarray(lump.whitened(problem)[:, :, 0].T)
    PB = problem.project(B)
    information = B.T @ PB
    own = np.maximum(np.diag(information), np.finfo(float).tiny)
    score = -(B.T @ problem.efficient_residual)
    posterior = 1.0 / (1.0 + own)
    return CauseMap(
        places=places,
        z=score / np.sqrt(own),
        estimate=score * posterior * lump.prior_sd[0],
        sd=np.sqrt(posterior) * lump.prior_sd[0],
        # Data as informative as the prior halve the variance.
        seen=own > 1.0,
        reached_by_noise=_largest_of_noise(information, own, seed),
    )


def _largest_of_noise(information: FloatArray, own: FloatArray, seed: int) -> float:
    """Return a quantile of the maximum of correlated standard normal variables."""
    scale = np.sqrt(own)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = root @ np.random.default_rng(seed).standard_normal((len(own), DRAWS))
    return float(np.quantile(np.abs(draws).max(axis=0), QUIET))


def voxels(found: CauseMap, body: Volume, voxel_mm: float = VOXEL_MM) -> Volume:
    """Interpolate the scores between the places inside the body.

    The interpolation is exact at the places and linear in the distance between them
    (the biharmonic spline in three dimensions), which limits overshoot and extrapolation.

    Parameters
    ----------
    found : CauseMap
    body : Volume
        `Tissue` labels of the body at rest.
    voxel_mm : float
        Voxel size of the map; > 0.

    Returns
    -------
    Volume of float32
        z in the body near places in `seen`; nan elsewhere.
    """
    if not voxel_mm > 0:
        raise InputError(f"The voxel size of a map must be > 0 mm, found {voxel_mm}.")
    nx, ny, nz = (
        max(1, round(n * s / voxel_mm))
        for n, s in zip(body.shape_xyz, body.spacing_mm, strict=True)
    )
    origin = np.asarray(body.origin_mm) - np.asarray(body.spacing_mm) / 2 + voxel_mm / 2
    z, y, x = np.meshgrid(*(np.arange(n) for n in (nz, ny, nx)), indexing="ij")
    centres = origin + voxel_mm * np.stack([x, y, z], axis=-1).reshape(-1, 3)
    inside = _tissue_at(body, centres)
    away, nearest = KDTree(found.places).query(centres[inside])
    drawn = np.full(len(centres), np.nan, np.float32)
    spline = RBFInterpolator(found.places, found.z, kernel="linear", degree=0)
    known = found.seen[nearest] & (away <= FARTHEST_MM)
    drawn[np.flatnonzero(inside)[known]] = spline(centres[inside][known])
    ox, oy, oz = origin.tolist()
    return Volume(drawn.reshape(nz, ny, nx), (voxel_mm,) * 3, (ox, oy, oz))


def _tissue_at(body: Volume, points: FloatArray) -> BoolArray:
    """Return a mask of the points that are in voxels of tissue."""
    index = np.rint((points - body.origin_mm) / np.asarray(body.spacing_mm)).astype(int)
    valid = ((index >= 0) & (index < body.shape_xyz)).all(axis=1)
    x, y, z = np.clip(index, 0, np.asarray(body.shape_xyz) - 1).T
    return np.asarray(valid & (body.values[z, y, x] != Tissue.AIR))

r"""Common error of the points on flat faces parallel to layers of voxels.

A plate flattens skin, mostly parallel to the layers of voxels. Labels then show the whole face at a
border between two layers, up to half a voxel from its true position: all its points share one
error, uniformly distributed over a voxel of edge h. (On nine blind bodies without a missing effect,
in voxels of 0.8 mm, faces under the plates scattered by 0.26 mm, with an error nearly linear in
their position between two layers.) The mean of independent noise at the points is never that large.

A face tilted by theta relative to the layers crosses them within the correlation length l of the
segmentation, and its error averages out. Residuals of one interface in one scan whose normals point
the same way along a voxel axis therefore have

.. math:: C_{ij} = \frac{h^2}{12} w_i w_j e^{-4 |x_i - x_j| / h}, \quad
    w = \exp \left( -\frac{1}{2} \left( \frac{\pi l \tan \theta}{h} \right)^2 \right)

with x along that axis.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from palpate.storage.values import BoolArray, FloatArray, Triple
from palpate.workers.diagnosis.algebra.low_rank import pivoted
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.problem.scan_prediction import ComparedScan
from palpate.workers.diagnosis.settings.values import SETTINGS


def voxel_steps(inverse: InverseProblem, predictions: Sequence[ComparedScan]) -> FloatArray:
    """Return columns whose outer product is the module's covariance, shape (m, q), in mm.

    Parameters
    ----------
    inverse : InverseProblem
    predictions : sequence of ComparedScan
        Predicted points of each scan.
    """
    k, columns = len(inverse.points), [np.zeros((len(inverse.bias), 0))]
    for number, (scan, at) in enumerate(zip(inverse.scans, predictions, strict=True)):
        if scan.voxel_mm is None:
            continue
        for which, covariance in _faces(inverse, at, scan.voxel_mm):
            found = pivoted(covariance, SETTINGS.noise.voxel_variance_mm2)
            placed = np.zeros((len(inverse.bias), found.shape[1]))
            placed[number * k + np.flatnonzero(which)] = found
            columns.append(placed)
    return np.hstack(columns)


def _faces(
    inverse: InverseProblem, at: ComparedScan, voxel_mm: Triple
) -> Iterator[tuple[BoolArray, FloatArray]]:
    """Yield masks of points facing one way along a voxel axis, with their covariance."""
    along = at.normals / np.maximum(np.linalg.norm(at.normals, axis=1), 1e-9)[:, None]
    for axis, h in enumerate(voxel_mm):
        cosine = np.clip(along[:, axis], -1.0, 1.0)
        slope = np.sqrt(1.0 - cosine**2) / np.maximum(np.abs(cosine), 1e-9)
        weight = np.exp(-0.5 * (np.pi * inverse.noise.correlation_mm * slope / h) ** 2)
        sd_mm = weight * h / np.sqrt(12.0)
        for interface in np.unique(inverse.points.interface):
            for side in (cosine > 0, cosine < 0):
                flat = sd_mm**2 > SETTINGS.noise.voxel_variance_mm2
                which = flat & side & (inverse.points.interface == interface)
                if which.any():
                    x = at.points[which, axis]
                    alike = np.exp(-4.0 * np.abs(x[:, None] - x) / h)
                    yield which, sd_mm[which][:, None] * sd_mm[which] * alike

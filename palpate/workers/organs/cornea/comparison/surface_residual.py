"""Signed distances of displaced points of a cornea from the imaged surfaces."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.comparison.observation.interface import InterfacePoints
from palpate.workers.organs.cornea.section.outline import Section

ANTERIOR, POSTERIOR = 0, 1


@dataclass(frozen=True, eq=False)
class SurfaceResidual:
    """Signed distances of points from the two surfaces of a section; see `Scan.compare`.

    Parameters
    ----------
    observed : Section
    """

    observed: Section

    def __call__(
        self, points: FloatArray, reference: InterfacePoints
    ) -> tuple[FloatArray, FloatArray]:
        """Return distances, (k,) in mm, positive outside, and outward normals."""
        residual, normals = np.empty(len(points)), np.zeros((len(points), 3))
        lines = {ANTERIOR: self.observed.anterior_mm, POSTERIOR: self.observed.posterior_mm}
        for number, line in lines.items():
            own = reference.interface == number
            outward = 1.0 if number == ANTERIOR else -1.0
            above, normal = signed_distances(points[own, :2], line)
            residual[own] = outward * above
            normals[own, :2] = outward * normal
        return residual, normals


def signed_distances(points: FloatArray, line: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the heights of points above a polyline, and upward normals at their feet.

    Parameters
    ----------
    points, line : ndarray, shape (k, 2) and (n, 2)
        The polyline from left to right.
    """
    start, along = line[:-1], np.diff(line, axis=0)
    arm = points[:, None] - start
    part = np.clip((arm * along).sum(-1) / (along**2).sum(-1), 0, 1)
    nearest = np.linalg.norm(arm - part[..., None] * along, axis=-1).argmin(axis=1)
    # Vertex normals are averaged from their neighbours, which makes the distance smooth.
    tangent = np.gradient(line, axis=0)
    share = part[np.arange(len(points)), nearest][:, None]
    blended = (1 - share) * tangent[nearest] + share * tangent[nearest + 1]
    normal = np.stack([-blended[:, 1], blended[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    foot = line[nearest] + share * along[nearest]
    return ((points - foot) * normal).sum(axis=1), normal

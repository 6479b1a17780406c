r"""Body shapes that are not ellipsoids.

Every coordinate is stretched by a wave through the body,

.. math:: x_i' = x_i \, (1 + a \sin(k_i \cdot s + \varphi_i)) ,

with s the position in units of the ellipsoids' semi-axes; then each side is scaled back to its
original extent, so that the plates start at the same distances. The chest wall stays in its plane.
"""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray, Triple
from palpate.workers.blind.causes.base import Rng, triple
from palpate.workers.blind.fine_mesh import fine_mesh_of
from palpate.workers.blind.meshed_body import Body
from palpate.workers.blind.segmented_scan import deformed_labels, glandular_share
from palpate.workers.blind.solver.quadratic_element import quadratic

AMPLITUDE = 0.05, 0.12
WAVE_NUMBER = 1.5, 3.0


@dataclass(frozen=True, slots=True)
class BodyShape:
    """Waves that stretch a body.

    Parameters
    ----------
    amplitude : float
        The amplitude a.
    waves : tuple of Triple
        Wave vector k of each axis, per semi-axis.
    phases : Triple
        Phases in radians.
    """

    amplitude: float
    waves: tuple[Triple, Triple, Triple]
    phases: Triple

    def moved(self, points: FloatArray) -> FloatArray:
        """Return the displaced points (n, 3) of a body; their bounding box is unchanged."""
        s = points / np.abs(points).max(axis=0)
        factors = 1 + self.amplitude * np.sin(s @ np.array(self.waves).T + self.phases)
        stretched = points * factors
        for side in (-1.0, 1.0):
            before = (side * points).max(axis=0)
            after = np.maximum((side * stretched).max(axis=0), 1e-9)
            on_it = side * stretched > 0
            stretched = np.where(on_it, stretched * before / after, stretched)
        return np.asarray(stretched)


def draw_shape(rng: Rng) -> BodyShape:
    """Draw a random shape."""
    directions = rng.standard_normal((3, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    waves = directions * rng.uniform(*WAVE_NUMBER, (3, 1))
    x, y, z = (triple(np.round(wave, 4)) for wave in waves)
    phases = triple(np.round(rng.uniform(0, 2 * np.pi, 3), 4))
    return BodyShape(round(rng.uniform(*AMPLITUDE), 4), (x, y, z), phases)


def reshaped(body: Body, shape: BodyShape) -> Body:
    """Return the body, both labels and mesh, in another shape."""
    mesh = body.mesh
    corners = shape.moved(mesh.nodes[: mesh.corners])
    other = quadratic(corners, mesh.cells[:, :4], 0.0)
    share, fine = glandular_share(body.labels), fine_mesh_of(mesh)
    return Body(deformed_labels(share, fine, other.nodes - mesh.nodes), other)

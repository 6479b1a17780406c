r"""Deviations from the nominal model that are present in every case, whatever its cause.

In the plain world there are none. In the hard world, as in a clinic, everything is slightly off:
the constants that a diagnosis holds fixed, the springs of the chest wall, the axis of the fibres,
the positions of the scans and the quality of their segmentation, which misses or adds pieces; and
bodies are not ellipsoids.

For the shape of such a body, every coordinate is stretched by a wave through it,

.. math:: x_i' = x_i \, (1 + a \sin(k_i \cdot s + \varphi_i)) ,

with s the position in units of the ellipsoids' semi-axes; then each side is scaled back to its
original extent, so that the plates start at the same distances. The chest wall stays in its plane.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from palpate.storage.values import FloatArray, Triple
from palpate.workers.blind.breast_scene import NU, Rng, Scene, log_uniform, triple
from palpate.workers.blind.case_body import Body, deformed_labels, glandular_share
from palpate.workers.blind.solver.quadratic_mesh import fine_mesh_of, quadratic


class World(StrEnum):
    """Difficulty of the cases of a set."""

    plain = "plain"
    hard = "hard"


SHAPE_AMPLITUDE = 0.05, 0.12
SHAPE_WAVE_NUMBER = 1.5, 3.0


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
    waves = directions * rng.uniform(*SHAPE_WAVE_NUMBER, (3, 1))
    x, y, z = (triple(np.round(wave, 4)) for wave in waves)
    phases = triple(np.round(rng.uniform(0, 2 * np.pi, 3), 4))
    return BodyShape(round(rng.uniform(*SHAPE_AMPLITUDE), 4), (x, y, z), phases)


def reshaped(body: Body, shape: BodyShape) -> Body:
    """Return the body, both labels and mesh, in another shape."""
    mesh = body.mesh
    corners = shape.moved(mesh.nodes[: mesh.corners])
    other = quadratic(corners, mesh.cells[:, :4], 0.0)
    share, fine = glandular_share(body.labels), fine_mesh_of(mesh)
    return Body(deformed_labels(share, fine, other.nodes - mesh.nodes), other)


SHIFT_SD_MM = TURN_SD_DEG = 0.3
# Deviations of fixed constants, so small that their consequences stay within the noise. Weakening
# the springs at the wall by a third moves a body by more than a millimetre.
NU_OFF, SPRINGS_OFF, FIBRE_TILT_SD_DEG = 0.002, 0.03, 0.3

Pose = tuple[float, float, float, float, float, float]
"""Shift along x, y and z in mm, then rotation about these axes in degrees."""


@dataclass(frozen=True, slots=True)
class Deviations:
    """The deviations of one case.

    Parameters
    ----------
    nu : float
        Poisson's ratio of all tissue.
    wall_spring_factor : float
        Factor on the given springs along the chest wall.
    fibre_tilt_deg : tuple of float
        Tilt of the axis of all fibres, about x and about y.
    noise_factor : float
        Ratio of the true segmentation noise to the given value.
    ln_noise_at_wall : float
        ln of the ratio of this noise at the chest wall to that at the nipple.
    poses : tuple of Pose
        Pose of each loaded scan; empty if the positions in the headers are right.
    pieces : int
        Number of pieces of gland missed in every scan, and also of pieces added.
    shape : BodyShape or None
        Waves that change the ellipsoids; None for ellipsoids.
    """

    nu: float = NU
    wall_spring_factor: float = 1.0
    fibre_tilt_deg: tuple[float, float] = (0.0, 0.0)
    noise_factor: float = 1.0
    ln_noise_at_wall: float = 0.0
    poses: tuple[Pose, ...] = ()
    pieces: int = 0
    shape: BodyShape | None = None

    def apply_to(self, scene: Scene) -> Scene:
        """Return a scene, including its causes, with these deviations."""
        fibres = scene.fibres
        if any(self.fibre_tilt_deg):
            fibres = _tilted(scene.fibres, self.fibre_tilt_deg)
        springs = self.wall_spring_factor
        return replace(scene, nu=self.nu, wall_spring_factor=springs, fibres=fibres)

    def posed(self, scan: int, places: FloatArray) -> FloatArray:
        """Return points (n, 3) of a loaded scan in its wrong pose, rotated about their centre."""
        if not self.poses:
            return places
        pose = np.array(self.poses[scan])
        middle = (places.min(axis=0) + places.max(axis=0)) / 2
        return np.asarray((places - middle) @ _rotation(pose[3:]).T + middle + pose[:3])


def draw_deviations(world: World, rng: Rng, scans: int) -> Deviations:
    """Draw the deviations of one case with the given number of loaded scans."""
    if world is World.plain:
        return Deviations()
    tilt_x, tilt_y = (round(a, 3) for a in rng.normal(0, FIBRE_TILT_SD_DEG, 2))
    sd = np.repeat([SHIFT_SD_MM, TURN_SD_DEG], 3)
    return Deviations(
        nu=round(rng.uniform(NU - NU_OFF, NU + NU_OFF), 5),
        wall_spring_factor=round(rng.uniform(1 - SPRINGS_OFF, 1 + SPRINGS_OFF), 4),
        fibre_tilt_deg=(tilt_x, tilt_y),
        noise_factor=round(log_uniform(rng, 0.5, 2.0), 3),
        ln_noise_at_wall=round(rng.uniform(-0.5, 0.5), 3),
        poses=tuple(_pose(sd * rng.standard_normal(6)) for _ in range(scans)),
        pieces=1,
        shape=draw_shape(rng),
    )


def _pose(values: FloatArray) -> Pose:
    x, y, z, a, b, c = (round(v, 4) for v in values.tolist())
    return x, y, z, a, b, c


def _tilted(
    fibres: Callable[[FloatArray], FloatArray] | None, tilt_deg: tuple[float, float]
) -> Callable[[FloatArray], FloatArray]:
    turn = _rotation(np.array([*tilt_deg, 0.0]))

    def at(points: FloatArray) -> FloatArray:
        straight = np.tile([0.0, 0.0, 1.0], (len(points), 1))
        return np.asarray((straight if fibres is None else fibres(points)) @ turn.T)

    return at


def _rotation(degrees: FloatArray) -> FloatArray:
    """Return the matrix of a rotation about the vector `degrees`, whose length is the angle."""
    angle = float(np.radians(np.linalg.norm(degrees)))
    if angle == 0:
        return np.eye(3)
    x, y, z = np.radians(degrees) / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)

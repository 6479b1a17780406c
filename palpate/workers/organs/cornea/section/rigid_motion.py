"""A rotation and a shift in the plane of a section."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section.outline import Section


@dataclass(frozen=True)
class RigidMotion:
    """A rotation about a centre, followed by a shift.

    Parameters
    ----------
    shift_mm : tuple of float
        Along x and y.
    tilt_rad : float
        Counter-clockwise.
    centre_mm : tuple of float
        Centre of the rotation.
    """

    shift_mm: tuple[float, float] = (0.0, 0.0)
    tilt_rad: float = 0.0
    centre_mm: tuple[float, float] = (0.0, 0.0)

    def of_points(self, points_mm: FloatArray) -> FloatArray:
        """Return the moved points, shape (n, 2)."""
        cos, sin = np.cos(self.tilt_rad), np.sin(self.tilt_rad)
        turn = np.array([[cos, -sin], [sin, cos]])
        arms = points_mm - np.array(self.centre_mm)
        return np.asarray(arms @ turn.T + self.centre_mm + self.shift_mm)

    def of_section(self, section: Section) -> Section:
        """Return the moved section."""
        return Section(
            anterior_mm=self.of_points(section.anterior_mm),
            posterior_mm=self.of_points(section.posterior_mm),
        )

    @property
    def inverse(self) -> "RigidMotion":
        """Return the inverse motion."""
        centre = (
            self.centre_mm[0] + self.shift_mm[0],
            self.centre_mm[1] + self.shift_mm[1],
        )
        shift = (-self.shift_mm[0], -self.shift_mm[1])
        return RigidMotion(shift_mm=shift, tilt_rad=-self.tilt_rad, centre_mm=centre)

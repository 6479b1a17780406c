"""The plates around a body, as lines in a section."""

from dataclasses import dataclass

import numpy as np

from palpate.service.report.drawing.slices import View
from palpate.storage.values import Triple, Volume

Line = tuple[tuple[float, float], tuple[float, float]]
Frame = tuple[float, float, float, float]
# Plates at less than about 3 degrees to a section are not drawn.
LEAST_SINE = 0.05


@dataclass(frozen=True)
class Plates:
    """Two parallel planes that touch a body.

    Parameters
    ----------
    axis : tuple of float
        Unit vector from the lower to the upper plate.
    heights_mm : tuple of float
        Heights of the lower and the upper plate along the axis.
    """

    axis: Triple
    heights_mm: tuple[float, float]

    def lines(
        self, view: View, at_mm: float, frame_mm: Frame, outwards_mm: float = 0.0
    ) -> list[Line]:
        """Return the intersections of the plates with a section, from edge to edge of a frame.

        Parameters
        ----------
        view : View
        at_mm : float
            Place of the section along the normal of the view.
        frame_mm : tuple of float
            Left, right, bottom and top.
        outwards_mm : float
            Distance of the lines from the body, so as not to hide its skin.
        """
        a, b = self.axis[view.across], self.axis[view.up]
        if np.hypot(a, b) < LEAST_SINE:
            return []
        left, right, bottom, top = frame_mm
        found: list[Line] = []
        low, high = self.heights_mm
        for height in (low - outwards_mm, high + outwards_mm):
            c = height - self.axis[view.normal] * at_mm
            if abs(b) >= abs(a):
                found.append(((left, (c - a * left) / b), (right, (c - a * right) / b)))
            else:
                found.append((((c - b * bottom) / a, bottom), ((c - b * top) / a, top)))
        return found


def plates_touching(body: Volume, axis: Triple) -> Plates:
    """Return the planes at both ends of a labelled body along an axis."""
    along = np.asarray(axis) / np.linalg.norm(axis)
    solid = body.values != 0
    heights = np.zeros(())
    for k, n in enumerate(body.shape_xyz):
        shape = [1, 1, 1]
        shape[2 - k] = n
        places = body.origin_mm[k] + np.arange(n) * body.spacing_mm[k]
        heights = heights + along[k] * places.reshape(shape)
    there = heights[solid] if solid.any() else heights
    half = 0.5 * float(np.abs(along) @ np.asarray(body.spacing_mm))
    x, y, z = along.tolist()
    return Plates((x, y, z), (float(there.min()) - half, float(there.max()) + half))

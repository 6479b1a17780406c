"""Regions of a body, defined by undeformed coordinates so that they apply to any mesh."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, Triple


@dataclass(frozen=True, slots=True)
class Box:
    """Points between two corners, in mm; an infinite coordinate leaves a side open."""

    lower_mm: Triple
    upper_mm: Triple

    def __post_init__(self) -> None:
        if any(a > b for a, b in zip(self.lower_mm, self.upper_mm, strict=True)):
            raise InputError(f"A box needs lower <= upper, got {self.lower_mm} and {self.upper_mm}")

    def contains(self, points: FloatArray, margin_mm: float = 0.0) -> BoolArray:
        """Test whether each of `points`, shape (k, 3), is inside the box grown by `margin_mm`."""
        low = np.asarray(self.lower_mm) - margin_mm
        high = np.asarray(self.upper_mm) + margin_mm
        return np.asarray(((points >= low) & (points <= high)).all(axis=1))


@dataclass(frozen=True, slots=True)
class Ball:
    """Points within `radius_mm` of a centre."""

    centre_mm: Triple
    radius_mm: float

    def contains(self, points: FloatArray, margin_mm: float = 0.0) -> BoolArray:
        """Test whether each of `points`, shape (k, 3), is inside the ball grown by `margin_mm`."""
        distance = np.linalg.norm(points - np.asarray(self.centre_mm), axis=1)
        return np.asarray(distance <= self.radius_mm + margin_mm)


@dataclass(frozen=True, slots=True)
class OutsideCircle:
    """Points at least `radius_mm` from an axis along z through `centre_mm`, (x, y)."""

    centre_mm: tuple[float, float]
    radius_mm: float

    def contains(self, points: FloatArray, margin_mm: float = 0.0) -> BoolArray:
        """Test whether each of `points`, shape (k, 3), is outside a circle `margin_mm` smaller."""
        return np.asarray(self._from_axis(points) >= self.radius_mm - margin_mm)

    def away(self, points: FloatArray) -> FloatArray:
        """Return the distance from points inside the circle to it, shape (k,)."""
        return np.asarray(self.radius_mm - self._from_axis(points))

    def _from_axis(self, points: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(points[:, :2] - np.asarray(self.centre_mm), axis=1))


Region = Box | Ball | OutsideCircle

EVERYWHERE = Box((-np.inf, -np.inf, -np.inf), (np.inf, np.inf, np.inf))


def nodes_in(region: Region, nodes: FloatArray, margin_mm: float) -> BoolArray:
    """Find the `nodes`, shape (n, 3), that belong to a region: at least the nearest one.

    A coarse mesh may have no node inside a small region; nodes within `margin_mm`, or else the
    nearest one, are then used.
    """
    inside = region.contains(nodes)
    if not inside.any():
        inside = region.contains(nodes, margin_mm)
    if not inside.any():
        inside[np.argmin(_distance(region, nodes))] = True
    return inside


def _distance(region: Region, nodes: FloatArray) -> FloatArray:
    """Return the distance of `nodes` from a region that contains none of them, shape (n,)."""
    if isinstance(region, Ball):
        return np.asarray(np.linalg.norm(nodes - np.asarray(region.centre_mm), axis=1))
    if isinstance(region, OutsideCircle):
        return region.away(nodes)
    nearest = np.clip(nodes, region.lower_mm, region.upper_mm)
    return np.asarray(np.linalg.norm(nodes - nearest, axis=1))

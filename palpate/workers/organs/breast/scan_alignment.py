"""Rigid motions between a breast at rest and the same breast under compression, and alignment.

The chest wall and the plates are planes: the wall determines the position along z and two angles,
the plates determine the third angle and the position along the compression. Along the remaining
axis, compression hardly moves the centre of the body: by 0.5 mm at most in simulated pairs, and by
0.1 mm in the pair of shared/data/breast_bct_niftysim. Angles of up to about 20 degrees can be
found; for larger ones, bring the scans into one frame with --axes first. A chest wall that is not
flat determines neither position nor angles.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.storage.values import FloatArray, Tissue, Volume
from palpate.workers.organs.breast.breast_keys import BreastCase
from palpate.workers.organs.breast.breast_problem import compression_axis
from palpate.workers.organs.breast.scan_facts import PlateLoad, Scan, plate_frame

# Minimum share of the lines of a plane face that end within a step of the plane.
FLAT_SHARE = 0.5
# Minimum share of the lines along the compression that end at a plate.
TOUCHED_SHARE = 0.08
# Tolerance for parallel plates; the faces of a round body that touches only at its rim are not.
PARALLEL = np.tan(np.radians(1.0))
ROUNDS = 4
# Smaller turns are not corrected when a scan is aligned: they would require resampling.
LEAST_TURN_DEG = 0.3


@dataclass(frozen=True)
class RigidMotion:
    """Motion that moves a scan into the frame of the scan at rest.

    Parameters
    ----------
    shift_mm : tuple of float
        Shift of the centre of the body along x, y and z.
    turn_deg : tuple of float
        Rotation vector about the centre of the body, in degrees.
    centre_mm : tuple of float
        The centre of the body in the scan.
    """

    shift_mm: tuple[float, float, float]
    turn_deg: tuple[float, float, float]
    centre_mm: tuple[float, float, float]

    @property
    def shift(self) -> float:
        """Return the length of the shift in mm."""
        return float(np.linalg.norm(self.shift_mm))

    @property
    def turn(self) -> float:
        """Return the angle of the turn in degrees."""
        return float(np.linalg.norm(self.turn_deg))

    @property
    def words(self) -> str:
        """Return the motion as a text: ``(8.0, 0.0, -0.2) mm``."""
        shift = f"({', '.join(_rounded(s) for s in self.shift_mm)}) mm"
        if self.turn < LEAST_TURN_DEG:
            return shift
        turns = [
            f"{_rounded(t)} degrees about {axis}"
            for axis, t in zip("xyz", self.turn_deg, strict=True)
            if abs(t) >= LEAST_TURN_DEG / 2
        ]
        return f"{shift}, turned by {' and '.join(turns)}"


def motion_between(rest: Scan, scan: Scan, load: PlateLoad, placed: bool = True) -> RigidMotion:
    """Return the motion that brings a loaded scan into the frame of the scan at rest.

    Parameters
    ----------
    rest, scan : Scan
    load : PlateLoad
        Determines which end of the body the plates leave in place.
    placed : bool
        Whether both scans have a common frame. If not, and the load does not determine the
        position along its axis, the centres are aligned.
    """
    frame = plate_frame(scan.axis)
    here, step = rest.sample[0] @ frame.T, np.abs(frame) @ rest.sample[2]
    there, its_step = scan.sample[0] @ frame.T, np.abs(frame) @ scan.sample[2]
    centre = there.mean(axis=0)
    wall = _wall(here, step)
    turn = _turn(there - centre, its_step, wall is not None)
    turned = turn.apply(there - centre) + centre
    z_wall = None if wall is None else _wall(turned, its_step)
    shift = np.array(
        [
            here[:, 0].mean() - centre[0],
            _along(here[:, 1], turned[:, 1], step[1], its_step[1], load, placed),
            0.0 if wall is None or z_wall is None else wall - z_wall,
        ]
    )
    x, y, z = (float(s) for s in shift @ frame)
    rx, ry, rz = (float(t) for t in turn.as_rotvec(degrees=True) @ frame)
    cx, cy, cz = (float(c) for c in centre @ frame)
    return RigidMotion((x, y, z), (rx, ry, rz), (cx, cy, cz))


def moved(labels: Volume, motion: RigidMotion) -> Volume:
    """Return a scan after a motion; turned labels are resampled to the nearest voxels."""
    if motion.turn < LEAST_TURN_DEG:
        x, y, z = np.add(labels.origin_mm, motion.shift_mm)
        return replace(labels, origin_mm=(float(x), float(y), float(z)))
    spacing, centre = np.asarray(labels.spacing_mm), np.asarray(motion.centre_mm)
    turn = Rotation.from_rotvec(motion.turn_deg, degrees=True)
    body = np.argwhere(labels.values != Tissue.AIR)[:, ::-1]
    corners = np.array(np.meshgrid(*zip(body.min(axis=0) - 1, body.max(axis=0) + 1, strict=True)))
    ends = np.asarray(labels.origin_mm) + spacing * corners.reshape(3, -1).T
    ends = turn.apply(ends - centre) + centre
    low = ends.min(axis=0)
    count = np.ceil((ends.max(axis=0) - low) / spacing).astype(int) + 1
    values = np.zeros(tuple(count[::-1]), labels.values.dtype)
    x, y = (low[a] + spacing[a] * np.arange(count[a]) for a in (0, 1))
    for k in range(count[2]):
        plane = np.stack(np.broadcast_arrays(x[None, :], y[:, None], low[2] + spacing[2] * k), -1)
        points = turn.inv().apply(plane.reshape(-1, 3) - centre) + centre
        index = np.rint((points - labels.origin_mm) / spacing).astype(np.intp)
        inside = np.all((index >= 0) & (index < labels.shape_xyz), axis=1)
        i, j, slices = index[inside].T
        values[k].reshape(-1)[inside] = labels.values[slices, j, i]
    ox, oy, oz = (float(o) for o in low + motion.shift_mm)
    return replace(labels, values=values, origin_mm=(ox, oy, oz))


def _along(
    here: FloatArray, there: FloatArray, step: float, its_step: float, load: PlateLoad, placed: bool
) -> float:
    """Return the shift along the compression, determined by the plates or their force."""
    low, high = here.min() - step / 2, here.max() + step / 2
    its_low, its_high = there.min() - its_step / 2, there.max() + its_step / 2
    if load.ends_mm is not None:
        return float(sum(load.ends_mm) - its_low - its_high) / 2
    if load.force_n is not None and load.fixed == "lower":
        return float(low - its_low)
    if (load.force_n is not None and load.fixed == "middle") or not placed:
        return float(low + high - its_low - its_high) / 2
    return 0.0


def _turn(points: FloatArray, step: FloatArray, flat_wall: bool) -> Rotation:
    """Return the rotation that makes the wall normal to z and the plates normal to their axis."""
    turn = Rotation.identity()
    for _ in range(ROUNDS):
        now = turn.apply(points)
        wall = _plane(*_ends(now, step, 2, lower=True), step[2]) if flat_wall else None
        if wall is not None:
            across, along = wall.slopes
            normal = np.array([-across, -along, 1.0]) / np.sqrt(1 + across**2 + along**2)
            axis = np.cross(normal, [0.0, 0.0, 1.0])
            size = np.linalg.norm(axis)
            if size > 0:
                turn = Rotation.from_rotvec(axis / size * np.arcsin(size)) * turn
        slopes = _plate_slopes(turn.apply(points), step)
        if len(slopes) == 2 and abs(slopes[0] - slopes[1]) < PARALLEL:
            turn = Rotation.from_rotvec([0.0, 0.0, -np.arctan(np.mean(slopes))]) * turn
    return turn


@dataclass(frozen=True)
class _Plane:
    """A plane face: its slopes along the two other axes, and its position in the middle."""

    slopes: Sequence[float]
    middle: float


def _wall(points: FloatArray, step: FloatArray) -> float | None:
    """Return the z of the flat face at the chest wall; None if it is not flat."""
    _, ends = _ends(points, step, 2, lower=True)
    middle = float(np.median(ends))
    flat = np.mean(np.abs(ends - middle) <= step[2]) >= FLAT_SHARE
    return middle - float(step[2]) / 2 if flat else None


def _ends(
    points: FloatArray, step: FloatArray, normal: int, *, lower: bool
) -> tuple[FloatArray, FloatArray]:
    """Return the first or last point of each line along an axis: across it, and along it."""
    across = [a for a in range(3) if a != normal]
    cells = np.floor((points[:, across] - points[:, across].min(axis=0)) / step[across] + 0.5)
    width = int(cells[:, 1].max()) + 1
    number = (cells[:, 0] * width + cells[:, 1]).astype(np.intp)
    ends = np.full(int(number.max()) + 1, np.inf)
    np.minimum.at(ends, number, points[:, normal] if lower else -points[:, normal])
    there = np.flatnonzero(np.isfinite(ends))
    places = np.column_stack([there // width, there % width]) * step[across]
    return places, ends[there] if lower else -ends[there]


def _plane(places: FloatArray, ends: FloatArray, step: float) -> _Plane | None:
    """Fit a plane to a face, ignoring lines that end elsewhere; None if it is not flat."""
    design = np.column_stack([places - places.mean(axis=0), np.ones(len(places))])
    kept = np.ones(len(places), bool)
    plane = np.zeros(3)
    for _ in range(12):
        plane = np.linalg.lstsq(design[kept], ends[kept], rcond=None)[0]
        off = np.abs(ends - design @ plane)
        kept = off <= max(1.5 * step, 1.5 * float(np.median(off)))
    if np.mean(off <= 1.5 * step) < FLAT_SHARE:
        return None
    return _Plane((float(plane[0]), float(plane[1])), float(plane[2]))


def _plate_slopes(points: FloatArray, step: FloatArray) -> list[float]:
    """Return the slopes of both plates across the compression; fewer if they hardly touch."""
    slopes = []
    for lower in (True, False):
        places, ends = _ends(points, step, 1, lower=lower)
        heights = -ends if lower else ends
        design = np.column_stack([places - places.mean(axis=0), np.ones(len(places))])
        kept = heights > np.quantile(heights, 0.3)
        plane = np.zeros(3)
        for _ in range(25):
            plane = np.linalg.lstsq(design[kept], heights[kept], rcond=None)[0]
            # The body is below the plate, and touches it where kept.
            kept = heights - design @ plane > -step[1]
        touched = np.abs(heights - design @ plane) <= step[1]
        if np.mean(touched) >= TOUCHED_SHARE:
            slopes.append(float(-plane[0] if lower else plane[0]))
    return slopes


def _rounded(value: float) -> str:
    return f"{round(value, 1) + 0.0:.1f}"


def aligned(rest: Volume, scan: Volume, load: PlateLoad) -> tuple[Volume, RigidMotion]:
    """Return a loaded scan in the frame of the scan at rest, and the motion applied.

    See `workers.organs.breast.scan_alignment` for the limits under compression.
    """
    here = Scan("the scan at rest", 0.0, load.axis, rest)
    there = Scan("the loaded scan", load.force_n, load.axis, scan)
    motion = motion_between(here, there, load, placed=False)
    there_now = moved(scan, motion)
    same = replace(there_now, frame_uid=rest.frame_uid, place_known=rest.place_known)
    return same, motion


def study_load(case: BreastCase) -> PlateLoad:
    """Return the load of a study for checks and alignment."""
    load, distance = case.load, case.load.plate_distance_mm
    fixed = "middle" if load.moving == "both" else "lower"
    axis = compression_axis(load.oblique_deg)
    if distance is None:
        return PlateLoad("case.load.force_n", axis, force_n=load.force_n, fixed=fixed)
    if distance.lower is not None and distance.upper is not None:
        ends = distance.lower, distance.upper
        return PlateLoad("case.load.plate_distance_mm", axis, ends_mm=ends)
    return PlateLoad(
        "case.load.plate_distance_mm.final",
        axis,
        initial_mm=distance.initial,
        distance_mm=distance.final,
    )

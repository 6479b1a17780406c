"""Effects of imaging and measurement."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from palpate.storage.values import FloatArray, IntArray, Tissue, Triple
from palpate.workers.mechanics.effects.effect import (
    Effect,
    from_zero,
    renamed,
    two_sided,
    unchanged_problem,
)
from palpate.workers.mechanics.fem.boundary_value_problem import Frame
from palpate.workers.mechanics.model_parameters import DEGREE, MM, NUMBER, Reading, percent

# --- rigid motion
# Move the body between the scans by what the registration has left.


SHIFTS = ("motion_x", "motion_y", "motion_z")
RIGID_MOTION_TURNS = ("motion_turn_x", "motion_turn_y", "motion_turn_z")


def rigid_columns(points: FloatArray, normals: FloatArray, centre_mm: Triple) -> FloatArray:
    """Return the normal motion for 1 mm along and 1 degree about each axis, shape (k, 6).

    Rotations are about `centre_mm` and linearised: they neglect r theta^2 / 2, which is 0.12 mm
    for 3 degrees at 85 mm. See `Effect.shift`.
    """
    arm = np.asarray(points) - np.asarray(centre_mm)
    # n . (w x r) = w . (r x n)
    return np.hstack([normals, np.radians(np.cross(arm, normals))])


def rigidly_moved(points: FloatArray, motion: FloatArray, centre_mm: Triple) -> FloatArray:
    """Move points by 3 shifts in mm and 3 rotations in degrees, shape (k, 3).

    Linearised like `rigid_columns`.
    """
    turn = np.radians(motion[3:])
    return np.asarray(points + motion[:3] + np.cross(turn, points - np.asarray(centre_mm)))


def _rigid_motion_columns(
    points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame
) -> FloatArray:
    """Return the columns of a motion that rotates about the middle of the body, shape (k, 6)."""
    return rigid_columns(points, normals, frame.centre_mm)


# Every scan is off by a registration error, whatever the hypothesis; a further motion common to
# all loaded scans is as rare as a scanner with a wrong scale.
RIGID_MOTION = Effect(
    name="rigid_motion",
    family="observation",
    summary="The two scans are not perfectly aligned.",
    parameters=(
        *(two_sided(n, MM, 5.0, f"shift of the deformed scan along {n[-1]}") for n in SHIFTS),
        *(
            two_sided(n, DEGREE, 3.0, f"rotation of the deformed scan about {n[-1]}")
            for n in RIGID_MOTION_TURNS
        ),
    ),
    prior_sd=(1.0, 1.0, 1.0, 1.0, 1.0, 1.0),
    steps=(0.01,) * 6,
    transform=unchanged_problem,
    references=("J. M. Fitzpatrick, J. B. West, C. R. Maurer, IEEE TMI 17 (1998) 694",),
    observation=_rigid_motion_columns,
    moves_scan=True,
)


# --- frame turn
# Rotate the frame of the cameras relative to the frame of the body.


FRAME_TURN_TURNS = ("frame_turn_x", "frame_turn_y", "frame_turn_z")


def _frame_turn_columns(
    moves: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame
) -> FloatArray:
    """Return the normal displacement due to 1 degree about each axis, shape (k, 3)."""
    return np.asarray(np.radians(np.cross(moves, normals)))


# Error of a fit to markers that are 0.5 mm off, on a base 30 mm wide.
FRAME_TURN = Effect(
    name="frame_turn",
    family="observation",
    summary="The cameras' frame is rotated relative to the body's: the assumed marker "
    "positions at rest are wrong.",
    parameters=tuple(
        two_sided(n, DEGREE, 5.0, f"rotation of the observed displacements about {n[-1]}")
        for n in FRAME_TURN_TURNS
    ),
    prior_sd=(1.0, 1.0, 1.0),
    steps=(0.01,) * 3,
    transform=unchanged_problem,
    references=("J. M. Fitzpatrick, J. B. West, C. R. Maurer, IEEE TMI 17 (1998) 694",),
    observation=_frame_turn_columns,
    sees="moves",
)


# --- image scale
# Let the loaded scans have a different scale from the scan at rest.


IMAGE_SCALE_NAMES = ("scale_x", "scale_y", "scale_z")


def _image_scale_columns(
    points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame
) -> FloatArray:
    """Return the normal motion of a magnification about the middle of the body, shape (k, 3).

    For a scale increased by one along each axis; see `Effect.shift`.
    """
    return np.asarray((points - np.asarray(frame.centre_mm)) * normals)


def _true_image_scale(given: Mapping[str, Any]) -> dict[str, float]:
    """Return the scale along each axis."""
    return dict(zip(IMAGE_SCALE_NAMES, given["scale"], strict=True))


# Distortions of MR images after correction: 1 % is a lot, and scans of one scanner share them.
# Voxels alone can mimic a tenth of that.
IMAGE_SCALE = Effect(
    name="image_scale",
    family="observation",
    summary="The loaded scans have a different scale from the scan at rest.",
    parameters=tuple(
        two_sided(
            name,
            NUMBER,
            0.05,
            f"relative enlargement of the body along {name[-1]}",
            reading=percent(f"% larger along {name[-1]}"),
        )
        for name in IMAGE_SCALE_NAMES
    ),
    prior_sd=(0.005,) * len(IMAGE_SCALE_NAMES),
    steps=(1e-4,) * len(IMAGE_SCALE_NAMES),
    transform=unchanged_problem,
    references=("D. Wang et al., Magn. Reson. Imaging 22 (2004) 1211",),
    observation=_image_scale_columns,
    truth=_true_image_scale,
)


# --- image shear
# Let the loaded scans be sheared relative to the scan at rest.


IMAGE_SHEAR_NAMES = ("shear_xy", "shear_xz", "shear_yz")
# Axis of the motion, and the coordinate that it is proportional to.
MOVED, BY = (0, 0, 1), (1, 2, 2)


def _image_shear_columns(
    points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame
) -> FloatArray:
    """Return the normal displacement of a unit shear about the middle of the body, shape (k, 3).

    See `Effect.shift`. The other three shears are these plus a rotation, which is part of a scan's
    pose.
    """
    arms = points - np.asarray(frame.centre_mm)
    return np.asarray(normals[:, MOVED] * arms[:, BY])


# A gantry a quarter of a degree off, or a residual distortion.
IMAGE_SHEAR = Effect(
    name="image_shear",
    family="observation",
    summary="The loaded scans are sheared relative to the scan at rest.",
    parameters=tuple(
        two_sided(
            name,
            NUMBER,
            0.05,
            f"shift along {name[-2]} per mm of {name[-1]}",
            reading=Reading(unit=f"mm along {name[-2]} for each mm of {name[-1]}"),
        )
        for name in IMAGE_SHEAR_NAMES
    ),
    prior_sd=(0.005,) * len(IMAGE_SHEAR_NAMES),
    steps=(1e-4,) * len(IMAGE_SHEAR_NAMES),
    transform=unchanged_problem,
    references=("D. Wang et al., Magn. Reson. Imaging 22 (2004) 1211",),
    observation=_image_shear_columns,
)


# --- segmentation offset
# Let labels be too large or too small.


TISSUES = (Tissue.FAT, Tissue.GLANDULAR, Tissue.SKIN, Tissue.MUSCLE)


def _segmentation_offset_columns(
    points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame
) -> FloatArray:
    """Return 1 where an interface encloses each tissue, shape (k, 4); see `Effect.shift`."""
    return np.equal.outer(np.asarray(tissues), np.array(TISSUES)).astype(np.float64)


SEGMENTATION_OFFSET = Effect(
    name="segmentation_offset",
    family="observation",
    summary="The labels of a tissue are drawn too large or too small.",
    parameters=tuple(
        two_sided(
            f"segmentation_{tissue.name.lower()}",
            MM,
            2.0,
            f"distance by which the labels of {tissue.name.lower()} exceed its true boundary",
        )
        for tissue in TISSUES
    ),
    prior_sd=(0.35,) * len(TISSUES),
    steps=(0.01,) * len(TISSUES),
    transform=unchanged_problem,
    references=("M. A. Lago, PhD thesis, 2014, section 4.5.7",),
    observation=_segmentation_offset_columns,
    truth=renamed(segmentation_fat_mm="outline_mm", segmentation_glandular_mm="glandular_mm"),
)


# --- marker standoff
# Let markers be off the surface on which they are assumed to be.


MARKER_STANDOFF_NAME = "marker_standoff"


def _marker_standoff_columns(
    arms: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame
) -> FloatArray:
    """Return the normal motion of the end of a 1 mm arm relative to its foot, shape (k, 1).

    The arm is normal to the surface and turns with it, so its contribution is exact for any
    rotation, and linear in its length.
    """
    return np.asarray((arms * normals).sum(axis=1)[:, None])


MARKER_STANDOFF = Effect(
    name="marker_standoff",
    family="observation",
    summary="The markers are off the surface and swing out as it rotates.",
    parameters=(
        from_zero(MARKER_STANDOFF_NAME, MM, 15.0, "height of the markers above the surface"),
    ),
    prior_sd=(5.0,),
    steps=(0.01,),
    transform=unchanged_problem,
    references=(
        "A. Cappozzo et al., Clin. Biomech. 11 (1996) 90: markers that move "
        "relative to the bones they represent",
    ),
    observation=_marker_standoff_columns,
    sees="arms",
)

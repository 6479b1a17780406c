"""The motion of the whole eye between two frames, from the periphery of the cornea."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.section.rigid_motion import RigidMotion

# Errors of a segmented surface are correlated over about this length.
CORRELATION_MM = 0.5


@dataclass(frozen=True)
class Registration:
    """The motion of the eye from the undeformed to the deformed frame.

    Parameters
    ----------
    motion : RigidMotion
        Maps the undeformed periphery to the deformed one.
    rms_mm : float
        Remaining distance between the two peripheries, along the normal.
    sd_y_mm, sd_tilt_rad : float
        Standard deviations of shift and tilt, if the remaining distance is noise that is
        correlated over half a millimetre.
    """

    motion: RigidMotion
    rms_mm: float
    sd_y_mm: float
    sd_tilt_rad: float


def register_periphery(
    undeformed: Section, deformed: Section, outer_mm: float = 1.5, shift_x_mm: float = 0.0
) -> Registration:
    """Return the rigid motion of a cornea's periphery between two frames.

    Least squares of the distances along the normal between both surfaces, over the outer part of
    the section on both sides. Shift along y and tilt are fitted; the shift along x is given,
    because a circular arc does not change when rotated about its centre, so x and tilt cannot be
    distinguished. Bending of the periphery by the jet counts as motion: check `rms_mm`, and
    prefer a wide frame and a small `outer_mm`.

    Parameters
    ----------
    undeformed, deformed : Section
        In one coordinate system; both surfaces are functions of x.
    outer_mm : float
        Width of the periphery on each side; > 0.
    shift_x_mm : float
        Shift of the eye along x, of the point midway between the two edges.

    Returns
    -------
    Registration

    Raises
    ------
    InputError
        If the sections do not overlap over three times `outer_mm`.
    """
    ends = [
        (surface[0, 0], surface[-1, 0])
        for section in (undeformed, deformed)
        for surface in (section.anterior_mm, section.posterior_mm)
    ]
    first, last = float(max(e[0] for e in ends)), float(min(e[1] for e in ends))
    if not (outer_mm > 0 and last - first >= 3 * outer_mm):
        raise InputError(
            f"The two frames share {last - first:.2f} mm of the cornea, too little for a periphery "
            f"of {outer_mm} mm on each side. Give a smaller periphery, or two frames of the same "
            "eye."
        )
    middle = 0.5 * (first + last)
    centre = (middle, float(np.interp(middle, *undeformed.anterior_mm.T)))
    y_mm, tilt = 0.0, 0.0
    for _ in range(20):
        motion = RigidMotion((shift_x_mm, y_mm), tilt, centre)
        pairs = [
            _distances(motion.of_points(a), b, (first, last), outer_mm, centre)
            for a, b in (
                (undeformed.anterior_mm, deformed.anterior_mm),
                (undeformed.posterior_mm, deformed.posterior_mm),
            )
        ]
        residual = np.concatenate([p[0] for p in pairs])
        jacobian = np.concatenate([p[1] for p in pairs])
        step = np.linalg.lstsq(jacobian, -residual, rcond=None)[0]
        y_mm, tilt = y_mm + float(step[0]), tilt + float(step[1])
        if np.abs(step).max() < 1e-10:
            break
    rms = float(np.sqrt(np.mean(residual**2)))
    independent = max(4 * outer_mm / CORRELATION_MM, 3.0)
    covariance = np.linalg.inv(jacobian.T @ jacobian / len(residual)) * rms**2 / (independent - 2)
    return Registration(
        motion=RigidMotion((shift_x_mm, y_mm), tilt, centre),
        rms_mm=rms,
        sd_y_mm=float(np.sqrt(covariance[0, 0])),
        sd_tilt_rad=float(np.sqrt(covariance[1, 1])),
    )


def _distances(
    moved: FloatArray,
    target: FloatArray,
    common: tuple[float, float],
    outer: float,
    centre: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """Return normal distances of peripheral points, and their derivatives in y and tilt."""
    x = moved[:, 0]
    inside = (x >= common[0]) & (x <= common[1])
    points = moved[inside & ((x < common[0] + outer) | (x > common[1] - outer))]
    slope = np.interp(points[:, 0], target[:, 0], np.gradient(target[:, 1], target[:, 0]))
    cosine = 1 / np.hypot(1, slope)
    gap = points[:, 1] - np.interp(points[:, 0], target[:, 0], target[:, 1])
    # A rotation moves a point by (-(y - yc), x - xc) per radian.
    turn = (points[:, 0] - centre[0]) + slope * (points[:, 1] - centre[1])
    return gap * cosine, np.column_stack([cosine, turn * cosine])

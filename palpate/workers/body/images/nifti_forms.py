"""Consistency checks of the geometry in a NIfTI file.

A file can give its geometry three times: ``sform`` (an affine), ``qform`` (a rotation)
and ``pixdim`` (only spacings, which the qform uses). Their spacings must agree, and
sform and qform must agree in the direction of each axis. Forms with the same code are in the same
space, where they must give every voxel the same position; forms with different codes,
such as scanner and template, may differ by a motion.
"""

from typing import Any

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.body.images.scan import SPACING_TOLERANCE

PLACE_TOLERANCE = 0.5
"""Distance between the two positions of a voxel that is attributed to rounding, in voxels."""


def check_forms(header: Any, pixdim_mm: FloatArray, unit_mm: float, what: str) -> None:
    """Raise InputError if sform, qform and pixdim contradict each other.

    Parameters
    ----------
    header : nibabel.Nifti1Header or Nifti2Header
    pixdim_mm : ndarray, shape (3,)
        Spacing in the header; NaN if it has none.
    unit_mm : float
        Length of the file's unit.
    what : str
        Name of the image in messages.
    """
    if header["sform_code"] == 0:
        return
    sform = _in_mm(header.get_sform(), unit_mm)
    steps = np.linalg.norm(sform[:3, :3], axis=0)
    known = np.isfinite(pixdim_mm)
    if not (np.all(np.isfinite(sform)) and np.all(steps > 0)):
        return  # no spacing, which has its own error message
    if np.any(np.abs(steps - pixdim_mm)[known] > SPACING_TOLERANCE * pixdim_mm[known]):
        other = "qform and pixdim" if header["qform_code"] else "pixdim"
        raise InputError(
            f"{what} is inconsistent: voxels measure {_mm(steps)} mm according to its sform, but "
            f"{_mm(pixdim_mm)} mm according to its {other}. Save it again with one geometry "
            "(nibabel: image.set_qform(affine) and image.set_sform(affine))."
        )
    if header["qform_code"] != 0 and known.all():
        _compare(sform, _in_mm(header.get_qform(), unit_mm), header, what)


def _compare(sform: FloatArray, qform: FloatArray, header: Any, what: str) -> None:
    """Raise InputError if two affines turn, mirror or, in the same space, shift the image."""
    advice = "Find out which one is right, and save the image with that one as both forms."
    cosines = np.sum(_unit(sform) * _unit(qform), axis=0)
    if cosines.min() < np.sqrt(0.5):
        raise InputError(
            f"{what} is inconsistent: its voxel axes run towards {_letters(sform)} according to "
            f"its sform, but towards {_letters(qform)} according to its qform. {advice}"
        )
    if header["sform_code"] != header["qform_code"]:
        return
    last = np.array(header.get_data_shape()[:3], dtype=float) - 1
    corners = np.array(np.meshgrid(*([0.0, n] for n in last))).reshape(3, -1)
    moved = (sform - qform)[:3, :3] @ corners + (sform - qform)[:3, 3:]
    apart = float(np.linalg.norm(moved, axis=0).max())
    if apart > PLACE_TOLERANCE * np.linalg.norm(sform[:3, :3], axis=0).min():
        raise InputError(
            f"{what} is inconsistent: sform and qform have the same code "
            f"({int(header['sform_code'])}), but place voxels up to {apart:.3g} mm apart. {advice}"
        )


def _in_mm(affine: FloatArray, unit_mm: float) -> FloatArray:
    scaled = np.array(affine, dtype=float)
    scaled[:3] *= unit_mm
    return scaled


def _unit(affine: FloatArray) -> FloatArray:
    steps = affine[:3, :3]
    unit: FloatArray = steps / np.linalg.norm(steps, axis=0)
    return unit


def _letters(affine: FloatArray) -> str:
    """Return the anatomical direction of each voxel axis, such as ``R A S``."""
    steps = affine[:3, :3]
    axes = np.abs(steps).argmax(axis=0)
    ends = ("RL", "AP", "SI")
    return " ".join(ends[a][int(steps[a, k] < 0)] for k, a in enumerate(axes))


def _mm(lengths: FloatArray) -> str:
    return " x ".join(f"{length:.4g}" if np.isfinite(length) else "?" for length in lengths)

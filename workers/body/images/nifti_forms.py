"""Checks whether the places that a NIfTI file states agree.

A file can state its voxels three times: ``sform`` (an affine), ``qform`` (a rotation)
and ``pixdim`` (spacings alone, which the qform uses). Their spacings must agree, and
sform and qform must not mirror or exchange axes. Forms with one code are in the same
space, where they must put every voxel at the same place; forms of different codes,
such as scanner and template, may differ by a motion.
"""

from typing import Any

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.body.images.scan import SPACING_TOLERANCE

PLACE_TOLERANCE = 0.5
"""Distance of one voxel's two places that is rounding, in voxels."""


def check_forms(header: Any, pixdim_mm: FloatArray, unit_mm: float, what: str) -> None:
    """Raise InputError if sform, qform and pixdim contradict each other.

    Parameters
    ----------
    header : nibabel.Nifti1Header or Nifti2Header
    pixdim_mm : ndarray, shape (3,)
        Spacing of the header; NaN where it states none.
    unit_mm : float
        Length of the file's unit.
    what : str
        How to name the image in messages.
    """
    if header["sform_code"] == 0:
        return
    sform = _in_mm(header.get_sform(), unit_mm)
    steps = np.linalg.norm(sform[:3, :3], axis=0)
    known = np.isfinite(pixdim_mm)
    if not (np.all(np.isfinite(sform)) and np.all(steps > 0)):
        return  # it states no spacing, which has a message of its own
    if np.any(np.abs(steps - pixdim_mm)[known] > SPACING_TOLERANCE * pixdim_mm[known]):
        other = "qform and pixdim" if header["qform_code"] else "pixdim"
        raise InputError(
            f"{what} contradicts itself: voxels measure {_mm(steps)} mm by its sform, "
            f"{_mm(pixdim_mm)} mm by its {other}. Save it again with one geometry "
            "(nibabel: image.set_qform(affine) and image.set_sform(affine))."
        )
    if header["qform_code"] != 0 and known.all():
        _compare(sform, _in_mm(header.get_qform(), unit_mm), header, what)


def _compare(sform: FloatArray, qform: FloatArray, header: Any, what: str) -> None:
    """Raise InputError if two affines turn, mirror or, in one space, move the image apart."""
    advice = "Find out which one is right, and save the image with that one as both forms."
    cosines = np.sum(_unit(sform) * _unit(qform), axis=0)
    if cosines.min() < np.sqrt(0.5):
        raise InputError(
            f"{what} contradicts itself: its voxel axes run to {_letters(sform)} by its sform, "
            f"to {_letters(qform)} by its qform. {advice}"
        )
    if header["sform_code"] != header["qform_code"]:
        return
    last = np.array(header.get_data_shape()[:3], dtype=float) - 1
    corners = np.array(np.meshgrid(*([0.0, n] for n in last))).reshape(3, -1)
    moved = (sform - qform)[:3, :3] @ corners + (sform - qform)[:3, 3:]
    apart = float(np.linalg.norm(moved, axis=0).max())
    if apart > PLACE_TOLERANCE * np.linalg.norm(sform[:3, :3], axis=0).min():
        raise InputError(
            f"{what} contradicts itself: sform and qform have the same code "
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

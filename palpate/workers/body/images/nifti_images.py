"""NIfTI-1 and NIfTI-2 files, read with nibabel.

The file's frame is RAS and is converted to LPS. The sform is used if the file has one, else the
qform. With neither, the standard defines no orientation (nifti1.h, "method 1"): the index axes
are then x, y, z at the given ``pixdim``, and the position is unknown.

A file can thus give its geometry three times: ``sform`` (an affine), ``qform`` (a rotation) and
``pixdim`` (only spacings, which the qform uses). Their spacings must agree, and sform and qform
must agree in the direction of each axis. Forms with the same code are in the same space, where
they must give every voxel the same position; forms with different codes, such as scanner and
template, may differ by a motion.

Names of labels are read from a header extension with a ``LabelTable``, as TotalSegmentator and
Connectome Workbench write it.
"""

import gzip
import html
import re
from dataclasses import replace
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any

import nibabel as nib
import numpy as np
from nibabel.arrayproxy import ArrayProxy

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.body.images.claimed_size import DEFLATE, check_end, check_stored, claimed_bytes
from palpate.workers.body.images.scan_orientation import RAS_TO_LPS, SPACING_TOLERANCE, Scan

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


_UNIT_MM = {0: 1.0, 1: 1e3, 2: 1.0, 3: 1e-3}
"""Millimetres per unit of a code in ``xyzt_units``: unknown, metre, millimetre, micrometre."""
_NAMED = re.compile(
    r"""<Label\s[^>]*?Key=["'](-?\d+)["'][^>]*>\s*(?:<!\[CDATA\[(.*?)\]\]>|([^<]*))""", re.DOTALL
)
HEADER_BYTES = 16 * 2**20
"""Largest number of bytes before the voxels: the header and its extensions."""
_REFUSE = 40
"""Severity from which nibabel's header checks raise errors."""


def read_nifti(path: Path) -> Scan:
    """Read a ``.nii`` or ``.nii.gz`` file."""
    with _opened(path) as stream:
        return _scan(path, stream)


def _opened(path: Path) -> Any:
    return gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb")


def _scan(path: Path, stream: Any) -> Scan:
    header = _header(path, stream)
    # Read before nibabel's checks, which silently change a zero or negative pixdim to 1.
    pixdim = np.array(header["pixdim"][1:4], dtype=float)
    bad = ~(np.isfinite(pixdim) & (pixdim > 0))
    header["pixdim"][1:4][bad] = 1.0
    header.check_fix(error_level=_REFUSE)
    _check_size(path, header)

    values = np.asanyarray(ArrayProxy(stream, header))
    bytes_each = header.get_data_dtype().itemsize
    stream.seek(header.get_data_offset() + bytes_each * prod(header.get_data_shape()))
    check_end(stream, str(path))
    if any(size != 1 for size in values.shape[3:]):
        raise InputError(
            f"{path} has {values.ndim} axes, shape {values.shape}; a volume has 3. "
            "Save one channel and one time point of it."
        )
    values = values.squeeze(tuple(range(3, values.ndim)))
    unit = _unit_mm(header, path)
    pixdim[bad] = np.nan
    check_forms(header, unit * pixdim, unit, str(path))
    placed = _place(values, header, unit, unit * pixdim)
    return replace(placed, names=_names(header), scaling=_scaling(header))


def _check_size(path: Path, header: Any) -> None:
    """Raise InputError if a header describes more voxels than the file or the memory can hold."""
    offset = int(header["vox_offset"])
    if not 0 <= offset <= HEADER_BYTES:
        raise InputError(
            f"{path} has a header with the voxels at byte {offset}, expected at most "
            f"{HEADER_BYTES}. Its header is damaged; export it again."
        )
    shape, dtype = header.get_data_shape(), header.get_data_dtype()
    size = claimed_bytes(shape, dtype.itemsize, str(path))
    if _scaling(header):  # scaled voxels are doubles
        claimed_bytes(shape, max(dtype.itemsize, 8), str(path))
    ratio = DEFLATE if path.suffix.lower() == ".gz" else 1
    check_stored(size, path.stat().st_size - (offset if ratio == 1 else 0), ratio, str(path))


def _scaling(header: Any) -> str:
    """Return how a header scales the stored numbers; empty if it does not."""
    with np.errstate(all="ignore"):
        slope, inter = header.get_slope_inter()
    unscaled = (slope, inter) in ((None, None), (1.0, 0.0))
    return "" if unscaled else f"scl_slope {slope:.6g} and scl_inter {inter:.6g}"


def _unit_mm(header: Any, path: Path) -> float:
    code = int(header["xyzt_units"]) & 7  # the other bits are the unit of time
    if code not in _UNIT_MM:
        raise InputError(
            f"{path} has the code {code} for its unit of length, expected 1 (metre), 2 (mm) or 3 "
            "(micrometre). Save the image again in mm."
        )
    return _UNIT_MM[code]


def _names(header: Any) -> dict[int, str]:
    """Return the names of labels in the file's extensions."""
    names: dict[int, str] = {}
    for extension in header.extensions:
        content = extension.get_content()
        text = content.decode(errors="replace") if isinstance(content, bytes) else str(content)
        if "<LabelTable" in text:
            for key, literal, escaped in _NAMED.findall(text):
                names[int(key)] = (literal or html.unescape(escaped)).strip()
    return names


def _header(path: Path, stream: Any) -> Any:
    start = BytesIO(stream.read(HEADER_BYTES))  # an extension can claim any size
    for kind in (nib.Nifti1Header, nib.Nifti2Header):
        if kind.may_contain_header(start.getvalue()[: nib.Nifti2Header.sizeof_hdr]):
            return kind.from_fileobj(start, check=False)
    raise InputError(f"{path} does not begin like a NIfTI file. Is it damaged or misnamed?")


def _place(values: Any, header: Any, unit: float, pixdim_mm: FloatArray) -> Scan:
    if header["sform_code"] == 0 and header["qform_code"] == 0:
        return Scan.without_frame(values, pixdim_mm)
    affine = header.get_best_affine()
    scan = Scan.with_steps(values, unit * affine[:3, :3], unit * affine[:3, 3], RAS_TO_LPS)
    if header["sform_code"] == 0:  # a qform takes its lengths from pixdim
        return replace(scan, spacing_mm=pixdim_mm)
    return scan

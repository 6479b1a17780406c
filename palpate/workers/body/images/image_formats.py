"""Label maps in any supported file format.

========================  ==========================================================
``.nrrd`` ``.nhdr``       `workers.body.images.nrrd_images`
``.nii`` ``.nii.gz``      `workers.body.images.nifti_images`
``.tif`` ``.tiff``        `workers.body.images.tiff_images`, spacing must be given
folder of TIFF slices     the same
``.npy``                  `read_numpy`, spacing must be given
``.dcm``                  `workers.body.images.dicom_images` (a multi-frame file)
folder of DICOM slices    the same
========================  ==========================================================

A NumPy array is indexed ``[z, y, x]`` like every volume here. It has no spacing and no frame:
spacing must be given, and the first voxel is at (0, 0, 0).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import Triple, Volume
from palpate.workers.body.images.claimed_size import check_end, check_stored, claimed_bytes
from palpate.workers.body.images.dicom_images import read_dicom
from palpate.workers.body.images.nifti_images import read_nifti
from palpate.workers.body.images.nrrd_images import read_nrrd
from palpate.workers.body.images.scan_orientation import (
    Scan,
    check_shape,
    parse_axes,
    three_axes,
    to_volume,
    whole_numbers,
)
from palpate.workers.body.images.tiff_images import TIFF_SUFFIXES, read_tiff
from palpate.workers.input_files import check_regular, reading


def read_numpy(path: Path) -> Scan:
    """Read an ``.npy`` file (never one with pickled objects)."""
    with path.open("rb") as file:
        version = np.lib.format.read_magic(file)
        read = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = read(file)
        if not dtype.hasobject:  # objects are refused below
            size = claimed_bytes(shape, dtype.itemsize, str(path))
            check_stored(size, path.stat().st_size - file.tell(), 1, str(path))
        file.seek(0)
        values = np.lib.format.read_array(file, allow_pickle=False)
        check_end(file, str(path))
    return Scan.without_frame(three_axes(values, str(path)).transpose())


Reader = Callable[[Path], Scan]

_READERS: dict[str, tuple[str, Reader]] = {
    ".nrrd": ("NRRD", read_nrrd),
    ".nhdr": ("NRRD", read_nrrd),
    ".nii": ("NIfTI", read_nifti),
    ".nii.gz": ("NIfTI", read_nifti),
    ".tif": ("TIFF", read_tiff),
    ".tiff": ("TIFF", read_tiff),
    ".npy": ("NumPy", read_numpy),
    ".dcm": ("DICOM", read_dicom),
}


@dataclass(frozen=True, eq=False)
class LabelImage:
    """A label map with the information about its labels in its file.

    Parameters
    ----------
    volume : Volume
        Whole numbers, unchanged from the file.
    names : mapping of int to str
        Names of labels; empty if the file has none.
    where : str
        Name of the image in messages.
    anatomical : bool
        True if the frame of the file is a patient's frame.
    remarks : tuple of str
        What the reader noticed in a file that it accepted.
    """

    volume: Volume
    names: Mapping[int, str]
    where: str
    anatomical: bool
    remarks: tuple[str, ...] = ()


def read_volume_file(
    path: Path, *, spacing_mm: Triple | None = None, axes: str | None = None
) -> Volume:
    """Read a label map as a volume; see `read_labels`."""
    return read_labels(path, spacing_mm=spacing_mm, axes=axes).volume


def read_labels(
    path: Path, *, spacing_mm: Triple | None = None, axes: str | None = None
) -> LabelImage:
    """Read a label map, with the names of its labels, along the axes of the body.

    Parameters
    ----------
    path : Path
        A file, or a folder of DICOM or TIFF slices.
    spacing_mm : tuple of float, optional
        Voxel spacing along x, y, z of the file's frame (before `axes`), for files without
        a spacing. If the file has one, both must agree.
    axes : str, optional
        World axes that become x (across), y (compression) and z (chest wall to
        nipple), such as ``"-z,y,x"`` or ``"L S A"``; see `scan_orientation.parse_axes`.

    Returns
    -------
    LabelImage
        Has integer ``values``, C-contiguous ``[z, y, x]``. Patient frames are converted
        to LPS (x to the left, y to posterior, z to superior), in every format.

    Raises
    ------
    InputError
        If the file is missing, damaged, of an unknown kind, not 3-D, oblique, without
        spacing, or contains values that are not whole numbers.
    """
    path = Path(path)
    parse_axes(axes)  # finds mistakes in the option before a large file is read
    kind, reader = _reader(path)
    what = str(path)
    with reading(path, kind):
        scan = reader(path)
        check_shape(scan.values, what)
        labels = replace(scan, values=whole_numbers(scan.values, what, scan.scaling))
        volume = to_volume(labels, what, spacing_mm=spacing_mm, axes=axes)
    if not scan.scaling:
        return LabelImage(volume, scan.names, what, scan.anatomical, scan.remarks)
    where = f"{what} (scaled by {scan.scaling})"
    scaled = f"The labels are the stored numbers scaled by {scan.scaling}."
    return LabelImage(volume, scan.names, where, scan.anatomical, (*scan.remarks, scaled))


def _reader(path: Path) -> tuple[str, Reader]:
    check_regular(path)
    if path.is_dir():
        return _folder_reader(path)
    if not path.exists():
        raise InputError(
            f"{path} does not exist. Check the path; relative paths start at {Path.cwd()}."
        )
    name = path.name.lower()
    for suffix in sorted(_READERS, key=len, reverse=True):
        if name.endswith(suffix):
            return _READERS[suffix]
    raise InputError(
        f"{path} is in an unsupported format (suffix {path.suffix or 'none'!r}). Supported: "
        f"{', '.join(_READERS)}, or a folder of DICOM or TIFF slices."
    )


def _folder_reader(folder: Path) -> tuple[str, Reader]:
    suffixes = {p.suffix.lower() for p in folder.iterdir() if p.is_file() and p.name[0] != "."}
    if not suffixes:
        raise InputError(
            f"{folder} contains no files. Give the folder with the slices of one image."
        )
    tiff = suffixes & set(TIFF_SUFFIXES)
    if tiff and ".dcm" in suffixes:
        raise InputError(f"{folder} mixes TIFF and DICOM slices. Put each image in its own folder.")
    whole = sorted(suffixes & {".nrrd", ".nhdr", ".nii", ".gz", ".npy"})
    if whole and not tiff and ".dcm" not in suffixes:
        raise InputError(
            f"{folder} is a folder with {', '.join(whole)} files, expected one image. "
            "Give the file itself (TotalSegmentator writes all classes to one file with --ml)."
        )
    return ("TIFF", read_tiff) if tiff else ("DICOM", read_dicom)

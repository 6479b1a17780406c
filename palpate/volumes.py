"""Label volumes from files and to files."""

from collections.abc import Mapping
from pathlib import Path

from palpate.service.export import VOLUME_SUFFIXES, check_suffix, export_volume
from palpate.storage.values import Volume
from palpate.workers.body.images import read


def read_volume(
    path: str | Path,
    spacing_mm: tuple[float, float, float] | None = None,
    axes: str | None = None,
) -> Volume:
    """Read a label volume from NRRD, NIfTI, TIFF, DICOM or ``.npy``.

    Parameters
    ----------
    path : str or Path
        A file, or a folder of slices.
    spacing_mm : tuple of float, optional
        Voxel spacing along x, y and z, where the file does not say.
    axes : str, optional
        Which axes of the image are x (across), y (compression) and z (chest wall to
        nipple), such as ``"-z,y,x"``; or the anatomical directions in which x, y and z
        increase, such as ``"L S A"``.

    Returns
    -------
    Volume
        ``values`` indexed ``[z, y, x]``, ``spacing_mm`` and ``origin_mm`` as (x, y, z).

    Raises
    ------
    InputError
        If it cannot be read or understood.
    """
    return read.read_volume(Path(path), spacing_mm=spacing_mm, axes=axes)


def write_volume(path: str | Path, volume: Volume, names: Mapping[int, str] | None = None) -> None:
    """Write a volume as NRRD or NIfTI.

    Parameters
    ----------
    path : str or Path
        Its suffix chooses the format: ``.nrrd``, ``.seg.nrrd`` (a segmentation in 3D Slicer),
        ``.nii`` or ``.nii.gz``.
    volume : Volume
    names : mapping of int to str, optional
        Names of its labels, such as ``{1: "Fat", 2: "Glandular"}``, which 3D Slicer and
        `palpate import` read.

    Raises
    ------
    InputError
        If the suffix is not known or the folder does not exist.
    StoreError
        If the file system refuses.
    """
    check_suffix(Path(path), VOLUME_SUFFIXES, "")
    export_volume(Path(path), volume, names)

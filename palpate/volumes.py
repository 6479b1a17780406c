"""Reading, writing and generating label volumes."""

from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any, Self

from palpate.service.export import VOLUME_SUFFIXES, check_suffix, export_volume
from palpate.service.report.notebook_html import volume_html
from palpate.service.simulation.organ_simulation import case_from_keys
from palpate.storage import values
from palpate.storage.read_only import ReadOnly, hold_read_only
from palpate.workers.body.images import image_formats
from palpate.workers.organs.organ_plugins import DEFAULT, organ_named


class Volume(values.Volume, ReadOnly):
    """Voxels with a position in space; notebooks show three sections through the middle.

    Parameters
    ----------
    values : ndarray, shape (nz, ny, nx)
        Labels (``uint8``, see `Tissue`), compartment ids (``uint16``) or grey values; copied and
        read-only.
    spacing_mm : tuple of float
        Distance between voxel centres along x, y and z; > 0.
    origin_mm : tuple of float
        Centre of the voxel ``values[0, 0, 0]`` as (x, y, z).
    frame_uid : str
        DICOM frame of reference of these coordinates; empty if the file names none.
    place_known : bool
        Whether the file gives the position of its voxels.

    Raises
    ------
    InputError
        If the array is not 3-D or a spacing is not a positive number.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        vars(self).update(deepcopy(vars(self)))
        hold_read_only(self)

    @classmethod
    def of(cls, volume: values.Volume) -> Self:
        """Convert a volume to this class, which notebooks can display; its voxels are shared."""
        made = object.__new__(cls)
        vars(made).update(vars(volume))
        hold_read_only(made)
        return made

    def __repr__(self) -> str:
        shape = " x ".join(map(str, self.shape_xyz))
        spacing = " x ".join(f"{mm:.4g}" for mm in self.spacing_mm)
        return f"<Volume of {shape} voxels of {spacing} mm (x, y, z), {self.values.dtype}>"

    def _repr_html_(self) -> str:
        return str(volume_html(self, repr(self)[1:-1]))


def read_volume(
    path: str | Path, spacing_mm: tuple[float, float, float] | None = None, axes: str | None = None
) -> Volume:
    """Read a label volume from NRRD, NIfTI, TIFF, DICOM or ``.npy``.

    Parameters
    ----------
    path : str or Path
        A file, or a folder of slices.
    spacing_mm : tuple of float, optional
        Voxel spacing along x, y and z, if the file does not give it.
    axes : str, optional
        Image axes that are x (across), y (compression) and z (chest wall to
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
    return Volume.of(image_formats.read_volume_file(Path(path), spacing_mm=spacing_mm, axes=axes))


def phantom(preset: str = "445ml", seed: int = 1, **settings: Any) -> Volume:
    """Generate a virtual breast.

    Parameters
    ----------
    preset : str
        ``"445ml"`` or ``"250ml"``.
    seed : int
        Each seed gives a different breast.
    **settings
        Keys of ``case.reference.phantom`` in a study file, such as ``spacing_mm=2`` or
        ``glandular_fraction=0.2``.

    Returns
    -------
    Volume
        Labels of `Tissue`, indexed ``[z, y, x]``; x is vertical, y the direction of compression,
        z runs from the chest wall to the nipple.

    Raises
    ------
    InputError
        If a setting is unknown or impossible.
    """
    case = case_from_keys(DEFAULT, {"phantom": {"preset": preset, "seed": seed, **settings}})
    return Volume.of(organ_named(DEFAULT).make_body(case.reference))


def write_volume(
    path: str | Path, volume: values.Volume, names: Mapping[int, str] | None = None
) -> None:
    """Write a volume as NRRD.

    Parameters
    ----------
    path : str or Path
        The suffix selects the format: ``.nrrd``, ``.seg.nrrd`` (a segmentation in 3D Slicer),
        ``.nii`` or ``.nii.gz``.
    volume : Volume
    names : mapping of int to str, optional
        Names of its labels, such as ``{1: "Fat", 2: "Glandular"}``, for 3D Slicer and
        `palpate import`. Without them, a study of the file needs `labels`.

    Raises
    ------
    InputError
        If the suffix is not supported or the folder does not exist.
    StoreError
        If the file cannot be written.
    """
    check_suffix(Path(path), VOLUME_SUFFIXES, "")
    export_volume(Path(path), volume, names)

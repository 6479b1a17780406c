"""Label volumes from files and to files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palpate.service.export import export_volume
from palpate.service.forward.case_keys import case_from_keys
from palpate.storage.values import Volume
from palpate.workers.body.images import read
from palpate.workers.organs.registry import DEFAULT, organ_named


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
    body: Volume = organ_named(DEFAULT).make_body(case.reference)
    return body


def write_volume(path: str | Path, volume: Volume, names: Mapping[int, str] | None = None) -> None:
    """Write a volume as NRRD.

    Parameters
    ----------
    path : str or Path
    volume : Volume
    names : mapping of int to str, optional
        Names of its labels, such as ``{1: "Fat", 2: "Glandular"}``, which 3D Slicer and
        `palpate import` read.

    Raises
    ------
    StoreError
        If the file system refuses.
    """
    export_volume(Path(path), volume, names)

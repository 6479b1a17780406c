"""Stored volumes and meshes as files, and the suffixes of the supported formats.

Volumes become NRRD or NIfTI-1, the latter with the names of labels in a ``LabelTable``: a header
extension, as written by TotalSegmentator and Connectome Workbench and read by the reader of NIfTI
in `workers.body.images`; 3D Slicer shows the labels without their names.
"""

from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import escape

import nibabel as nib
import nrrd
import numpy as np

from palpate.service.export.exported_mesh import MESH_FORMATS, export_mesh
from palpate.storage.backends.atomic_files import explained, replacing
from palpate.storage.errors import InputError
from palpate.storage.store import Store
from palpate.storage.stored_arrays import load_mesh
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.images.nrrd_images import FRAME_KEY, PLACE_KEY
from palpate.workers.body.images.tissue_labels import label_counts
from palpate.workers.body.mesh.mesh_hierarchy import from_arrays
from palpate.workers.plugins import plugins

NIFTI_SUFFIXES = (".nii", ".nii.gz")
VOLUME_SUFFIXES = (".nrrd", *NIFTI_SUFFIXES)
MESH_SUFFIXES = tuple(MESH_FORMATS)


def solved_suffixes() -> tuple[str, ...]:
    """Return the suffixes to which a solved body can be exported."""
    return tuple(f".{name}" for name in plugins("exporters"))


def suffix_of(path: Path, known: tuple[str, ...]) -> str:
    """Return the longest known suffix of a name, else its own suffix.

    Examples
    --------
    >>> suffix_of(Path("Body.NII.GZ"), VOLUME_SUFFIXES)
    '.nii.gz'
    >>> suffix_of(Path("body.seg.nrrd"), VOLUME_SUFFIXES)
    '.nrrd'
    """
    fitting = [suffix for suffix in known if path.name.lower().endswith(suffix)]
    return max(fitting, key=len, default=path.suffix.lower())


def check_suffix(path: Path | None, known: tuple[str, ...], option: str = "--out ") -> None:
    """Reject an unsupported file name before anything is computed.

    Raises
    ------
    InputError
        If the suffix is not in `known`, or the folder is missing.
    """
    if path is None:
        return
    suffix = suffix_of(path, known)
    if suffix not in known:
        raise InputError(
            f"{option}{path}: {suffix or 'no suffix'} is not supported; use one of "
            f"{', '.join(known)}."
        )
    if not path.parent.is_dir():
        raise InputError(f"{option}{path}: the folder {path.parent} does not exist; create it.")
    if path.is_dir():
        raise InputError(f"{option}{path} is a folder: give the name of a file.")


SCANNER = 1
NO_PLACE = 0
IGNORED_BY_OTHERS = 0
"""Extension code that programs skip unless they look for its text."""


def export_nifti(path: Path, volume: Volume, names: Mapping[int, str]) -> None:
    """Write a volume in RAS; one with unknown position keeps only its spacing.

    Parameters
    ----------
    path : Path
        Ends in ``.nii`` or ``.nii.gz``.
    volume : Volume
    names : mapping of int to str
        Names of the labels.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    values = np.asarray(volume.values)
    if values.dtype.kind in "biu":  # NIfTI programs rarely read 64-bit labels
        values = values.astype(np.min_scalar_type(max(int(values.max(initial=0)), 1)))
    affine = np.diag([*volume.spacing_mm, 1.0])
    affine[:3, 3] = volume.origin_mm
    affine[:2] *= -1  # LPS to RAS
    image = nib.Nifti1Image(values.transpose(), affine)
    image.header.set_xyzt_units("mm")
    code = SCANNER if volume.place_known else NO_PLACE
    image.set_sform(affine, code)
    image.set_qform(affine, code)
    if names:
        extension = nib.nifti1.Nifti1Extension(IGNORED_BY_OTHERS, _label_table(names).encode())
        image.header.extensions.append(extension)
    with explained(path), replacing(path) as temporary:
        nib.save(image, temporary)


def _label_table(names: Mapping[int, str]) -> str:
    labels = "".join(f'<Label Key="{k}">{escape(name)}</Label>' for k, name in names.items())
    return (
        '<?xml version="1.0" encoding="UTF-8"?><CaretExtension><VolumeInformation Index="0">'
        f"<LabelTable>{labels}</LabelTable><VolumeType>Label</VolumeType>"
        "</VolumeInformation></CaretExtension>"
    )


TISSUE_NAMES = {int(tissue): tissue.name.capitalize() for tissue in Tissue if tissue}
"""Names of the labels of a tissue volume; 0 is always background."""


def export_volume(path: Path, volume: Volume, names: Mapping[int, str] | None = None) -> None:
    """Write a volume as NRRD or NIfTI, readable by `workers.body.images.image_formats`.

    Parameters
    ----------
    path : Path
        One of `service.export.stored_files.VOLUME_SUFFIXES`; any other suffix is written as NRRD.
    volume : Volume
    names : mapping of int to str, optional
        Names of its labels, such as `TISSUE_NAMES`. In NRRD they use the format of 3D Slicer's
        ``.seg.nrrd``; with that suffix, Slicer opens the file as a segmentation.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    named = _names_present(volume, names or {})
    if suffix_of(path, VOLUME_SUFFIXES) in NIFTI_SUFFIXES:
        export_nifti(path, volume, named)
        return
    header = {
        "space": "left-posterior-superior",
        "space directions": np.diag(volume.spacing_mm),
        "space origin": np.asarray(volume.origin_mm),
        "space units": ["mm", "mm", "mm"],
        **_segments(named),
        **({FRAME_KEY: volume.frame_uid} if volume.frame_uid else {}),
        **({} if volume.place_known else {PLACE_KEY: "false"}),
    }
    with explained(path), replacing(path) as temporary:
        nrrd.write(str(temporary), volume.values, header, index_order="C")


def _names_present(volume: Volume, names: Mapping[int, str]) -> dict[int, str]:
    """Return the names of the labels that occur in a volume."""
    return {k: names[k] for k in label_counts(volume) if k in names} if names else {}


def _segments(names: Mapping[int, str]) -> dict[str, str]:
    """Return the header fields that name labels."""
    fields: dict[str, str] = {}
    for number, (label, name) in enumerate(names.items()):
        segment = f"Segment{number}"
        fields |= {
            f"{segment}_ID": f"{segment}_{name}",
            f"{segment}_Name": name,
            f"{segment}_LabelValue": str(label),
            f"{segment}_Layer": "0",
        }
    return fields


def export_stored_mesh(
    path: Path, store: Store, mesh: str, displacement_mm: np.ndarray | None = None
) -> None:
    """Write the finest mesh of a hierarchy, deformed if a displacement is given.

    Parameters
    ----------
    path : Path
        One of `service.export.stored_files.MESH_SUFFIXES`.
    store : Store
    mesh : str
        Digest of the hierarchy.
    displacement_mm : ndarray, shape (n, 3), optional
        Added to the nodes, and written as nodal data.
    """
    finest = from_arrays(load_mesh(store, mesh)[0]).finest
    body, points = finest.mesh, {}
    if displacement_mm is not None:
        body = type(body)(body.nodes + displacement_mm, body.tets)
        points = {"displacement_mm": displacement_mm}
    tissue = finest.fractions.argmax(axis=1).astype(np.int32)
    export_mesh(path, body, points, {"tissue": tissue})

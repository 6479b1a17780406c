"""Export of stored volumes and meshes."""

from collections.abc import Mapping
from pathlib import Path

import nrrd
import numpy as np

from palpate.service.export.nifti_file import export_nifti
from palpate.service.export.suffixes import NIFTI_SUFFIXES, VOLUME_SUFFIXES, suffix_of
from palpate.storage.backends.atomic import explained, replacing
from palpate.storage.stores.meshes import export_mesh, load_mesh
from palpate.storage.stores.store import Store
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.images.labels import label_counts
from palpate.workers.body.images.nrrd_file import FRAME_KEY, PLACE_KEY
from palpate.workers.body.mesh.hierarchy import from_arrays

TISSUE_NAMES = {int(tissue): tissue.name.capitalize() for tissue in Tissue if tissue}
"""Names of the labels of a tissue volume; 0 is always background."""


def export_volume(path: Path, volume: Volume, names: Mapping[int, str] | None = None) -> None:
    """Write a volume as NRRD or NIfTI, readable by `workers.body.images.read`.

    Parameters
    ----------
    path : Path
        One of `service.export.suffixes.VOLUME_SUFFIXES`; any other suffix is written as NRRD.
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
        One of `service.export.suffixes.MESH_SUFFIXES`.
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

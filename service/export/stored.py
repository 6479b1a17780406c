"""Writes volumes and meshes as they lie in a store."""

from pathlib import Path

import nrrd
import numpy as np

from storage.atomic import explained, replacing
from storage.meshes import export_mesh, load_mesh
from storage.stores import Store
from storage.values import Volume
from workers.body.mesh.hierarchy import from_arrays


def export_volume(path: Path, volume: Volume) -> None:
    """Write a volume as NRRD, in LPS as `workers.body.images.read` reads it back.

    Raises
    ------
    StoreError
        If the file system refuses.
    """
    header = {
        "space": "left-posterior-superior",
        "space directions": np.diag(volume.spacing_mm),
        "space origin": np.asarray(volume.origin_mm),
        "space units": ["mm", "mm", "mm"],
    }
    with explained(path), replacing(path) as temporary:
        nrrd.write(str(temporary), volume.values, header, index_order="C")


def export_stored_mesh(
    path: Path, store: Store, mesh: str, displacement_mm: np.ndarray | None = None
) -> None:
    """Write the finest mesh of a hierarchy, deformed when a displacement is given.

    Parameters
    ----------
    path : Path
        One of `service.export.suffixes.MESH_SUFFIXES`.
    store : Store
    mesh : str
        Digest.
    displacement_mm : ndarray, shape (n, 3), optional
        Added to the nodes, and kept as data at the nodes.
    """
    finest = from_arrays(load_mesh(store, mesh)[0]).finest
    body, points = finest.mesh, {}
    if displacement_mm is not None:
        body = type(body)(body.nodes + displacement_mm, body.tets)
        points = {"displacement_mm": displacement_mm}
    tissue = finest.fractions.argmax(axis=1).astype(np.int32)
    export_mesh(path, body, points, {"tissue": tissue})

"""Meshes of a whole body, without loss of labelled volume."""

import numpy as np
from scipy.ndimage import label

from palpate.storage.errors import InputError
from palpate.storage.values import TetMesh, Volume
from palpate.workers.body.mesh.hierarchy import Hierarchy, build_hierarchy

VOLUME_TOLERANCE = 0.02  # of the volume of the labels


def mesh_whole_body(
    labels: Volume, *, element_size_mm: float | None = None, nodes: int | None = None
) -> Hierarchy:
    """Mesh a label volume with `build_hierarchy`, and compare the volumes.

    Raises
    ------
    InputError
        If it cannot be meshed, or a part of the body is lost.
    """
    try:
        hierarchy = build_hierarchy(labels, element_size_mm=element_size_mm, nodes=nodes)
    except InputError:
        # Only the largest piece was refused; the existence of others is the reason to report.
        _check_volume(_largest_piece_ml(labels), labels)
        raise
    check_mesh_volume(hierarchy.finest.mesh, labels)
    return hierarchy


def check_mesh_volume(mesh: TetMesh, labels: Volume) -> None:
    """Raise InputError if a mesh does not have the volume of its labels.

    Raises
    ------
    InputError
        If the two differ by more than `VOLUME_TOLERANCE`.
    """
    corners = mesh.nodes[mesh.tets]
    _check_volume(
        float(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum()) / 6000, labels
    )


def _check_volume(meshed_ml: float, labels: Volume) -> None:
    labelled_ml = float(np.count_nonzero(labels.values)) * labels.voxel_mm3 / 1000
    if abs(meshed_ml - labelled_ml) <= VOLUME_TOLERANCE * labelled_ml:
        return
    raise InputError(
        f"The mesh has a volume of {meshed_ml:.4g} ml, but its labels cover {labelled_ml:.4g} ml: "
        f"a difference of {meshed_ml / labelled_ml - 1:+.1%}, expected {VOLUME_TOLERANCE:.0%} at "
        "most. Only the largest connected piece is meshed: connect the pieces of the body, or "
        "remove what does not belong to it. Parts thinner than an element are lost: use more nodes."
    )


def _largest_piece_ml(labels: Volume) -> float:
    pieces, count = label(labels.values != 0)
    voxels = np.bincount(pieces.ravel())[1:].max() if count else 0
    return float(voxels) * labels.voxel_mm3 / 1000

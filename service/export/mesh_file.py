"""Writes a solved body as a mesh with its displacement, stress, strain and volume change."""

from pathlib import Path

import numpy as np

from palpate.service.export.solved_body import SolvedBody
from palpate.storage.stores.meshes import export_mesh
from palpate.storage.values import FloatArray, TetMesh

# ParaView and Gmsh order a symmetric tensor so when they are given six numbers a cell.
SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


def export_solved_mesh(path: Path, body: SolvedBody) -> None:
    """Write the deformed mesh with what the solver knows of it.

    At the nodes ``displacement_mm``, ``volume_ratio`` (J) and ``pressure_kpa``; in the elements
    ``tissue``, ``volume_ratio``, ``pressure_kpa``, ``von_mises_kpa``, and as six components xx, yy,
    zz, xy, yz, xz ``cauchy_stress_kpa`` and ``green_strain``.

    Raises
    ------
    InputError
        If the suffix is not known.
    StoreError
        If the file system refuses.
    """
    fields, model = body.fields, body.level.model
    points = {
        "displacement_mm": body.displacement_mm,
        "volume_ratio": fields.node_volume_ratio,
        "pressure_kpa": 1e3 * fields.node_pressure_mpa,
    }
    cells = {
        "tissue": model.fractions.argmax(axis=1).astype(np.int32),
        "volume_ratio": fields.volume_ratio,
        "pressure_kpa": 1e3 * fields.pressure_mpa,
        "von_mises_kpa": 1e3 * fields.von_mises_mpa,
        "cauchy_stress_kpa": 1e3 * _six(fields.cauchy_mpa),
        "green_strain": _six(fields.green_strain),
    }
    export_mesh(path, TetMesh(body.positions_mm, model.elements.tets), points, cells)


def _six(tensors: FloatArray) -> FloatArray:
    """Return the components xx, yy, zz, xy, yz, xz, shape (m, 6)."""
    return np.stack([tensors[:, i, j] for i, j in SYMMETRIC], axis=1)

"""A solved body as a mesh with its displacement, stress, strain and volume change."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.service.export.solved_body import SolvedBody
from palpate.storage.stores.meshes import export_mesh
from palpate.storage.values import FloatArray, IntArray, TetMesh
from palpate.workers.mechanics.fem.equilibrium.element_fields import ElementFields

# The order of a symmetric tensor's six components in ParaView and Gmsh.
SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


@dataclass(frozen=True, eq=False)
class MeshData:
    """A deformed mesh with values at its nodes and in its elements.

    At the nodes ``displacement_mm``, ``volume_ratio`` (J) and ``pressure_kpa``; in the elements
    ``tissue``, ``volume_ratio``, ``pressure_kpa``, ``von_mises_kpa``, and as six components xx, yy,
    zz, xy, yz, xz ``cauchy_stress_kpa`` and ``green_strain``.

    Parameters
    ----------
    mesh : TetMesh
    points, cells : dict of str to ndarray
        Values at the n nodes, shape (n,) or (n, 3), and in the m elements, shape (m,) or (m, 6).
    """

    mesh: TetMesh
    points: dict[str, FloatArray]
    cells: dict[str, FloatArray | IntArray]


def mesh_data(
    deformed: TetMesh, displacement_mm: FloatArray, tissue: IntArray, fields: ElementFields
) -> MeshData:
    """Return a deformed mesh with all values that are written to files.

    Parameters
    ----------
    deformed : TetMesh
        A mesh with n nodes and m elements.
    displacement_mm : ndarray, shape (n, 3)
    tissue : ndarray of int32, shape (m,)
    fields : ElementFields
    """
    points = {
        "displacement_mm": displacement_mm,
        "volume_ratio": fields.node_volume_ratio,
        "pressure_kpa": 1e3 * fields.node_pressure_mpa,
    }
    cells: dict[str, FloatArray | IntArray] = {
        "tissue": tissue,
        "volume_ratio": fields.volume_ratio,
        "pressure_kpa": 1e3 * fields.pressure_mpa,
        "von_mises_kpa": 1e3 * fields.von_mises_mpa,
        "cauchy_stress_kpa": 1e3 * _six(fields.cauchy_mpa),
        "green_strain": _six(fields.green_strain),
    }
    return MeshData(deformed, points, cells)


def export_solved_mesh(path: Path, body: SolvedBody) -> None:
    """Write the deformed mesh with the values in `MeshData`.

    Raises
    ------
    InputError
        If the suffix is unknown.
    StoreError
        If the file cannot be written.
    """
    model = body.level.model
    tissue = model.fractions.argmax(axis=1).astype(np.int32)
    deformed = TetMesh(body.positions_mm, model.elements.tets)
    data = mesh_data(deformed, body.displacement_mm, tissue, body.fields)
    export_mesh(path, data.mesh, data.points, data.cells)


def _six(tensors: FloatArray) -> FloatArray:
    """Return the components xx, yy, zz, xy, yz, xz, shape (m, 6)."""
    return np.stack([tensors[:, i, j] for i, j in SYMMETRIC], axis=1)

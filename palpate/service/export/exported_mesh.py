"""Tetrahedra with values as a file for other programs, written with meshio."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.storage.backends.atomic_files import explained, replacing
from palpate.storage.errors import InputError
from palpate.storage.values import TetMesh

FULL_FROM_SIX = (0, 3, 5, 3, 1, 4, 5, 4, 2)
"""Indices into a 3 x 3 tensor, in the order xx, yy, zz, xy, yz, xz."""
# Formats of one file that can hold values. Meshio alone would write .msh for Ansys.
MESH_FORMATS = {".vtu": "vtu", ".vtk": "vtk", ".msh": "gmsh"}


def export_mesh(
    path: Path | str,
    mesh: TetMesh,
    point_data: Mapping[str, NDArray[Any]] | None = None,
    cell_data: Mapping[str, NDArray[Any]] | None = None,
) -> None:
    """Write tetrahedra to a file for other programs.

    Parameters
    ----------
    path : path
        The suffix selects the format: .vtu or .vtk (ParaView), .msh (Gmsh).
    mesh : TetMesh
    point_data : mapping of str to ndarray, shape (n,), (n, 3) or (n, 6), optional
        Values at nodes, such as ``displacement_mm``; six are the components xx, yy, zz, xy, yz,
        xz of a symmetric tensor, written to .msh with all nine.
    cell_data : mapping of str to ndarray, shape (m,), (m, 3) or (m, 6), optional
        Values in tetrahedra, such as ``tissue``.

    Raises
    ------
    InputError
        If the suffix is unknown or an array does not fit the mesh.
    StoreError
        If the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in MESH_FORMATS:
        raise InputError(
            f"{path} cannot be written: {path.suffix or 'no suffix'!r} is not a supported mesh "
            f"format. Use one of {', '.join(MESH_FORMATS)}."
        )
    points, cells = dict(point_data or {}), dict(cell_data or {})
    _check_lengths(points, len(mesh.nodes), "nodes")
    _check_lengths(cells, len(mesh.tets), "tetrahedra")
    file_format = MESH_FORMATS[path.suffix.lower()]
    if file_format == "gmsh":
        points, cells = _full_tensors(points), _full_tensors(cells)
    import meshio  # slow to load, and only exports need it

    written = meshio.Mesh(
        mesh.nodes,
        [("tetra", mesh.tets)],
        point_data={name: _writable_mesh(values) for name, values in points.items()},
        cell_data={name: [_writable_mesh(values)] for name, values in cells.items()},
    )
    with explained(path), replacing(path) as temporary:
        meshio.write(temporary, written, file_format=file_format)


def _check_lengths(data: Mapping[str, NDArray[Any]], count: int, of: str) -> None:
    for name, values in data.items():
        if values.shape not in ((count,), (count, 3), (count, 6)):
            raise InputError(
                f"{name!r} has shape {values.shape}, but the mesh has {count} {of}: "
                f"expected ({count},), ({count}, 3) or ({count}, 6)."
            )


def _full_tensors(data: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return symmetric tensors with nine components, row by row, as Gmsh requires."""
    return {
        name: values[:, FULL_FROM_SIX] if values.shape[1:] == (6,) else values
        for name, values in data.items()
    }


def _writable_mesh(values: NDArray[Any]) -> NDArray[Any]:
    """Convert booleans and small integers to a type that all formats support."""
    kind = values.dtype.kind
    if kind == "b" or (kind in "iu" and values.dtype.itemsize < 4):
        return values.astype(np.int32)
    return values.astype(np.float64) if kind == "f" else values

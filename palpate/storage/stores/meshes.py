"""Meshes: stored in Zarr, exported with meshio."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from numpy.typing import NDArray

from palpate.storage.backends.atomic import explained, replacing
from palpate.storage.errors import InputError
from palpate.storage.stores.arrays import Arrays, Meta, exists, load_arrays, save_arrays
from palpate.storage.stores.store import Store
from palpate.storage.values import TetMesh

# Formats of one file that can hold values. Meshio alone would write .msh for Ansys.
FULL_FROM_SIX = (0, 3, 5, 3, 1, 4, 5, 4, 2)
"""Indices into a 3 x 3 tensor, in the order xx, yy, zz, xy, yz, xz."""
FORMATS = {".vtu": "vtu", ".vtk": "vtk", ".msh": "gmsh"}


def save_mesh(
    store: Store, digest: str, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]
) -> None:
    """Write the arrays of a mesh or a hierarchy, whole or not at all.

    Raises
    ------
    StoreError
        If an array is not numeric, or the mesh cannot be written.
    """
    save_arrays(store.layout.mesh(digest), arrays, meta)


def load_mesh(store: Store, digest: str) -> tuple[Arrays, Meta]:
    """Read a mesh or a hierarchy; see `save_mesh`.

    Raises
    ------
    StoreError
        If it is missing or damaged.
    NewerSchemaError
        If a newer version of Palpate wrote it.
    """
    return load_arrays(store.layout.mesh(digest))


def has_mesh(store: Store, digest: str) -> bool:
    """Return True if the mesh exists and is complete."""
    return exists(store.layout.mesh(digest))


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
    if path.suffix.lower() not in FORMATS:
        raise InputError(
            f"{path} cannot be written: {path.suffix or 'no suffix'!r} is not a supported mesh "
            f"format. Use one of {', '.join(FORMATS)}."
        )
    points, cells = dict(point_data or {}), dict(cell_data or {})
    _check_lengths(points, len(mesh.nodes), "nodes")
    _check_lengths(cells, len(mesh.tets), "tetrahedra")
    file_format = FORMATS[path.suffix.lower()]
    if file_format == "gmsh":
        points, cells = _full_tensors(points), _full_tensors(cells)
    written = meshio.Mesh(
        mesh.nodes,
        [("tetra", mesh.tets)],
        point_data={name: _writable(values) for name, values in points.items()},
        cell_data={name: [_writable(values)] for name, values in cells.items()},
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


def _writable(values: NDArray[Any]) -> NDArray[Any]:
    """Convert booleans and small integers to a type that all formats support."""
    kind = values.dtype.kind
    if kind == "b" or (kind in "iu" and values.dtype.itemsize < 4):
        return values.astype(np.int32)
    return values.astype(np.float64) if kind == "f" else values

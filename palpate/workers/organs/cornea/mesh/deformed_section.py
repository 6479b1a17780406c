"""The surfaces of a section displaced with its mesh."""

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.section.polyline import arclength_mm, points_at


def deformed_section(
    section: Section, mesh: T6Mesh, displacement_mm: FloatArray, points_per_side: int = 4
) -> Section:
    """Return the surfaces of a section, displaced with its mesh.

    Points of the undeformed surfaces are displaced by the quadratic interpolation along the
    sides of the elements, so a zero displacement returns the original surfaces, independent of
    the mesh.

    Parameters
    ----------
    section : Section
        The undeformed section that was meshed.
    mesh : T6Mesh
    displacement_mm : ndarray, shape (n, 2)
    points_per_side : int
        Number of pieces per side of an element; at least 1.

    Returns
    -------
    Section
        As many pieces as the surface has sides, times `points_per_side`.

    Raises
    ------
    InputError
        If the displacement does not match the mesh.
    """
    if displacement_mm.shape != mesh.nodes_mm.shape:
        raise InputError(
            f"A displacement of shape {displacement_mm.shape} does not match a mesh of "
            f"{len(mesh.nodes_mm)} nodes; expected {mesh.nodes_mm.shape}."
        )
    if points_per_side < 1:
        raise InputError(f"A side needs at least one piece, got {points_per_side}.")
    return Section(
        anterior_mm=_moved(
            section.anterior_mm, mesh, mesh.anterior, displacement_mm, points_per_side
        ),
        posterior_mm=_moved(
            section.posterior_mm, mesh, mesh.posterior, displacement_mm, points_per_side
        ),
    )


def _moved(
    surface: FloatArray, mesh: T6Mesh, nodes: IntArray, displacement: FloatArray, pieces: int
) -> FloatArray:
    # Nodes are on the surface, so their x determines the position along it.
    along = np.interp(mesh.nodes_mm[nodes, 0], surface[:, 0], arclength_mm(surface))
    t = np.arange(pieces) / pieces
    shape = np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)])
    sides = np.stack([nodes[:-2:2], nodes[1::2], nodes[2::2]])
    moved = np.einsum("kp,ksi->spi", shape, displacement[sides]).reshape(-1, 2)
    places = np.einsum("kp,ks->sp", shape, np.stack([along[:-2:2], along[1::2], along[2::2]]))
    last = displacement[nodes[-1:]]
    return points_at(surface, np.append(places.ravel(), along[-1])) + np.concatenate([moved, last])

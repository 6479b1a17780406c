"""The undeformed body of a case: voxels, and a mesh of quadratic tetrahedra."""

from dataclasses import dataclass

from palpate.storage.values import Volume
from palpate.workers.blind.scene import Anatomy
from palpate.workers.blind.solver.quadratic_element import QuadraticMesh, quadratic
from palpate.workers.body.mesh.hierarchy import build_hierarchy
from palpate.workers.body.phantom.breast import BreastPhantom, generate_breast

SPACING_MM = 0.8
CORNERS = 2000  # of the tetrahedra; about 14,000 nodes including mid-edge nodes


@dataclass(frozen=True, eq=False)
class Body:
    """The labels of the undeformed body and its mesh."""

    labels: Volume
    mesh: QuadraticMesh


def body_of(anatomy: Anatomy, corners: int = CORNERS, spacing_mm: float = SPACING_MM) -> Body:
    """Generate and mesh a body of fat and glandular tissue.

    Parameters
    ----------
    anatomy : Anatomy
    corners : int
        Desired number of corner nodes, met within 10 %.
    spacing_mm : float
        Edge of the voxels.

    Raises
    ------
    InputError
        If the anatomy or the sizes are invalid.
    """
    settings = BreastPhantom(
        lower_mm=anatomy.lower_mm,
        upper_mm=anatomy.upper_mm,
        half_width_mm=anatomy.half_width_mm,
        depth_mm=anatomy.depth_mm,
        spacing_mm=spacing_mm,
        glandular_fraction=anatomy.glandular_fraction,
        skin_mm=0.0,
        ligament_mm=0.0,
        compartments=anatomy.compartments,
    )
    labels = generate_breast(settings, anatomy.seed).labels
    mesh = build_hierarchy(labels, nodes=corners).finest.mesh
    return Body(labels, quadratic(mesh.nodes, mesh.tets, 0.0))

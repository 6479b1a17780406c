"""Displacement images of deformed bodies."""

import numpy as np

from palpate.storage.values import Volume
from palpate.workers.comparison.warp_volume import displacement_image, warp_labels
from tests.workers.comparison.kuhn_mesh import box_mesh

LATTICE = Volume(np.zeros((1, 1, 1), np.uint8), (0.5, 0.75, 1.0), (0.1, 0.2, 0.3))


def test_affine_map_gives_the_length_of_each_displacement() -> None:
    """Under x -> F x, the tissue at x comes from F^-1 x."""
    F = np.array([[1.2, 0.1, 0.0], [-0.2, 0.7, 0.15], [0.05, 0.0, 1.1]])
    mesh = box_mesh((3, 4, 3), (-2.0, 1.0, 0.0), (6.0, 9.0, 5.0), jitter=0.2)
    displacement = mesh.nodes @ F.T - mesh.nodes
    image = displacement_image(mesh, displacement, LATTICE)
    assert image.on_lattice_of(LATTICE)
    nx, ny, nz = image.shape_xyz
    z, y, x = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
    places = np.stack([x, y, z], axis=-1) * image.spacing_mm + image.origin_mm
    moved = np.linalg.norm(places - places @ np.linalg.inv(F).T, axis=-1)
    known = np.isfinite(image.values)
    np.testing.assert_allclose(image.values[known], moved[known], atol=1e-4)
    body = Volume(np.ones((9, 12, 12), np.uint8), (1.0, 1.0, 1.0), (-3.0, -1.0, -2.0))
    labels = warp_labels(body, mesh, displacement, LATTICE)
    np.testing.assert_array_equal(known, labels.values == 1)

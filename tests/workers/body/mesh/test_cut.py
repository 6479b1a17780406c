"""Cutting keeps volume and neighbours, and follows the surface."""

import numpy as np
import pytest

from palpate.storage.values import FloatArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.adaptive_cuts import Cut, LevelSet, cut, level_set_of
from palpate.workers.body.mesh.adaptive_lattice import graded_lattice
from palpate.workers.body.mesh.body_outline import distance_at
from palpate.workers.body.mesh.mesh_geometry import (
    boundary_triangles,
    measures,
    triangle_areas_mm2,
    volumes_mm3,
)

RADIUS, CENTRE = 8.3, np.array([0.3, -0.2, 6.0])


def ball(voxel_mm: float = 0.5) -> Volume:
    """Return a ball cut off by the wall at z = 0."""
    n = round(12 / voxel_mm)
    at = (np.arange(2 * n) + 0.5 - n) * voxel_mm
    z, y, x = np.meshgrid(at + 12, at, at, indexing="ij")
    far = (x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2 + (z - CENTRE[2]) ** 2
    values = np.where(far < RADIUS**2, Tissue.GLANDULAR, Tissue.FAT).astype(np.uint8)
    return Volume(values, (voxel_mm,) * 3, (at[0], at[0], at[0] + 12))


def cut_ball(cell_mm: float) -> tuple[TetMesh, LevelSet, Cut]:
    n = round(24 / cell_mm)
    corner = np.array([-12.0, -12.0, 0.0])
    lattice = graded_lattice(np.zeros((n, n, n), np.uint8), corner, cell_mm)
    surface = level_set_of(ball(), Tissue.GLANDULAR)
    wall = lattice.mesh.nodes[:, 2] == 0
    free = np.zeros(len(wall), np.bool_)
    return lattice.mesh, surface, cut(lattice.mesh, lattice.size_mm, surface, 0.0, free, wall)


def field_at(surface: LevelSet, points: FloatArray) -> FloatArray:
    return np.array([distance_at(surface.field, surface.frame, *p) for p in points])


def test_both_sides_together_equal_the_original() -> None:
    before, _, after = cut_ball(1.0)
    volumes = volumes_mm3(after.mesh)
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(volumes_mm3(before).sum(), rel=1e-12)
    areas = [
        triangle_areas_mm2(m.nodes, boundary_triangles(m.tets)).sum() for m in (before, after.mesh)
    ]
    assert areas[1] == pytest.approx(areas[0], rel=1e-12)


def test_surface_between_the_sides_is_closed_and_shared() -> None:
    """Every face of one side, off the wall, is a face of the other side."""
    _, _, after = cut_ball(1.0)
    sides = []
    for side in (after.inside, ~after.inside):
        faces = boundary_triangles(after.mesh.tets[side])
        on = after.on_surface[faces].all(axis=1)
        flat = (after.mesh.nodes[faces][..., 2] == 0).all(axis=1)
        sides.append({tuple(sorted(map(int, face))) for face in faces[on & ~flat]})
    assert sides[0] == sides[1]
    assert len(sides[0]) > 500


def test_surface_nodes_are_on_the_surface() -> None:
    _, surface, after = cut_ball(1.0)
    on = after.mesh.nodes[after.on_surface]
    assert np.abs(field_at(surface, on)).max() < 0.01
    # The voxels' surface is off the sphere by a tenth of a voxel or so.
    away = np.linalg.norm(on - CENTRE, axis=1) - RADIUS
    assert np.abs(away).mean() < 0.05
    assert np.abs(away).max() < 0.43  # half a voxel's diagonal
    assert (on[:, 2] == 0).sum() > 36  # the circle is 36 mm long


def test_volume_and_shape_converge() -> None:
    errors = []
    height = RADIUS + CENTRE[2]
    exact = np.pi * height**2 * (3 * RADIUS - height) / 3
    for cell in (3.0, 1.5):
        _, _, after = cut_ball(cell)
        volumes = volumes_mm3(after.mesh)
        errors.append(abs(volumes[after.inside].sum() / exact - 1))
    # Chords cut off a volume that falls with the square of their length.
    assert errors[1] < 0.4 * errors[0]
    assert measures(after.mesh)["aspect"].max() < 8.0


def test_fixed_nodes_do_not_move() -> None:
    n = 16
    lattice = graded_lattice(np.zeros((n, n, n), np.uint8), np.array([-12.0, -12.0, 0.0]), 1.5)
    surface = level_set_of(ball(), Tissue.GLANDULAR)
    wall = lattice.mesh.nodes[:, 2] == 0
    fixed = np.ones(len(wall), np.bool_)
    after = cut(lattice.mesh, lattice.size_mm, surface, 0.0, fixed, wall)
    assert np.array_equal(after.mesh.nodes[: len(wall)], lattice.mesh.nodes)
    assert volumes_mm3(after.mesh).min() > 0

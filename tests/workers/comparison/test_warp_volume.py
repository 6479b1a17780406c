"""The deformed image against shifts, affine maps and point-by-point membership."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.storage.errors import InputError
from palpate.storage.values import TetMesh, Tissue, Volume
from palpate.workers.comparison.warp_volume import warp_grey, warp_labels
from tests.workers.comparison.coverage_count import warp_coverage
from tests.workers.comparison.kuhn_mesh import box_mesh, inside_some_tet

RNG = np.random.default_rng(7)
LABELS = Volume(RNG.integers(1, 6, (11, 13, 17), dtype=np.uint8), (0.5, 1.0, 1.5), (2.0, -3.0, 1.0))


def edges_mm(volume: Volume):
    """Return corners of the voxels' box, half a voxel beyond the outermost centres."""
    low = np.asarray(volume.origin_mm) - 0.5 * np.asarray(volume.spacing_mm)
    return low, low + np.asarray(volume.shape_xyz) * volume.spacing_mm


def mesh_of(volume: Volume, cells=(4, 3, 3), jitter=0.25) -> TetMesh:
    return box_mesh(cells, *edges_mm(volume), jitter=jitter, seed=1)


def centres_mm(volume: Volume):
    nx, ny, nz = volume.shape_xyz
    z, y, x = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
    return np.stack([x, y, z], axis=-1) * volume.spacing_mm + volume.origin_mm


def wavy(mesh: TetMesh, amplitude_mm: float):
    """Return a smooth displacement with rotation, stretch and bending, without folds if small."""
    return amplitude_mm * np.sin(mesh.nodes[:, [1, 2, 0]] * [0.4, 0.5, 0.6] + [0.3, 1.1, 2.0])


def test_zero_displacement_returns_every_voxel():
    mesh = mesh_of(LABELS)
    warped = warp_labels(LABELS, mesh, np.zeros_like(mesh.nodes))
    assert warped.origin_mm == pytest.approx(LABELS.origin_mm)
    assert warped.values.dtype == np.uint8
    np.testing.assert_array_equal(warped.values, LABELS.values)


def test_tissue_outside_the_mesh_does_not_appear():
    """A mesh over the voxels 2..14 in x leaves columns 0, 1, 15 and 16 behind."""
    low, high = edges_mm(LABELS)
    low[0] += 2 * 0.5
    high[0] -= 2 * 0.5
    mesh = box_mesh((3, 3, 3), low, high, jitter=0.2)
    warped = warp_labels(LABELS, mesh, np.zeros_like(mesh.nodes))
    np.testing.assert_array_equal(warped.values, LABELS.values[:, :, 2:15])
    assert warped.origin_mm == pytest.approx((3.0, -3.0, 1.0))


@pytest.mark.parametrize("voxels", [(1, 0, 0), (0, -2, 0), (3, 1, -4)])
def test_shift_by_whole_voxels(voxels):
    """The box moves by the shift, its contents stay; within the old box this is a roll."""
    mesh = mesh_of(LABELS)
    shift_mm = np.asarray(voxels) * LABELS.spacing_mm
    warped = warp_labels(LABELS, mesh, np.broadcast_to(shift_mm, mesh.nodes.shape))
    np.testing.assert_array_equal(warped.values, LABELS.values)
    assert warped.origin_mm == pytest.approx(np.asarray(LABELS.origin_mm) + shift_mm)
    start = np.rint((np.asarray(warped.origin_mm) - LABELS.origin_mm) / LABELS.spacing_mm)
    placed = np.zeros(np.asarray(LABELS.values.shape) + 16, dtype=np.uint8)
    z, y, x = (start.astype(int) + 8)[::-1]
    nz, ny, nx = warped.values.shape
    placed[z : z + nz, y : y + ny, x : x + nx] = warped.values
    padded = np.pad(LABELS.values, 8)
    np.testing.assert_array_equal(placed, np.roll(padded, voxels[::-1], axis=(0, 1, 2)))


def test_affine_map_against_the_inverse_map_of_each_voxel():
    """Under x -> F x + c voxel centre p gets the reference voxel nearest to F^-1 (p - c)."""
    F = np.array([[1.2, 0.1, 0.0], [-0.2, 0.8, 0.15], [0.05, 0.0, 1.1]])
    c = np.array([0.37, -1.21, 2.13])
    mesh = mesh_of(LABELS)
    warped = warp_labels(LABELS, mesh, mesh.nodes @ F.T + c - mesh.nodes)
    back = (centres_mm(warped) - c) @ np.linalg.inv(F).T
    index = np.rint((back - LABELS.origin_mm) / LABELS.spacing_mm).astype(int)
    inside = np.all((index >= 0) & (index < LABELS.shape_xyz), axis=-1)
    clipped = np.clip(index, 0, np.asarray(LABELS.shape_xyz) - 1)
    expected = np.where(
        inside, LABELS.values[clipped[..., 2], clipped[..., 1], clipped[..., 0]], Tissue.AIR
    )
    np.testing.assert_array_equal(warped.values, expected)
    assert inside.sum() == pytest.approx(LABELS.values.size * np.linalg.det(F), rel=0.05)


def test_result_on_another_lattice():
    """Twice as fine along x, half as fine along y, out of phase: still the nearest voxel."""
    lattice = Volume(np.zeros((1, 1, 1), np.uint8), (0.25, 2.0, 1.5), (0.125, 0.5, 0.25))
    mesh = mesh_of(LABELS)
    warped = warp_labels(LABELS, mesh, np.zeros_like(mesh.nodes), lattice)
    assert warped.on_lattice_of(lattice)
    index = np.floor((centres_mm(warped) - LABELS.origin_mm) / LABELS.spacing_mm + 0.5).astype(int)
    expected = LABELS.values[index[..., 2], index[..., 1], index[..., 0]]
    np.testing.assert_array_equal(warped.values, expected)


def test_mesh_beyond_the_image_shows_air():
    """A mesh one voxel larger than the image on every side adds a rim of air."""
    low, high = edges_mm(LABELS)
    mesh = box_mesh((4, 4, 4), low - LABELS.spacing_mm, high + LABELS.spacing_mm, jitter=0.2)
    warped = warp_labels(LABELS, mesh, np.zeros_like(mesh.nodes))
    np.testing.assert_array_equal(warped.values, np.pad(LABELS.values, 1))


def test_compartment_numbers_keep_their_type():
    ids = Volume(RNG.integers(300, 60000, (4, 5, 6)).astype(np.uint16), (1.0, 1.0, 1.0))
    mesh = mesh_of(ids, (2, 2, 2))
    warped = warp_labels(ids, mesh, np.zeros_like(mesh.nodes))
    np.testing.assert_array_equal(warped.values, ids.values)
    assert warped.values.dtype == np.uint16


def test_linear_grey_field_is_exact_under_an_affine_map():
    """g(X) = a + b . X is linear, so after x = F X + c its value is a + b . F^-1 (x - c)."""
    a, b = 3.0, np.array([0.7, -1.3, 0.4])
    grey = Volume(
        (a + centres_mm(LABELS) @ b).astype(np.float64), LABELS.spacing_mm, LABELS.origin_mm
    )
    F = np.array([[1.1, 0.0, 0.2], [0.1, 0.9, 0.0], [0.0, -0.1, 1.05]])
    c = np.array([1.0, 2.0, -3.0])
    centre = np.asarray(LABELS.origin_mm)
    mesh = box_mesh(  # within the outermost centres, where no value is clamped
        (4, 3, 3),
        centre,
        centre + (np.asarray(LABELS.shape_xyz) - 1) * LABELS.spacing_mm,
        jitter=0.2,
    )
    displacement = mesh.nodes @ F.T + c - mesh.nodes
    warped = warp_grey(grey, mesh, displacement, outside=-99.0)
    owned = warp_coverage(mesh, displacement, grey).counts.values == 1
    expected = a + (centres_mm(warped) - c) @ np.linalg.inv(F).T @ b
    assert warped.values.dtype == np.float32
    assert owned.sum() > 1000
    np.testing.assert_allclose(warped.values[owned], expected[owned], rtol=0, atol=2e-6)
    assert np.all(warped.values[~owned] == -99.0)


def test_grey_between_two_voxels():
    """Voxels 0 and 8 along x, shifted right by a quarter: the second is 0.75 * 8 = 6.

    The first comes from x = -0.25, beyond the first centre, where 0 is used.
    """
    grey = Volume(np.array([[[0, 8]]], dtype=np.int16), (1.0, 1.0, 1.0))
    mesh = mesh_of(grey, (1, 1, 1), 0.0)
    shift = np.broadcast_to([0.25, 0.0, 0.0], mesh.nodes.shape)
    warped = warp_grey(grey, mesh, shift)
    np.testing.assert_allclose(warped.values, [[[0.0, 6.0]]], rtol=0, atol=1e-6)


@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("spacing", [(0.31, 0.31, 0.31), (0.2, 0.47, 1.3)])
def test_every_voxel_of_a_jittered_box_is_written_once(jitter, spacing):
    """A box with its sides between voxel centres contains a known number of centres."""
    lattice = Volume(np.zeros((1, 1, 1), np.uint8), spacing)
    size = (np.array([30, 25, 12]) + 0.5) * spacing
    mesh = box_mesh((5, 4, 3), -0.25 * np.asarray(spacing), size, jitter=jitter, seed=3)
    coverage = warp_coverage(mesh, np.zeros_like(mesh.nodes), lattice)
    assert coverage.inverted == 0
    np.testing.assert_array_equal(coverage.counts.values, np.ones((13, 26, 31)))


def test_nodes_edges_and_faces_on_voxel_centres():
    """Worst ties: all nodes of the unjittered grid on centres, edges along every lattice line.

    The low sides of the box 0..8 belong to it, the high sides do not: 8 centres per axis.
    """
    lattice = Volume(np.zeros((1, 1, 1), np.uint8), (1.0, 1.0, 1.0))
    mesh = box_mesh((4, 2, 8), (0, 0, 0), (8, 8, 8))
    coverage = warp_coverage(mesh, np.zeros_like(mesh.nodes), lattice)
    np.testing.assert_array_equal(coverage.counts.values, np.ones((8, 8, 8)))


def test_numbering_of_nodes_and_elements_does_not_matter():
    """The owner of a tied voxel must not depend on the order of the elements' corners."""
    lattice = Volume(np.zeros((1, 1, 1), np.uint8), (1.0, 1.0, 1.0))
    mesh = box_mesh((4, 4, 4), (0, 0, 0), (8, 8, 8))
    rng = np.random.default_rng(5)
    name = rng.permutation(len(mesh.nodes)).astype(np.int32)
    nodes = np.empty_like(mesh.nodes)
    nodes[name] = mesh.nodes
    even = [[0, 1, 2, 3], [1, 2, 0, 3], [3, 2, 1, 0], [2, 3, 0, 1]]
    tets = np.array([name[t][even[rng.integers(4)]] for t in rng.permutation(mesh.tets)], np.int32)
    coverage = warp_coverage(TetMesh(nodes, tets), np.zeros_like(nodes), lattice)
    assert coverage.inverted == 0
    np.testing.assert_array_equal(coverage.counts.values, np.ones((8, 8, 8)))


def test_deformed_mesh_owns_the_voxels_in_its_elements():
    """Point by point: clearly inside is owned once, clearly outside is not owned."""
    mesh = mesh_of(LABELS)
    displacement = wavy(mesh, 0.5)
    coverage = warp_coverage(mesh, displacement, LABELS)
    assert coverage.inverted == 0
    points = centres_mm(coverage.counts).reshape(-1, 3)
    counts = coverage.counts.values.ravel()
    surely = inside_some_tet(mesh, displacement, points, -1e-3)
    perhaps = inside_some_tet(mesh, displacement, points, 1e-3)
    assert counts.max() == 1
    assert np.all(counts[surely] == 1)
    assert np.all(counts[~perhaps] == 0)
    assert surely.sum() > 1500


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), snap=st.sampled_from([0.0, 0.25, 0.5, 1.0]))
def test_no_holes_inside_a_randomly_deformed_box(seed, snap):
    """Sides fixed, inner nodes anywhere short of folding, also on ties: all ones."""
    rng = np.random.default_rng(seed)
    lattice = Volume(np.zeros((1, 1, 1), np.uint8), (1.0, 1.0, 1.0))
    mesh = box_mesh((3, 3, 3), (-0.5, -0.5, -0.5), (14.5, 11.5, 8.5))
    moves = rng.uniform(-1, 1, mesh.nodes.shape)
    moves[(mesh.nodes == mesh.nodes.min(axis=0)) | (mesh.nodes == mesh.nodes.max(axis=0))] = 0.0
    if snap:
        target = np.rint((mesh.nodes + moves) / snap) * snap
        moves = np.where(moves == 0.0, 0.0, target - mesh.nodes)
    coverage = warp_coverage(mesh, moves, lattice)
    if coverage.inverted == 0:
        np.testing.assert_array_equal(coverage.counts.values, np.ones((9, 12, 15)))
    else:
        assert coverage.counts.values.min() >= 1


def test_folded_elements_are_counted_and_leave_no_hole():
    """One inner node pulled through a face of its neighbour: some voxels twice, none missing."""
    lattice = Volume(np.zeros((1, 1, 1), np.uint8), (1.0, 1.0, 1.0))
    mesh = box_mesh((2, 2, 2), (-0.5, -0.5, -0.5), (15.5, 15.5, 15.5))
    displacement = np.zeros_like(mesh.nodes)
    displacement[13] = (12.0, 0.0, 0.0)
    coverage = warp_coverage(mesh, displacement, lattice)
    assert coverage.inverted > 0
    counts = coverage.counts.values
    assert counts.shape == (16, 16, 20)
    assert counts[:, :, :16].min() == 1
    assert counts.max() > 1


def test_mirrored_body_has_only_folded_elements():
    """x -> -x turns every element inside out, so none of them may write."""
    mesh = mesh_of(LABELS)
    mirror = mesh.nodes * [-2.0, 0.0, 0.0]
    assert warp_coverage(mesh, mirror, LABELS).inverted == len(mesh.tets)
    assert not warp_labels(LABELS, mesh, mirror).values.any()
    assert not warp_grey(LABELS, mesh, mirror).values.any()


def test_corner_a_hair_beyond_a_voxel_centre():
    """The box follows the snapped corners: 5 + 1e-9 counts as 5, and nothing is written outside."""
    lattice = Volume(np.zeros((1, 1, 1), np.uint8), (1.0, 1.0, 1.0))
    for hair in (-1e-9, 0.0, 1e-9):
        mesh = box_mesh((1, 1, 1), (5 + hair,) * 3, (8 + hair,) * 3)
        counts = warp_coverage(mesh, np.zeros_like(mesh.nodes), lattice).counts
        assert counts.origin_mm == (5.0, 5.0, 5.0)
        np.testing.assert_array_equal(counts.values, np.ones((3, 3, 3)))


def test_runs_of_one_line_join():
    """Elements as thin as 1/500 voxel, along x: each centre once for every cut."""
    lattice = Volume(np.zeros((1, 1, 1), np.uint8), (1.0, 1.0, 1.0))
    cuts = np.sort(np.random.default_rng(2).uniform(0, 6, 60))
    cuts = np.concatenate([[-0.5], cuts, cuts[-1:] + 0.002, [6.5]])
    boxes = [box_mesh((1, 1, 1), (a, -0.5, -0.5), (b, 3.5, 3.5)) for a, b in pairwise(cuts)]
    nodes = np.concatenate([b.nodes for b in boxes])
    tets = np.concatenate([b.tets + 8 * i for i, b in enumerate(boxes)]).astype(np.int32)
    coverage = warp_coverage(TetMesh(nodes, tets), np.zeros_like(nodes), lattice)
    np.testing.assert_array_equal(coverage.counts.values, np.ones((4, 4, 7)))


@pytest.mark.parametrize(
    ("displacement", "message"),
    [
        (np.zeros((3, 3)), "the mesh has nodes"),
        (np.full((8, 3), np.nan), "not finite"),
        (np.arange(24.0).reshape(8, 3) * 1e5, "would fill a box"),
    ],
)
def test_refuses_unusable_displacement(displacement, message):
    volume = Volume(np.ones((2, 2, 2), np.uint8), (1.0, 1.0, 1.0))
    with pytest.raises(InputError, match=message):
        warp_labels(volume, mesh_of(volume, (1, 1, 1)), displacement)

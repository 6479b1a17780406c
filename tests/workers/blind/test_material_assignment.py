"""Constants of an integration point, averaged over the quarter of the element around it."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.values import Tissue, Volume
from palpate.workers.blind.breast_scene import NU, Constants, Scene
from palpate.workers.blind.case_deviations import Deviations
from palpate.workers.blind.random_case import draw
from palpate.workers.blind.scene_solution import materials_of, wall_of
from palpate.workers.blind.tissue_causes import FibreContrast
from tests.workers.blind.pressed_blocks import block

SIDES = np.array([30.0, 20.0, 16.0])
SLOPE = 1e-3  # of the stiffness per mm: exp is linear to 0.02 %
# A corner's quarter is the set of points nearest to it. There its barycentric coordinate is the
# largest of four, with mean (1 + 1/2 + 1/3 + 1/4) / 4; the others have equal means.
OWN = 25 / 48


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_stiffness_gradient_gives_the_mean_of_each_quarter(axis):
    mesh = block((2, 2, 1), SIDES)
    labels = Volume(np.full((16, 20, 30), Tissue.FAT, np.uint8), (1.0,) * 3, (-14.5, -9.5, 0.5))
    scene = Scene(draw(1).anatomy, Constants(10.0, 40.0, 80.0))
    scene = replace(scene, ln_stiffness=(lambda points: SLOPE * points[:, axis],))
    materials = materials_of(scene, mesh, labels)
    corners = mesh.nodes[mesh.cells[:, :4], axis]
    quarter = OWN * corners + (1 - OWN) / 3 * (corners.sum(axis=1, keepdims=True) - corners)
    mu = 0.010 / (2 * (1 + NU))
    places = (materials.mu / mu - 1) / SLOPE
    # 64 samples in an element miss the middle of a quarter by at most a tenth of its edges.
    np.testing.assert_allclose(places, quarter, atol=0.1 * np.ptp(corners, axis=1).max())
    np.testing.assert_allclose(materials.eta / 0.080, materials.mu / mu, rtol=1e-12)


def test_glandular_tissue_stiffens_the_points_on_its_side():
    """Elements have corners at x = -15 and 15, and the tissue's boundary cuts them at x = 0."""
    mesh = block((1, 1, 1), SIDES)
    values = np.full((16, 20, 30), Tissue.FAT, np.uint8)
    values[:, :, 15:] = Tissue.GLANDULAR
    labels = Volume(values, (1.0,) * 3, (-14.5, -9.5, 0.5))
    materials = materials_of(Scene(draw(1).anatomy, Constants(10.0, 40.0, 80.0)), mesh, labels)
    share = (2 * (1 + NU) * materials.mu - 0.010) / 0.030
    right = mesh.nodes[mesh.cells[:, :4], 0] > 0
    assert share[right].min() > 0.5 > share[~right].max()
    assert materials.kappa == pytest.approx(materials.mu * 2 * (1 + NU) / (3 * (1 - 2 * NU)))


def test_glandular_fibres_have_their_own_stiffness():
    """Fibres are six times stiffer than in fat beyond a plane, and equally stiff elsewhere."""
    mesh = block((1, 1, 1), SIDES)
    values = np.full((16, 20, 30), Tissue.FAT, np.uint8)
    values[:, :, 15:] = Tissue.GLANDULAR
    labels = Volume(values, (1.0,) * 3, (-14.5, -9.5, 0.5))
    scene = Scene(draw(1).anatomy, Constants(10.0, 40.0, 80.0))
    contrast = FibreContrast(6.0, 0.0).apply_to(scene)
    plain, found = materials_of(scene, mesh, labels), materials_of(contrast, mesh, labels)
    assert plain.eta == pytest.approx(np.full(plain.eta.shape, 0.080))
    gland = (2 * (1 + NU) * found.mu - 0.010) / 0.030
    assert found.eta == pytest.approx(0.080 * (1 + 5 * gland))
    assert np.array_equal(found.mu, plain.mu)


def test_deviations_apply_to_materials_springs_and_fibres():
    """With nu = 0.48 instead of 0.49, tissue is half as stiff against volume changes."""
    mesh = block((1, 1, 1), SIDES)
    labels = Volume(np.full((16, 20, 30), Tissue.FAT, np.uint8), (1.0,) * 3, (-14.5, -9.5, 0.5))
    plain = Scene(draw(1).anatomy, Constants(10.0, 40.0, 80.0))
    off = Deviations(nu=0.48, wall_spring_factor=1.5, fibre_tilt_deg=(3.0, 0.0)).apply_to(plain)
    found = materials_of(off, mesh, labels)
    assert found.mu == pytest.approx(np.full(found.mu.shape, 0.010 / 2.96))
    assert found.kappa == pytest.approx(np.full(found.mu.shape, 0.010 / 0.12))
    tilted = [0.0, -np.sin(np.radians(3)), np.cos(np.radians(3))]
    assert found.fibre.reshape(-1, 3) == pytest.approx(np.tile(tilted, (found.mu.size, 1)))
    springs = [wall_of(scene, mesh).spring[..., :2] for scene in (plain, off)]
    assert springs[1] == pytest.approx(1.5 * springs[0])
    assert springs[0].min() > 0

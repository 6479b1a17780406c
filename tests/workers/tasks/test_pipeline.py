"""Phantom > mesh > solve > deform > score, without mocks, on a small breast."""

import math

import numpy as np
import pytest

from palpate.storage.values import Tissue, Volume
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.organs.breast.breast_keys import BreastCase, BreastScore, ImageSpec
from palpate.workers.organs.breast.breast_organ import ORGAN, on_lattice, read_image
from palpate.workers.organs.breast.breast_problem import extent_of
from palpate.workers.tasks import pipeline

MESH = {"nodes": 1200}
PHANTOM = {"preset": "250ml", "spacing_mm": 2.0}


def case(**keys):
    return BreastCase.model_validate({"reference": {"phantom": PHANTOM}, "mesh": MESH} | keys)


def pressed(model, asked, values, extent, target=None):
    return ORGAN.solve(model, ORGAN.problem(model, asked, values, extent, target))


class Breast:
    def __init__(self):
        self.labels = ORGAN.make_body(case().reference)
        self.hierarchy = ORGAN.make_mesh(self.labels, case())
        self.model = prepare(self.hierarchy)
        self.extent = extent_of(self.labels)

        self.done = {}

    def press(self, asked, target=None, **constants):
        key = repr((asked.model_dump_json(), target, constants))
        if key not in self.done:
            values = asked.complete(constants)
            self.done[key] = pressed(self.model, asked, values, self.extent, target)
        solution = self.done[key]
        assert solution.outcome.converged, solution.outcome.reason
        return solution

    def deformed(self, asked, target=None, **constants):
        solution = self.press(asked, target, **constants)
        return ORGAN.deform(self.labels, self.hierarchy, solution.displacement_mm)


@pytest.fixture(scope="module")
def breast():
    return Breast()


@pytest.fixture(scope="module")
def target(breast):
    return breast.deformed(case())


def test_constants_of_the_target_score_minus_infinity(breast, target):
    again = pressed(breast.model, case(), case().complete(), breast.extent)
    body = ORGAN.deform(breast.labels, breast.hierarchy, again.displacement_mm)
    score = ORGAN.scorer(target, BreastScore()).score(body)
    assert (score.jc, score.mhd_mm, score.gsf) == (1.0, 0.0, -math.inf)


def test_score_worsens_away_from_the_target(breast, target):
    scorer = ORGAN.scorer(target, BreastScore())
    gsf = [scorer.score(breast.deformed(case(), E_fat=e)).gsf for e in (0.0105, 0.02)]
    assert gsf == sorted(gsf)
    assert gsf[1] < scorer.score(breast.labels).gsf


def test_skin_modulus_has_no_effect_without_skin(breast):
    soft, stiff = (breast.press(case(), E_skin=e).displacement_mm for e in (0.2, 3.0))
    np.testing.assert_array_equal(soft, stiff)


def test_skin_membrane_stiffens_the_body(breast):
    bare = breast.press(case()).outcome
    skin = case(model={"skin": "membrane"})
    soft, stiff = (breast.press(skin, E_skin=e).outcome for e in (0.2, 3.0))
    assert bare.plate_displacement_mm > soft.plate_displacement_mm > stiff.plate_displacement_mm


def test_unmodelled_skin_behaves_as_fat(breast):
    """Thesis X1: renaming the skin's voxels to fat changes nothing."""
    renamed = breast.labels.values.copy()
    assert (renamed == Tissue.SKIN).any()
    renamed[renamed == Tissue.SKIN] = Tissue.FAT
    plain = Volume(renamed, breast.labels.spacing_mm, breast.labels.origin_mm)
    model = prepare(ORGAN.make_mesh(plain, case()))
    of_fat = pressed(model, case(), case().complete(), breast.extent)
    with_skin = breast.press(case())
    np.testing.assert_array_equal(of_fat.displacement_mm, with_skin.displacement_mm)


def test_force_between_plates_equals_the_requested_force(breast):
    outcome = breast.press(case(load={"force_n": 60.0})).outcome
    assert outcome.plate_force_n == pytest.approx(60.0, rel=1e-6)
    assert outcome.force_imbalance < 1e-3


def test_body_is_compressed_at_the_position_of_the_target(breast):
    asked = case(load={"plate_distance_mm": {"final": 40}})
    # An imaged target from 1 to 41 mm; voxels of 2 mm end within one of the plates.
    lower, upper = extent_of(breast.deformed(asked, target=(1.0, 41.0)))
    assert lower == pytest.approx(1.0, abs=2.0)
    assert upper == pytest.approx(41.0, abs=2.0)


def test_candidate_is_sampled_on_the_voxels_of_the_target(breast):
    fine = Volume(np.zeros((1, 1, 1), np.uint8), (1.5, 1.5, 1.5), (0.3, 0.4, 0.5))
    solution = breast.press(case())
    mesh = breast.hierarchy
    there = ORGAN.deform(breast.labels, mesh, solution.displacement_mm, fine)
    here = ORGAN.deform(breast.labels, mesh, solution.displacement_mm)
    assert there.on_lattice_of(fine)
    count = [np.count_nonzero(v.values == Tissue.FAT) * v.voxel_mm3 for v in (there, here)]
    assert count[0] == pytest.approx(count[1], rel=0.02)


def test_volume_on_its_own_lattice_is_unchanged(breast):
    assert on_lattice(breast.labels, breast.labels) is breast.labels


def test_volume_on_another_lattice_covers_every_corner():
    block = Volume(np.full((4, 4, 4), 2, np.uint8), (2.0, 2.0, 2.0))
    lattice = Volume(np.zeros((1, 1, 1), np.uint8), (1.0, 1.0, 1.0), (0.5, 0.5, 0.5))
    moved = on_lattice(block, lattice)
    assert moved.on_lattice_of(lattice)
    # The faces of the block are on faces of the lattice: 8 voxels for each, and no others.
    assert np.count_nonzero(moved.values == 2) == 8 * 64


def test_image_becomes_tissues_cropped_to_the_body(tmp_path):
    values = np.zeros((6, 8, 8), np.int16)
    values[0:4, 2:6, 2:6] = 7
    values[1:3, 3:5, 3:5] = 9
    np.save(tmp_path / "scan.npy", values)
    labels = {0: "air", 7: "fat", 9: "glandular"}
    spec = ImageSpec(volume=str(tmp_path / "scan.npy"), labels=labels, spacing_mm=1.5)
    volume = read_image(spec)
    assert volume.spacing_mm == (1.5, 1.5, 1.5)
    assert volume.values.shape == (5, 6, 6)
    assert np.count_nonzero(volume.values == Tissue.GLANDULAR) == 8
    assert np.count_nonzero(volume.values == Tissue.FAT) == 64 - 8


def test_watch_adds_up_the_time_of_a_stage():
    watch = pipeline.Watch()
    for _ in range(2):
        with watch.stage("solve"):
            pass
    assert list(watch.seconds) == ["solve"]
    assert watch.seconds["solve"] >= 0

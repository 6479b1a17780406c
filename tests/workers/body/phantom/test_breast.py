"""The generated breast: volume, tissue fractions, anatomy, and repeatability."""

import json

import numpy as np
import pytest

from palpate.storage.values import Tissue
from palpate.workers.body.phantom.compartments import FIRST_ID
from palpate.workers.body.phantom.phantom_generation import (
    choose_compartments,
    generate_breast,
    gland_weight,
)
from palpate.workers.body.phantom.phantom_settings import BreastPhantom


@pytest.fixture(scope="module")
def phantom():
    return generate_breast(BreastPhantom(spacing_mm=0.5), 1)


@pytest.mark.parametrize("preset", ["445ml", "250ml"])
@pytest.mark.parametrize(("spacing", "tolerance"), [(0.5, 5e-4), (1.0, 1e-3), (2.0, 3e-3)])
def test_volume_equals_two_half_ellipsoids(preset, spacing, tolerance):
    settings = BreastPhantom.preset(preset, spacing_mm=spacing)
    phantom = generate_breast(settings, 3)
    body = np.count_nonzero(phantom.labels.values) * spacing**3 / 1000
    assert phantom.facts["volume_ml"] == pytest.approx(body)
    assert body == pytest.approx(settings.outline_ml, rel=tolerance)


@pytest.mark.parametrize("fraction", [0.07, 0.20, 0.35])
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("preset", "spacing"), [("445ml", 1.0), ("250ml", 2.0)])
def test_glandular_fraction_by_volume_is_within_one_percent(preset, spacing, seed, fraction):
    settings = BreastPhantom.preset(preset, spacing_mm=spacing, glandular_fraction=fraction)
    phantom = generate_breast(settings, seed)
    counts = np.bincount(phantom.labels.values.ravel(), minlength=6)
    interior = counts[[Tissue.FAT, Tissue.GLANDULAR, Tissue.LIGAMENT]].sum()
    computed = counts[Tissue.GLANDULAR] / interior
    assert computed == pytest.approx(fraction, rel=0.01)
    assert phantom.facts["glandular_fraction"] == pytest.approx(computed)


def test_glandular_fraction_is_met_by_splitting_a_large_compartment():
    settings = BreastPhantom(spacing_mm=1.0, compartments=20, glandular_fraction=0.07)
    phantom = generate_breast(settings, 2)
    assert phantom.facts["split_compartment"]
    assert phantom.facts["glandular_fraction"] == pytest.approx(0.07, rel=1e-4)


def test_labels_follow_the_compartments_one_to_one(phantom):
    ids, labels = phantom.compartments.values, phantom.labels.values
    assert (ids.dtype, labels.dtype) == (np.uint16, np.uint8)
    assert ids.flags.c_contiguous
    assert labels.flags.c_contiguous
    assert ids.shape == labels.shape == (100, 200, 340)
    for number, tissue in enumerate([Tissue.AIR, Tissue.SKIN, Tissue.LIGAMENT]):
        np.testing.assert_array_equal(ids == number, labels == tissue)
    tissue = ids >= FIRST_ID
    assert set(np.unique(labels[tissue])) == {Tissue.FAT, Tissue.GLANDULAR}
    mixed = sum(
        len(np.unique(labels[ids == i])) > 1 for i in np.unique(ids[labels == Tissue.GLANDULAR])
    )
    assert mixed == phantom.facts["split_compartment"]
    assert len(np.unique(ids[tissue])) == phantom.facts["compartments"]


def test_volumes_have_the_standard_frame(phantom):
    labels = phantom.labels
    assert labels.spacing_mm == (0.5, 0.5, 0.5)
    assert labels.origin_mm == pytest.approx((-49.75, -49.75, 0.25))
    assert phantom.compartments.on_lattice_of(labels)
    zyx = np.argwhere(labels.values > 0)
    low, high = zyx.min(axis=0), zyx.max(axis=0) + 1
    np.testing.assert_array_equal(low, 0)
    np.testing.assert_array_equal(high, labels.values.shape)
    # The slice furthest from the chest wall contains the nipple: x = y = 0.
    tip = zyx[zyx[:, 0] == 99][:, ::-1] * 0.5 + labels.origin_mm
    assert np.abs(tip[:, 1].mean()) < 0.3
    assert -6 < tip[:, 0].min() < 0 < tip[:, 0].max() < 13


def test_gland_is_behind_the_nipple_surrounded_by_fat(phantom):
    labels = phantom.labels
    zyx = np.argwhere(labels.values == Tissue.GLANDULAR)
    x, y, z = (zyx[:, ::-1] * 0.5 + labels.origin_mm).T
    q = (x / np.where(x >= 0, 120, 50)) ** 2 + (y / 50) ** 2
    # Uniform tissue would have mean x = 26 mm, and half of it at sqrt(q) > 0.6 at mid depth.
    assert -5 < x.mean() < 25
    assert abs(y.mean()) < 8
    assert z.mean() > 0.4 * 50
    assert np.mean(np.sqrt(q) < 0.5) > 0.75
    assert np.mean(x > 80) < 0.02


def test_tissue_fractions_do_not_depend_on_the_voxel_size():
    """Layers thinner than a voxel keep their volume: 0.6 mm of ligament at 2 mm."""
    shares = [generate_breast(BreastPhantom(spacing_mm=h), 4).facts for h in (0.5, 1.0, 2.0)]
    for name in ("ligament_fraction", "skin_ml", "interior_ml"):
        values = [facts[name] for facts in shares]
        assert values == pytest.approx([values[0]] * 3, rel=0.03)


def test_has_no_skin_or_ligament_unless_requested():
    labels = generate_breast(BreastPhantom(spacing_mm=2.0, skin_mm=0, ligament_mm=0), 1).labels
    assert set(np.unique(labels.values)) == {Tissue.AIR, Tissue.FAT, Tissue.GLANDULAR}


def test_phantom_is_determined_by_its_seed():
    settings = BreastPhantom(spacing_mm=1.0)
    one, again, other = (generate_breast(settings, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one.compartments.values, again.compartments.values)
    np.testing.assert_array_equal(one.labels.values, again.labels.values)
    assert np.mean(one.labels.values != other.labels.values) > 0.1
    for facts in (one.facts, again.facts):
        assert facts.pop("seconds") > 0
    assert one.facts == again.facts


def test_density_changes_the_tissue_and_not_the_compartments():
    """A denser breast from the same seed contains almost all of the gland of the less dense one."""
    thin, dense = (
        generate_breast(BreastPhantom(spacing_mm=1.0, glandular_fraction=f), 7) for f in (0.1, 0.3)
    )
    np.testing.assert_array_equal(thin.compartments.values, dense.compartments.values)
    gland = thin.labels.values == Tissue.GLANDULAR
    assert np.mean(dense.labels.values[gland] == Tissue.GLANDULAR) > 0.9


def test_facts_are_ready_for_json(phantom):
    assert json.loads(json.dumps(phantom.facts)) == phantom.facts


def test_race_selects_compartments_in_proportion_to_their_odds():
    """First place of an exponential race goes to i with probability w_i / sum w."""
    rng = np.random.default_rng(0)
    voxels, odds = np.full(4, 10), np.array([1.0, 2.0, 3.0, 4.0])
    first = [int(choose_compartments(voxels, odds, 10, rng).whole[0]) for _ in range(4000)]
    share = np.bincount(first, minlength=4) / len(first)
    np.testing.assert_allclose(share, odds / 10, atol=4 * np.sqrt(0.25 / 4000))


def test_last_place_goes_to_a_compartment_that_fits():
    """Select 900 of 1000; then 400 does not fit, and the first later size that fits is 100."""
    voxels, odds = np.array([900, 400, 100, 30]), np.array([1e12, 1e6, 1.0, 1e-6])
    choice = choose_compartments(voxels, odds, 1000, np.random.default_rng(0))
    assert sorted(choice.whole) == [0, 2]
    assert choice.split is None
    choice = choose_compartments(voxels, odds, 1200, np.random.default_rng(0))
    assert (list(choice.whole), choice.split, choice.split_voxels) == ([0], 1, 300)
    choice = choose_compartments(voxels, odds, 904, np.random.default_rng(0))
    assert (list(choice.whole), choice.split) == ([0], None)


def test_odds_of_glandular_tissue_fall_from_the_nipple_axis_to_the_skin():
    settings = BreastPhantom()
    outwards = np.column_stack([np.zeros(20), np.linspace(0, 40, 20), np.full(20, 25.0)])
    assert np.all(np.diff(gland_weight(settings, outwards)) < 0)
    axis = np.column_stack([np.zeros(10), np.zeros(10), np.linspace(5, 49, 10)])
    assert np.all(np.diff(gland_weight(settings, axis)) > 0)


@pytest.mark.slow
def test_full_resolution_takes_seconds():
    settings = BreastPhantom(spacing_mm=0.2)
    generate_breast(BreastPhantom(spacing_mm=2.0), 1)  # compiles
    facts = generate_breast(settings, 1).facts
    assert facts["volume_ml"] == pytest.approx(settings.outline_ml, rel=1e-4)
    assert facts["glandular_fraction"] == pytest.approx(0.2, rel=0.01)
    assert facts["seconds"] < 60  # 2 to 4 s on an idle core

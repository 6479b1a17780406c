"""Scores of shapes with hand-calculated distances, and of random shapes checked by scipy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison import nearest_voxel
from palpate.workers.comparison.similarity_score import Scorer, gsf, score_labels
from palpate.workers.comparison.voxel_set import BOUNDARY, Metric, voxel_set
from tests.workers.comparison.drawings import draw, mhd_by_distance_transforms, of_mask

SPACINGS = [(1.0, 1.0, 1.0), (0.2, 0.2, 0.2), (0.2, 0.2, 0.5), (0.31, 0.7, 1.13)]
SURFACES = ["boundary", "all"]


@pytest.mark.parametrize("surface", SURFACES)
def test_score_of_bars_shifted_by_one_voxel(surface):
    """There is one plane, so every voxel is a boundary voxel.

    ::

        X  ##..     distances to Y: 1 0   mean 1/2
        Y  .##.     distances to X: 0 1   mean 1/2

    One voxel of three is shared: JC = 1/3, Dice = 2/4, GSF = ln(2/3 * 1/2) = -ln 3.
    """
    score = Scorer(draw(".##."), surface=surface).score(draw("##.."))
    assert score.jc == pytest.approx(1 / 3)
    assert score.dice == pytest.approx(1 / 2)
    assert score.mhd_mm == pytest.approx(1 / 2)
    assert score.mhd_voxels == pytest.approx(1 / 2)
    assert score.gsf == pytest.approx(-math.log(3))


def test_the_worse_direction_counts():
    """::

    X  #....    to Y: 0        mean 0
    Y  #...#    to X: 0 4      mean 2
    """
    x, y = draw("#...."), draw("#...#")
    assert Scorer(y).score(x).mhd_mm == pytest.approx(2.0)
    assert Scorer(x).score(y).mhd_mm == pytest.approx(2.0)
    assert Scorer(y).score(x).gsf == pytest.approx(math.log(0.5 * 2.0))


def test_distance_of_a_3_4_5_triangle():
    """::

        X  #....    Y  .....
           .....       .....
           .....       .....
           .....       ....#

    4 along x and 3 along y: 5 voxels. With voxels of 0.3 x 0.4 mm: hypot(1.2, 1.2) mm; in voxels,
    this is divided by the geometric mean of 0.3, 0.4 and 0.6 mm.
    """
    x = "#.... ..... ..... ....."
    y = "..... ..... ..... ....#"
    assert Scorer(draw(y)).score(draw(x)).mhd_mm == pytest.approx(5.0)
    spacing = (0.3, 0.4, 0.6)
    score = Scorer(draw(y, spacing)).score(draw(x, spacing))
    assert score.mhd_mm == pytest.approx(1.2 * math.sqrt(2))
    assert score.mhd_voxels == pytest.approx(1.2 * math.sqrt(2) / 0.072 ** (1 / 3))
    assert score.jc == 0.0


def test_nearest_voxel_may_be_off_the_axis():
    """::

    Y  #....#     The voxel X at column 0, row 2 is 2 from the upper left;
       ......     there is nothing on its own row.
       X.....
    """
    score = Scorer(draw("#....# ...... ......")).score(draw("...... ...... #....."))
    # Y to X: 2 and hypot(5, 2).
    assert score.mhd_mm == pytest.approx((2 + math.hypot(5, 2)) / 2)


def test_score_of_a_cube_in_a_cube():
    """A cube of 3 in the middle of a cube of 5.

    The larger cube has 98 boundary voxels: 54 on faces, at a distance of 1 from the smaller cube,
    36 on edges (sqrt 2) and 8 corners (sqrt 3). All 26 boundary voxels of the smaller are 1 from
    the boundary of the larger, but 0 from the larger as a set. JC = 27/125.
    """
    small, large = np.zeros((7, 7, 7), bool), np.zeros((7, 7, 7), bool)
    small[2:5, 2:5, 2:5] = True
    large[1:6, 1:6, 1:6] = True
    total = 54 + 36 * math.sqrt(2) + 8 * math.sqrt(3)
    boundary = Scorer(of_mask(large), surface="boundary").score(of_mask(small))
    everything = Scorer(of_mask(large), surface="all").score(of_mask(small))
    assert boundary.jc == everything.jc == pytest.approx(27 / 125)
    assert boundary.mhd_mm == pytest.approx(total / 98)
    assert everything.mhd_mm == pytest.approx(total / 125)


def test_edge_of_the_image_is_a_boundary():
    """A cube of 3 that fills its image has 26 boundary voxels, as it does within air.

    The boundary distance to its own middle voxel is (6 + 12 sqrt 2 + 8 sqrt 3) / 26.
    """
    full = of_mask(np.ones((3, 3, 3), bool))
    middle = np.zeros((3, 3, 3), bool)
    middle[1, 1, 1] = True
    expected = (6 + 12 * math.sqrt(2) + 8 * math.sqrt(3)) / 26
    assert Scorer(full).score(of_mask(middle)).mhd_mm == pytest.approx(expected)
    assert Scorer(of_mask(middle)).score(full).mhd_mm == pytest.approx(expected)


def random_pair(rng):
    """Return two masks of random density, sometimes made of separate lumps."""
    shape = rng.integers(2, 22, 3)
    x, y = (rng.random(shape) < rng.choice([0.01, 0.1, 0.5, 0.9]) for _ in range(2))
    x[tuple(rng.integers(0, shape))] = True
    y[tuple(rng.integers(0, shape))] = True
    return x, y


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("spacing", SPACINGS)
def test_scores_of_random_volumes_match_scipy(surface, spacing):
    rng = np.random.default_rng(11)
    for _ in range(15):
        x, y = random_pair(rng)
        score = Scorer(of_mask(y, spacing), surface=surface).score(of_mask(x, spacing))
        expected = mhd_by_distance_transforms(x, y, spacing, surface)
        assert score.mhd_mm == pytest.approx(expected, rel=1e-7)
        assert score.jc == (x & y).sum() / (x | y).sum()


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("spacing", [SPACINGS[0], SPACINGS[3]])
def test_search_method_does_not_change_the_result(surface, spacing, monkeypatch):
    """Local search, line search and distance maps give exactly equal scores."""
    rng = np.random.default_rng(12)
    for _ in range(10):
        x, y = random_pair(rng)
        scores = set()
        for near, far in [(1e9, 1e9), (0.0, 1e9), (0.0, 0.0), (1.0, 0.5)]:
            monkeypatch.setattr(nearest_voxel, "NEAR_LOOKS", near)
            monkeypatch.setattr(nearest_voxel, "FAR_LOOKS", far)
            scores.add(Scorer(of_mask(y, spacing), surface=surface).score(of_mask(x, spacing)))
        assert len(scores) == 1


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("looks", [0.0, 2.0])
def test_boxes_may_differ(surface, looks, monkeypatch):
    """One scorer scores candidates in different boxes, inside and outside the target's box."""
    monkeypatch.setattr(nearest_voxel, "FAR_LOOKS", looks)
    monkeypatch.setattr(nearest_voxel, "NEAR_LOOKS", looks)
    rng = np.random.default_rng(13)
    spacing = np.array([0.5, 1.0, 0.75])
    world = (40, 44, 48)
    place = (slice(15, 25), slice(14, 26), slice(13, 27))
    y = np.zeros(world, bool)
    y[place] = rng.random((10, 12, 14)) < 0.6
    target_origin = np.array([3.0, -1.0, 7.0])
    scorer = Scorer(of_mask(y[place], tuple(spacing), tuple(target_origin)), surface=surface)
    for _ in range(12):
        shape = rng.integers(1, 15, 3)
        start = rng.integers(0, np.array(world) - shape + 1)
        x = np.zeros(world, bool)
        box = tuple(slice(a, a + n) for a, n in zip(start, shape, strict=True))
        x[box] = rng.random(shape) < 0.7
        x[tuple(start)] = True
        shift = (start - [15, 14, 13])[::-1]
        candidate = of_mask(x[box], tuple(spacing), tuple(target_origin + shift * spacing))
        score = scorer.score(candidate)
        expected = mhd_by_distance_transforms(x, y, tuple(spacing), surface)
        assert score.mhd_mm == pytest.approx(expected, rel=1e-9)
        assert score.jc == (x & y).sum() / (x | y).sum()


def test_distances_beyond_the_search_disc_are_exact():
    """Two voxels are 300 apart along y, further than the line search reaches."""
    x, y = np.zeros((1, 301, 4), bool), np.zeros((1, 301, 4), bool)
    x[0, 0, 0] = y[0, 300, 3] = True
    assert Scorer(of_mask(y)).score(of_mask(x)).mhd_mm == pytest.approx(math.hypot(300, 3))


def test_a_line_outside_the_disc_may_be_nearer(monkeypatch):
    """The nearest voxel on X's own row is 100 away, but one 70 rows away, beyond `FAR`, is nearer.

    The local search must then give up instead of returning 100.
    """
    monkeypatch.setattr(nearest_voxel, "FAR_LOOKS", 1e9)
    x, y = np.zeros((1, 80, 101), bool), np.zeros((1, 80, 101), bool)
    x[0, 0, 0] = y[0, 0, 100] = y[0, 70, 0] = True
    box = of_mask(x)
    sets = [voxel_set(of_mask(mask), (Tissue.GLANDULAR,), box) for mask in (x, y)]
    metric = Metric.of_spacing(box.spacing_mm)
    assert nearest_voxel.squared_distances(sets[0], sets[1], BOUNDARY, metric) is None
    y[0, 70, 0] = False
    y[0, 60, 0] = True  # within the disc the result is certain
    other = voxel_set(of_mask(y), (Tissue.GLANDULAR,), box)
    squared = nearest_voxel.squared_distances(sets[0], other, BOUNDARY, metric)
    np.testing.assert_array_equal(squared, [3600])


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), surface=st.sampled_from(SURFACES))
def test_scores_are_symmetric_and_related(seed, surface):
    """Swapping the sets changes nothing; Dice = 2 JC / (JC + 1); GSF follows from JC and MHD."""
    x, y = random_pair(np.random.default_rng(seed))
    a = Scorer(of_mask(y), surface=surface).score(of_mask(x))
    b = Scorer(of_mask(x), surface=surface).score(of_mask(y))
    assert a == b
    assert a.dice == pytest.approx(2 * (x & y).sum() / (x.sum() + y.sum()))
    if not np.array_equal(x, y) and a.mhd_voxels > 0:
        assert a.gsf == pytest.approx(math.log((1 - a.jc) * a.mhd_voxels))


@pytest.mark.parametrize("surface", SURFACES)
def test_identical_volumes_have_a_perfect_score(surface):
    x = of_mask(np.random.default_rng(1).random((5, 6, 7)) < 0.4, (0.3, 0.3, 0.9))
    score = Scorer(x, surface=surface).score(x)
    assert score.as_dict() == {
        "jc": 1.0,
        "dice": 1.0,
        "mhd_mm": 0.0,
        "mhd_voxels": 0.0,
        "gsf": -math.inf,
    }


def test_solid_has_zero_distance_to_its_boundary_layer():
    """A cube of 3 without its middle voxel has the cube's boundary voxels: MHD is 0."""
    full = np.ones((3, 3, 3), bool)
    skin = full.copy()
    skin[1, 1, 1] = False
    score = Scorer(of_mask(full)).score(of_mask(skin))
    assert score.jc == pytest.approx(26 / 27)
    assert score.mhd_mm == 0.0
    assert score.gsf == -math.inf


def test_empty_candidate_is_the_worst():
    target = of_mask(np.ones((2, 2, 2), bool))
    score = Scorer(target).score(of_mask(np.zeros((2, 2, 2), bool)))
    assert (score.jc, score.dice, score.mhd_mm, score.mhd_voxels) == (0.0, 0.0, math.inf, math.inf)
    assert score.gsf == math.inf


def test_geometric_similarity_function():
    """ln(0.5 * 2) = 0; a shift by one voxel that halves JC gives ln 0.5."""
    assert gsf(0.5, 2.0) == 0.0
    assert gsf(0.5, 1.0) == pytest.approx(-0.6931471805599453)
    assert gsf(0.0, math.inf) == math.inf
    assert gsf(1.0, 0.0) == -math.inf


def test_several_labels_are_scored_together_or_separately():
    """::

    target     FGGS     fat JC 1; glandular 1 of 2 shared; skin 1 of 2 shared;
    candidate  FGSS     glandular with skin: the same 3 voxels
    """
    F, G, S = Tissue.FAT, Tissue.GLANDULAR, Tissue.SKIN
    target = Volume(np.array([[[F, G, G, S]]], np.uint8), (1.0, 1.0, 1.0))
    candidate = Volume(np.array([[[F, G, S, S]]], np.uint8), (1.0, 1.0, 1.0))
    apart = score_labels(target, candidate, (F, G, S))
    assert {label: score.jc for label, score in apart.items()} == {F: 1.0, G: 0.5, S: 0.5}
    assert apart[G].mhd_mm == pytest.approx(0.5)
    assert Scorer(target, (G, S)).score(candidate).jc == 1.0


def test_accepts_other_integer_types():
    mask = np.array([[[1, 0, 1]]], bool)
    wide = Volume(of_mask(mask).values.astype(np.int64), (1.0, 1.0, 1.0))
    assert Scorer(wide).score(of_mask(mask)).jc == 1.0


def test_refuses_invalid_input():
    target = of_mask(np.ones((2, 2, 2), bool))
    empty = of_mask(np.zeros((2, 2, 2), bool))
    with pytest.raises(InputError, match=r"no glandular voxel.*\[1\]"):
        Scorer(empty)
    with pytest.raises(InputError, match="not AIR"):
        Scorer(target, (Tissue.AIR,))
    with pytest.raises(InputError, match="'boundary' or 'all'"):
        Scorer(target, surface="edge")
    with pytest.raises(InputError, match="different lattices"):
        Scorer(target).score(of_mask(np.ones((2, 2, 2), bool), (1.0, 1.0, 1.1)))
    with pytest.raises(InputError, match="different lattices"):
        Scorer(target).score(of_mask(np.ones((2, 2, 2), bool), origin_mm=(0.5, 0.0, 0.0)))
    with pytest.raises(InputError, match="float64"):
        Scorer(target).score(Volume(np.ones((2, 2, 2)), (1.0, 1.0, 1.0)))
    with pytest.raises(InputError, match="from 0 to 255"):
        Scorer(target).score(Volume(np.full((2, 2, 2), 300), (1.0, 1.0, 1.0)))

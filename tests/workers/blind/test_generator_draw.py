"""The distribution of random cases, and terms shared with the diagnosis."""

import ast
import json
from collections import Counter
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from palpate import workers
from palpate.storage.errors import InputError
from palpate.workers.blind.breast_scene import Scene
from palpate.workers.blind.random_case import BY_KIND, KINDS, SINGLES, draw
from palpate.workers.organs.breast.breast_effects import BREAST_EFFECTS

FAMILIES = {e.name: e.family for e in BREAST_EFFECTS}
ROOM = Path(workers.__file__).parent


def test_shares_sum_to_one_and_match_the_draws():
    assert sum(KINDS.values()) == pytest.approx(1)
    kinds = Counter(draw(seed).kind for seed in range(600))
    for kind, share in KINDS.items():
        assert abs(kinds[kind] - 600 * share) < 4.5 * np.sqrt(600 * share)


def test_shares_follow_the_protocol():
    assert 0.15 <= KINDS["control"] <= 0.2
    assert KINDS["pair"] == 0.1
    assert KINDS["triple"] == 0.04
    assert KINDS["plate_force"] == 0.05
    assert sum(KINDS[cause.kind] for cause in SINGLES) == pytest.approx(0.5)
    others = [k for k, cause in BY_KIND.items() if cause.effect is None]
    assert sum(KINDS[k] for k in others) == pytest.approx(0.13)
    unlike = [k for k in others if BY_KIND[k].family is None]
    assert unlike == ["wall_rise"]


def test_case_is_determined_by_its_seed():
    for kind in (None, "inclusion", "pair", "triple"):
        assert draw(17, kind) == draw(17, kind)
    assert draw(17).anatomy != draw(18).anatomy


def test_body_constants_and_forces_do_not_depend_on_the_kind():
    cases = [draw(5, kind) for kind in KINDS]
    for case in cases:
        assert case.anatomy == cases[0].anatomy
        assert case.constants == cases[0].constants
        assert case.loads == cases[0].loads
        assert case.noise_sd_mm == cases[0].noise_sd_mm
        assert case.kind in KINDS


@pytest.mark.parametrize("kind", BY_KIND)
def test_every_cause_uses_terms_of_the_catalogue(kind):
    cause = BY_KIND[kind]
    assert cause.kind == kind
    if cause.effect is not None:
        assert cause.family == FAMILIES[cause.effect]
    elif cause.family is not None:
        assert cause.family in FAMILIES.values()


@pytest.mark.parametrize("kind", BY_KIND)
def test_every_cause_changes_the_scene_but_not_the_body(kind):
    for seed in range(5):
        truth = draw(seed, kind)
        nominal = Scene(truth.anatomy, truth.constants)
        changed = [
            f.name
            for f in fields(Scene)
            if getattr(truth.scene, f.name) != getattr(nominal, f.name)
        ]
        assert len(changed) == 1
        assert changed[0] not in ("anatomy", "constants")


@pytest.mark.parametrize("kind", [k for k in BY_KIND if k != "segmentation"])
def test_fields_of_a_cause_are_finite_everywhere_in_the_box(kind):
    for seed in range(10):
        truth = draw(seed, kind)
        scene, body = truth.scene, truth.anatomy
        points = np.random.default_rng(0).uniform(-1, 1, (200, 3)) * body.half_mm + body.centre_mm
        at_least_zero = (*scene.friction, scene.wall_compliance, scene.wall_grip, scene.skin_grip)
        either = (*scene.ln_stiffness, scene.ln_gland_fibres, scene.wall_rise_mm)
        for f in (*at_least_zero, *either):
            if f is not None:
                values = f(points)
                assert values.shape == (200,)
                assert np.isfinite(values).all()
        for f in at_least_zero:
            assert f is None or f(points).min() >= 0
        for grown in scene.growth:
            assert -0.05 < grown(points, np.ones(200)).min() <= grown(points, np.ones(200)).max()
            assert grown(points, np.ones(200)).max() < 0.2
        if scene.fibres is not None:
            assert np.linalg.norm(scene.fibres(points), axis=1) == pytest.approx(1)


@pytest.mark.parametrize(("kind", "count"), [("pair", 2), ("triple", 3)])
def test_simultaneous_causes_have_different_effects(kind, count):
    """An adhesion and a tether are one effect; five of 60 triples would otherwise combine them."""
    for seed in range(60):
        truth = draw(seed, kind)
        assert len(truth.causes) == len(truth.families) == count
        assert len(set(truth.effects)) == count
        assert all(type(c) in SINGLES for c in truth.causes)


def test_magnitudes_have_the_documented_ranges():
    """Ranges from the classes, evenly spread on a logarithmic scale."""
    ranges = {
        "swelling": ("volume_fraction", 0.01, 0.12),
        "oedema": ("volume_fraction", 0.05, 0.5),
        "short_plate": ("edge_mm", 2.0, 8.0),
        "wall_rise": ("rise_mm", 0.8, 6.0),
        "adhesion": ("grip_kpa_per_mm", 0.3, 10.0),
    }
    for kind, (name, low, high) in ranges.items():
        sizes = np.abs([getattr(draw(seed, kind).causes[0], name) for seed in range(200)])
        assert low <= sizes.min() < low * (high / low) ** 0.1
        assert high * (low / high) ** 0.1 < sizes.max() <= high
        assert np.median(np.log(sizes)) == pytest.approx(np.log(low * high) / 2, abs=0.3)


def test_glandular_fibres_are_stiffer_or_softer_than_fat():
    ratios = np.log([draw(seed, "fibre_contrast").causes[0].ratio for seed in range(200)])
    assert np.log(1.5) <= np.abs(ratios).min() < np.abs(ratios).max() <= np.log(15.0)
    assert 60 < np.count_nonzero(ratios > 0) < 140


def test_image_scale_is_too_large_or_too_small_along_one_axis():
    scales = np.array([draw(seed, "image_scale").causes[0].scale for seed in range(200)])
    assert (np.count_nonzero(scales, axis=1) == 1).all()
    assert (np.count_nonzero(scales, axis=0) > 40).all()
    sizes = np.abs(scales).sum(axis=1)
    assert 0.003 <= sizes.min() < 0.004
    assert 0.018 < sizes.max() <= 0.02
    assert 60 < np.count_nonzero(scales.sum(axis=1) > 0) < 140


def test_lumps_are_inside_the_body():
    for seed in range(50):
        truth = draw(seed, "inclusion")
        lump, body = truth.causes[0], truth.anatomy
        x, y, z = lump.centre_mm
        along = body.upper_mm if x > 0 else body.lower_mm
        assert (x / along) ** 2 + (y / body.half_width_mm) ** 2 + (z / body.depth_mm) ** 2 < 1
        assert z >= lump.radius_mm
        # The volume is that of a ball of the lump's radius, whatever the stretch.
        inside = truth.scene.ln_stiffness[0]
        sharp = replace(lump, fade=0.0).apply_to(Scene(body, truth.constants)).ln_stiffness[0]
        cloud = np.random.default_rng(1).uniform(-30, 30, (40_000, 3)) + lump.centre_mm
        share = np.count_nonzero(sharp(cloud)) / len(cloud)
        assert share * 60**3 == pytest.approx(4 / 3 * np.pi * lump.radius_mm**3, rel=0.25)
        assert inside(np.array([lump.centre_mm]))[0] == pytest.approx(np.log(lump.ratio))


def test_loads_use_both_axes_with_increasing_forces():
    loads = draw(3).loads
    assert [load.axis for load in loads] == ["y", "y", "x", "x"]
    assert loads[0].force_n < loads[1].force_n
    assert loads[2].force_n < loads[3].force_n
    assert [load.axis for load in draw(3, one_direction=True).loads] == ["y", "y"]
    assert draw(3, one_direction=True).causes == draw(3).causes


def test_record_is_complete_plain_json():
    for kind in KINDS:
        record = json.loads(json.dumps(draw(8, kind).record()))
        assert record["kind"] == kind
        for cause in record["causes"]:
            assert set(cause["parameters"]) == {f.name for f in fields(BY_KIND[cause["kind"]])}


@pytest.mark.parametrize("seed", [-1, 1.5, True, "3"])
def test_refuses_invalid_seeds(seed):
    with pytest.raises(InputError, match="seed"):
        draw(seed)


def test_error_for_an_unknown_kind_lists_the_kinds():
    with pytest.raises(InputError, match="bent_plate"):
        draw(1, "bending")


def imports_of(folder: Path) -> set[str]:
    modules = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                modules |= {node.module} | {f"{node.module}.{a.name}" for a in node.names}
            elif isinstance(node, ast.Import):
                modules |= {a.name for a in node.names}
    return modules


def test_generator_and_diagnosis_share_no_physics():
    theirs = (
        "palpate.workers.mechanics.fem",
        "palpate.workers.mechanics.effects",
        "palpate.workers.diagnosis",
        "palpate.workers.comparison.observation",
    )
    assert not [name for name in imports_of(ROOM / "blind") if name.startswith(theirs)]
    rooms = ("body", "mechanics", "comparison", "diagnosis", "organs")
    for room in rooms:
        assert any((ROOM / room).rglob("*.py"))
        assert not [n for n in imports_of(ROOM / room) if n.startswith("palpate.workers.blind")]

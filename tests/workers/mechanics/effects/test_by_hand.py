"""Changes made by each effect, worked out by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.boundary_value_problem import (
    Constants,
    FibreField,
    Frame,
    Gradient,
    Inclusion,
    Membrane,
)
from palpate.workers.mechanics.fem.loads_and_regions import (
    Attachment,
    DistanceControl,
    NoPlates,
    Wall,
)
from palpate.workers.mechanics.materials.polynomial_laws import Yeoh
from palpate.workers.mechanics.model_parameters import KPA_PER_MM, MM_PER_KPA, N_PER_M
from palpate.workers.organs.breast.breast_effects import CATALOGUE
from tests.workers.mechanics.effects.lopsided import HALF_MM, busy, plain

effect = CATALOGUE.named
FRAME = Frame((1.0, -2.0, 20.0), tuple(HALF_MM))


def test_gravity_effects_add_a_body_force():
    moved = effect("gravity_change").apply(busy(), {"gravity_y": 0.5}, FRAME)
    assert moved.gravity_g == (0.1, 0.7, 0.3)
    assert moved.imaged_gravity_g == busy().imaged_gravity_g
    both = effect("gravity_prestress").apply(plain(), {"common_gravity": 1.0}, FRAME)
    assert both.gravity_g == both.imaged_gravity_g == (0.0, 0.0, 1.0)


def test_plate_effects_change_force_shape_and_edge():
    half = effect("plate_force").apply(plain(), {"ln_plate_force": math.log(0.5)}, FRAME)
    assert half.load.force_n == pytest.approx(10.0)
    at_distance = replace(plain(), load=DistanceControl(-20.0, 20.0))
    assert not effect("plate_force").acts_on(at_distance, FRAME)
    # 2 mm at 50 mm is a curvature of 2 * 2 / 2500 per mm.
    bent = effect("plate_flex").apply(at_distance, {"flex_depth": 2.0}, FRAME)
    assert bent.load.device.upper.bow_per_mm == pytest.approx((0.0, 1.6e-3))
    tilted = effect("plate_tilt").apply(busy(), {"tilt_depth": 3.0, "tilt_across": 1.0}, FRAME)
    assert tilted.load.device.upper.tilt_deg == (4.0, -1.0)
    assert tilted.load.device.lower == busy().load.device.lower
    shorter = effect("plate_edge").apply(plain(), {"plate_edge": 7.0}, FRAME)
    wall_mm = 20.0 - HALF_MM[2]
    # The rounding of 2 mm is in front of the edge.
    rounded = 2.0 * (1 - np.exp(-3.5))
    assert shorter.load.device.edge_mm == pytest.approx(wall_mm + 7.0 + rounded)
    further = effect("plate_edge").apply(shorter, {"plate_edge": 1.0}, FRAME)
    assert further.load.device.edge_mm == pytest.approx(wall_mm + 8.0 + rounded)
    loose = replace(plain(), load=NoPlates())
    for name in ("plate_edge", "plate_force", "plate_tilt", "plate_flex", "plate_friction"):
        assert not effect(name).acts_on(loose, FRAME)


def test_compressibility_contrast_changes_only_glandular_tissue():
    """From nu = 0.49, 1 - 2 nu = 0.02, to three times that."""
    moved = effect("compressibility_contrast").apply(
        plain(), {"ln_compressibility_contrast": math.log(3.0)}, FRAME
    )
    was = plain().constants
    assert moved.constants[Tissue.FAT] == was[Tissue.FAT]
    expected = (1 - 3 * (1 - 2 * was[Tissue.GLANDULAR].poisson)) / 2
    assert moved.constants[Tissue.GLANDULAR].poisson == pytest.approx(expected)
    assert moved.constants[Tissue.GLANDULAR].young_mpa == was[Tissue.GLANDULAR].young_mpa


def test_image_shear_equals_the_shear_matrix():
    points = np.random.default_rng(3).uniform(-30.0, 30.0, (40, 3))
    normals = np.random.default_rng(4).standard_normal((40, 3))
    tissues = np.full(40, Tissue.FAT)
    values = {"shear_xy": 0.01, "shear_xz": -0.02, "shear_yz": 0.03}
    matrix = np.array([[0.0, 0.01, -0.02], [0.0, 0.0, 0.03], [0.0, 0.0, 0.0]])
    moved = (points - np.asarray(FRAME.centre_mm)) @ matrix.T
    found = effect("image_shear").shift(points, normals, tissues, values, FRAME)
    np.testing.assert_allclose(found, (moved * normals).sum(axis=1), atol=1e-12)


def test_wall_compliance_acts_in_series_and_wall_hold_in_parallel():
    """Compliances add in series, springs in parallel."""
    compliance = MM_PER_KPA.to_inside(0.1)
    assert compliance == 100.0
    wall = effect("wall_compliance").apply(plain(), {"wall_compliance": compliance}, FRAME).wall
    assert wall == Wall((False, False, False), (0.0, 0.0, 0.01))
    sprung = effect("wall_compliance").apply(busy(), {"wall_compliance": compliance}, FRAME).wall
    assert sprung.spring_mpa_per_mm[2] == pytest.approx(1 / (100.0 + 1 / 3e-3))
    hold = {"wall_hold_x": KPA_PER_MM.to_inside(0.5)}
    held = effect("wall_hold").apply(busy(), hold, FRAME).wall
    assert held.spring_mpa_per_mm == pytest.approx((6e-4, 2e-4, 3e-3))
    glued = replace(plain(), wall=Wall((True, True, True)))
    assert not effect("wall_hold").acts_on(glued, FRAME)


def test_attachment_is_added_to_existing_ones():
    """The middle of the body is at (1, -2, 20) mm."""
    where = {"attachment_x": 10.0, "attachment_z": -20.0, "attachment_radius": 8.0}
    held = effect("local_attachment").apply(
        plain(), where | {"attachment_stiffness_y": KPA_PER_MM.to_inside(0.5)}, FRAME
    )
    assert held.attachments == (Attachment((0.0, 5e-4, 0.0), (11.0, -2.0, 0.0), 8.0),)
    again = effect("local_attachment").apply(held, {"attachment_stiffness_x": 1e-3}, FRAME)
    assert again.attachments == (
        *held.attachments,
        Attachment((1e-3, 0.0, 0.0), (1.0, -2.0, 20.0), 12.0),
    )
    assert effect("local_attachment").apply(plain(), where, FRAME).attachments == ()


def test_growth_and_fibre_contrast_change_only_their_tissue():
    grown = effect("growth").apply(plain(), {"ln_growth_glandular": math.log(1.1)}, FRAME)
    assert grown.constants[Tissue.GLANDULAR].growth == pytest.approx(1.1)
    assert grown.constants[Tissue.FAT] == plain().constants[Tissue.FAT]
    contrast = effect("fibre_contrast").apply(plain(), {"ln_fibre_contrast": math.log(3.0)}, FRAME)
    was = plain().constants
    fibre = contrast.constants[Tissue.GLANDULAR].fibre_mpa
    assert was[Tissue.GLANDULAR].fibre_mpa > 0
    assert fibre == pytest.approx(3 * was[Tissue.GLANDULAR].fibre_mpa)
    assert contrast.constants[Tissue.FAT] == was[Tissue.FAT]
    only_fat = replace(plain(), constants={Tissue.FAT: was[Tissue.FAT]})
    assert not effect("fibre_contrast").acts_on(only_fat, FRAME)


def test_variations_keep_their_order():
    gradient = effect("stiffness_gradient").apply(plain(), {"ln_gradient_y": 0.4}, FRAME)
    assert gradient.variations == (Gradient((0.0, 0.4, 0.0), FRAME),)
    where = {"inclusion_ln_ratio": 2.0, "inclusion_x": 10.0, "inclusion_z": -5.0}
    lump = effect("inclusion").apply(gradient, where, FRAME)
    assert lump.variations == (
        Gradient((0.0, 0.4, 0.0), FRAME),
        Inclusion(2.0, (11.0, -2.0, 15.0), 6.0),
    )


def test_fibre_effects_turn_the_fibre_direction():
    turned = effect("fibre_rotation").apply(plain(), {"fibre_turn_y": 10.0}, FRAME)
    direction = turned.fibres.directions(np.zeros((1, 3)))[0]
    assert direction == pytest.approx((0.0, math.sin(math.radians(10)), math.cos(math.radians(10))))
    fanned = effect("fibre_fan").apply(turned, {"fibre_fan_x": 20.0}, FRAME)
    edge = np.array([[FRAME.centre_mm[0] + FRAME.half_mm[0], 0.0, 0.0]])
    a = fanned.fibres.directions(edge)[0]
    assert a[0] / a[2] == pytest.approx(math.tan(math.radians(20)))
    assert a[1] / a[2] == pytest.approx(math.tan(math.radians(10)))
    own = replace(plain(), fibres=FibreField(fan_deg=(5.0, 0.0), frame=Frame()))
    assert effect("fibre_fan").apply(own, {"fibre_fan_y": 1.0}, FRAME).fibres.frame == Frame()


def test_second_fibres_are_normal_to_compression_and_first_fibres():
    s = math.sqrt(0.5)
    oblique = plain()
    device = replace(oblique.load.device, axis=(s, s, 0.0))
    oblique = replace(oblique, load=replace(oblique.load, device=device))
    second = effect("second_fibres").apply(oblique, {"second_fibres": 0.01}, FRAME)
    assert second.fibres.second_axis == (-s, s, 0.0)
    assert {c.second_fibre_mpa for c in second.constants.values()} == {0.01}
    turned = replace(second, fibres=replace(second.fibres, second_axis=(1.0, 0.0, 0.0)))
    more = effect("second_fibres").apply(turned, {"second_fibres": 0.01}, FRAME)
    assert more.fibres.second_axis == (1.0, 0.0, 0.0)
    assert more.constants[Tissue.FAT].second_fibre_mpa == 0.02


def test_material_effects_scale_the_constants():
    at = {"ln_compressibility": math.log(2.0)}
    soft = effect("compressibility").apply(plain(), at, FRAME)
    fat, was = soft.constants[Tissue.FAT], plain().constants[Tissue.FAT]
    assert fat.poisson == pytest.approx(0.48)
    assert fat.young_mpa == was.young_mpa
    assert fat.kappa_mpa == pytest.approx(was.kappa_mpa / 2)
    with pytest.raises(InputError, match="needs E > 0 and 0 < nu"):
        effect("compressibility").apply(plain(), {"ln_compressibility": 4.0}, FRAME)
    crept = effect("creep").apply(busy(), {"creep": 0.25}, FRAME)
    assert crept.constants[Tissue.FAT] == Constants(0.0075, 0.49, 0.015)
    assert crept.membrane == Membrane(0.375, 1.5)
    stiffer = effect("strain_stiffening").apply(plain(), {"stiffening": 1.5}, FRAME)
    assert stiffer.constants[Tissue.GLANDULAR].stiffening == 1.5


def test_creep_scales_a_chosen_law():
    """Creep multiplies the energy, and therefore stress and tangent."""
    own = replace(plain().constants[Tissue.FAT], law=Yeoh(0.002, 0.001))
    base = replace(plain(), constants={Tissue.FAT: own})
    law = effect("creep").apply(base, {"creep": 0.25}, FRAME).constants[Tissue.FAT].law
    F = np.eye(3) + 0.2 * np.random.default_rng(3).standard_normal((3, 3))
    weaker = Yeoh(0.0015, 0.00075)
    assert law.energy(F) == pytest.approx(weaker.energy(F), rel=1e-14)
    np.testing.assert_allclose(law.stress(F), weaker.stress(F), rtol=1e-12)
    np.testing.assert_allclose(law.tangent(F), weaker.tangent(F), rtol=1e-12, atol=1e-18)
    assert law.shear_modulus_mpa == pytest.approx(0.003)
    stiffer = effect("strain_stiffening").apply(base, {"stiffening": 1.0}, FRAME)
    assert stiffer.constants[Tissue.FAT] == own


def test_skin_effects_add_or_scale_stiffness():
    added = N_PER_M.to_inside(1500.0)
    assert added == 1.5
    made = effect("skin_added").apply(plain(), {"skin_added": added}, FRAME).membrane
    assert made.young_mpa * made.thickness_mm == pytest.approx(1.5)
    more = effect("skin_added").apply(busy(), {"skin_added": added}, FRAME).membrane
    assert more == Membrane(1.5, 1.5)
    scaled = effect("skin_scaled").apply(busy(), {"ln_skin": math.log(3.0)}, FRAME).membrane
    assert scaled.young_mpa == pytest.approx(1.5)
    assert scaled.thickness_mm == 1.5


def test_image_scale_moves_the_skin_outwards():
    """1 % along x, 40 mm from the middle: 0.4 mm where the skin faces x, 3/5 of it elsewhere."""
    points = np.array([[41.0, -2.0, 20.0], [41.0, 28.0, 20.0]])
    normals = np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0]])
    tissues = np.full(2, Tissue.FAT)
    seen = effect("image_scale").shift(points, normals, tissues, {"scale_x": 0.01}, FRAME)
    assert seen == pytest.approx([0.4, 0.24])

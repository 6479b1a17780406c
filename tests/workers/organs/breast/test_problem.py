"""Constants of each tissue and positions of the plates, calculated by hand."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.mechanics.fem.loads_and_regions import DistanceControl, ForceControl
from palpate.workers.organs.breast.breast_effects import BREAST_MODEL
from palpate.workers.organs.breast.breast_keys import LoadSpec, ModelSpec
from palpate.workers.organs.breast.breast_problem import (
    check_skin_layer,
    extent_of,
    materials_of,
    plates_of,
    problem_of,
)

FORCE = LoadSpec(force_n=100)
BODY = (-50.0, 50.0)


def problem(skin="none", **constants):
    return problem_of(ModelSpec(skin=skin), FORCE, BREAST_MODEL.complete(constants), BODY)


def distance(**keys):
    return LoadSpec.model_validate({"plate_distance_mm": keys})


def test_ligaments_are_fat():
    of = problem(E_fat=0.012).constants
    assert of[Tissue.LIGAMENT] == of[Tissue.FAT]
    assert (of[Tissue.FAT].young_mpa, of[Tissue.FAT].fibre_mpa) == (0.012, 0.1)
    assert (of[Tissue.GLANDULAR].young_mpa, of[Tissue.GLANDULAR].fibre_mpa) == (0.04, 0.15)


def test_muscle_is_fat_unless_given_constants():
    assert problem().constants[Tissue.MUSCLE] == problem().constants[Tissue.FAT]
    stated = problem(E_muscle=0.06).constants
    assert stated[Tissue.MUSCLE].young_mpa == 0.06
    assert stated[Tissue.FAT].young_mpa == 0.01


def test_without_skin_its_voxels_are_fat():
    assert problem("none").constants[Tissue.SKIN] == problem().constants[Tissue.FAT]
    assert problem("none").membrane is None


def test_a_membrane_covers_fat():
    wrapped = problem_of(
        ModelSpec(skin="membrane", skin_thickness_mm=1.2), FORCE, BREAST_MODEL.complete(), BODY
    )
    assert wrapped.constants[Tissue.SKIN] == wrapped.constants[Tissue.FAT]
    assert (wrapped.membrane.young_mpa, wrapped.membrane.thickness_mm) == (1.6, 1.2)


def test_a_layer_of_skin_is_a_tissue_without_fibres():
    layered = problem("layer", E_skin=0.9)
    assert layered.membrane is None
    assert layered.constants[Tissue.SKIN].young_mpa == 0.9
    assert layered.constants[Tissue.SKIN].fibre_mpa == 0


@pytest.mark.parametrize(
    ("skin", "materials"), [("none", [0, 1, 2, 1, 4, 1]), ("layer", [0, 1, 2, 3, 4, 1])]
)
def test_tissues_of_one_material_are_meshed_as_one(skin, materials):
    every = Volume(np.arange(6, dtype=np.uint8).reshape(1, 1, 6), (1.0, 1.0, 1.0))
    assert materials_of(every, ModelSpec(skin=skin)).values.ravel().tolist() == materials


def test_every_solid_tissue_has_constants():
    assert set(problem().constants) == set(Tissue) - {Tissue.AIR}


def test_fibres_run_from_chest_wall_to_nipple_and_act_only_in_tension():
    assert problem().fibres.axis == (0, 0, 1)
    assert not problem().literal_fibre
    literal = problem_of(ModelSpec(fibres="literal"), FORCE, BREAST_MODEL.complete(), BODY)
    assert literal.literal_fibre


def test_an_oblique_view_turns_the_plates_and_their_distance():
    """A box of 8 x 4 mm seen along its diagonal is 12 / sqrt(2) mm thick."""
    box = Volume(np.ones((2, 4, 8), np.uint8), (1, 1, 1), (-3.5, -1.5, 0.5))
    assert extent_of(box, 45.0) == pytest.approx((-12 / 8**0.5, 12 / 8**0.5))
    load = LoadSpec(force_n=100, oblique_deg=45, moving="both")
    device = plates_of(load, (-5, 5)).device
    assert device.axis == pytest.approx((-(0.5**0.5), 0.5**0.5, 0))
    assert device.lower_share == 0.5


def test_effects_are_constants_of_the_model():
    held = problem(wall_hold_x=1e-3, friction=0.3)
    assert held.wall.spring_mpa_per_mm == (1e-3, 0, 0)
    assert held.load.device.friction == 0.3
    assert problem() == problem(wall_hold_x=0.0)


def test_under_a_force_the_plates_start_at_the_body():
    assert plates_of(FORCE, BODY) == ForceControl(100, -50, 50)
    assert plates_of(FORCE, BODY, target=(0.0, 60.0)) == ForceControl(100, -50, 50)


def test_plates_end_centred_on_the_body():
    assert plates_of(distance(final=60), (-40.0, 60.0)) == DistanceControl(-20, 40)


def test_plates_end_centred_on_the_imaged_target():
    # The compressed body of the image reaches from 86 to 152: its middle is at 119.
    load = distance(initial=126.7, final=65)
    assert plates_of(load, (39.0, 167.0), target=(86.0, 152.0)) == DistanceControl(86.5, 151.5)


def test_plates_end_at_given_positions():
    assert plates_of(distance(lower=3, upper=30), BODY, (5.0, 9.0)) == DistanceControl(3, 30)


def test_the_extent_ends_at_the_outer_faces_of_the_outermost_voxels():
    #  y index   0 1 2 3 4      centres at 10, 12, 14, 16, 18 mm
    #            . # # # .      faces at 11 and 17 mm
    values = np.zeros((1, 5, 2), np.uint8)
    values[0, 1:4, 0] = Tissue.FAT
    assert extent_of(Volume(values, (1.0, 2.0, 1.0), (0.0, 10.0, 0.0))) == (11.0, 17.0)


def test_air_has_no_extent():
    with pytest.raises(InputError, match="all air"):
        extent_of(Volume(np.zeros((2, 2, 2), np.uint8), (1.0, 1.0, 1.0)))


def box_with_skin(skin_voxels):
    """A block of 40 mm on the wall, its five free sides covered; voxels of 1 mm."""
    values = np.zeros((44, 48, 48), np.uint8)
    values[:40, 4:44, 4:44] = Tissue.SKIN if skin_voxels else Tissue.FAT
    inner = slice(4 + skin_voxels, 44 - skin_voxels)
    values[: 40 - skin_voxels, inner, inner] = Tissue.FAT
    return Volume(values, (1.0, 1.0, 1.0))


def test_elements_as_small_as_the_skin_is_thick_resolve_it():
    check_skin_layer(box_with_skin(4), element_size_mm=3.0)


def test_message_names_sizes_of_elements_and_skin():
    # Volume over area makes the edges of the block a little thinner than 4 mm.
    with pytest.raises(InputError, match=r"is 3\.\d mm thick, the elements are 8 mm.*membrane"):
        check_skin_layer(box_with_skin(4), element_size_mm=8.0)


def test_a_layer_needs_voxels_of_skin():
    with pytest.raises(InputError, match="needs skin voxels, but the body has none"):
        check_skin_layer(box_with_skin(0), element_size_mm=1.0)

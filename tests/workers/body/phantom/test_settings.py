"""Settings of a breast phantom: presets, the voxel box, and refusals."""

import math

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.body.phantom.phantom_settings import BreastPhantom


def test_default_is_the_445_ml_body():
    settings = BreastPhantom()
    assert settings == BreastPhantom.preset("445ml")
    assert settings.outline_ml == pytest.approx(math.pi / 3 * 5 * 5 * 17)
    assert settings.shape_xyz == (170, 100, 50)


def test_250_ml_preset_is_170_by_75_by_37_5_mm():
    settings = BreastPhantom.preset("250ml", spacing_mm=0.5)
    assert settings.shape_xyz == (340, 150, 75)
    assert settings.outline_ml == pytest.approx(250, abs=0.5)


def test_full_resolution_box_is_106_million_voxels():
    assert BreastPhantom(spacing_mm=0.2).shape_xyz == (850, 500, 250)


@pytest.mark.parametrize("spacing", [0.2, 0.3, 0.7, 1.0, 1.3, 2.0])
@pytest.mark.parametrize("preset", ["445ml", "250ml"])
def test_box_covers_the_body_and_mid_planes_are_voxel_faces(preset, spacing):
    settings = BreastPhantom.preset(preset, spacing_mm=spacing)
    first = np.array(settings.origin_mm)
    last = first + (np.array(settings.shape_xyz) - 1) * spacing
    half, rounding = spacing / 2, 1e-6
    body_first = np.array([-settings.lower_mm, -settings.half_width_mm, 0.0])
    body_last = np.array([settings.upper_mm, settings.half_width_mm, settings.depth_mm])
    assert np.all(first - half <= body_first + rounding)
    assert np.all(last + half >= body_last - rounding)
    faces = (first - half) / spacing
    np.testing.assert_allclose(faces, np.rint(faces), atol=1e-9)
    assert faces[2] == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("spacing_mm", 0.19),
        ("spacing_mm", 2.1),
        ("spacing_mm", math.nan),
        ("glandular_fraction", 0.06),
        ("glandular_fraction", 0.36),
        ("glandular_fraction", "0.2"),
        ("skin_mm", -0.1),
        ("ligament_mm", 3.5),
        ("ligament_mm", math.inf),
        ("depth_mm", 0.0),
        ("lower_mm", None),
        ("compartments", 19),
        ("compartments", 4001),
        ("compartments", 100.5),
        ("compartments", True),
    ],
)
def test_invalid_setting_is_refused_with_name_and_value(name, value):
    with pytest.raises(InputError, match=name) as caught:
        BreastPhantom(**{name: value})
    assert repr(value) in str(caught.value)


def test_refuses_box_too_large_for_memory():
    with pytest.raises(InputError, match="larger spacing_mm"):
        BreastPhantom(upper_mm=250, lower_mm=250, half_width_mm=150, depth_mm=150, spacing_mm=0.2)


def test_unknown_names_are_refused_with_a_list():
    with pytest.raises(InputError, match="445ml, 250ml"):
        BreastPhantom.preset("450ml")
    with pytest.raises(InputError, match="glandular_fraction"):
        BreastPhantom.preset("445ml", glandularity=0.2)


@pytest.mark.parametrize("seed", [-1, 1.5, True, "1", None])
def test_refuses_invalid_seed(seed):
    with pytest.raises(InputError, match="seed"):
        generate_breast(BreastPhantom(spacing_mm=2.0), seed)


def test_accepts_numpy_scalars():
    settings = BreastPhantom(spacing_mm=np.float64(2.0), compartments=np.int64(60))
    assert generate_breast(settings, np.int64(3)).facts["compartments"] > 20


def test_refuses_ligaments_that_leave_no_room_for_gland():
    settings = BreastPhantom(
        spacing_mm=2.0, ligament_mm=3.0, compartments=4000, glandular_fraction=0.35
    )
    with pytest.raises(InputError, match="ligament_mm"):
        generate_breast(settings, 1)

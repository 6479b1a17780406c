"""Plausibility checks of the frames of a cornea."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from palpate.storage.errors import InputError
from palpate.workers.common_keys import validated
from palpate.workers.organs.cornea.cornea_checks import CHECKS
from palpate.workers.organs.cornea.cornea_keys import CorneaCase, CorneaScore, CorneaTarget
from palpate.workers.organs.cornea.cornea_organ import ORGAN
from palpate.workers.organs.cornea.section_measures import shape_of
from palpate.workers.organs.cornea.tonometer_frames import coloured_pixels, read_frame
from palpate.workers.organs.plausibility_rule import Finding
from tests.cases.cornea.painted_frames import (
    DENTED,
    MIDDLE_MM,
    PIXEL_MM,
    REST,
    Brush,
    eye,
    painted,
    pixels_of,
    resized,
    saved,
    surface_pixels,
)

FOLDERS = [p / "shared/data/corvis_profiles" for p in Path(__file__).resolve().parents]
RED = (255, 0, 0)
ORIENTATION = 274


def findings(
    folder: Path, rest: Any = REST, dented: Any = DENTED, pixel_mm: Any = PIXEL_MM, **case: Any
) -> list[Finding]:
    """Return the findings about two frames, written to files and read again."""
    frames = [saved(p, folder / f"{n}.png") for n, p in (("rest", rest), ("jet", dented))]
    for frame in frames:
        frame["pixel_mm"] = list(pixel_mm)
    return pair_findings(*frames, **case)


def pair_findings(reference: dict[str, Any], target: dict[str, Any], **more: Any) -> list[Finding]:
    case = validated(CorneaCase, {"organ": "cornea", "reference": {"frame": reference}} | more)
    goal = validated(CorneaTarget, {"frame": target})
    bodies = ORGAN.make_body(case.reference), ORGAN.make_body(goal)
    return [*CHECKS.of_case(case), *CHECKS.of_bodies(case, goal, CorneaScore(), *bodies)]


def only(found: list[Finding]) -> str:
    """Return the text of the only finding, which must be a refusal."""
    assert [one.severity for one in found] == ["implausible"]
    return found[0].text


@pytest.mark.parametrize("dent_mm", [0.1, 0.5, 1.2])
def test_accepts_good_pairs_of_frames(tmp_path: Path, dent_mm: float) -> None:
    assert findings(tmp_path, dented=pixels_of(eye(dent_mm), 3)) == []


def test_accepts_the_corvis_pair_and_names_the_motion_of_the_eye() -> None:
    corvis = next((folder for folder in FOLDERS if folder.is_dir()), None)
    if corvis is None:
        pytest.skip("shared/data/corvis_profiles is not on this machine")
    pixel_mm = [0.00628272, 0.00663455]
    rest = {"file": str(corvis / "pair_rest_0.00ms.png"), "pixel_mm": pixel_mm}
    jet = {"file": str(corvis / "pair_deformed_18.27ms.png"), "pixel_mm": pixel_mm}
    found = pair_findings(rest, jet | {"first_pixel": [-3, 91]})
    assert [one.severity for one in found] == ["warning"]
    assert "move by -0.25 mm along y and turn by +1.1 degrees" in found[0].text


@pytest.mark.parametrize("orientation", [2, 3, 4, 5, 6, 7, 8])
def test_applies_the_exif_orientation(tmp_path: Path, orientation: int) -> None:
    """The pixels are stored turned or mirrored; the tag gives the orientation."""
    stored = {
        2: REST[:, ::-1],
        3: REST[::-1, ::-1],
        4: REST[::-1],
        5: REST.T,
        6: np.rot90(REST),
        7: REST[::-1, ::-1].T,
        8: np.rot90(REST, -1),
    }[orientation]
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    file = tmp_path / "turned.png"
    Image.fromarray(np.ascontiguousarray(stored)).save(file, exif=exif)
    np.testing.assert_array_equal(read_frame(file, PIXEL_MM).grey, REST)


def test_measures_radius_thickness_and_width(tmp_path: Path) -> None:
    frame = saved(REST, tmp_path / "rest.png")
    case = validated(CorneaCase, {"organ": "cornea", "reference": {"frame": frame}})
    shape = shape_of(ORGAN.make_body(case.reference))
    assert shape.radius_mm == pytest.approx(7.8, abs=0.03)
    assert shape.central_thickness_mm == pytest.approx(0.595, abs=0.01)
    assert shape.width_mm == pytest.approx(2 * MIDDLE_MM, abs=0.03)


def test_names_the_scale_of_frames_exported_at_half_size(tmp_path: Path) -> None:
    first, second = findings(tmp_path, resized(REST, 0.5), resized(DENTED, 0.5))
    assert "radius of the anterior surface is 3.9 mm (usual for a cornea: 6 to 10 mm)" in first.text
    assert "the central thickness is 0.302 mm (usual for a cornea: 0.4 to 0.75 mm)" in first.text
    assert "the width shown is 4.48 mm (usual for a cornea: 6 to 14 mm)" in first.text
    for one in (first, second):
        assert one.severity == "implausible"
        assert "exported at 0.5 times its size: set pixel_mm to [0.03125, 0.033]" in one.text


def test_names_the_scale_of_frames_exported_at_double_size(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"at 2 times its size: set pixel_mm to \[0.0078125, 0.0"):
        findings(tmp_path, resized(REST, 2), resized(DENTED, 2))


def test_names_the_scale_of_a_frame_stretched_along_one_axis(tmp_path: Path) -> None:
    found = findings(tmp_path, resized(REST, 1, 2), resized(DENTED, 1, 2))
    assert "exported at 1 x 2 times its size: set pixel_mm to [0.015625, 0.00825]" in found[0].text


def test_the_scale_that_is_named_is_accepted(tmp_path: Path) -> None:
    named = (0.03125, 0.033)
    assert findings(tmp_path, resized(REST, 0.5), resized(DENTED, 0.5), named) == []


def test_refuses_frames_of_two_scales(tmp_path: Path) -> None:
    rest = saved(REST, tmp_path / "rest.png")
    other = saved(DENTED, tmp_path / "jet.png") | {"pixel_mm": [1.05 * s for s in PIXEL_MM]}
    assert "both have 576 columns" in only(pair_findings(rest, other))
    smaller = saved(resized(DENTED, 0.7), tmp_path / "jet.png")
    assert "576 and 403 columns" in only(pair_findings(rest, smaller))


def test_refuses_a_thickness_that_was_not_corrected_for_refraction(tmp_path: Path) -> None:
    frames = [saved(p, tmp_path / f"{n}.png") for n, p in enumerate((REST, DENTED))]
    for frame in frames:
        del frame["refraction"]  # the default corrects what these frames show already
    found = pair_findings(*frames)
    assert "set refraction: null" in found[0].text


def test_refuses_swapped_frames(tmp_path: Path) -> None:
    assert "look swapped" in only(findings(tmp_path, DENTED, REST))


def test_refuses_two_frames_without_a_jet(tmp_path: Path) -> None:
    assert "cannot be measured" in only(findings(tmp_path, dented=pixels_of(eye(), 5)))


def test_refuses_frames_upside_down(tmp_path: Path) -> None:
    text = only(findings(tmp_path, REST[::-1].copy(), DENTED[::-1].copy()))
    assert "curves into the eye" in text
    assert "upside down" in text


def test_names_a_picture_that_is_turned_by_90_degrees(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"rest\.png.*is rotated by 90 degrees"):
        findings(tmp_path, np.rot90(REST).copy(), np.rot90(DENTED).copy())


@pytest.mark.parametrize(
    ("brush", "where"),
    [
        (lambda d: d.line(surface_pixels(eye()), fill=RED, width=2), "columns 0 to 575"),
        (lambda d: d.line(surface_pixels(eye(), 6), fill=(0, 255, 0)), "columns 0 to 575"),
        (lambda d: d.line([(288, 0), (288, 239)], fill=(255, 255, 0)), "columns 288 to 288"),
    ],
    ids=["red line on the surface", "green line above it", "yellow crosshair"],
)
def test_refuses_coloured_lines_on_the_cornea(tmp_path: Path, brush: Brush, where: str) -> None:
    text = only(findings(tmp_path, painted(REST, brush)))
    assert "coloured pixels on or near the cornea" in text
    assert where in text


def test_refuses_a_coloured_line_on_the_target(tmp_path: Path) -> None:
    drawn = painted(DENTED, lambda d: d.line(surface_pixels(eye(1.0)), fill=RED, width=2))
    assert "jet.png (target.frame) has" in only(findings(tmp_path, dented=drawn))


def test_warns_of_colours_next_to_the_cornea(tmp_path: Path) -> None:
    logo = painted(REST, lambda d: d.text((5, 5), "OD", fill=(0, 120, 255), font_size=20))
    (found,) = findings(tmp_path, logo)
    assert found.severity == "warning"
    assert "next to the cornea in columns 6 to 32" in found.text


def test_a_tint_of_the_whole_picture_is_no_annotation() -> None:
    assert not coloured_pixels(REST[:, :, None] * np.array([0.6, 0.8, 1.0])).any()


@pytest.mark.parametrize(
    ("brush", "cause"),
    [
        (lambda d: d.ellipse((250, 10, 330, 60), fill=(255,) * 3), "a reflection or text"),
        (lambda d: d.polygon([(0, 0), (200, 0), (0, 110)], fill=(120,) * 3), "a lid"),
        (lambda d: d.rectangle((0, 0, 575, 25), fill=(200,) * 3), "columns 0 to 575, rows 0 to 25"),
    ],
    ids=["reflection", "lid", "frame of a window"],
)
def test_names_the_likely_cause_if_no_cornea_is_found(
    tmp_path: Path, brush: Brush, cause: str
) -> None:
    with pytest.raises(InputError) as error:
        findings(tmp_path, painted(REST, brush))
    assert "rest.png" in str(error.value)
    assert cause in str(error.value)


def test_refuses_text_on_the_surface(tmp_path: Path) -> None:
    def text(draw: Any) -> None:
        draw.text((230, 20), "OD 15 mmHg", fill=(255,) * 3, font_size=24)

    refusal = only(findings(tmp_path, painted(REST, text)))
    assert "the anterior surface deviates by 0.1" in refusal
    assert "full brightness, such as a reflection or text (columns 347 to 359" in refusal


def test_warns_of_a_motion_of_the_whole_eye(tmp_path: Path) -> None:
    moved = pixels_of(eye(1.0, (0.0, -0.2)), 2)
    (found,) = findings(tmp_path, dented=moved)
    assert found.severity == "warning"
    assert "move by -0.20 mm along y" in found.text
    assert "Search eye_shift_y_mm and eye_tilt_deg" in found.text
    assert findings(tmp_path, dented=moved, constants={"eye_shift_y_mm": -0.2}) == []
    turned = pixels_of(eye(1.0, tilt_deg=10.0), 2)
    assert "an eye moves by less than" in only(findings(tmp_path, dented=turned))


def test_refuses_a_file_with_several_images(tmp_path: Path) -> None:
    file = tmp_path / "movie.tif"
    images = [Image.fromarray(pixels) for pixels in (REST, DENTED)]
    images[0].save(file, save_all=True, append_images=images[1:])
    with pytest.raises(InputError, match="has 2 images; expected one"):
        read_frame(file, PIXEL_MM)


@pytest.mark.parametrize(
    ("stated", "text"),
    [
        ({"section": {"radius_mm": 3.6}}, "radius_mm is 3.6 mm; the radius of a cornea is 6 to 10"),
        ({"section": {"central_mm": 595}}, "central_mm is 595 mm; the central thickness"),
        ({"section": {"chord_mm": 4.5}}, "chord_mm is 4.5 mm; the width of a section is 6 to 14"),
    ],
)
def test_refuses_a_generated_section_unlike_a_cornea(stated: dict[str, Any], text: str) -> None:
    case = validated(CorneaCase, {"organ": "cornea", "reference": stated})
    assert text in only(list(CHECKS.of_case(case)))


def test_refuses_pressures_in_other_units() -> None:
    load = {"iop_mmhg": 2.0, "jet": {"pressure_kpa": 15_000}}
    case = validated(CorneaCase, {"organ": "cornea", "load": load})
    iop, jet = (finding.text for finding in CHECKS.of_case(case))
    assert "iop_mmhg is 2 mmHg; the pressure of an eye is 4 to 70 mmHg" in iop
    assert "pressure_kpa is 15000 kPa" in jet


STUDY = """
name: frames
case:
  organ: cornea
  reference: {{frame: {{file: rest.png, pixel_mm: {pixel}, refraction: null}}}}
  mesh: {{elements: 60}}
  load: {{iop_mmhg: 15, jet: {{pressure_mmhg: 112.5}}}}
target: {{frame: {{file: jet.png, pixel_mm: {pixel}, refraction: null}}}}
search: {{parameters: {{mu1_pa: [1, 40000], alpha1: [0.1, 100]}}, population: 4, generations: 1}}
"""


def test_run_ends_with_exit_code_2_and_evaluates_nothing(tmp_path: Path) -> None:
    saved(resized(REST, 0.5), tmp_path / "rest.png")
    saved(resized(DENTED, 0.5), tmp_path / "jet.png")
    (tmp_path / "study.yaml").write_text(STUDY.format(pixel=list(PIXEL_MM)))
    command = [sys.executable, "-m", "palpate", "run", "study.yaml", "--workers", "1"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert "rest.png (case.reference.frame)" in done.stderr
    assert "set pixel_mm to [0.03125, 0.033]" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.glob("**/evaluations/*.json"))

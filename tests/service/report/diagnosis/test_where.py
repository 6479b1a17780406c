"""Pictures of the gap: positions and colours."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from palpate.service.diagnosis.diagnosis_run import FinishedDiagnosis
from palpate.service.report.diagnosis import diagnosis_tables as tables
from palpate.service.report.diagnosis import gap_pictures as where
from palpate.service.report.diagnosis.diagnosis_page import render_diagnosis
from palpate.service.report.diagnosis.gap_maps import (
    FAINT_COLOUR,
    SIDES,
    UNKNOWN_COLOUR,
    Solid,
    seen_from_all_sides,
    surface_map,
    triangle_colours,
    view_basis,
)
from palpate.service.report.diagnosis.gap_pictures import (
    CAUSE_COLOURS,
    GLAND_IN_BOTH,
    IN_BOTH,
    OVERLAY_COLOURS,
    QUIET_LABEL,
    TOO_LITTLE,
    TOO_MUCH,
    overlay_labels,
    overlays,
    score_colours,
    score_labels,
)
from palpate.service.report.drawing.colours import BLUE, SIGNED, VERMILION, ColourScale, to_rgba
from palpate.service.report.drawing.volume_sections import VIEWS, Section, section
from palpate.storage.values import Volume
from tests.service.report.diagnosis_at_hand import found as without_bodies
from tests.service.report.diagnosis_at_hand import summary
from tests.service.report.diagnosis_bodies_at_hand import LUMP_MM, SCANS, egg, found
from tests.service.report.pages import Page


@pytest.fixture(scope="module")
def whole() -> FinishedDiagnosis:
    return found()


@pytest.fixture(scope="module")
def source(whole: FinishedDiagnosis) -> str:
    return render_diagnosis(whole)


@pytest.fixture(scope="module")
def page(source: str) -> Page:
    return Page(source)


def test_page_with_bodies_is_self_contained_and_small(source: str, page: Page) -> None:
    page.needs_no_other_file()
    assert page.drawings()
    assert len(source) < 3e6
    assert render_diagnosis(found()) == source


def test_every_scan_has_map_and_sections(page: Page) -> None:
    labels = [drawing.get("aria-label", "") for drawing in page.drawings()]
    told = [label.split(":")[0] for label in labels if "Scan at" in label]
    assert told == [f"Scan at {name}" for name in SCANS] * 2


def test_without_a_named_effect_there_is_one_column_and_no_arrow() -> None:
    alone = Page(render_diagnosis(found(named=False, verdict="none-of-these", something_else=True)))
    assert "with plate tilt" not in alone.text
    cells = [row for row in alone.cells if row and row[0] == "40 N along x"]
    assert cells
    assert all("→" not in cell for row in cells for cell in row)


def test_both_sides_together_show_the_plates_along_x_and_along_y() -> None:
    for face in np.concatenate([np.eye(3)[:2], -np.eye(3)[:2]]):
        assert max(face @ view_basis(way)[2] for _, way in SIDES) > 0.4
    for _, way in SIDES:
        across, up, near = view_basis(way)
        np.testing.assert_allclose(np.cross(across, up), near, atol=1e-12)
        assert up[2] > 0.7  # the nipple points upwards
        assert near[2] > 0.4  # and towards the viewer


def square(z: float) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[0, 0, z], [4, 0, z], [4, 4, z], [0, 4, z]], float)
    return corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def test_a_triangle_has_the_colour_of_its_nearest_point() -> None:
    """Two triangles: the point of one is within the noise, the other's is not."""
    vertices, triangles = square(0.0)
    points = np.array([[3.0, 1.0, 0.0], [1.0, 3.0, 0.0]])
    values, spread = np.array([-1.0, 0.15]), np.array([0.1, 0.1])
    one = Solid("outline", vertices, triangles, points)
    scale = ColourScale(SIGNED, 2.0)
    colours = triangle_colours(one, values, spread, scale)
    np.testing.assert_allclose(colours[0], scale.at(np.array(-1.0)))
    np.testing.assert_allclose(colours[1], to_rgba(FAINT_COLOUR)[:3])
    far = Solid("outline", vertices + 50.0, triangles, points)
    for colour in triangle_colours(far, values, spread, scale):
        np.testing.assert_allclose(colour, to_rgba(UNKNOWN_COLOUR)[:3])


def test_nearer_triangles_hide_farther_ones() -> None:
    low, triangles = square(0.0)
    high, _ = square(1.0)
    vertices = np.concatenate([high, low])
    both = np.concatenate([triangles, triangles + 4])
    points = np.array([[2.0, 2.0, 1.0], [2.0, 2.0, 0.0]])
    for seen in seen_from_all_sides([Solid("outline", vertices, both, points)]):
        rows, columns = seen.front.shape
        assert seen.front[rows // 2, columns // 2] in (0, 1)
        # The upper square is complete; an edge of the lower one is visible below it.
        shown = np.bincount(seen.front[seen.front >= 0], minlength=4)
        assert shown[0] == pytest.approx(shown[1], rel=0.02)
        assert 0 < shown[2:].sum() < shown[:2].sum() / 2
        assert seen.front[0].max() == -1  # there is air around


def test_every_solid_is_drawn_from_both_sides_for_each_model() -> None:
    vertices, triangles = square(0.0)
    points = np.array([[3.0, 1.0, 0.0], [1.0, 3.0, 0.0]])
    seen = seen_from_all_sides([Solid("outline", vertices, triangles, points)])
    rows = {
        "nominal model": {"outline": (np.array([1.0, -1.0]), np.full(2, 0.1))},
        "with plate tilt": {"outline": (np.zeros(2), np.full(2, 0.1))},
    }
    drawn = surface_map(seen, rows, 1.0)
    images = [part for part in drawn.parts if part.startswith("<image")]
    assert len(images) == 4 + 1  # and the scale
    assert images[0] != images[2]
    text = " ".join(drawn.parts)
    for title in rows:
        assert title in text
    for side, _ in SIDES:
        assert text.count(side) == 2


def test_scans_and_models_share_colour_scale(whole: FinishedDiagnosis, page: Page) -> None:
    maps = whole.maps
    loud = np.abs(maps["local_before"])[np.abs(maps["local_before"]) >= 0.2]
    assert np.quantile(loud, 0.98) > 0.5
    labels = [image for image in page.drawings() if "outside" in _text(image)]
    ticks = [
        sorted(t for t in _text(image).split() if t.lstrip("−").replace(".", "").isdigit())
        for image in labels
    ]
    assert len(ticks) == 2
    assert ticks[0] == ticks[1]


def _text(image: object) -> str:
    return " ".join(image.itertext())  # type: ignore[attr-defined]


def test_sections_are_compared_voxel_by_voxel() -> None:
    """Body b, gland g; the model has both one column too far to the right::

    scan  .bgb.
    model ..bgb
    """
    seen = Section(np.array([[0, 1, 2, 1, 0]], np.uint8), (1.0, 1.0), (0.0, 0.0))
    model = Section(np.array([[0, 0, 1, 2, 1]], np.uint8), (1.0, 1.0), (0.0, 0.0))
    labels = overlay_labels(seen, model).values[0].tolist()
    assert labels == [0, TOO_LITTLE, TOO_LITTLE, TOO_MUCH, TOO_MUCH]
    same = overlay_labels(seen, seen).values[0].tolist()
    assert same == [0, IN_BOTH, GLAND_IN_BOTH, IN_BOTH, 0]


def test_excess_is_vermilion_and_missing_tissue_is_blue() -> None:
    assert OVERLAY_COLOURS[0, 3] == 0
    assert OVERLAY_COLOURS[TOO_MUCH].tolist() == [*bytes.fromhex(VERMILION[1:]), 255]
    assert OVERLAY_COLOURS[TOO_LITTLE].tolist() == [*bytes.fromhex(BLUE[1:]), 255]


def test_excess_length_is_marked_at_ends() -> None:
    """Along x the model is 6 mm longer at each end, along y and z it fits."""
    seen, model = egg(np.array([18.0, 16.0, 14.0])), egg(np.array([24.0, 16.0, 14.0]))
    for view in VIEWS:
        shown = overlay_labels(section(seen, view, 0.0), section(model, view, 0.0))
        if view.name == "transverse":
            assert TOO_MUCH not in shown.values
            continue
        line = shown.values[len(shown.values) // 2]
        assert {line[5], line[-6]} == {TOO_MUCH}
        assert shown.extent_mm[:2] == (-30.75, 30.75)


def test_sections_align_with_axes() -> None:
    """The frame is the scan's; parts of the model outside are cut off."""
    seen, model = egg(np.array([18.0, 16.0, 14.0])), egg(np.array([27.0, 16.0, 14.0]))
    drawing = ElementTree.fromstring(
        str(overlays(seen, {"nominal model": model}, (0.0, 0.0, 0.0)).markup("sections"))
    )
    images = list(drawing.iter("image"))
    axes = [p.get("d", "") for p in drawing.iter("path") if "H" in p.get("d", "")]
    assert len(images) == len(axes) == 3
    for image, path in zip(images, axes, strict=True):
        x, y, width, height = (float(image.get(k, 0)) for k in ("x", "y", "width", "height"))
        left, top, bottom, right = (float(number) for number in re.findall(r"[\d.]+", path))
        assert left - 3 < x < x + width < right + 3
        assert top - 3 < y < y + height < bottom + 3


def test_the_map_of_causes_is_drawn_where_the_lump_is(whole: FinishedDiagnosis) -> None:
    frame = whole.maps["cause_frame"]
    scores = Volume(whole.maps["cause_before"], tuple(frame[0]), tuple(frame[1]))
    colours = ColourScale(CAUSE_COLOURS, 6.2)
    coronal = section(score_labels(scores, colours), VIEWS[0], LUMP_MM[2])
    pixels = score_colours(colours)[coronal.values].astype(int)
    left, right, bottom, top = coronal.extent_mm
    rows, columns, _ = pixels.shape
    column = int((LUMP_MM[0] - left) / (right - left) * columns)
    row = int((LUMP_MM[1] - bottom) / (top - bottom) * rows)
    red, green, _, _ = pixels[row, column]
    assert red > 1.5 * green  # purple: stiffer
    # The opposite sign on the other side.
    red, green, _, _ = pixels[rows - 1 - row, columns - 1 - column]
    assert green > red


def test_cause_map_uses_the_whole_colour_scale() -> None:
    """From the softest to the stiffest: both ends of the scale have their colours."""
    scores = np.array([np.nan, -4.0, -1.9, 0.0, 1.9, 4.0], np.float32).reshape(1, 1, 6)
    colours = ColourScale(CAUSE_COLOURS, 4.0)
    labels = score_labels(Volume(scores, (1.0, 1.0, 1.0)), colours).values.ravel()
    assert (labels[2:5] == QUIET_LABEL).all()
    shown = score_colours(colours)[labels].astype(int)
    assert shown[0, 3] == 0
    for pixel, stop in zip(shown[[1, 5]], (CAUSE_COLOURS[0], CAUSE_COLOURS[-1]), strict=True):
        np.testing.assert_allclose(pixel, [*bytes.fromhex(stop[1:]), 255], atol=2)


def test_cause_map_caption_compares_with_noise(whole: FinishedDiagnosis) -> None:
    told = whole.summary.cause_map
    assert told is not None
    assert where.cause_words(told).startswith(
        "stiffer tissue at x = 8, y = −4, z = 2 mm (the cross) would explain the gap best. Its "
        "score of 6.2 is more than noise alone reaches anywhere"
    )
    quiet = replace(told, before=replace(told.before, score=-2.1))
    assert "softer tissue" in where.cause_words(quiet)
    assert "Its score of −2.1 is no more than noise alone" in where.cause_words(quiet)


def test_overlap_is_shown_before_and_after_with_its_attainable_value(
    whole: FinishedDiagnosis, page: Page
) -> None:
    told_rows = whole.summary.overlap
    assert told_rows is not None
    rows = tables.overlap_table(told_rows)
    assert [(r.scan, r.interface) for r in rows] == [
        ("40 N", "outline"),
        ("40 N", "glandular"),
        ("40 N along x", "outline"),
        ("40 N along x", "glandular"),
    ]
    told = told_rows[0]
    assert rows[0].jc == (f"{told.before.jc:.3f}", "1.000")
    assert rows[0].gsf[1] == "−∞"  # the same voxels
    shown = next(row for row in page.cells if row[:2] == ["40 N", "outline"] and "→" in row[2])
    assert " ".join(shown[2].split()) == (f"{rows[0].jc[0]} → 1.000 ({told.reachable_jc:.3f})")


def test_shows_known_percentiles_of_regions() -> None:
    regions = [r | {"p50_mm": 0.2, "p95_mm": 0.714} for r in summary()["where"]]
    page = Page(render_diagnosis(without_bodies(summary(where=regions))))
    row = next(r for r in page.cells if r[:3] == ["80 N", "glandular", "nipple third"])
    assert row[5:7] == ["0.20", "0.71"]

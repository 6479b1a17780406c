"""Exact areas and distances against shapes calculated by hand and against rasterised ones."""

import math
import time

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section_comparison import SectionTarget, overlap_areas
from palpate.workers.organs.cornea.section_mesh import deformed_section, mesh_section
from palpate.workers.organs.cornea.section_outline import Section, generated_section
from tests.workers.organs.cornea.section.rasterised import rasterised_score

SECTION = generated_section()
MESH = mesh_section(SECTION, 960, (-1.5, 1.5))


def dented(depth_mm: float, width_mm: float = 2.0, centre_mm: float = 0.0) -> Section:
    x = MESH.nodes_mm[:, 0]
    down = depth_mm * np.exp(-(((x - centre_mm) / width_mm) ** 2))
    aside = 0.05 * depth_mm * x * np.exp(-((x / 3) ** 2))
    return deformed_section(SECTION, MESH, np.column_stack([aside, -down]))


def box(x0: float, y0: float, x1: float, y1: float) -> FloatArray:
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def slab(x0: float, y0: float, x1: float, y1: float) -> Section:
    x = np.linspace(x0, x1, 5)
    return Section(
        anterior_mm=np.column_stack([x, np.full(5, y1)]),
        posterior_mm=np.column_stack([x, np.full(5, y0)]),
    )


def test_areas_match_hand_calculation() -> None:
    assert overlap_areas(box(0, 0, 2, 2), box(1, 1, 4, 3)) == pytest.approx((4, 6, 1))
    assert overlap_areas(box(0, 0, 1, 1), box(2, 0, 3, 1)) == pytest.approx((1, 1, 0))
    diamond = np.array([[0.5, -0.5], [1.5, 0.5], [0.5, 1.5], [-0.5, 0.5]])
    assert overlap_areas(box(0, 0, 1, 1), diamond) == pytest.approx((1, 2, 1))
    # A C-shape, which a vertical line cuts into several pieces, and a bar through its opening.
    c = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 2], [3, 2], [3, 3], [0, 3]], dtype=float)
    assert overlap_areas(c, box(2, -1, 2.5, 4)) == pytest.approx((7, 2.5, 1))


def test_areas_of_rotated_squares_match_the_octagon() -> None:
    square = box(-1, -1, 1, 1)
    for angle in np.linspace(0.01, np.pi / 4, 7):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        # Circumscribed about the unit circle, so area = perimeter / 2 = sum of tangents.
        exact = 4 * (math.tan(angle / 2) + math.tan(np.pi / 4 - angle / 2))
        area_a, area_b, both = overlap_areas(square @ turn.T, square)
        assert (area_a, area_b, both) == pytest.approx((4, 4, exact))


def test_score_of_a_shifted_slab_matches_hand_calculation() -> None:
    score = SectionTarget(slab(0, 0, 10, 1)).score(slab(0, 0.1, 10, 1.1))
    assert score.jc == pytest.approx(0.9 / 1.1)
    # Long sides are 0.1 mm apart. The short sides coincide over 0.9 mm; the rest, 0.1 mm on each
    # of two edges, is 0.05 mm away on average. Near the corners, the distance of a long side
    # inside the other slab falls towards the edge: 2 (0.1^2 / 2) less.
    length = 2 * 10 + 2 * 1
    total = 2 * 10 * 0.1 - 2 * 0.1**2 / 2 + 2 * 0.1 * 0.05
    assert score.mhd_um == pytest.approx(1000 * total / length, rel=1e-4)
    assert score.gsf == pytest.approx(math.log((1 - score.jc) * score.mhd_um / 2))


def test_identical_sections_have_no_distance() -> None:
    score = SectionTarget(dented(0.9)).score(dented(0.9))
    assert score.jc == 1.0
    assert score.mhd_um < 1e-9
    assert score.gsf == -math.inf


@pytest.mark.parametrize(
    "candidate",
    [(0.88,), (0.6,), (0.0,), (0.9, 2.0, 0.2), (0.9, 1.2), (2.5,)],
    ids=["close", "stiffer", "undeformed", "off-centre", "narrow", "snapped"],
)
def test_score_matches_rasterised_sections(candidate: tuple[float, ...]) -> None:
    exact = SectionTarget(dented(0.9), pixel_um=4.0).score(dented(*candidate))
    jc, mhd_um = rasterised_score(dented(*candidate), dented(0.9), pixel_um=4.0)
    assert exact.jc == pytest.approx(jc, abs=2e-4)
    # Rasterised distances are between pixel centres.
    assert abs(exact.mhd_um - mhd_um) < 0.25 * 4.0


def test_difference_from_rasterised_score_falls_with_pixel_size() -> None:
    exact = SectionTarget(dented(0.9)).score(dented(0.6, 1.5, 0.3))
    errors = []
    for pixel_um in (16.0, 4.0):
        jc, mhd_um = rasterised_score(dented(0.6, 1.5, 0.3), dented(0.9), pixel_um)
        errors.append((abs(jc - exact.jc), abs(mhd_um - exact.mhd_um)))
    assert errors[1][0] < 0.5 * errors[0][0]
    assert errors[1][1] < 0.5 * errors[0][1]


def test_score_is_symmetric_and_falls_for_closer_sections() -> None:
    a, b = dented(0.9), dented(0.6, 1.5, 0.3)
    there, back = SectionTarget(a).score(b), SectionTarget(b).score(a)
    assert (there.jc, there.mhd_um) == pytest.approx((back.jc, back.mhd_um))
    scores = [SectionTarget(a).score(dented(d)).gsf for d in (0.2, 0.5, 0.8, 0.89)]
    assert np.all(np.diff(scores) < 0)


def test_scoring_takes_less_than_20_ms() -> None:
    target, candidate = SectionTarget(dented(0.9)), dented(0.6)
    target.score(candidate)
    durations = []
    for _ in range(20):
        begin = time.perf_counter()
        target.score(candidate)
        durations.append(time.perf_counter() - begin)
    # 2.5 ms on one core; the fastest of many, as other work may hold the core.
    assert min(durations) < 0.020


def test_rejects_invalid_targets() -> None:
    with pytest.raises(InputError, match="positive size"):
        SectionTarget(SECTION, pixel_um=0.0)
    with pytest.raises(InputError, match="no area"):
        SectionTarget(slab(0, 1, 10, 1))

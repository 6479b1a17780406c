"""The noise-free gap, against exactly known maps of the body."""

import numpy as np
import pytest

from palpate.service.blind.case_truth import Moved
from palpate.service.blind.true_gap import NEIGHBOURS, drawn_mm, material_points, true_gap
from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray

AXES = np.array([45.0, 30.0, 35.0])


def ellipsoid(count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return points on the upper part of an ellipsoid, and their outward normals."""
    drawn = np.random.default_rng(seed).normal(size=(6 * count, 3))
    unit = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    unit = unit[unit[:, 2] > 0.2][:count]
    normals = unit / AXES
    return unit * AXES, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def pressed(x: FloatArray) -> FloatArray:
    """Apply a map of determinant 1: 20 % compression along y, then a parabolic shear."""
    out = x * [1.12, 0.8, 1 / (1.12 * 0.8)]
    out[:, 0] += 0.002 * out[:, 1] ** 2 + 0.1 * out[:, 2]
    return out


def normals_after(x: FloatArray, normals: FloatArray) -> FloatArray:
    """Return unit normals of the pressed surface (Nanson: inverse transpose of the gradient)."""
    step = 1e-5
    F = np.stack(
        [(pressed(x + step * e) - pressed(x - step * e)) / (2 * step) for e in np.eye(3)], axis=2
    )
    np.testing.assert_allclose(np.linalg.det(F), 1.0, rtol=1e-8)
    out = np.einsum("kji,kj->ki", np.linalg.inv(F), normals)
    return out / np.linalg.norm(out, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def truth() -> Moved:
    points, _ = ellipsoid(3000, 0)
    displacement = np.stack([pressed(points) - points, np.zeros_like(points)])
    return Moved(points, np.zeros(len(points), np.int32), displacement)


@pytest.fixture(scope="module")
def noisy() -> tuple[FloatArray, FloatArray]:
    """Provide points that noise shifts 0.3 mm off the interface, inside the rim of the truth."""
    points, normals = ellipsoid(600, 1)
    inside = points[:, 2] > 0.4 * AXES[2]
    points, normals = points[inside], normals[inside]
    off = np.random.default_rng(2).normal(0, 0.3, len(points))
    return points + off[:, None] * normals, normals


def test_points_near_the_interface_move_with_the_body(
    truth: Moved, noisy: tuple[FloatArray, FloatArray]
) -> None:
    points, normals = noisy
    went = material_points(points, truth)
    after = normals_after(points, normals)
    off = np.einsum("kc,kc->k", went[0] - pressed(points), after)
    assert np.sqrt(np.mean(off**2)) < 0.008
    # The displacement of the nearest true point is much worse: it ignores the depth.
    nearest = np.argmin(np.linalg.norm(points[:, None] - truth.points[None], axis=2), axis=1)
    naive = np.einsum("kc,kc->k", points + truth.displacement[0, nearest] - pressed(points), after)
    assert np.sqrt(np.mean(naive**2)) > 0.05
    np.testing.assert_allclose(went[1], points, atol=1e-9)  # an undeformed body


def test_interpolation_converges_with_the_number_of_true_points(
    noisy: tuple[FloatArray, FloatArray],
) -> None:
    points, normals = noisy
    on = points - np.einsum("kc,kc->k", points - noisy_feet(points), normals)[:, None] * normals
    errors = []
    for count in (375, 1500):
        at, _ = ellipsoid(count, 5)
        bent = 3 * np.sin(at / 12)
        truth = Moved(at, np.zeros(count, np.int32), bent[None])
        wrong = material_points(on, truth)[0] - on - 3 * np.sin(on / 12)
        errors.append(np.sqrt(np.mean(wrong**2)))
    # Half the spacing; cubic functions in a plane are of an order above two.
    assert errors[1] < errors[0] / 4


def noisy_feet(points: FloatArray) -> FloatArray:
    """Project radially onto the ellipsoid."""
    return points / np.linalg.norm(points / AXES, axis=1, keepdims=True)


def test_gap_equals_a_known_error_field(truth: Moved, noisy: tuple[FloatArray, FloatArray]) -> None:
    points, normals = noisy
    after = normals_after(points, normals)
    rng = np.random.default_rng(3)
    amiss = 0.25 * np.sin(points[:, 0] / 15)
    slip = np.cross(after, rng.normal(size=after.shape))  # along the surface: no gap
    moved = np.stack([pressed(points) + (amiss[:, None] * after + slip), points + 0.7 * normals])
    known = np.stack([np.zeros(len(points)), np.full(len(points), 0.2)])
    of_gland = np.ones(len(points), np.int32)
    found = true_gap(points, of_gland, moved, np.stack([after, normals]), truth, known)
    expected = np.sqrt(np.mean(amiss**2))
    assert found.scans_mm == pytest.approx((expected, 0.5), abs=0.003)
    both = np.sqrt((expected**2 + 0.25) / 2)
    assert found.gap_mm == pytest.approx(both, abs=0.003)
    assert found.material_mm == found.gap_mm


def test_sliding_skin_opens_no_gap(truth: Moved, noisy: tuple[FloatArray, FloatArray]) -> None:
    """The skin slides 8 mm around the body, which takes it a millimetre off the tangent plane."""
    points, normals = noisy
    feet = noisy_feet(points)
    angle = 8.0 / 35.0
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0]])
    turn = np.vstack([turn, [0, 0, 1]])
    slid = (feet / AXES) @ turn.T * AXES  # still on the ellipsoid
    off = np.einsum("kc,kc->k", points - feet, normals)
    there = slid / AXES**2
    there /= np.linalg.norm(there, axis=1, keepdims=True)
    amiss = 0.2 * np.cos(points[:, 1] / 12)
    after = normals_after(slid, there)
    # A point that the scan has put off the outline is off it in the model, too.
    moved = pressed(slid) + (pressed(points) - pressed(feet)) + amiss[:, None] * after
    on = np.zeros(len(points), np.int32)
    nothing = np.zeros((1, len(points)))
    still = Moved(truth.points, truth.interface, truth.displacement[:1])
    found = true_gap(points, on, moved[None], after[None], still, nothing)
    assert found.gap_mm == pytest.approx(np.sqrt(np.mean(amiss**2)), abs=0.015)
    assert found.material_mm > 0.5
    assert np.abs(off).max() > 0.5


def test_rejects_an_answer_to_other_scans(
    truth: Moved, noisy: tuple[FloatArray, FloatArray]
) -> None:
    points, normals = noisy
    none = np.zeros((1, len(points)))
    with pytest.raises(InputError, match="The answer has 1 scans"):
        true_gap(points, none[0].astype(np.int32), points[None], normals[None], truth, none)
    few = Moved(truth.points[:9], truth.interface[:9], truth.displacement[:, :9])
    with pytest.raises(InputError, match=f"has 9 points, expected at least {NEIGHBOURS}"):
        material_points(points, few)


def test_oversized_scans_and_labels_displace_drawn_interfaces() -> None:
    """Four points on a cube's faces, two of fat and two of gland, in one scan."""
    centre = (1.0, 2.0, 3.0)
    points = np.array([[[11.0, 2, 3], [1, -8, 3], [1, 2, 23], [-9, 2, 3]]])
    normals = np.array([[[1.0, 0, 0], [0, -1, 0], [0, 0, 1], [0, 1, 0]]])
    interface = np.array([0, 0, 1, 1], np.int32)
    scales = {"scale_x": 0.02, "scale_y": 0.01, "scale_z": -0.01}
    labels = {"segmentation_fat_mm": 0.3, "segmentation_glandular_mm": -0.1}
    # 10 mm by 2 %, 10 mm by 1 %, 20 mm by -1 %; the last one moves along its face.
    scaled = np.array([[0.2, 0.1, -0.2, 0.0]])
    assert drawn_mm(points, normals, interface, centre, scales) == pytest.approx(scaled)
    both = drawn_mm(points, normals, interface, centre, scales | labels | {"growth": 1.0})
    assert both == pytest.approx(scaled + np.array([0.3, 0.3, -0.1, -0.1]))
    # 0.5 mm along x, and a turn by 1 degree about z: -y, x times 0.01745.
    motion = {"motion_x_mm": 0.5, "motion_turn_z_deg": 1.0}
    elsewhere = drawn_mm(points, normals, interface, centre, motion)
    assert elsewhere == pytest.approx(np.array([[0.5, 0.0, 0.0, -0.1745]]), abs=1e-4)
    # 0.01 mm along x for each mm of y, on a face along x, 5 mm above the middle.
    raised = points + np.array([0.0, 5.0, 0.0])
    sheared = drawn_mm(raised, normals, interface, centre, {"shear_xy": 0.01})
    assert sheared[0, 0] == pytest.approx(0.05)


def test_points_under_a_plate_are_on_the_outline(
    truth: Moved, noisy: tuple[FloatArray, FloatArray]
) -> None:
    """Every second point is under a plate: it starts on the outline, the others where drawn.

    If all points were free, the drawn offset of the pressed ones would count as a gap.
    """
    points, normals = noisy
    off = np.einsum("kc,kc->k", points - noisy_feet(points), normals)
    feet = points - off[:, None] * normals
    after = normals_after(feet, normals)
    on_plate = np.arange(len(points)) % 2 == 0
    amiss = 0.15 * np.cos(points[:, 0] / 14)
    at_rest = np.where(on_plate[:, None], feet, points)
    moved = (pressed(at_rest) + amiss[:, None] * after)[None]
    outline, nothing = np.zeros(len(points), np.int32), np.zeros((1, len(points)))
    still = Moved(truth.points, truth.interface, truth.displacement[:1])
    share = on_plate[None].astype(float)
    found = true_gap(points, outline, moved, after[None], still, nothing, share)
    expected = np.sqrt(np.mean(amiss**2))
    assert found.gap_mm == pytest.approx(expected, abs=0.004)
    free = true_gap(points, outline, moved, after[None], still, nothing)
    drawn = np.sqrt(np.mean((off * on_plate) ** 2))
    assert free.gap_mm == pytest.approx(np.hypot(expected, drawn), rel=0.15)

"""Segmentation of generated frames to a fraction of a pixel, and images without a cornea."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.frame_segmentation import SegmentedFrame, segment_frame
from palpate.workers.organs.cornea.section_mesh import deformed_section, mesh_section
from palpate.workers.organs.cornea.section_outline import RigidMotion, Section, generated_section
from palpate.workers.organs.cornea.tonometer_frames import Frame
from tests.workers.organs.cornea.frames.generated_frame import FrameLook, generated_frame

SPACING_MM = (0.015625, 0.0165)
SHAPE = (240, 576)
CORNEA = generated_section(points=1001)
MESH = mesh_section(CORNEA)


def eye(dent_mm: float, tilt_rad: float = 0.02) -> Section:
    """Return a section in the coordinates of a 9 mm x 4 mm frame, with its apex near the top."""
    down = dent_mm * np.exp(-((MESH.nodes_mm[:, 0] / 1.6) ** 2))
    moved = deformed_section(CORNEA, MESH, np.column_stack([0 * down, -down]), 12)
    top = float(CORNEA.anterior_mm[:, 1].max())
    return RigidMotion((4.5, -top - 0.4), tilt_rad).of_section(moved)


def errors_px(found: SegmentedFrame, truth: Section) -> tuple[FloatArray, FloatArray]:
    spacing = found.frame.spacing_mm
    x = found.columns * spacing[0]
    return (
        found.anterior_row + np.interp(x, *truth.anterior_mm.T) / spacing[1],
        found.posterior_row + np.interp(x, *truth.posterior_mm.T) / spacing[1],
    )


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("dent_mm", [0.0, 1.0])
@pytest.mark.parametrize(
    ("look", "anterior_px", "posterior_px"),
    [
        # Uniform tissue: only the finite resolution of the method. The bright ridge under the
        # anterior surface shifts the steepest position outwards by a quarter of a pixel.
        (FrameLook(ridge=0.0, speckle=0.0, noise=0.0), 0.03, 0.03),
        (FrameLook(), 0.3, 0.15),
        (FrameLook(speckle=0.4, noise=6.0), 0.3, 0.3),
        (FrameLook(blur_px=0.6), 0.3, 0.15),
    ],
    ids=["clean", "default", "noisy", "sharp"],
)
def test_surfaces_are_accurate_to_a_fraction_of_a_pixel(
    dent_mm: float, look: FrameLook, anterior_px: float, posterior_px: float
) -> None:
    truth = eye(dent_mm)
    found = segment_frame(generated_frame(truth, SPACING_MM, SHAPE, look, seed=3))
    anterior, posterior = errors_px(found, truth)
    assert len(found.columns) == SHAPE[1]
    assert rms(anterior) < anterior_px
    assert rms(posterior) < posterior_px


@pytest.mark.parametrize("dent_mm", [0.0, 1.0])
def test_reflex_and_shadows_are_bridged_and_marked(dent_mm: float) -> None:
    truth = eye(dent_mm)
    look = FrameLook(reflex_px=9.0, shadows=((150, 170), (400, 412)))
    found = segment_frame(generated_frame(truth, SPACING_MM, SHAPE, look, seed=3))
    anterior, posterior = errors_px(found, truth)
    assert rms(anterior) < 0.3
    assert rms(posterior) < 0.3
    for first, last in look.shadows:
        inside = (found.columns > first + 4) & (found.columns < last - 4)
        assert np.all(found.anterior_confidence[inside] == 0)
        assert np.all(found.posterior_confidence[inside] == 0)
        assert np.abs(anterior[inside]).max() < 1.0
    assert np.mean(found.anterior_confidence > 0.5) > 0.8


def test_segmentation_is_independent_of_pixel_size() -> None:
    truth = eye(1.0)
    fine = (SPACING_MM[0] / 2, SPACING_MM[1] / 2)
    look = FrameLook(blur_px=2.0, ridge_depth_px=8.0)
    found = segment_frame(generated_frame(truth, fine, (480, 1152), look, seed=5))
    anterior, posterior = errors_px(found, truth)
    assert rms(anterior) < 0.6  # 0.3 camera pixels
    assert rms(posterior) < 0.3


def test_cornea_beyond_the_frame_is_cropped() -> None:
    truth = eye(0.0, tilt_rad=0.0)
    found = segment_frame(generated_frame(truth, SPACING_MM, (100, 576), seed=1))
    assert 100 < found.columns[0] < 200
    assert 376 < found.columns[-1] < 476
    anterior, posterior = errors_px(found, truth)
    assert rms(anterior) < 0.4
    assert rms(posterior) < 0.4


def test_labels_have_the_area_of_the_section() -> None:
    found = segment_frame(generated_frame(eye(1.0), SPACING_MM, SHAPE, seed=2))
    labels = found.labels
    assert labels.shape == SHAPE
    assert set(np.unique(labels).tolist()) == {0, 1}
    expected = np.sum(found.posterior_row - found.anterior_row)
    assert labels.sum() == pytest.approx(expected, rel=0.005)


def test_rejects_images_without_a_cornea() -> None:
    rng = np.random.default_rng(0)
    row, column = np.indices(SHAPE)
    noise = 8 + 2 * rng.standard_normal(SHAPE)
    half = noise + 40 * (row > 120)
    blob = noise + 60 * np.exp(-(((row - 150) / 30) ** 2 + ((column - 300) / 60) ** 2))
    for grey, message in (
        (noise, "surface of a cornea is visible in"),
        (half, "posterior surface"),
        (blob, "surface of a cornea is visible in"),
        (np.full(SHAPE, 7.0), "All grey values"),
    ):
        with pytest.raises(InputError, match=message):
            segment_frame(Frame(grey=grey, spacing_mm=SPACING_MM))


def test_rejects_frames_that_are_not_greyscale() -> None:
    with pytest.raises(InputError, match="16 x 16"):
        Frame(grey=np.zeros((4, 500)), spacing_mm=SPACING_MM)
    with pytest.raises(InputError, match="positive width and height"):
        Frame(grey=np.zeros((40, 50)), spacing_mm=(0.01, 0.0))
    with pytest.raises(InputError, match="not finite"):
        Frame(grey=np.full((40, 50), np.nan), spacing_mm=SPACING_MM)

"""Mammograms of compressed phantoms on two meshes."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.comparison.mammogram_image import EQUAL_GREY
from palpate.workers.thesis.phantom_compression import (
    REDUCED,
    Compressed,
    compress,
    mammogram_pair,
    two_materials,
)


@pytest.fixture(scope="module")
def pressed() -> tuple[Compressed, Compressed]:
    phantom = generate_breast(replace(REDUCED, spacing_mm=0.75, glandular_fraction=0.2), 4)
    materials = two_materials(phantom.labels)
    first, second = (
        compress(phantom, build_hierarchy(materials, element_size_mm=size), "CC", "neo-Hookean")
        for size in (3.0, 4.5)
    )
    return first, second


def test_identical_bodies_differ_only_by_noise(pressed: tuple[Compressed, Compressed]) -> None:
    pair = mammogram_pair(pressed[0], pressed[0], "CC", 1.0, seed=3)
    assert pair.attenuation_rms == pytest.approx(pair.quantum_rms, rel=0.1)
    assert abs(float(np.median(pair.difference)) - EQUAL_GREY) <= 1


def test_two_meshes_differ_beyond_noise(pressed: tuple[Compressed, Compressed]) -> None:
    pair = mammogram_pair(*pressed, "CC", 1.0, seed=3)
    assert pair.attenuation_rms > 2 * pair.quantum_rms
    assert pair.adaptive_picture.shape == pair.homogeneous_picture.shape == pair.difference.shape
    assert np.ptp(pair.difference.astype(int)) > 50


def test_rejects_a_diverged_body(pressed: tuple[Compressed, Compressed]) -> None:
    outcome = replace(pressed[0].outcome, converged=False, reason="the plate lost contact")
    with pytest.raises(InputError, match="the plate lost contact"):
        mammogram_pair(pressed[0], Compressed(None, None, outcome, 0.0), "CC", 1.0)

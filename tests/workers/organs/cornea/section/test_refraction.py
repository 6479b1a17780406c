"""Refraction correction against flat and spherical surfaces."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section_outline import (
    CAMERA_ANGLE_DEG,
    CORNEA_INDEX,
    corrected_posterior,
    generated_section,
)


def apparent_posterior(
    anterior_mm: FloatArray,
    posterior_mm: FloatArray,
    index: float = CORNEA_INDEX,
    camera_angle_deg: float = CAMERA_ANGLE_DEG,
    axis_x_mm: float | None = None,
) -> FloatArray:
    """Return the apparent positions of the points of a posterior surface.

    The inverse of `corrected_posterior`, by a fixed-point iteration: the error of the
    correction is subtracted from the apparent position until it is below a nanometre.

    Parameters
    ----------
    anterior_mm, posterior_mm, index, camera_angle_deg, axis_x_mm
        As in `corrected_posterior`.

    Returns
    -------
    ndarray, shape (m, 2)
    """
    angle = np.deg2rad(camera_angle_deg)
    flat = np.tan(np.arcsin(np.sin(angle) / index)) / np.tan(angle)
    gap = np.interp(posterior_mm[:, 0], *anterior_mm.T) - posterior_mm[:, 1]
    apparent = posterior_mm + np.column_stack([np.zeros_like(gap), (1 - flat) * gap])
    for _ in range(60):
        missed = posterior_mm - corrected_posterior(
            anterior_mm, apparent, index, camera_angle_deg, axis_x_mm
        )
        apparent = apparent + missed * [1.0, flat]
        if np.abs(missed).max() < 1e-6:
            break
    return apparent


def test_behind_a_flat_surface_the_depth_is_the_ratio_of_tangents() -> None:
    x = np.linspace(-4, 4, 101)
    anterior, apparent = np.column_stack([x, 0 * x]), np.column_stack([x, 0 * x - 0.33])
    inner = np.arcsin(np.sin(np.pi / 4) / 1.376)
    true = corrected_posterior(anterior, apparent)
    assert np.allclose(true, np.column_stack([x, 0 * x - 0.33 / np.tan(inner)]), atol=1e-9)
    nearly_head_on = corrected_posterior(anterior, apparent, camera_angle_deg=0.1)
    assert np.allclose(nearly_head_on[:, 1], -0.33 * 1.376, atol=1e-5)


def test_unit_index_changes_nothing() -> None:
    section = generated_section()
    same = corrected_posterior(section.anterior_mm, section.posterior_mm, index=1.0)
    assert np.allclose(same, section.posterior_mm, atol=1e-9)


def test_correction_matches_rays_traced_backwards_through_a_sphere() -> None:
    # From a point of the slit plane out through the sphere, parallel to the camera's ray outside:
    # find the exit point by minimising the optical path to a plane wavefront (Fermat), which
    # uses neither Snell's law nor the profile.
    radius, index, angle = 7.8, 1.376, np.pi / 4
    section = generated_section(anterior_radius_mm=radius, points=2001)
    top = float(section.anterior_mm[:, 1].max())
    toward = np.array([0.0, np.cos(angle), -np.sin(angle)])
    inner = section.posterior_mm[200:-200:100]
    apparent = []
    for px, py in inner:
        point = np.array([px, py, 0.0])
        xs = px + np.linspace(-0.4, 0.4, 81)
        zs = np.linspace(-0.9, 0.0, 181)
        for _ in range(8):
            x, z = np.meshgrid(xs, zs, indexing="ij")
            y = top - radius + np.sqrt(radius**2 - x**2 - z**2)
            out = np.stack([x, y, z], axis=-1)
            path = index * np.linalg.norm(out - point, axis=-1) - out @ toward
            i, j = np.unravel_index(np.argmin(path), path.shape)
            xs = np.linspace(xs[max(i - 1, 0)], xs[min(i + 1, 80)], 81)
            zs = np.linspace(zs[max(j - 1, 0)], zs[min(j + 1, 180)], 181)
        leaves = out[i, j]
        # The straight ray, extended to the plane z = 0.
        apparent.append((leaves - toward * (leaves[2] / toward[2]))[:2])
    found = corrected_posterior(section.anterior_mm, np.array(apparent), index)
    assert np.allclose(found, inner, atol=2e-5)


def test_apparent_and_corrected_are_inverse_for_a_tilted_dented_cornea() -> None:
    section = generated_section()
    dent = np.column_stack(
        [0 * section.anterior_mm[:, 0], -0.9 * np.exp(-((section.anterior_mm[:, 0] / 1.6) ** 2))]
    )
    anterior = section.anterior_mm + dent
    anterior[:, 1] += 0.03 * anterior[:, 0]
    true = np.column_stack([anterior[:, 0], anterior[:, 1] - 0.55])[20:-20]
    apparent = apparent_posterior(anterior, true)
    # The same thickness appears less reduced behind the dent than behind the convex flanks.
    thickness = np.interp(apparent[:, 0], *anterior.T) - apparent[:, 1]
    assert np.all((thickness > 0.25) & (thickness < 0.42))
    assert np.allclose(corrected_posterior(anterior, apparent), true, atol=1e-5)


def test_rejects_invalid_optics() -> None:
    section = generated_section()
    a, p = section.anterior_mm, section.posterior_mm
    with pytest.raises(InputError, match="at least 1"):
        corrected_posterior(a, p, index=0.9)
    with pytest.raises(InputError, match="between 0 and 80"):
        corrected_posterior(a, p, camera_angle_deg=90.0)
    with pytest.raises(InputError, match="above the anterior"):
        corrected_posterior(p, a[10:-10])
    with pytest.raises(InputError, match="doubles back"):
        corrected_posterior(a[::-1], p)

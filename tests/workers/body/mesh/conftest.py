"""Bodies defined by formulas. The half ellipsoid is the breast of the thesis: 170 x 100 x 50 mm."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.storage.values import Tissue, Volume
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, build_hierarchy

Inside = Callable[
    [NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]
]

SEMI_AXES_MM = (85.0, 50.0, 50.0)
HALF_ELLIPSOID_MM3 = 2 / 3 * np.pi * np.prod(SEMI_AXES_MM)


def body(
    inside: Inside,
    half_width_mm: tuple[float, float],
    height_mm: float,
    spacing_mm: tuple[float, float, float] = (2.0, 2.0, 2.0),
) -> Volume:
    """Return fat where ``inside(x, y, z)`` is true; the wall is z = 0, x and y are centred on 0."""
    size = np.array([2 * half_width_mm[0], 2 * half_width_mm[1], height_mm])
    n = np.ceil(size / spacing_mm).astype(int) + np.array([6, 6, 3])
    first = np.array([-0.5 * (n[0] - 1), -0.5 * (n[1] - 1), 0.5]) * spacing_mm
    x, y, z = (first[c] + np.arange(n[c]) * spacing_mm[c] for c in range(3))
    mask = inside(x[None, None, :], y[None, :, None], z[:, None, None])
    return Volume(np.where(mask, Tissue.FAT, Tissue.AIR).astype(np.uint8), spacing_mm, tuple(first))


def half_ellipsoid(spacing_mm: tuple[float, float, float] = (2.0, 2.0, 2.0)) -> Volume:
    a, b, c = SEMI_AXES_MM
    return body(
        lambda x, y, z: (x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2 < 1, (a, b), c, spacing_mm
    )


@pytest.fixture(scope="session")
def make_body() -> Callable[..., Volume]:
    return body


@pytest.fixture(scope="session")
def make_half_ellipsoid() -> Callable[..., Volume]:
    return half_ellipsoid


@pytest.fixture(scope="session")
def breast() -> Volume:
    return half_ellipsoid()


@pytest.fixture(scope="session")
def meshes(breast: Volume) -> Hierarchy:
    return build_hierarchy(breast, nodes=5000)


@pytest.fixture(scope="session")
def breast_mm3() -> float:
    return float(HALF_ELLIPSOID_MM3)

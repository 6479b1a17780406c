"""A small body whose every voxel tells where it is."""

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from storage.values import Volume

SHAPE = (4, 5, 6)
SPACING = np.array([0.5, 1.25, 2.0])


@pytest.fixture
def numbered() -> NDArray[np.uint16]:
    """Voxels [i, j, k], each with a label of its own: 0, 1, 2, ..."""
    return np.arange(np.prod(SHAPE), dtype=np.uint16).reshape(SHAPE)


def signed_permutations() -> list[NDArray[np.float64]]:
    """All 48 ways to lay three index axes along three world axes."""
    turns = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[order, range(3)] = signs
            turns.append(turn)
    return turns


def centres(volume: Volume) -> dict[int, tuple[float, float, float]]:
    """Label -> (x, y, z) of its voxel, from spacing and origin alone."""
    places = {}
    for (z, y, x), label in np.ndenumerate(volume.values):
        place = np.array(volume.origin_mm) + np.array([x, y, z]) * volume.spacing_mm
        places[int(label)] = (float(place[0]), float(place[1]), float(place[2]))
    return places


def expected_centres(
    values: NDArray[np.uint16], steps: NDArray[np.float64], origin: NDArray[np.float64]
) -> dict[int, NDArray[np.float64]]:
    """The same, from the definition: origin + steps @ (i, j, k)."""
    return {
        int(label): origin + steps @ np.array(index, dtype=float)
        for index, label in np.ndenumerate(values)
    }


def assert_same_places(
    volume: Volume, expected: dict[int, NDArray[np.float64]], atol: float = 1e-9
) -> None:
    found = centres(volume)
    assert found.keys() == expected.keys()
    labels = sorted(found)
    np.testing.assert_allclose(
        np.array([found[n] for n in labels]), np.array([expected[n] for n in labels]), atol=atol
    )

"""Space-filling designs: balance and reproducibility."""

import numpy as np
import pytest

from palpate.service.search.search_interface import Space
from palpate.service.simulation.candidate_tables import DESIGNS, design
from palpate.storage.errors import InputError

SPACE = Space.from_bounds({"E_fat_kpa": (5, 20), "E_glandular_kpa": (5, 80), "nu": (0.45, 0.49)})


@pytest.mark.parametrize("kind", DESIGNS)
@pytest.mark.parametrize("n", [1, 64])
def test_each_half_of_an_interval_has_half_of_the_points(kind: str, n: int) -> None:
    points = design(SPACE, kind, n, seed=2)
    assert points.shape == (n, 3)
    assert (points >= SPACE.lower).all()
    assert (points <= SPACE.upper).all()
    below = (SPACE.to_unit(points) < 0.5).sum(axis=0)
    assert np.abs(2 * below - n).max() <= 1 + 0.1 * n
    np.testing.assert_array_equal(points, design(SPACE, kind, n, seed=2))
    assert not np.array_equal(points, design(SPACE, kind, n, seed=3))


def test_rejects_invalid_designs() -> None:
    for kind, n, seed in (("sobel", 8, 1), ("sobol", 0, 1), ("sobol", 8, -1)):
        with pytest.raises(InputError):
            design(SPACE, kind, n, seed)

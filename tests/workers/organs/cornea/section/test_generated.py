"""Generated sections against their defining curves."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.section_outline import generated_section


@pytest.mark.parametrize("asphericity", [-1.3, -1.0, -0.2, 0.0, 0.3])
def test_the_anterior_surface_is_the_conic(asphericity: float) -> None:
    anterior = generated_section(asphericity=asphericity).anterior_mm
    x, sag = anterior[:, 0], anterior[:, 1].max() - anterior[:, 1]
    assert np.allclose(x**2 + (1 + asphericity) * sag**2, 2 * 7.8 * sag, atol=1e-12)


def test_the_posterior_surface_is_one_circle_with_the_stated_thickness() -> None:
    section = generated_section(central_thickness_mm=0.5, peripheral_thickness_mm=0.8)
    x, y = section.posterior_mm.T
    columns = np.column_stack([x, y, np.ones_like(x)])
    solution, *_ = np.linalg.lstsq(columns, x**2 + y**2, rcond=None)
    radius = np.sqrt(solution[2] + 0.25 * (solution[0] ** 2 + solution[1] ** 2))
    assert np.allclose(np.hypot(x - solution[0] / 2, y - solution[1] / 2), radius, atol=1e-10)
    ends = section.anterior_mm[-1] - section.posterior_mm[-1]
    assert np.hypot(*ends) == pytest.approx(0.8)
    assert section.anterior_mm[:, 1].max() - y.max() == pytest.approx(0.5)
    # The edge is normal to the anterior circle, whose centre is 7.8 mm below its apex.
    centre = np.array([0.0, section.anterior_mm[:, 1].max() - 7.8])
    out = section.anterior_mm[-1] - centre
    assert abs(out[0] * ends[1] - out[1] * ends[0]) < 1e-12


def test_section_is_symmetric_with_the_given_width() -> None:
    section = generated_section(diameter_mm=11.0, points=101)
    for surface in (section.anterior_mm, section.posterior_mm):
        assert len(surface) == 101
        assert np.array_equal(surface[::-1] * [-1, 1], surface)
    assert section.anterior_mm[-1].tolist() == [5.5, 0.0]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"anterior_radius_mm": -1.0}, "anterior radius"),
        ({"central_thickness_mm": 0.0}, "central thickness"),
        ({"diameter_mm": 16.0}, "does not reach a diameter"),
        ({"central_thickness_mm": 4.0}, "leave no posterior arc"),
        ({"points": 10}, "odd number"),
    ],
)
def test_rejects_impossible_geometry(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        generated_section(**wrong)  # type: ignore[arg-type]

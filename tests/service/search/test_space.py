"""The box of parameters: validation, and rounding at its bounds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.service.search.search_interface import Space
from palpate.storage.errors import InputError
from tests.service.search.boxes import contains

finite = st.floats(allow_nan=False, allow_infinity=False, width=32)


def test_the_unit_cube_maps_onto_the_bounds() -> None:
    space = Space.from_bounds({"E_fat_kpa": (5, 20), "eta_fat_kpa": (50, 200)})
    genes = space.from_unit(np.array([[0.0, 1.0], [0.2, 0.5]]))
    assert genes.tolist() == [[5.0, 200.0], [8.0, 125.0]]
    assert space.to_unit(genes).tolist() == [[0.0, 1.0], [0.2, 0.5]]
    assert space.as_dict(genes[1]) == {"E_fat_kpa": 8.0, "eta_fat_kpa": 125.0}
    assert space.dimension == 2
    assert space.span.tolist() == [15.0, 150.0]


@pytest.mark.parametrize(
    ("bounds", "said"),
    [
        ((20, 5), "reversed"),
        ((5, 5), "nothing to search"),
        ((5, np.inf), "finite"),
        ((np.nan, 5), "finite"),
        ((-1.7e308, 1.7e308), "too wide"),
        ((5, 10, 15), "two bounds"),
    ],
)
def test_rejects_invalid_bounds_by_name(bounds: tuple[float, ...], said: str) -> None:
    with pytest.raises(InputError, match=said) as error:
        Space.from_bounds({"eta_fat_kpa": (50, 200), "E_skin_kpa": bounds})
    assert "E_skin_kpa" in str(error.value)
    assert "eta_fat_kpa" not in str(error.value)


def test_rejects_a_repeated_name() -> None:
    with pytest.raises(InputError, match="E_fat_kpa is listed twice"):
        Space(("E_fat_kpa", "nu", "E_fat_kpa"), (0, 0, 0), (1, 1, 1))


def test_rejects_a_space_without_parameters() -> None:
    with pytest.raises(InputError, match=r"search\.parameters"):
        Space.from_bounds({})


def test_rejects_names_without_bounds() -> None:
    with pytest.raises(InputError, match="2 names, 2 lower and 1 upper"):
        Space(("a", "b"), (0, 0), (1,))


@settings(deadline=None)
@given(finite, finite, st.floats(0, 1))
def test_rounding_never_leaves_the_box(a: float, b: float, unit: float) -> None:
    if a == b:
        return
    space = Space(("a",), (min(a, b),), (max(a, b),))
    assert contains(space, space.from_unit(np.array([[unit]])))


def test_contains_includes_the_bounds() -> None:
    space = Space(("a", "b"), (0, 0), (1, 2))
    assert contains(space, np.array([[0.0, 2.0], [1.0, 0.0]]))
    assert not contains(space, np.array([[0.5, 0.5], [np.nextafter(1.0, 2.0), 1.0]]))

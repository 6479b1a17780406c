"""Flat keys are equivalent to a study file."""

import pytest

from palpate.service.simulation.organ_simulation import case_from_keys
from palpate.service.study.study_keys import study_of
from palpate.storage.errors import InputError

PHANTOM = {"spacing_mm": 2.0}


@pytest.mark.parametrize(
    "keys",
    [
        {"phantom": PHANTOM},
        {"reference": {"phantom": PHANTOM}, "element_size_mm": 6, "skin": "membrane"},
        {"phantom": PHANTOM, "load": {"force_n": 30}, "oblique_deg": 45, "E_skin_kpa": 900},
    ],
)
def test_keys_give_same_case_as_file(keys: dict[str, object]) -> None:
    case = case_from_keys("breast", keys)
    study = study_of("breast").model_validate(
        {
            "name": "same",
            "case": case.model_dump(mode="json"),
            "target": {"constants": {"E_fat_kpa": 9}},
            "search": {"parameters": {"E_fat_kpa": [5, 20]}},
        }
    )
    assert study.case == case


def test_keys_belong_to_one_section() -> None:
    from palpate.service.simulation.organ_simulation import _sections
    from palpate.workers.organs.organ_plugins import organ_spec

    for organ in ("breast", "cornea"):
        spec = organ_spec(organ)
        keys = [key for door in _sections(spec.case).values() for key in door.model_fields]
        assert len(keys) == len(set(keys))
        # The intraocular pressure is a key of the load and a constant with the same meaning.
        assert set(keys) & set(spec.parameters.door_names) <= {"iop_mmhg"}


def test_sections_are_checked() -> None:
    with pytest.raises(InputError, match="mesh"):
        case_from_keys("breast", {"phantom": PHANTOM, "mesh": 3})

"""Keys that are newer than stored studies do not change the digests of those studies."""

import pytest

from palpate.service.search.search_keys import PriorSpec, SearchSpec, StopSpec
from palpate.workers.organs.breast.breast_keys import BreastScore, ModelSpec
from palpate.workers.organs.specimen.specimen_body_keys import (
    BodySpec,
    CircleSpec,
    MaterialSpec,
    RegionSpec,
    SheetSpec,
)
from palpate.workers.organs.specimen.specimen_keys import LoadsSpec, PredictSpec

SEARCH = {"parameters": {"E_fat_kpa": (5, 20)}}
BOX = {"box_mm": (1, 2, 3)}
PLANE = {"plane": {"axis": "x", "at_mm": 0}}
MATERIAL = {"E_kpa": (1, 2), "nu": 0.4, "density_kg_per_m3": 1000}
# Each model, the keys that it needs, and a later key with a value other than its default.
CASES = [
    (SearchSpec, SEARCH, "mode", "steady"),
    (SearchSpec, SEARCH, "in_flight", 4),
    (SearchSpec, SEARCH, "start", ({"E_fat_kpa": 7.0},)),
    (SearchSpec, SEARCH, "stop", StopSpec(score=-9.0)),
    (SearchSpec, SEARCH, "scale", {"E_fat_kpa": "log"}),
    (SearchSpec, SEARCH, "constraints", ("E_glandular_kpa > E_fat_kpa",)),
    (SearchSpec, SEARCH, "prior", {"E_fat_kpa": PriorSpec(mean=8.0, sd=2.0)}),
    (ModelSpec, {}, "law", ModelSpec(law="yeoh").law),
    (BreastScore, {}, "objective", "jc"),
    (BodySpec, BOX, "sheet", SheetSpec(size_mm=(4, 5), thickness_mm=1)),
    (RegionSpec, PLANE, "outside_circle_mm", CircleSpec(centre=(0, 0), radius=1)),
    (LoadsSpec, {}, "pressure_kpa", 3.0),
    (PredictSpec, {"name": "held out"}, "pressure_kpa", 3.0),
    (PredictSpec, {"name": "held out"}, "files", ("held_out.csv",)),
    (MaterialSpec, {**MATERIAL, "law": "yeoh"}, "constants", {"yeoh_c2": 0.5}),
]


@pytest.mark.parametrize(("model", "needed", "key", "value"), CASES)
def test_a_later_key_is_written_only_if_it_is_set(model, needed, key, value) -> None:
    assert key not in model(**needed).model_dump(mode="json")
    assert key in model.later_keys
    unset = model.model_fields[key].get_default(call_default_factory=True)
    assert key not in model(**needed).model_copy(update={key: unset}).model_dump(mode="json")
    assert key in model(**needed).model_copy(update={key: value}).model_dump(mode="json")


def test_every_later_key_has_a_case() -> None:
    for model in {model for model, *_ in CASES}:
        assert set(model.later_keys) == {key for one, _, key, _ in CASES if one is model}

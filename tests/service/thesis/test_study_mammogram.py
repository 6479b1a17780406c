"""Mammograms of a study's body, pressed for each view with the estimated constants."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.common_keys import validated
from palpate.workers.organs.organ_plugins import organ_spec
from palpate.workers.tasks.mammogram_tasks import take_view
from palpate.workers.thesis.phantom_compression import TARGETS, case_of


@pytest.fixture(scope="module")
def case() -> dict[str, Any]:
    """Return the case of a small breast with coarse elements."""
    told = case_of("X1", 3, "sketch")
    told["reference"]["phantom"]["spacing_mm"] = 2.0
    told["mesh"] = {"nodes": 1100}
    spec = validated(organ_spec("breast").case, told, "The case")
    return dict(spec.model_dump(mode="json"))


@pytest.fixture(scope="module")
def found() -> dict[str, float]:
    parameters = organ_spec("breast").parameters
    return dict(parameters.from_door(TARGETS["X1"]))


def test_equal_constants_give_equal_mammograms(
    case: dict[str, Any], found: dict[str, float], tmp_path: Path
) -> None:
    taken = take_view(case, found, found, "CC", str(tmp_path), pixel_mm=2.0, noise_seed=None)
    assert taken.target is not None
    assert np.array_equal(taken.fitted.energy_kev, taken.target.energy_kev)
    assert taken.fitted.log_attenuation.max() > 0.5


@pytest.mark.slow
def test_mammograms_depend_on_constants_and_view(
    case: dict[str, Any], found: dict[str, float], tmp_path: Path
) -> None:
    softer = found | {"E_fat": 0.5 * found["E_fat"]}
    both = {
        view: take_view(case, found, softer, view, str(tmp_path), pixel_mm=2.0, noise_seed=None)
        for view in ("CC", "MLO")
    }
    for taken in both.values():
        assert taken.target is not None
        apart = taken.fitted.log_attenuation - taken.target.log_attenuation
        assert np.abs(apart).max() > 0.05
    across, oblique = (both[v].fitted.geometry.down_mm for v in ("CC", "MLO"))
    assert across @ oblique == pytest.approx(np.cos(np.radians(45)) * across @ across)


def test_rejects_a_cornea(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="of the cornea"):
        take_view({"organ": "cornea", "load": {}}, {}, None, "CC", str(tmp_path))

"""The plug-ins keep the promises that Palpate relies on."""

import pytest
from palpate_example.effect import SIDE_WEIGHT
from palpate_example.law import GENT
from palpate_example.organ import GEL
from palpate_example.score import CENTROID

from palpate.testing import check_effect, check_law, check_organ, check_score

CASE = {"reference": {"phantom": {"preset": "250ml", "spacing_mm": 2}}, "mesh": {"nodes": 1500}}


def test_effect() -> None:
    check_effect(SIDE_WEIGHT)


@pytest.mark.parametrize("lock", [0.0, 0.05])
def test_law(lock: float) -> None:
    check_law(GENT.make(0.003, {"lock": lock}))


def test_score() -> None:
    check_score(CENTROID)


def test_organ() -> None:
    check_organ(GEL, CASE, free=["E_fat"])

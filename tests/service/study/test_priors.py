"""Priors of searched constants: invalid ones, exact residuals, and a study that uses one."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate
from palpate.service.results.quotability_rule import EstimateFacts, quotability
from palpate.service.results.results_as_json import study_json
from palpate.service.results.results_from_journal import study_results
from palpate.service.search.search_keys import SearchSpec
from palpate.service.study.study_keys import parse_spec
from palpate.storage.errors import InputError
from palpate.storage.values import FreeParameter
from palpate.workers.common_keys import validated
from palpate.workers.organs.normal_equations import NormalEquations
from palpate.workers.tasks.pipeline import with_priors
from tests.recovery.stand_ins import SPEC, Inline, run

BOUNDS = {"E_fat_kpa": [5, 20], "E_glandular_kpa": [5, 80]}
SEARCH = {"parameters": BOUNDS, "strategy": "least-squares", "starts": 1, "levels": []}
STUDY = {
    "name": "prior",
    "case": {
        "reference": {"phantom": {"preset": "250ml", "spacing_mm": 2.0}},
        "mesh": {"nodes": 1200},
    },
    "target": {"constants": {"E_fat_kpa": 10, "E_glandular_kpa": 40}},
    "seed": 3,
}


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            {"prior": {"E_fat_kpa": {"mean": 8, "sd": 1}}, "strategy": "genetic"},
            "minimises a score",
        ),
        ({"prior": {"E_skin_kpa": {"mean": 8, "sd": 1}}}, "E_skin_kpa is not searched"),
        ({"prior": {"E_fat_kpa": {"mean": 30, "sd": 1}}}, "30, is outside its bounds"),
        ({"prior": {"E_fat_kpa": {"mean": 8, "sd": 0}}}, "prior.E_fat_kpa.sd"),
        ({"prior": {"E_fat_kpa": [8, 1]}}, "prior.E_fat_kpa"),
    ],
)
def test_rejects_priors_that_cannot_be_used(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        validated(SearchSpec, {"parameters": BOUNDS, "strategy": "least-squares", **keys}, "search")


def test_units_are_converted() -> None:
    prior = "strategy: least-squares\n  prior: {E_fat_kpa: {mean: 8, sd: 2}}\n  pop"
    spec = parse_spec(SPEC.replace("pop", prior, 1), "a study", Path())
    fat, gland = spec.free_parameters
    assert fat["prior"] == pytest.approx((0.008, 0.002))
    assert "prior" not in gland


@pytest.mark.parametrize("lower", [0.0, 0.005])
def test_residual_and_derivatives_match_differences(lower: float) -> None:
    free: list[FreeParameter] = [
        {"name": "a", "lower": 1.0, "upper": 2.0},
        {"name": "b", "lower": lower, "upper": 0.02, "prior": (0.008, 0.002)},
    ]
    none = NormalEquations(3.0, np.ones(2), np.eye(2), 50)

    def at(step: float) -> NormalEquations:
        value = 0.011 * np.exp(step) if lower else 0.011 + step
        return with_priors(none, [1.5, value], free)

    here, step = at(0.0), 1e-6 if lower else 1e-9
    assert here.cost == pytest.approx(3.0 + 1.5**2)
    assert here.residuals == 51
    by_difference = (at(step).cost - at(-step).cost) / (4 * step)
    assert here.gradient == pytest.approx([1.0, 1.0 + by_difference])
    assert here.hessian == pytest.approx(np.diag([1.0, 1.0 + (by_difference / 1.5) ** 2]))


def test_estimate_is_weighed_between_image_and_prior(tmp_path: Path) -> None:
    """Where both are equally precise, the estimate is in the middle and the variance halves."""
    sd = 10 * 0.01 / np.sqrt(20)  # of the image alone, see `stand_ins.fit_of`
    prior = f"strategy: least-squares\n  prior: {{E_fat_kpa: {{mean: {10 + sd}, sd: {sd}}}}}\n  pop"
    run(tmp_path / "demo", Inline(), parse_spec(SPEC.replace("pop", prior, 1), "a study", Path()))
    found = study_results(tmp_path / "demo").identification
    assert found is not None
    fat, gland = found.constants["E_fat"], found.constants["E_glandular"]
    assert fat.prior_share == pytest.approx(0.5, abs=0.005)
    assert fat.estimate == pytest.approx(10 + sd / 2, abs=0.01 * sd)
    assert fat.errors["image and prior"] == pytest.approx(sd / np.sqrt(2), rel=0.005)
    assert gland.prior_share == 0.0
    assert gland.errors["image and prior"] == pytest.approx(4 * sd, rel=0.005)


def test_value_determined_by_its_prior_is_not_quotable(tmp_path: Path) -> None:
    """A real study of a simulated target: the images determine E_fat to about 0.5 %."""
    prior = {"E_fat_kpa": {"mean": 11.0, "sd": 0.01}}
    keys = STUDY | {"search": SEARCH | {"prior": prior}}
    palpate.Study.from_dict(keys, tmp_path / "study").run(in_process=True)
    record = study_json(study_results(tmp_path / "study"))
    fat = record["estimates"]["E_fat"]
    assert fat["estimate"] == pytest.approx(11.0, abs=0.05)
    assert "the prior determines it more than the images do" in fat["reasons"]
    assert not fat["quotable"]
    assert record["identification"]["constants"]["E_fat"]["prior_share"] > 0.9
    sentence = "The estimate and the interval of E_fat_kpa include its prior, 11 ± 0.01 kPa."
    assert sentence in record["caveats"]


@pytest.mark.parametrize(
    ("value", "share", "reason"),
    [
        (8.0, 0.6, "the prior determines it more than the images do"),
        (8.0, 0.4, ""),
        (12.0, 0.6, "4 standard deviations from the mean of its prior, against the images"),
    ],
)
def test_a_dominant_or_contradicted_prior_is_the_reason(
    value: float, share: float, reason: str
) -> None:
    facts = EstimateFacts(
        value=value, unit="kPa", interval=(7, 13), prior=(8.0, 1.0), prior_share=share
    )
    assert quotability(facts).reasons == ((reason,) if reason else ())

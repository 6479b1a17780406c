"""Batches from Python agree with the forward model."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate
from palpate.testing.plugin_claims import small_breast
from palpate.workers.comparison.similarity_score import Scorer


def study_in(folder: Path) -> palpate.Study:
    file = folder / "body.nrrd"
    palpate.write_volume(file, small_breast(), {1: "Fat", 2: "Glandular"})
    spec: dict[str, Any] = {
        "name": "small",
        "case": {
            "reference": {"volume": str(file)},
            "mesh": {"nodes": 400},
            "load": {"force_n": 20},
        },
        "target": {"constants": {"E_fat_kpa": 12}},
        "search": {"parameters": {"E_fat_kpa": [5, 20]}},
    }
    return palpate.Study.from_dict(spec, folder / "runs" / "small")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> palpate.Study:
    return study_in(tmp_path_factory.mktemp("small"))


def test_scores_agree_with_forward_model(study: palpate.Study) -> None:
    table = {"E_fat_kpa": [8.0, 12.0, 0.1]}
    found = study.evaluate(table, in_process=True)
    assert found["status"].tolist() == ["done", "done", "diverged"]
    assert found["reason"][2]
    assert found["jc"][1] == 1.0  # the constants of the target
    model = palpate.Breast(study.spec.case.reference.volume, nodes=400, force_n=20)
    target = model.simulate(E_fat_kpa=12).deformed
    predicted = Scorer(target).score(model.simulate(E_fat_kpa=8).deformed)
    assert found["jc"][0] == predicted.as_dict()["jc"]
    assert found["gsf"][0] == predicted.as_dict()["gsf"]
    again = study.evaluate(table, in_process=True)
    assert again["reused"].all()
    np.testing.assert_array_equal(again["gsf"], found["gsf"])
    assert not Path(study.folder).exists()  # a batch is not a run of the study


def test_rejects_invalid_rows_before_work_starts(tmp_path: Path) -> None:
    study = study_in(tmp_path)
    with pytest.raises(palpate.InputError, match="Row 2: E_fat_kpa"):
        study.evaluate([{"E_fat_kpa": 8}, {"E_fat_kpa": 0}], in_process=True)
    assert not (tmp_path / "runs").exists()


def test_a_design_stays_within_the_bounds(study: palpate.Study) -> None:
    columns = study.design(16, "latin-hypercube", seed=4)
    assert list(columns) == ["E_fat_kpa"]
    assert ((columns["E_fat_kpa"] >= 5) & (columns["E_fat_kpa"] <= 20)).all()


def test_results_can_be_pickled(study: palpate.Study) -> None:
    found = study.evaluate({"E_fat_kpa": [12.0]}, in_process=True)
    again = pickle.loads(pickle.dumps(found))
    assert again["gsf"].tolist() == found["gsf"].tolist()

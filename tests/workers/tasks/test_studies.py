"""The folder of a study, opened for a diagnosis."""

from pathlib import Path

import numpy as np
import pytest

from palpate.service.study.study_keys import StudySpec
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError, StoreError
from palpate.storage.journal import Journal
from palpate.storage.journal_records import EvaluationRecord, SessionRecord, Status, StudyRecord
from palpate.storage.store import open_store
from palpate.workers.resources import CACHE
from palpate.workers.tasks import study_tasks as tasks
from palpate.workers.tasks.diagnosis_sources import check_source, is_study, open_study

SPEC = {
    "name": "small",
    "case": {
        "reference": {
            "phantom": {
                "spacing_mm": 2.0,
                "lower_mm": 30.0,
                "upper_mm": 45.0,
                "half_width_mm": 28.0,
                "depth_mm": 32.0,
                "glandular_fraction": 0.3,
                "skin_mm": 0.0,
                "ligament_mm": 0.0,
                "compartments": 60,
            }
        },
        "mesh": {"nodes": 500},
        "load": {"force_n": 10},
    },
    "target": {"constants": {"E_fat_kpa": 10.0}},
    "search": {"parameters": {"E_fat_kpa": [5.0, 20.0]}, "population": 4, "generations": 1},
}


def spec_of() -> StudySpec:
    return StudySpec.model_validate(SPEC)


def begun(folder: Path, *, ran: bool = True) -> Path:
    """Return a study as left by `palpate run`, with two candidates evaluated."""
    folder.mkdir(parents=True)
    spec, store = spec_of(), str(open_store(folder.parent / "store").root)
    case = spec.case.model_dump(mode="json")
    with Journal(StudyLayout(folder).journal) as journal:
        journal.append(StudyRecord(spec.digest, spec.as_dict(), {"code": "c"}).to_json())
        if not ran:
            return folder
        prepared = tasks.prepare_case(case, store)
        target = tasks.make_target(case, spec.target.model_dump(mode="json"), store)
        session = SessionRecord("2024-01-01", store, {"code": "c"}, prepared, target, 1, 0.1)
        journal.append(session.to_json())
        for candidate, (kpa, gsf) in enumerate([(12.0, -1.0), (9.5, -3.0)]):
            score = {"gsf": gsf, "jc": 0.9, "mhd_mm": 0.1, "mhd_voxels": 0.1}
            journal.append(
                EvaluationRecord(
                    candidate=candidate,
                    generation=0,
                    genes={"E_fat_kpa": kpa},
                    status=Status.DONE,
                    digest=f"d{candidate}",
                    score=score,
                ).to_json()
            )
    return folder


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return begun(tmp_path_factory.mktemp("runs") / "small")


def test_study_opens_with_its_volumes_and_best_candidate(study: Path) -> None:
    assert is_study(study)
    source = open_study(study)
    check_source(source)
    assert (source.name, list(source.scans)) == ("small", ["10 N"])
    (free,) = source.free
    assert (free.name, free.lower, free.upper) == ("E_fat", 0.005, 0.02)
    assert source.study.best == {"E_fat": 0.0095}
    assert source.study.own == {"target_mesh": source.study.case.mesh.model_dump()}
    body = source.study.reference.values > 0
    pressed = source.study.target.values > 0
    assert np.ptp(np.nonzero(pressed)[1]) < np.ptp(np.nonzero(body)[1])


def test_error_for_a_study_that_has_not_run_names_the_command(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has not run.*palpate run"):
        open_study(begun(tmp_path / "runs" / "small", ran=False))


def test_refuses_folder_that_is_not_a_study(tmp_path: Path) -> None:
    assert not is_study(tmp_path)
    with pytest.raises(InputError, match="is not a study"):
        open_study(tmp_path)


def test_error_names_the_missing_volume(tmp_path: Path) -> None:
    folder = begun(tmp_path / "runs" / "small")
    (session,) = [s for s in Journal.read(StudyLayout(folder).journal) if s["kind"] == "session"]
    target = open_store(session["store"]).layout.volume(session["target"]["target"])
    target.rename(tmp_path / "elsewhere")
    CACHE.clear()
    with pytest.raises(StoreError, match=target.stem):
        open_study(folder)

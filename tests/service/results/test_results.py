"""The record of `palpate report --json`."""

import json
import math
from pathlib import Path

import pytest

from palpate.service.results.results_as_json import candidate_json, study_json
from palpate.service.results.results_from_journal import (
    candidate_results,
    is_running,
    study_results,
)
from palpate.service.study.loop import Study
from palpate.service.study.search_replay import PendingGeneration, SearchReplay
from palpate.service.study.study_folder import StudyLog
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError
from tests.recovery.stand_ins import SPEC, Inline, executions, rewrite, run, small_spec

KEYS = {
    "study",
    "estimates",
    "identification",
    "score",
    "evaluations",
    "seconds",
    "stopped",
    "generations",
    "per_label",
    "per_label_before",
    "stages",
    "versions",
    "config",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results") / "runs" / "demo"
    run(folder, Inline())
    return folder


def test_report_has_all_documented_keys(folder: Path) -> None:
    found = study_json(study_results(folder))
    assert set(found) >= KEYS
    json.dumps(found, allow_nan=False)
    assert found["study"] == "demo"
    assert found["stopped"] == "all 5 generations are done"
    assert found["state"] == "stopped"
    assert set(found["score"]) == {"jc", "mhd_mm", "mhd_voxels", "gsf"}
    assert set(found["evaluations"]) == {"done", "diverged", "crashed", "lost", "reused"}
    assert found["config"] == small_spec().as_dict()


def test_estimates_compare_the_best_candidate_with_the_target(folder: Path) -> None:
    found = study_json(study_results(folder))
    endings = StudyLog.read(StudyLayout(folder).journal).endings.values()
    best = min((r for r in endings if r.score), key=lambda r: r.score["gsf"] if r.score else 0)
    row = found["estimates"]["E_glandular"]
    assert row["estimate"] == best.genes["E_glandular_kpa"]
    assert row["target"] == 40
    assert row["relative_error"] == pytest.approx(abs(row["estimate"] - 40) / 40)
    assert (row["unit"], row["bounds"]) == ("kPa", [5, 80])
    assert found["score"]["gsf"] == best.score["gsf"] if best.score else False
    assert found["best"]["candidate"] == best.candidate


def test_counts_and_stages_add_up(folder: Path) -> None:
    found = study_json(study_results(folder))
    counts = found["evaluations"]
    assert sum(counts[s] for s in ("done", "diverged", "crashed", "lost")) == 12 + 4 * 10
    endings = StudyLog.read(StudyLayout(folder).journal).endings.values()
    computed = len({r.digest for r in endings} & set(executions(folder)))
    assert counts["reused"] == 52 - computed
    assert found["stages"]["solve"]["count"] == computed
    assert found["stages"]["solve"]["total"] == pytest.approx(0.01 * computed)
    assert len(found["failures"]) == counts["diverged"]


def test_the_best_of_the_generations_never_gets_worse(folder: Path) -> None:
    rows = study_json(study_results(folder))["generations"]
    assert [row["number"] for row in rows] == [1, 2, 3, 4, 5]
    bests = [row["best"] for row in rows]
    assert bests == sorted(bests, reverse=True)
    assert all(row["best"] <= row["mean"] for row in rows)


def test_reads_a_study_that_has_just_started(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    study = Study(small_spec(), folder)
    with study.folder.open() as journal:
        study.folder.begin(journal)
        assert is_running(folder)
        found = study_json(study_results(folder))
    assert found["state"] == "running"
    assert found["stopped"] is None
    assert found["score"]["gsf"] is None
    assert found["estimates"]["E_fat"]["estimate"] is None
    assert found["generations"] == [{"number": 1, "asked": 12, "ended": 0, "complete": False}]
    assert study_json(study_results(folder))["state"] == "interrupted"


def test_perfect_score_is_a_string(tmp_path: Path) -> None:
    """GSF is -inf for identical volumes, which JSON cannot represent as a number."""
    folder = tmp_path / "demo"
    run(folder, Inline(), small_spec(SPEC.replace("generations: 5", "generations: 1")))
    journal = StudyLayout(folder).journal
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    told = next(line for line in lines if line.get("candidate") == 3)
    told["score"]["gsf"] = "-inf"
    rewrite(journal, lines)
    assert StudyLog.read(journal).endings[3].score["gsf"] == -math.inf  # type: ignore[index]
    found = study_json(study_results(folder))
    assert found["score"]["gsf"] == "-inf"
    assert found["best"]["candidate"] == 3
    assert found["generations"][0]["best"] == "-inf"
    assert math.isfinite(found["generations"][0]["mean"])


def test_elite_shows_the_evaluation_it_shares(folder: Path) -> None:
    elite = candidate_json(candidate_results(folder, 12))
    origin = candidate_json(candidate_results(folder, elite["evaluated_as"]))
    assert elite["generation"] == 2
    assert origin["generation"] == 1
    assert elite["genes"] == origin["genes"]
    assert elite["score"] == origin["score"]
    best = candidate_json(candidate_results(folder, None))
    assert best["candidate"] == study_json(study_results(folder))["best"]["candidate"]


def test_rejects_unknown_candidates_and_studies(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="0 to 59"):
        candidate_results(folder, 60)
    with pytest.raises(InputError, match="has no journal"):
        study_results(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        study_results(tmp_path / "nothing")


SCORE_KEYS = ["jc", "mhd_mm", "mhd_voxels", "gsf"]
EVALUATION_KEYS = ["candidate", "generation", "status", "reason", "genes", "score", "digest"]
STUDY_KEYS: dict[str, list[str] | None] = {
    "study": None,
    "caveats": None,
    "state": None,
    "stopped": None,
    "identifiable": None,
    "ratios": [],
    "estimates": ["E_fat", "E_glandular"],
    "identification": None,
    "score": SCORE_KEYS,
    "best": EVALUATION_KEYS,
    "evaluations": ["done", "diverged", "crashed", "lost", "reused"],
    "generations": None,
    "failures": None,
    "per_label_before": [],
    "per_label": [],
    "seconds": None,
    "findings": None,
    "derived": [],
    "stages": ["solve"],
    "facts": ["tissue_ml"],
    "target_kind": None,
    "sessions": None,
    "unverified_records": None,
    "unchained_records": None,
    "versions": None,
    "store": None,
    "folder": None,
    "config": ["name", "case", "target", "score", "search", "seed", "keep"],
    "lowest_score": None,
    "best_note": None,
}
ESTIMATE_KEYS = ["gene", "estimate", "target", "relative_error", "unit", "bounds"]
ESTIMATE_KEYS += ["interval", "quotable", "reasons"]
GENERATION_KEYS = ["number", "asked", "ended", "complete"]
SCORED_KEYS = ["best", "mean", "best_candidate", "best_genes", "failed"]
CANDIDATE_KEYS = ["study", "candidate", "generation", "evaluated_as", "genes", "held", "status"]
ENDED_KEYS = [
    "score",
    "reason",
    "traceback",
    "outcome",
    "seconds",
    "worker",
    "attempts",
    "reused",
    "digest",
]


def test_json_keys_are_stable(folder: Path) -> None:
    record = study_json(study_results(folder))
    assert list(record) == list(STUDY_KEYS)
    for key, expected in STUDY_KEYS.items():
        assert expected is None or list(record[key]) == expected, key
    assert all(list(row) == ESTIMATE_KEYS for row in record["estimates"].values())
    assert all(list(row) == GENERATION_KEYS + SCORED_KEYS for row in record["generations"])
    assert all(list(row) == EVALUATION_KEYS for row in record["failures"])
    assert list(record["failures"][0]["genes"]) == ["E_fat_kpa", "E_glandular_kpa"]
    assert list(record["stages"]["solve"]) == ["total", "mean", "count"]
    ended = candidate_json(candidate_results(folder, 3))
    assert list(ended) == CANDIDATE_KEYS + ENDED_KEYS
    assert list(ended["score"]) == SCORE_KEYS


def test_a_candidate_without_an_ending_is_waiting(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    study = Study(small_spec(), folder)
    with study.folder.open() as journal:
        study.folder.begin(journal)
        proposed = SearchReplay(study.spec.search_strategy, study.spec.search.space).propose()
        assert isinstance(proposed, PendingGeneration)
        journal.append(proposed.record().to_json())
    record = candidate_json(candidate_results(folder, 3))
    assert list(record) == CANDIDATE_KEYS
    assert record["status"] == "waiting"

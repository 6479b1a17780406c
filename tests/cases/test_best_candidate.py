"""Consistency of the best candidate of a study across all outputs."""

import math
from collections.abc import Mapping
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from palpate.service.cluster.dask_dashboard import IdleTime, StudyRow
from palpate.service.commands.studies.report import print_report
from palpate.service.results.results_as_json import study_json
from palpate.service.results.results_from_journal import candidate_results, study_results
from palpate.service.search.search_interface import Generation
from palpate.service.server.job_progress import JobProgress
from palpate.service.study.study_events import StudyFacts
from palpate.service.study.study_folder import read_study
from palpate.service.study.study_progress import PlainProgress
from palpate.service.study.study_session import DaskRecords
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.best_candidate import (
    BestSoFar,
    best_of,
    best_searched,
    best_so_far,
    rank_of,
    rank_of_line,
)
from palpate.storage.journal import Journal
from palpate.storage.journal_records import EvaluationRecord, Status
from palpate.workers.tasks import diagnosis_sources as studies_module
from tests.recovery.stand_ins import Inline, run, small_spec

LEAST_SQUARES = """
name: demo
case: {reference: {phantom: {preset: 445ml}}, mesh: {nodes: 2000}}
target: {constants: {E_fat_kpa: 10, E_glandular_kpa: 40}}
search:
  strategy: least-squares
  parameters: {E_fat_kpa: [5, 20], E_glandular_kpa: [5, 70]}
seed: 7
"""


class NearMisses(Inline):
    """Dispatcher that gives lower sums of squares a worse GSF."""

    def run(self, task: Any, calls: Any) -> Any:
        for ending in super().run(task, calls):
            fit = (ending.value or {}).get("fit")
            if fit:
                ending.value["score"] |= {"gsf": -math.log10(fit["cost"] + 1e-9)}
            yield ending


def evaluation(
    candidate: int, gsf: float, cost: float | None = None, level: int | None = None
) -> EvaluationRecord:
    fit: Any = None if cost is None else {"cost": cost}
    score: Any = {"gsf": gsf, "jc": 0.9, "mhd_mm": 1.0, "mhd_voxels": 1.0}
    return EvaluationRecord(
        candidate, 0, {"E_fat_kpa": 10.0 + candidate}, f"digest {candidate}", Status.DONE,
        score=score, fit=fit, level=level,
    )  # fmt: skip


def by_candidate(*records: EvaluationRecord) -> Mapping[int, EvaluationRecord]:
    return {record.candidate: record for record in records}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run a least-squares study in which the lowest GSF and the lowest sum differ."""
    folder = tmp_path_factory.mktemp("best") / "runs" / "demo"
    run(folder, NearMisses(), small_spec(LEAST_SQUARES))
    return folder


@pytest.fixture(scope="module")
def expected(folder: Path) -> EvaluationRecord:
    endings = read_study(folder)[1].endings.values()
    own = [r for r in endings if r.score and r.fit and r.level is None]
    best = min(own, key=lambda r: r.fit["cost"] if r.fit else 0)
    lowest = min(own, key=lambda r: r.score["gsf"] if r.score else 0)
    assert best.candidate != lowest.candidate
    return best


def test_least_squares_ranks_by_the_sum_of_squares() -> None:
    endings = by_candidate(evaluation(0, -2.0, 50.0), evaluation(1, -1.0, 10.0))
    best = best_of(endings)
    assert best is not None
    assert best.candidate == 1


def test_genetic_search_ranks_by_gsf_then_by_number() -> None:
    endings = by_candidate(evaluation(2, -2.0), evaluation(1, -2.0), evaluation(0, -1.0))
    best = best_of(endings)
    assert best is not None
    assert best.candidate == 1


def test_coarse_resolutions_are_used_only_without_full_resolution_scores() -> None:
    coarse = [evaluation(0, -9.0, 1.0, level=0), evaluation(1, -8.0, 2.0, level=1)]
    best = best_of(by_candidate(*coarse))
    assert best is not None
    assert best.candidate == 1  # the finest of the coarse ones
    best = best_of(by_candidate(*coarse, evaluation(2, -1.0, 30.0)))
    assert best is not None
    assert best.candidate == 2


def test_best_of_the_genetic_stage_is_kept_after_polishing() -> None:
    endings = by_candidate(evaluation(0, -2.0), evaluation(1, -1.5), evaluation(2, -1.0, 3.0))
    best, searched = best_of(endings), best_searched(endings)
    assert best is not None
    assert searched is not None
    assert (best.candidate, searched.candidate) == (2, 0)


def test_failed_candidates_are_never_best() -> None:
    crashed = EvaluationRecord(0, 0, {}, "d", Status.DIVERGED, reason="no equilibrium")
    assert best_of(by_candidate(crashed)) is None
    assert rank_of(crashed) is None
    assert rank_of_line(crashed.to_json()) is None


def test_journal_lines_rank_like_records() -> None:
    records = [
        evaluation(0, -math.inf),
        evaluation(1, -2.0, 5.0),
        evaluation(2, -2.0, 5.0, level=3),
    ]
    assert [rank_of_line(r.to_json()) for r in records] == [rank_of(r) for r in records]


def test_best_is_independent_of_the_order_of_arrival() -> None:
    records = [evaluation(c, gsf, cost) for c, gsf, cost in ((0, -3, 9), (1, -1, 2), (2, -2, 2))]
    found = []
    for order in (records, records[::-1]):
        best = BestSoFar()
        for record in order:
            best.add(record)
        assert best.record is not None
        assert best.lowest_score is not None
        found.append((best.record.candidate, best.lowest_score.candidate))
    assert found == [(1, 0), (1, 0)]


def test_the_note_names_both_candidates_with_both_numbers() -> None:
    note = best_so_far([evaluation(4, -2.25, 50.5), evaluation(7, -1.5, 10.25)]).note
    assert note == (
        "Candidate 7 is best because this strategy minimises the sum of squared distances "
        "(10.25; GSF -1.5); candidate 4 has the lowest GSF (-2.25) but a larger sum (50.5)."
    )
    assert best_so_far([evaluation(4, -2.25), evaluation(7, -1.5)]).note == ""


def test_results_and_json_agree(folder: Path, expected: EvaluationRecord) -> None:
    results = study_results(folder)
    assert results.best is not None
    assert results.best.candidate == expected.candidate
    assert results.estimates["E_fat"].estimate == expected.genes["E_fat_kpa"]
    assert candidate_results(folder, None).candidate == expected.candidate
    record = study_json(results)
    assert record["best"]["candidate"] == expected.candidate
    assert record["lowest_score"]["candidate"] != expected.candidate
    assert record["best_note"].startswith(f"Candidate {expected.candidate} is best because")
    last = [g for g in record["generations"] if expected.candidate == g.get("best_candidate")]
    assert len(last) == 1  # its own generation also names it


def test_end_of_the_journal_has_the_best_candidate(
    folder: Path, expected: EvaluationRecord
) -> None:
    _, log = read_study(folder)
    assert log.end is not None
    assert log.end.best == expected.candidate
    assert log.identification is not None
    assert log.identification.candidate == expected.candidate


def test_diagnosis_of_a_study_starts_from_the_best_candidate(
    folder: Path, expected: EvaluationRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Bodies:
        def __init__(self, *_: object) -> None: ...

        def body(self, name: str) -> str:
            return name

    monkeypatch.setattr(studies_module, "BodyStore", Bodies)
    monkeypatch.setattr(studies_module, "source_of_study", lambda organ, study: study)
    study: Any = studies_module.open_study(folder)
    assert study.best == expected.genes


def test_live_progress_has_the_best_candidate(folder: Path, expected: EvaluationRecord) -> None:
    best = JobProgress(folder).update().best
    assert best is not None
    assert best.candidate == expected.candidate
    ranked, lines = BestSoFar(), BestSoFar()
    for line in Journal.read(StudyLayout(folder).journal):
        if line["kind"] == "evaluation":
            ranked.add(EvaluationRecord.from_json(line))
            lines.add_line(line)
            assert lines.record == ranked.record
            assert lines.note == ranked.note


def test_terminal_and_report_name_the_best_candidate(
    folder: Path, expected: EvaluationRecord
) -> None:
    text = StringIO()
    progress = PlainProgress(Console(file=text, width=200))
    run(folder, Inline(), small_spec(LEAST_SQUARES), observers=[progress])
    assert progress.best is not None
    assert progress.best.candidate == expected.candidate
    assert f"(candidate {expected.candidate})" in dict(progress.rows())["best so far"]
    out = StringIO()
    print_report(study_results(folder), Console(file=out, width=400))
    assert f"candidate {expected.candidate}: GSF" in out.getvalue()
    assert f"Candidate {expected.candidate} is best because" in out.getvalue()


def test_dashboard_shows_the_best_score(folder: Path, expected: EvaluationRecord) -> None:
    sent: list[dict[str, Any]] = []
    client: Any = type("Client", (), {"loop": None, "id": "c"})()
    records = DaskRecords(client)
    records._events = type(
        "Events", (), {"add": sent.append, "send": lambda: None, "are_due": False}
    )  # type: ignore[assignment]
    records.started(StudyFacts("demo", str(folder), 100, 5, 1, ""))
    for record in read_study(folder)[1].endings.values():
        records.evaluation_ended(record, False)
    records.generation_begun(0, 1)
    records.generation_ended(0, Generation(np.zeros((1, 1)), np.zeros(1)))
    row = StudyRow("demo", 100, "c")
    for sent_record in sent[1:]:
        row.add(sent_record, IdleTime())
    assert expected.score is not None
    assert row.best_score == expected.score["gsf"]
    assert row.state == "generation 1"

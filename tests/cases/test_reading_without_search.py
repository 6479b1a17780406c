"""Reading finished studies after changes to the search."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate
from palpate.service.report.study.study_data import read_study_data
from palpate.service.results.results_as_json import candidate_json, study_json
from palpate.service.results.results_from_journal import candidate_results, study_results
from palpate.service.search import genetic_operators
from palpate.service.search.cma_search import CmaSearch
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import JournalError
from tests.recovery.stand_ins import SPEC, Inline, run, small_spec

CMA = SPEC.replace("  population: 12", "  strategy: cma\n  population: 12")


def everything_of(folder: Path) -> dict[str, Any]:
    """Return everything read by `status`, `report`, `show`, the page and Python."""
    study = study_json(study_results(folder))
    last = study["generations"][-1]["number"] * 12 - 1
    shown = [candidate_json(candidate_results(folder, number)) for number in (None, 0, 13, last)]
    page = read_study_data(folder, quick=True)
    columns = palpate.Study.open(folder).candidates()
    return {
        "study": study,
        "shown": shown,
        "endings": [ending.to_json() for ending in page.endings],
        "python": {name: repr(column.tolist()) for name, column in columns.items()},
    }


def test_studies_are_readable_after_a_change_of_the_mutation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "runs" / "demo"
    run(folder, Inline())
    before = everything_of(folder)

    original = genetic_operators.AdaptiveFeasible.__call__

    def another_step(*args: Any) -> Any:
        return np.clip(original(*args) * 1.01, 5.0, 20.0)

    monkeypatch.setattr(genetic_operators.AdaptiveFeasible, "__call__", another_step)
    assert everything_of(folder) == before
    journal = StudyLayout(folder).journal
    lines = journal.read_text().splitlines(keepends=True)
    ends = ('"kind":"end"', '"kind":"identification"')
    cut = [line for line in lines if not any(end in line for end in ends)]
    journal.write_text("".join(cut))
    with pytest.raises(JournalError, match="can still be read with `palpate status`"):
        run(folder, Inline())
    assert journal.read_text() == "".join(cut)


def test_cma_studies_are_readable_without_cma(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "runs" / "demo"
    run(folder, Inline(), small_spec(CMA))
    before = everything_of(folder)
    monkeypatch.setitem(sys.modules, "cma", None)

    def not_asked(*_: Any) -> Any:
        raise AssertionError("reading asked the search")

    monkeypatch.setattr(CmaSearch, "propose", not_asked)
    assert everything_of(folder) == before

"""Comparison of studies: constants, scores, differing settings, convergence."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest

from palpate.service.report.study.comparison_page import render_comparison
from palpate.service.results.study_comparison import TABLE, StudyComparison, compare_studies
from palpate.service.study.study_keys import StudySpec, differing_settings
from palpate.storage.errors import InputError
from tests.recovery.stand_ins import Inline, run, small_spec
from tests.recovery.test_strategies import spec_of
from tests.service.report.pages import Page


def named(spec: StudySpec, name: str) -> StudySpec:
    return spec.model_copy(update={"name": name})


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two studies of the same target, only one of which has converged."""
    root = tmp_path_factory.mktemp("comparison") / "runs"
    run(root / "fitted", Inline(), named(spec_of("least-squares"), "fitted"))
    run(root / "searched", Inline(), named(small_spec(), "searched"))
    return root


@pytest.fixture(scope="module")
def comparison(root: Path) -> StudyComparison:
    return compare_studies([root / "fitted", root / "searched"])


def test_shows_only_differing_settings(comparison: StudyComparison) -> None:
    assert comparison.settings["search.strategy"] == ("least-squares", "genetic")
    assert "seed" not in comparison.settings
    assert "name" not in comparison.settings
    a, b = (study.results.spec.as_dict() for study in comparison.studies)
    assert set(comparison.settings) | {"name"} >= set(differing_settings([a, b])) - {"target"}


def test_the_lowest_score_never_rises(comparison: StudyComparison) -> None:
    for study in comparison.studies:
        lowest = np.array(study.lowest_scores)
        counts = study.results.counts
        assert len(lowest) == counts.done + counts.diverged
        assert np.all(np.diff(lowest) <= 0)
    assert comparison.axis == "GSF"


def test_json_record_and_table_agree(comparison: StudyComparison) -> None:
    record = json.loads(json.dumps(comparison.as_dict(), allow_nan=False))
    assert [one["label"] for one in record["studies"]] == ["fitted", "searched"]
    rows = list(csv.DictReader(io.StringIO(comparison.as_csv())))
    assert list(rows[0]) == list(TABLE)
    found = {(row["study"], row["quantity"]): row for row in rows}
    assert len(found) == len(rows) == 2 * (2 + 3)
    fitted, searched = (one["estimates"]["E_fat"] for one in record["studies"])
    row = found["fitted", "E_fat_kpa"]
    assert float(row["value"]) == fitted["estimate"]
    assert float(row["lower"]) == fitted["interval"]["lower"]
    assert (row["unit"], row["quotable"], row["reasons"]) == ("kPa", "True", "")
    row = found["searched", "E_fat_kpa"]
    assert (row["lower"], row["quotable"]) == ("", "False")
    assert row["reasons"] == "; ".join(searched["reasons"]) == "the search has not converged"
    gsf = record["studies"][1]["score"]["gsf"]
    assert float(found["searched", "gsf"]["value"]) == gsf


def test_the_page_shows_constants_scores_and_settings(comparison: StudyComparison) -> None:
    page = Page(render_comparison(comparison))
    page.needs_no_other_file()
    assert page.row("Constant")[1:] == ["fitted", "searched"]
    assert page.row("Efat")[1].startswith("10 (9.963 to 10.04) kPa")
    assert page.row("Efat")[2].endswith("kPa *")
    assert page.row("search.strategy")[1:] == ["least-squares", "genetic"]
    assert "searched, E_fat_kpa and E_glandular_kpa: the search has not converged." in page.text
    charts = page.drawings()
    assert len(charts) == 3
    assert render_comparison(comparison) == page.source


def test_labels_studies_of_one_name_by_their_folders(root: Path, tmp_path: Path) -> None:
    run(tmp_path / "again", Inline(), named(spec_of("least-squares"), "fitted"))
    found = compare_studies([root / "fitted", tmp_path / "again"])
    assert [s.label for s in found.studies] == [str(root / "fitted"), str(tmp_path / "again")]
    assert found.settings == {}
    assert (
        "None: the study files are identical except for their names."
        in Page(render_comparison(found)).text
    )


def test_rejects_studies_that_cannot_be_compared(root: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least two"):
        compare_studies([root / "fitted"])
    with pytest.raises(InputError, match="given twice"):
        compare_studies([root / "fitted", root / "fitted"])
    with pytest.raises(InputError, match="does not exist"):
        compare_studies([root / "fitted", tmp_path / "nothing"])

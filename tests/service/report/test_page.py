"""The page of a hand-made study: well formed, self-contained and complete."""

import json
from collections.abc import Callable
from dataclasses import replace

import pytest

from palpate.service.report.study.study_data import Bodies, StudyData
from palpate.service.report.study.study_page import render_study
from palpate.service.results.results_as_json import study_json
from tests.service.report.pages import Page
from tests.service.report.study_data_at_hand import (
    BODIES,
    nothing_yet,
    perfect,
    record,
    results,
    study_data,
)

CASES = {"whole": study_data, "nothing yet": nothing_yet, "perfect": perfect}


@pytest.fixture(scope="module")
def source() -> str:
    return render_study(study_data())


@pytest.fixture(scope="module")
def page(source: str) -> Page:
    return Page(source)


@pytest.mark.parametrize("made", CASES.values(), ids=CASES)
def test_page_is_well_formed_and_self_contained(made: Callable[[], StudyData]) -> None:
    source = render_study(made())
    page = Page(source)
    assert source.startswith("<!DOCTYPE html>")
    page.needs_no_other_file()


def test_page_is_reproducible(source: str) -> None:
    assert render_study(study_data()) == source


def test_the_verdict_is_a_sentence_with_signed_errors(page: Page) -> None:
    assert "Efat 10.1 kPa, +1.2 % from the target; ηfat 93 kPa." in page.text
    assert "share 89.0 % of the volume that they fill together" in page.text
    assert "their surfaces are 0.396 mm (0.2 voxels) apart" in page.text
    assert "The search has ended: all 2 generations are done." in page.text


def test_parameters_are_shown_with_bounds_target_and_unit(page: Page) -> None:
    assert page.row("Efat") == ["Efat", "10.1", "–", "10", "+1.2 %", "5 … 20", "kPa"]
    assert page.row("ηfat") == ["ηfat", "93", "–", "–", "–", "50 … 200", "kPa"]


def test_every_number_of_the_results_is_in_the_page(page: Page) -> None:
    begin = page.text.index('{ "study": "made-by-hand"')
    assert json.JSONDecoder().raw_decode(page.text, begin)[0] == study_json(results())


def test_similarity_includes_undeformed_body(page: Page) -> None:
    glandular = page.row("glandular")
    before, after = glandular[1].split(" → ")
    assert 0.0 < float(before) < float(after) == 0.8904
    assert page.row("fat")[1].endswith("→ 0.7777")
    assert glandular[5].endswith("→ −3.83")


def test_failures_are_shown_with_constants_and_escaped_reason(source: str, page: Page) -> None:
    assert "2 of 5 evaluations have no score" in page.text
    diverged = page.row("2")
    assert diverged[1:4] == ["1", "diverged", "Efat 5.5 kPa, ηfat 55.25 kPa"]
    assert diverged[4] == "element 17 <inverted> at 61 % of the load"
    assert "Traceback: <b>" in page.row("3")[4]
    assert "<inverted>" not in source


def test_many_failures_are_folded() -> None:
    many = tuple(record(i, (5.5, 60.0), status="lost", reason="its worker died") for i in range(25))
    page = Page(render_study(study_data(endings=many, results=results(best=None), bodies=Bodies())))
    assert page.seen.count("details") == Page(render_study(nothing_yet())).seen.count("details") + 1
    assert "25 of 25 evaluations have no score" in page.text


def test_shows_time_counts_and_throughput(page: Page) -> None:
    assert page.row("solve") == ["solve", "90 s", "22.5 s", "90.0 %"]
    assert page.row("score") == ["score", "10 s", "2.5 s", "10.0 %"]
    for said in (
        "2 min 3 s of wall time",
        "Evaluations done3",
        "Evaluations diverged1",
        "Evaluations crashed1",
        "Evaluations lost0",
        "Reused from the store1",
        "Throughput1.95 evaluations per min",  # 4 of 5 computed in 123 s
        "Parallel evaluations3",
    ):
        assert said in page.text, said


def test_shows_solver_output_of_best_simulation(page: Page) -> None:
    for said in (
        "Plate displacement37.66 mm",
        "Force on the plate40 N",
        "Contact area3051 mm²",
        "Smallest volume ratio J0.7697",
        "relative1.4·10⁻¹⁰",
        "13 + 11",
        "13 + 1 391",
        "Force of the chest wall−0.0021 N",
        "Stored energy471.1 mJ",
    ):
        assert said.replace(" ", "") in page.text.replace("\u202f", "").replace(" ", ""), said


def test_page_of_a_new_study_reports_that_nothing_was_evaluated() -> None:
    text = Page(render_study(nothing_yet())).text
    assert "No estimates yet" in text
    assert "The search is still running" in text
    assert "No evaluation has a score yet" in text
    assert "nothing has been evaluated yet" in text


def test_infinities_are_drawn_and_printed() -> None:
    page = Page(render_study(perfect()))
    assert "−∞" in page.text
    labels = ["".join(drawing.itertext()) for drawing in page.drawings()]
    assert any("identical to the target" in text and "failed" in text for text in labels)


@pytest.mark.parametrize(
    ("state", "said"),
    [("running", "still running"), ("interrupted", "Running it again continues it")],
)
def test_page_shows_that_the_search_is_unfinished(state: str, said: str) -> None:
    unfinished = study_data(results=results(state=state, stop_reason=None), bodies=Bodies())
    assert said in Page(render_study(unfinished)).text


def test_warns_about_estimate_at_bound() -> None:
    plain = study_data(bodies=Bodies())
    assert "is at the edge" not in Page(render_study(plain)).text
    estimates = dict(plain.results.estimates)
    estimates["eta_fat"] = replace(estimates["eta_fat"], estimate=199.5)
    at_edge = study_data(results=results(estimates=estimates), bodies=Bodies())
    assert "ηfat is at the edge" in Page(render_study(at_edge)).text


@pytest.mark.parametrize("lost", ["reference", "target", "best"])
def test_shows_other_volumes_if_one_is_lost(lost: str) -> None:
    kept = {name: getattr(BODIES, name) for name in ("reference", "target", "best")}
    bodies = Bodies(**(kept | {lost: None, "missing": (f"The {lost} is gone.",)}))
    page = Page(render_study(study_data(bodies=bodies)))
    assert f"The {lost} is gone." in page.text
    labels = {drawing.get("aria-label", "") for drawing in page.drawings()}
    titles = {"reference": "Undeformed", "target": "Target", "best": "Best candidate"}
    for name, title in titles.items():
        assert (f"{title}, coronal" in labels) == (name != lost)
    assert any(label.startswith("Difference") for label in labels) == (lost == "reference")

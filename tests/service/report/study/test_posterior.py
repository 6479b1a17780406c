"""The corner plot on the page of a study."""

from dataclasses import replace

import pytest

from palpate.service.report.study.study_charts import posterior_picture
from palpate.service.report.study.study_data import StudyData, read_study_data
from palpate.service.report.study.study_page import render_study
from tests.recovery.stand_ins import Inline, run
from tests.recovery.test_strategies import spec_of
from tests.service.report.pages import Page


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> StudyData:
    folder = tmp_path_factory.mktemp("posterior") / "runs" / "demo"
    run(folder, Inline(), spec_of("least-squares"))
    return read_study_data(folder)


def test_the_page_shows_the_constants_that_have_intervals(data: StudyData) -> None:
    page = Page(render_study(data))
    page.needs_no_other_file()
    (drawn,) = [d for d in page.drawings() if d.get("aria-label", "").startswith("Posterior.")]
    assert "E fat, kPa: 10, 9.963 to 10.04" in drawn.get("aria-label", "")
    assert "90 % intervals" in page.text
    assert render_study(data) == page.source


def test_fewer_than_two_intervals_need_no_corner_plot(data: StudyData) -> None:
    results = data.results
    weak = replace(results.estimates["E_fat"], interval=None)
    assert posterior_picture(replace(results, estimates={"E_fat": weak})) is None
    assert posterior_picture(replace(results, posterior=None)) is None
    assert "Posterior." not in render_study(replace(data, quick=True))

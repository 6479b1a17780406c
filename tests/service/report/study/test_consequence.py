"""Quotable constants and next steps for every kind of ending."""

from dataclasses import replace
from typing import Any

import pytest

from palpate.service.report.study.study_consequence import next_step, quotable
from palpate.service.report.study.study_page import render_study
from palpate.service.results.identification import (
    Identification,
    IdentifiedConstant,
    IdentifiedRatio,
    Interval,
)
from palpate.service.results.quotability_rule import Quotability
from tests.service.report.pages import Page
from tests.service.report.study_data_at_hand import results, study_data


def known(e_fat: str = "value", eta_fat: str = "weak", **changed: Any) -> Identification:
    """E_fat within 3 %, eta_fat from half to one and a half times its value."""
    intervals = {
        "value": {"E_fat": (9.8, 10.4), "eta_fat": (90.0, 96.0)},
        "weak": {"E_fat": (5.0, 15.0), "eta_fat": (46.0, 140.0)},
    }
    constants = {}
    for name, verdict, estimate in (("E_fat", e_fat, 10.12), ("eta_fat", eta_fat, 93.0)):
        ends = intervals.get(verdict, {}).get(name)
        interval = None if ends is None else Interval(*ends, 0.9, "tangents")
        constants[name] = IdentifiedConstant(name, estimate, "kPa", interval, verdict)  # type: ignore[arg-type]
    return Identification(0, constants, **changed)


def page(identification: Identification | None, **changed: Any) -> Page:
    return Page(render_study(study_data(results=results(identification=identification, **changed))))


def test_quotes_only_well_determined_constants() -> None:
    shown = page(known())
    assert (
        "Quote Efat = 10.1 (9.8 to 10.4) kPa; do not quote ηfat (weakly determined, 46 to 140 kPa)."
    ) in shown.text
    assert shown.row("Efat")[1:3] == ["10.1", "9.8 … 10.4"]
    assert shown.row("ηfat")[1:3] == ["93 weakly determined", "46 … 140"]
    assert '<tr class="weak"><td><i>η</i>' in shown.source
    assert "<tr><td><i>E</i>" in shown.source
    assert "Intervals are 90 % intervals from the derivatives" in shown.text
    assert "determine ηfat better: palpate diagnose" in shown.text


def test_intervals_are_drawn() -> None:
    assert 'class="interval"' in page(known()).source
    assert 'class="interval"' not in page(None).source


def test_quotes_all_well_determined_constants() -> None:
    said = "What to quote Quote Efat = 10.1 (9.8 to 10.4) kPa and ηfat = 93 (90 to 96) kPa."
    assert said in page(known(eta_fat="value")).text


def test_quotes_only_ratios_without_a_force() -> None:
    ratio = IdentifiedRatio("eta_fat", "E_fat", 9.19, Interval(9.0, 9.4, 0.9, "tangents"), "value")
    text = page(known("ratio", "ratio", ratios=(ratio,))).text
    assert "Quote ratios only: ηfat / Efat = 9.19." in text
    assert "Give the plate force" in text
    assert "only its ratio" in text


def test_study_without_derivatives_has_no_intervals() -> None:
    text = page(known("unknown", "unknown", note="the simulation had no tangents")).text
    assert "Do not quote Efat and ηfat (no interval is known)." in text
    assert "There are no intervals: the simulation had no tangents." in text


def test_an_estimate_at_its_bound_is_not_quoted() -> None:
    estimates = dict(results().estimates)
    estimates["eta_fat"] = replace(estimates["eta_fat"], estimate=199.5)
    text = page(known(eta_fat="value"), estimates=estimates).text
    assert "do not quote ηfat (at the upper bound of the searched interval (200 kPa))" in text
    assert "Widen the searched interval of ηfat" in text


def test_an_estimate_at_its_physical_limit_is_an_answer() -> None:
    estimates = dict(results().estimates)
    limited = {"lower": 0.0, "upper": 100.0, "estimate": 0.2, "target": 0.0, "limit": 0.0}
    estimates["eta_fat"] = replace(
        estimates["eta_fat"], **limited, interval=(0.0, 12.0), description="fibre stiffness"
    )
    constants = dict(known().constants)
    interval = Interval(0.0, 12.0, 0.9, "tangents")
    constants["eta_fat"] = replace(constants["eta_fat"], interval=interval, identifiable="limit")
    found = results(identification=Identification(0, constants), estimates=estimates)
    shown = Page(render_study(study_data(results=found)))
    assert "Efat = 10.1 (9.8 to 10.4) kPa" in shown.text
    assert "ηfat < 12 kPa (90 %, no fibre stiffness is needed)." in shown.text
    assert shown.row("ηfat")[2] == "below 12"
    for word in ("do not quote", "Widen", "edge of the searched interval", "weakly determined"):
        assert word not in shown.text.split("Intervals are")[0]


def test_the_search_of_poissons_ratio_is_not_widened_beyond_a_half() -> None:
    estimates = dict(results().estimates)
    estimates["nu"] = replace(
        estimates["E_fat"], gene="nu", unit="", lower=0.45, upper=0.499, estimate=0.499, target=None
    )
    text = Page(str(next_step(results(estimates=estimates), "image"))).text
    assert "Widen the searched interval of ν (it must be below 0.5) and run" in text


def test_each_reason_is_said_once() -> None:
    """Of nine constants, none has converged and two are weakly determined."""
    weak = ("weakly determined, 5 to 15 kPa", "weakly determined, 1 to 9 kPa")
    late = "the search has not converged"
    reasons = [(late, why) for why in weak] + [(late,)] * 7
    one = results().estimates["E_fat"]
    estimates = {
        f"E_{n}": replace(one, gene=f"E_{n}_kpa", quotability=Quotability(False, why))
        for n, why in enumerate(reasons)
    }
    said = str(quotable(results(estimates=estimates)))
    assert said.count("the search has not converged") == 1
    assert said.count("weakly determined") == 1
    lines = [Page(line).text for line in said.split("<br>")]
    assert [line.partition(":")[2] for line in lines] == [
        " the search has not converged.",
        " weakly determined.",
    ]
    assert "E0 (5 to 15 kPa) and E1 (1 to 9 kPa)" in lines[1]


def test_error_of_an_estimate_is_shown_with_the_digits_that_differ() -> None:
    estimates = dict(results().estimates)
    estimates["E_fat"] = replace(estimates["E_fat"], estimate=9.997, target=10.0)
    shown = page(None, estimates=estimates)
    assert "Efat 9.997 kPa, −0.03 % from the target" in shown.text
    assert shown.row("Efat")[1] == "9.997"


@pytest.mark.parametrize(
    ("state", "said"),
    [("running", "updated after every generation"), ("interrupted", "palpate run /nowhere")],
)
def test_an_unfinished_search_is_not_quoted(state: str, said: str) -> None:
    text = page(None, state=state, stop_reason=None).text
    assert "Do not quote Efat and ηfat (the search has not finished, and this is" in text
    assert said in text


def test_page_states_date_mesh_seed_version_and_command() -> None:
    text = page(None).text
    for said in ("1 January 2026, 00:00 UTC", "916 nodes, 3 744 tetrahedra", "Seed", "0.1.0"):
        assert said in text, said
    assert "Commandpalpate run /nowhere/runs/made-by-hand" in text


def test_headline_tile_table_and_chart_round_alike() -> None:
    shown = page(None)
    assert "share 89.0 % of the volume" in shown.text
    tiles = shown.source[shown.source.index('class="tiles"') :][:900]
    assert "0.890" in tiles
    assert "0.396" in tiles
    assert "are 0.396 mm" in shown.text
    assert shown.text.count("10.1 kPa") == 1
    charts = "".join(text for d in shown.drawings() for text in d.itertext())
    assert "10.1" in charts
    assert "10.12" not in charts

"""The page of a diagnosis: self-contained and consistent with the record."""

import copy
import json
import math
import re
import subprocess
import sys
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from palpate.service.diagnosis.diagnosed_constants import summary_json
from palpate.service.diagnosis.diagnosis_words import STRENGTHS, sentence, strength
from palpate.service.report.diagnosis.diagnosis_charts import Evidence, Judged, evidence, gaps
from palpate.service.report.diagnosis.diagnosis_page import render_diagnosis
from palpate.service.report.diagnosis.gap_maps import gap_range_mm, residual_map
from palpate.service.report.drawing.colours import SIGNED, ColourScale
from palpate.service.report.drawing.svg import Svg
from palpate.service.report.page.page_elements import DIAGNOSIS_TERMS
from palpate.service.report.study.page_provenance import Made, Origin
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.scan_plan import REDRAWN
from palpate.workers.organs.breast.breast_effects import CATALOGUE
from tests.service.report.diagnosis_at_hand import VERDICTS, found, gap, nothing, summary, typed
from tests.service.report.pages import Page


def sentence_of(told: dict[str, Any]) -> str:
    return sentence(typed(told))


@pytest.fixture(scope="module")
def source() -> str:
    return render_diagnosis(found())


@pytest.fixture(scope="module")
def page(source: str) -> Page:
    return Page(source)


@pytest.mark.parametrize("told", VERDICTS.values(), ids=VERDICTS)
def test_page_is_well_formed_and_self_contained(told: dict[str, Any]) -> None:
    source = render_diagnosis(found(told))
    page = Page(source)
    page.needs_no_other_file()
    begin = page.text.index('{ "case": "by-hand"')
    shown = json.JSONDecoder().raw_decode(page.text, begin)[0]
    for constant in shown["constants"].values():
        assert constant.pop("quotable") is not bool(constant.pop("reasons"))
    assert {name: shown[name] for name in told} == told


def test_page_is_reproducible(source: str) -> None:
    assert render_diagnosis(found()) == source


def test_the_page_is_written_without_matplotlib() -> None:
    """Importing it would take as long as writing the page."""
    page = "palpate.service.report.diagnosis.diagnosis_page"
    asked = f"import sys, {page}; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", asked], check=False).returncode == 0


DIFFER = (
    "Model and data differ by 0.27 mm (0.23 to 0.31) beyond the noise, most in the nipple third of "
    "the glandular interface in the scan at 80 N (0.61 mm)."
)
TILT = "plate tilt (5.48 ± 0.27 deg, strong evidence)"
HELD_OUT = (
    "On scans left out of the fit, it leaves nothing above the noise (at most 0.15 mm) of 0.31 mm."
)


def test_verdict_says_where_which_and_how_far() -> None:
    assert sentence_of(summary()) == f"{DIFFER} The cause is {TILT}. {HELD_OUT}"


def test_worst_place_is_the_largest_significant_region() -> None:
    def said(*regions: dict[str, Any]) -> str:
        return sentence_of(summary(where=list(regions))).split(" beyond the noise")[1].split(".")[0]

    def region(mm: float, mean: float, **changes: Any) -> dict[str, Any]:
        told = {"scan": "40 N", "interface": "outline", "region": "middle third"}
        told |= {"signed_mean_mm": mean, "significant": True}
        return told | gap(mm, mm / 2, 2 * mm) | changes

    assert said() == ""
    assert said(region(0.4, 0.3, significant=False)) == ""
    small, whole = region(0.2, -0.15), region(0.9, 0.0, region="all")
    middle = ", most in the middle third of the outline interface in the scan at 40 N (0"
    assert said(small, region(0.4, 0.3)) == middle
    assert f"{middle}.40 mm, the model outside)" in sentence_of(
        summary(where=[small, region(0.4, 0.3)])
    )
    assert f"{middle}.20 mm, the model inside)" in sentence_of(summary(where=[whole, small]))
    assert ", most in the outline interface in the scan at 40 N (0.90 mm)" in sentence_of(
        summary(where=[whole])
    )


def test_worst_place_of_a_specimen_is_a_state() -> None:
    def state(name: str, left_mm: float) -> dict[str, Any]:
        left = {"before_mm": [0.0, left_mm, math.nan], "after_mm": None}
        points = [{"name": "M", "displacement_mm": [0.0, 1.0, 2.0]} | left]
        return {"state": name, "repeats_mm": None, "points": points}

    states = [state("pulled", 0.1), state("bent", -0.4), state("twisted", 0.2)]
    assert "beyond the noise, most in the state bent." in sentence_of(summary(markers=states))
    assert "beyond the noise. " in sentence_of(summary(markers=states[:1], where=[]))


@pytest.mark.parametrize(
    ("gain", "word"),
    [
        (None, "–"),
        (-3.0, "none"),
        (5.0, "none"),
        (10.0, "faint"),
        (10.1, "weak"),
        (20.0, "weak"),
        (20.1, "clear"),
        (50.0, "clear"),
        (50.1, "strong"),
    ],
)
def test_words_for_evidence_change_at_their_thresholds(gain: float | None, word: str) -> None:
    assert strength(gain) == word


def test_glossary_states_the_thresholds_of_the_words() -> None:
    settings = SETTINGS.selection
    ends = [settings.first_measured, settings.first, *(most for _, most in STRENGTHS)]
    numbers = [float(n) for n in re.findall(r"\d+", dict(DIAGNOSIS_TERMS)["Evidence"])]
    assert numbers == ends


def test_one_scan_gives_a_lead_on_terminal_page_and_record() -> None:
    assert sentence_of(VERDICTS["one scan"]) == (
        f"{DIFFER.replace('0.27 mm (0.23 to 0.31)', '0.30 mm (0.20 to 0.40)')} A lead, not a "
        f"finding: {TILT}. It leaves 0.10 mm (0.00 to 0.20) on the scan used in the fit; this was "
        "not checked on other scans."
    )
    checked = {
        name: summary_json(typed(told))["shrinkage"]["checked_on"]
        for name, told in VERDICTS.items()
    }
    assert checked == {
        "effect": "other scans",
        "no gap": None,
        "none of these": None,
        "not told apart": "other scans",
        "one scan": "same scan",
    }
    text = Page(render_diagnosis(found(VERDICTS["one scan"]))).text
    assert "How much plate tilt reduces the gap was not checked on other scans." in text
    assert "treat this cause as a lead, not a finding" in text
    assert "Confirm plate tilt with a scan under another load." in text
    assert "Do not quote Efat and η (it depends on a cause that is not certain)" in text


def test_something_that_no_effect_explains_is_stated() -> None:
    told = VERDICTS["none of these"] | {"gap_mm": summary()["gap_mm"] | {"after": None}}
    assert sentence_of(told) == f"{DIFFER} No effect in the catalogue explains it."
    text = Page(render_diagnosis(found(told))).text
    assert "explains would gain 41.2 nats: something else acts." in text


def test_something_else_acts_beside_the_named_effects() -> None:
    told = summary(left_gain=17.34, something_else=True)
    rest = "A systematic rest remains: something else acts as well."
    assert sentence_of(told) == f"{DIFFER} The cause is {TILT}. {HELD_OUT} {rest}"
    text = Page(render_diagnosis(found(told))).text
    assert "would gain 17.3 nats beside the named effects: something else acts." in text
    assert "something else acts" not in Page(render_diagnosis(found())).text


def test_a_second_segmentation_is_drawn_not_measured() -> None:
    option = {"name": REDRAWN, "separates": [], "reveals": [], "minimum_ratio": 0.8}
    text = Page(render_diagnosis(found(summary(next_acquisitions=[option])))).text
    assert (
        "Draw a second segmentation of every scan: effects 0.80 times as large would show." in text
    )


@pytest.mark.parametrize(
    ("separates", "words"),
    [
        ([["plate_tilt", "fibre_fan"]], "Measure 9 N, to distinguish plate tilt from fibre fan."),
        ([], "Measure 9 N: effects 0.80 times as large would show."),
    ],
)
def test_next_measurement_says_what_it_decides(separates: list[list[str]], words: str) -> None:
    option = {"name": "9 N", "separates": separates, "reveals": [], "minimum_ratio": 0.8}
    told = summary(
        verdict="cannot-be-told-apart",
        rivals=["plate_tilt", "fibre_fan"],
        next_acquisitions=[option],
    )
    assert words in Page(render_diagnosis(found(told))).text


@pytest.mark.parametrize(("gap_mm", "is_small"), [(0.14, True), (0.16, False)])
def test_a_small_gap_may_be_the_solver_s(gap_mm: float, is_small: bool) -> None:
    gap = summary()["gap_mm"]
    before = gap["before"] | {"gap_mm": gap_mm}
    noise = [{"interface": "skin", "stated_mm": 0.2, "learnt_mm": 0.2}]
    words = "Two solvers of one model may differ by as much."
    assert (words in sentence_of(summary(gap_mm=gap | {"before": before}, noise=noise))) == is_small
    assert words not in sentence_of(summary(gap_mm=gap | {"before": before}))


def test_a_state_of_a_specimen_is_no_scan() -> None:
    told = VERDICTS["one scan"] | {"markers": []}
    assert sentence_of(told).endswith(
        "on the state used in the fit; this was not checked on other states."
    )


def test_says_which_scans_chose_the_cause() -> None:
    gap = summary()["gap_mm"]
    rest = "it leaves nothing above the noise (at most 0.15 mm) of 0.31 mm."
    assert sentence_of(summary()).endswith(f"On scans left out of the fit, {rest}")
    said = sentence_of(summary(gap_mm=gap | {"chosen_again": ["40 N", "80 N"]}))
    assert said.endswith(f"Chosen and fitted on the other scans, {rest}")
    said = sentence_of(summary(gap_mm=gap | {"chosen_again": ["80 N"]}))
    assert said.endswith(f"{rest} Without the scan at 40 N, it would not be chosen.")


def test_reports_a_systematic_residual_below_noise() -> None:
    gap = summary()["gap_mm"]
    gap["before"] = gap["held_out_before"] = gap["before"] | {"gap_mm": 0.0, "low_mm": 0.0}
    said = sentence_of(summary(gap_mm=gap))
    assert said.startswith("The residual is below the noise level but systematic.")
    assert said.endswith("leaves nothing above the noise (at most 0.15 mm).")


def test_reports_wrong_noise() -> None:
    def said(stated: float, learnt: float) -> str:
        noise = {"interface": "outline", "stated_mm": stated, "learnt_mm": learnt}
        return sentence_of(summary(noise=[noise])).removeprefix(sentence_of(summary()))

    assert said(0.3, 0.35) == ""
    assert said(0.2, 0.3) == (
        " The noise of the outline interface is set too small: 0.20 mm, but its residuals "
        "show 0.30 mm."
    )
    assert "is set too large: 0.40 mm" in said(0.4, 0.3)


def test_wrong_noise_is_warning_outside_headline() -> None:
    noise = {"interface": "outline", "stated_mm": 0.2, "learnt_mm": 0.3}
    shown = render_diagnosis(found(summary(noise=[noise])))
    (warned,) = re.findall(r'<p class="note warn">([^<]*)</p>', shown)
    assert warned.startswith("The noise of the outline interface is set too small")
    assert shown.count("set too small") == 1


def test_reports_gap_of_micrometres() -> None:
    gaps_mm = summary()["gap_mm"] | {
        "noise_floor": 0.0012,
        "before": gap(0.0031, 0.0027, 0.0035),
        "after": None,
        "held_out_before": None,
        "held_out_after": None,
    }
    told = sentence_of(summary(gap_mm=gaps_mm))
    assert told.startswith("Model and data differ by 0.0031 mm (0.0027 to 0.0035) beyond the noise")
    # Under a tenth of a millimetre of noise the same gap is none.
    told = sentence_of(summary(gap_mm=gaps_mm | {"noise_floor": 0.1}))
    assert told.startswith("The residual is below the noise level but systematic")


def with_second_cause() -> dict[str, Any]:
    """Return a diagnosis of a tilt and a flexing plate, which alone gains nothing."""
    told = copy.deepcopy(summary(primary=["plate_tilt", "plate_flex"]))
    told["refits"][2]["log_evidence_gain"] = 160.0
    (flex,) = (one for one in told["effects"] if one["name"] == "plate_flex")
    flex["gain"] = 1.5
    return told


def test_a_further_cause_has_the_evidence_that_it_adds() -> None:
    told = with_second_cause()
    causes = f"The causes are {TILT} and plate flex (8.0 ± 1.0 mm, clear evidence)."
    assert causes in sentence_of(told)
    row = Page(render_diagnosis(found(told))).row("plate flexplate geometry")
    assert (row[1], row[3]) == ("clear", "32.8")
    told["refits"] = told["refits"][:2]
    assert "plate flex (8.0 ± 1.0 mm)." in sentence_of(told)


def test_a_residual_that_no_effect_explains_is_no_agreement() -> None:
    told = nothing("no-gap")
    told["gap_mm"] = told["gap_mm"] | {"before": gap(0.12, 0.08, 0.15)}
    said = sentence_of(told)
    assert said.startswith("Model and data differ by 0.12 mm (0.08 to 0.15) beyond the noise")
    assert said.endswith("It is too small or too irregular to name a cause.")


@pytest.mark.parametrize(
    ("which", "said"),
    [
        (
            "no gap",
            "Model and data agree: the residual is no larger than the noise. A gap larger than "
            "0.11 mm is unlikely.",
        ),
        ("none of these", "No effect in the catalogue explains it."),
        (
            "not told apart",
            "These scans cannot decide: plate tilt and plate flex explain it almost equally well; "
            f"the best is {TILT}. {HELD_OUT}",
        ),
    ],
)
def test_each_verdict_has_its_sentence(which: str, said: str) -> None:
    assert said in sentence_of(VERDICTS[which])


def test_no_gap_shows_what_would_have_been_seen() -> None:
    said = (
        "These scans would have shown, from this size on: plate flex 2 mm and plate tilt 1.3 deg."
    )
    silent = Page(render_diagnosis(found(VERDICTS["no gap"])))
    assert said in silent.text
    assert silent.row("plate tiltplate geometry")[3:] == ["–", "1.3 deg", "1 %"]
    assert "These scans would have shown" not in Page(render_diagnosis(found())).text


def test_absorbed_effects_are_last_and_grey(source: str, page: Page) -> None:
    heading = ["Effect", "Evidence", "Magnitude", "Gain, nats", "Seen from"]
    assert [*heading, "Absorbed by constants"] in page.cells
    tilt = page.row("plate tiltplate geometry")
    assert tilt[1] == "strong"
    assert tilt[2].startswith("tilt depth 5.48 ± 0.27 degtilt across −0.04 ± 0.12 deg")
    assert tilt[3:] == ["127.2", "1.3 deg", "1 %"]
    hidden = page.row("plate forceloading")
    assert hidden[1] == "–"
    assert hidden[3:] == ["–", "–", "99 %"]
    assert "the constants absorb 99 % of it" in hidden[2]
    order = [row[0] for row in page.cells if row[0].startswith("plate ")]
    assert order[:3] == [
        "plate tiltplate geometry",
        "plate flexplate geometry",
        "plate forceloading",
    ]
    assert '<tr class="off"><td>plate force<small>' in source
    assert "<tr><td>plate tilt<small>" in source
    assert "What plate_tilt &lt;is&gt;." in source


def test_constants_are_shown_without_and_with_the_effect(page: Page) -> None:
    assert page.row("Efat") == ["Efat", "10", "11", "10.7 … 11.3", "+10.0 %", "kPa", "yes"]
    alone = Page(render_diagnosis(found(VERDICTS["no gap"])))
    assert "no effect would gain enough to be fitted" in alone.text
    assert alone.row("Efat") == ["Efat", "10", "–", "9.8 … 10.2", "–", "kPa", "yes"]


def test_regions_without_a_significant_gap_are_grey(source: str, page: Page) -> None:
    assert page.row("40 N")[1:] == ["outline", "all", "0.10 mm (0.00 to 0.20)", "0.00", "8"]
    assert page.row("80 N")[1:] == [
        "glandular",
        "nipple third",
        "0.61 mm (0.51 to 0.70)",
        "−0.25",
        "8",
    ]
    assert '<tr class="off"><td>40 N' in source
    assert "<tr><td>80 N" in source


def test_lists_causes_outside_catalogue(page: Page) -> None:
    for what, why in CATALOGUE.not_simulated:
        assert page.row(what)[1] == why


def test_counts_points_left_out(page: Page) -> None:
    assert "were left out" not in page.text
    record = summary() | {"left_out": 9}
    note = f"Of {record['points'] + 9} points, 9 were left out, because at least one scan does not"
    assert note in Page(render_diagnosis(found(record))).text


def test_causes_that_cannot_be_told_apart_need_another_scan() -> None:
    text = Page(render_diagnosis(found(VERDICTS["not told apart"]))).text
    assert "These scans cannot decide between the causes. Run “palpate plan”" in text
    assert "Effects within 5 nats of the best cannot be told apart." in text


def test_headline_lengths_agree_with_tiles() -> None:
    """Headline and tiles are rounded alike."""
    told = Page(render_diagnosis(found()))
    lengths = re.findall(r"(?:differ by|of) (\d\.\d\d) mm", sentence_of(summary()))
    assert lengths == ["0.27", "0.31"]
    tiles = told.source[told.source.index('class="tiles"') : told.source.index('class="contents"')]
    assert all(length in tiles for length in lengths)


@pytest.mark.parametrize(
    ("which", "quote", "following"),
    [
        (
            "effect",
            "Quote Efat = 11 (10.7 to 11.3) kPa and η = 60.1 (55 to 66) kPa, fitted with plate "
            "tilt.",
            "Add plate",
        ),
        (
            "no gap",
            "Quote Efat = 10 (9.8 to 10.2) kPa. The constants may have absorbed plate force.",
            "Nothing needs to be added",
        ),
        (
            "none of these",
            "Do not quote Efat (the model lacks something that is not in the catalogue)",
            "Check where model and data differ",
        ),
        (
            "not told apart",
            "Do not quote Efat and η (it depends on a cause that is not certain)",
            "palpate plan",
        ),
    ],
)
def test_each_verdict_says_what_to_quote_and_what_to_do_next(
    which: str, quote: str, following: str
) -> None:
    text = Page(render_diagnosis(found(VERDICTS[which]))).text
    assert f"What to quote {quote}" in text
    assert f"Next {following}" in text or following in text[text.index("Next ") :][:120]


def test_page_shows_provenance() -> None:
    made = Made(
        "2026-11-22T10:05:00+00:00",
        "palpate diagnose cases/by-hand",
        94.0,
        [("case by-hand", "0123abcd"), ("reference", "4567ef")],
        "about 5000 nodes",
        "standard deviation 0.4 mm",
    )
    text = Page(render_diagnosis(found(), Origin(made))).text
    for said in (
        "22 November 2026, 10:05 UTC",
        "case by-hand, 0123abcd",
        "reference, 4567ef",
        "about 5000 nodes",
        "standard deviation 0.4 mm",
        "Run time94 s",
        "Commandpalpate diagnose cases/by-hand",
    ):
        assert said in text, said


def test_doubtful_results_give_warnings() -> None:
    refits = [summary()["refits"][0] | {"converged": False}]
    assert "The refit of plate flex did not converge" in render_diagnosis(
        found(summary(refits=refits))
    )
    gap = summary()["gap_mm"]
    gap["held_out_share"] = {"share": 0.3, "low": -0.2, "high": 0.6}
    assert "treat this cause as a lead" in render_diagnosis(found(summary(gap_mm=gap)))
    gap = summary()["gap_mm"] | {"not_judged": ["80 N"]}
    assert "The gap of 80 N with the effect is not checked" in render_diagnosis(
        found(summary(gap_mm=gap))
    )
    assert "note warn" not in render_diagnosis(found())


def test_draws_a_map_for_each_scan_and_interface() -> None:
    labels = [
        drawing.get("aria-label", "") for drawing in Page(render_diagnosis(found())).drawings()
    ]
    captions = [label for label in labels if "scan at" in label]
    assert [caption.split(":")[0] for caption in captions] == [
        "Outline, scan at 40 N",
        "Glandular, scan at 40 N",
        "Outline, scan at 80 N",
        "Glandular, scan at 80 N",
    ]
    # Twelve points, half of them on each interface; twice the noise is 0.8 mm.
    maps = found().maps
    loud = 100 * (abs(maps["before"][0, :6]) >= 0.8).mean()
    assert f"of a point: {loud:.0f} % (nominal model)" in captions[0]


def rects(svg: Svg, *classes: str) -> list[tuple[str, float, float]]:
    """Return bars as (class, start, end) in pixels, without the legend."""
    drawing = ElementTree.fromstring(str(svg.markup("bars")))
    bars = [e for e in drawing.iter("rect") if e.get("height") == "15"]
    return [
        (e.get("class", ""), float(e.get("x", 0)), float(e.get("x", 0)) + float(e.get("width", 0)))
        for e in bars
        if not classes or e.get("class") in classes
    ]


@pytest.mark.parametrize("width", [980.0, 400.0])
def test_bar_lengths_equal_gaps(width: float) -> None:
    gap = typed(summary()).gap_mm
    drawn = gaps([Judged("all", gap.before, gap.after)], 0.4367, "plate tilt", width)
    (_, zero, before), (_, also_zero, after) = rects(drawn)
    assert zero == also_zero
    assert (after - zero) / (before - zero) == pytest.approx(0.05 / 0.2684, abs=2e-3)
    per_mm = (before - zero) / 0.2684
    whiskers = [p for p in drawn.parts if 'class="whisker"' in p]
    ends = [[float(x) for x in re.findall(r"M([\d.]+) ", p)][::2] for p in whiskers]
    spans = [[(x - zero) / per_mm for x in pair] for pair in ends]
    assert spans[0] == pytest.approx([0.2256, 0.3053], abs=2e-3)
    assert spans[1] == pytest.approx([0.0, 0.1206], abs=2e-3)
    (limit,) = [p for p in drawn.parts if 'class="limit" d="M' in p and "V" in p]
    at = float(re.findall(r'd="M([\d.]+)', limit)[0])
    assert (at - zero) / per_mm == pytest.approx(0.4367, abs=2e-3)
    assert at < width


def test_evidence_stacks_the_field_only_where_it_helps() -> None:
    rows = [
        Evidence("tilt", 127.0, -1.0),
        Evidence("flex", 95.0, 1.5),
        Evidence("both", -2.0, None),
    ]
    bars = rects(evidence(rows, 2.8, 980.0))
    assert [b[0] for b in bars] == ["bar-after", "bar-after", "bar-field", "bar-after"]
    (_, zero, end), second, field, less = bars
    per_nat = (end - zero) / 127.0
    assert [(x - zero) / per_nat for x in second[1:]] == pytest.approx([0, 95.0], abs=0.05)
    assert [(x - zero) / per_nat for x in field[1:]] == pytest.approx([95.0, 96.5], abs=0.05)
    assert [(x - zero) / per_nat for x in less[1:]] == pytest.approx([-2.0, 0.0], abs=0.05)


def test_evidence_has_a_line_at_the_threshold_of_a_cause() -> None:
    drawn = evidence([Evidence("tilt", 14.0, None)], 7.0, 980.0)
    ((_, zero, end),) = rects(drawn)
    (limit,) = [p for p in drawn.parts if 'class="limit" d="M' in p and "V" in p]
    at = float(re.findall(r'd="M([\d.]+)', limit)[0])
    assert at == pytest.approx((zero + end) / 2, abs=0.1)


def test_legend_names_the_field_only_where_it_is_drawn() -> None:
    for field, shown in ((None, False), (-1.0, False), (12.0, True)):
        drawn = evidence([Evidence("tilt", 14.0, field)], 7.0, 980.0)
        assert ("left for something else" in "".join(drawn.parts)) is shown


def test_the_threshold_does_not_cross_titles_on_narrow_pages() -> None:
    rows = [Evidence("tilt", 14.0, None), Evidence("flex", 9.0, None)]
    drawn = evidence(rows, 7.0, 400.0)
    titles = [
        float(text.get("y", 0))
        for text in ElementTree.fromstring(str(drawn.markup("bars"))).iter("text")
        if text.text in ("tilt", "flex")
    ]
    (limit,) = [p for p in drawn.parts if 'class="limit" d="M' in p and "V" in p]
    spans = re.findall(r"M[\d.]+ ([\d.]+)V([\d.]+)", limit)
    assert len(titles) == len(spans) == 2
    for y in titles:
        assert not any(float(start) < y < float(end) for start, end in spans)


def test_colours_show_sign_and_noise() -> None:
    """Three points: within the noise, outside and inside the scanned tissue."""
    points = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [4.0, 6.0, 6.0]])
    residual, noise = np.array([0.7, 1.0, -2.0]), np.full(3, 0.4)
    drawn = residual_map(points, {"nominal model": residual}, noise, 2.0)
    dots = dots_of(drawn)
    (outside,) = ColourScale(SIGNED, 2.0).written(np.array([1.0]))
    assert [(kind, colour) for kind, colour, _ in dots] == [
        ("quiet", None),
        ("loud", outside),
        ("loud", SIGNED[0]),
    ] * 3
    (x0, y0), (x1, y1), (x2, y2) = (place for _, _, place in dots[:3])  # x to the right, y up
    assert (x2 - x0) / (x1 - x0) == pytest.approx(4.0, rel=0.01)
    assert (y2 - y0) / (y1 - y0) == pytest.approx(3.0, rel=0.01)
    assert (x2 - x0) / (y0 - y2) == pytest.approx(4 / 6, rel=0.01)


def dots_of(svg: Svg) -> list[tuple[str, str | None, tuple[float, float]]]:
    """Return dots as (kind, colour, pixel), the first of each colour."""
    drawing = ElementTree.fromstring(str(svg.markup("dots")))
    paths = [path for path in drawing.iter("path") if "dots" in path.get("class", "").split()]
    return [
        (path.get("class", "").split()[1], path.get("stroke"), first_place(path.get("d", "")))
        for path in paths
    ]


def first_place(data: str) -> tuple[float, float]:
    x, y = re.findall(r"M([-\d.]+) ([-\d.]+)h0", data)[0]
    return float(x), float(y)


def test_colour_scale_covers_significant_residuals() -> None:
    noise = np.full(100, 0.2)
    assert gap_range_mm(np.full(100, 0.3), noise) == 0.5  # nothing stands out
    assert gap_range_mm(np.append(np.full(99, 0.3), 3.0), noise) == 3.0


def test_no_evidence_chart_without_refits() -> None:
    assert "Log evidence gained" not in render_diagnosis(found(nothing("no-gap")))
    assert "Log evidence gained" in render_diagnosis(found())

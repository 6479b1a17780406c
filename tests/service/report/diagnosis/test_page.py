"""The page of a diagnosis: self-contained and consistent with the record."""

import copy
import json
import re
import subprocess
import sys
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from palpate.service.diagnosis.diagnosed_constants import summary_json
from palpate.service.diagnosis.diagnosis_words import sentence
from palpate.service.report.diagnosis.diagnosis_charts import (
    Cause,
    Evidence,
    Judged,
    evidence,
    gaps,
    probabilities,
)
from palpate.service.report.diagnosis.diagnosis_page import render_diagnosis
from palpate.service.report.diagnosis.gap_maps import gap_range_mm, residual_map
from palpate.service.report.drawing.colours import SIGNED, ColourScale
from palpate.service.report.drawing.svg import Svg
from palpate.service.report.study.page_provenance import Made, Origin
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


def test_verdict_names_cause_magnitude_and_held_out_gap() -> None:
    assert sentence_of(summary()) == (
        "Model and data differ by 0.27 mm (0.23 to 0.31) beyond the noise. The cause is plate "
        "tilt (5.48 ± 0.27 deg, probability > 99 %). On scans not used in the fit, it "
        "leaves nothing above the noise (at most 0.15 mm) of 0.31 mm."
    )


def test_one_scan_gives_a_lead_on_terminal_page_and_record() -> None:
    assert sentence_of(VERDICTS["one scan"]) == (
        "Model and data differ by 0.30 mm (0.20 to 0.40) beyond the noise. A lead, not a finding: "
        "plate tilt (5.48 ± 0.27 deg, probability > 99 %). It leaves 0.10 mm (0.00 to 0.20) on the "
        "scan used in the fit; this was not checked on other scans."
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


def test_evidence_has_its_unit_and_an_unknown_cause_its_probability() -> None:
    told = VERDICTS["none of these"] | {"none_of_these_probability": 0.93}
    assert "another cause is most probable (93 %)." in sentence_of(told)
    assert "nats, alarm at" in Page(render_diagnosis(found(told))).text


def test_a_second_segmentation_is_drawn_not_measured() -> None:
    option = {"name": REDRAWN, "separates": [], "reveals": [], "minimum_ratio": 0.8}
    text = Page(render_diagnosis(found(summary(next_acquisitions=[option])))).text
    assert "Draw a second segmentation of every scan." in text


def test_a_state_of_a_specimen_is_no_scan() -> None:
    told = VERDICTS["one scan"] | {"markers": []}
    assert sentence_of(told).endswith(
        "on the state used in the fit; this was not checked on other states."
    )


def test_reports_a_remaining_gap_and_that_only_the_first_cause_is_certain() -> None:
    record = summary(primary=["plate_tilt", "plate_force"])
    record["gap_mm"] = VERDICTS["one scan"]["gap_mm"] | {"after": gap(0.3, 0.2, 0.4)}
    text = sentence_of(record)
    assert ": plate tilt (5.48 ± 0.27 deg, probability > 99 %), perhaps with" in text
    assert "It leaves 0.30 mm (0.20 to 0.40)" in text
    assert text.endswith(
        "A complete model would leave at most 0.09 mm: another cause acts as well."
    )
    record["gap_mm"] = VERDICTS["one scan"]["gap_mm"] | {"after": gap(0.3, 0.04, 0.5)}
    assert "another cause" not in sentence_of(record)


def test_reports_a_systematic_residual_below_noise() -> None:
    gap = summary()["gap_mm"]
    gap["before"] = gap["held_out_before"] = gap["before"] | {"gap_mm": 0.0, "low_mm": 0.0}
    said = sentence_of(summary(gap_mm=gap))
    assert said.startswith("The residual is below the noise level but systematic.")
    assert said.endswith("leaves nothing above the noise (at most 0.15 mm).")


def test_reports_supported_but_absorbed_effect() -> None:
    def said(probability: float) -> str:
        changed = copy.deepcopy(summary())
        (force,) = (one for one in changed["effects"] if one["name"] == "plate_force")
        force |= {"probability": probability, "magnitude": 0.431, "sd": 0.064}
        return sentence_of(changed).removeprefix(sentence_of(summary()))

    assert said(0.6) == ""
    assert said(0.95) == (
        " The scans support plate force (0.431 ± 0.064, probability 95 %), but the fitted "
        "constants can almost mimic it; confirm it with an independent measurement."
    )


def test_reports_wrong_or_uneven_noise() -> None:
    def said(stated: float, learnt: float, least: float, most: float) -> str:
        noise = {"interface": "outline", "stated_mm": stated, "learnt_mm": learnt}
        ends = {"least_mm": least, "most_mm": most}
        return sentence_of(summary(noise=[noise | ends])).removeprefix(sentence_of(summary()))

    assert said(0.3, 0.35, 0.30, 0.40) == ""
    assert said(0.2, 0.3, 0.28, 0.32) == (
        " The noise of the outline interface is set too small: 0.20 mm, but its residuals "
        "show 0.30 mm."
    )
    assert said(0.3, 0.3, 0.22, 0.41) == (
        " The outline interface is segmented less accurately in one part of the body than in "
        "another: its noise is 0.22 to 0.41 mm."
    )


def test_wrong_noise_is_warning_outside_headline() -> None:
    noise = {"interface": "outline", "stated_mm": 0.2, "learnt_mm": 0.3}
    even = {"least_mm": 0.3, "most_mm": 0.3}
    shown = render_diagnosis(found(summary(noise=[noise | even])))
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


def test_two_effects_at_once_are_both_named() -> None:
    both = sentence_of(summary(primary=["plate_tilt", "plate_flex"]))
    assert "The cause is plate tilt (5.48 ± 0.27 deg, probability > 99 %) and plate flex (" in both


@pytest.mark.parametrize(
    ("which", "said"),
    [
        ("no gap", "A gap larger than 0.11 mm is unlikely."),
        ("none of these", "no effect in the catalogue explains it"),
        (
            "not told apart",
            "cannot decide which of plate tilt and plate flex is the cause; plate tilt is most "
            "probable.",
        ),
    ],
)
def test_each_verdict_has_its_sentence(which: str, said: str) -> None:
    assert said in sentence_of(VERDICTS[which])


def test_absorbed_effects_are_last_and_grey(source: str, page: Page) -> None:
    tilt = page.row("plate tiltplate geometry")
    assert tilt[1] == "> 99 %"
    assert tilt[2].startswith("tilt depth 5.48 ± 0.27 degtilt across −0.04 ± 0.12 deg")
    assert tilt[3:] == ["> 1000", "1 %"]
    hidden = page.row("plate forceloading")
    assert hidden[1] == "–"
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
    assert "left out" not in page.text
    record = summary() | {"left_out": 9}
    note = f"Of {record['points'] + 9} points, 9 were left out, because at least one scan does not"
    assert note in Page(render_diagnosis(found(record))).text


def test_the_set_of_several_causes_names_their_family() -> None:
    text = Page(render_diagnosis(found(VERDICTS["not told apart"]))).text
    assert "Plate tilt, plate flex and no gap account for 90 % of the probability." in text
    assert "The most probable family is plate geometry (> 99 %)." in text


def test_omits_improbable_family() -> None:
    told = VERDICTS["not told apart"]
    faint = dict.fromkeys(told["families"], 0.06)
    assert (
        "most probable family" not in Page(render_diagnosis(found(told | {"families": faint}))).text
    )


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


def test_causes_in_90_percent_set_are_coloured() -> None:
    rows = [Cause("tilt", 0.7, True), Cause("flex", 0.25, True), Cause("no gap", 0.05, False)]
    colours = [bar[0] for bar in rects(probabilities(rows, 980.0))]
    assert colours == ["bar-after", "bar-after", "bar-before"]


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
    assert "Evidence of the refits" not in render_diagnosis(found(nothing("no-gap")))
    assert "Evidence of the refits" in render_diagnosis(found())

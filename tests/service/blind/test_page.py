"""The page of a scored set, and the output of the commands."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from palpate.service.blind.blind_metrics import floor_mm, metrics
from palpate.service.blind.blind_page import comparison, render, with_metrics
from palpate.service.blind.case_truth import CaseRecord
from palpate.service.blind.set_scoring import ScoredSet
from tests.service.blind.blind_at_hand import nothing, record
from tests.service.report.pages import Page

SEALS = {
    "set": "sealed-1",
    "manifest": "a" * 64,
    "answers": "b" * 64,
    "declared": None,
    "directions": "all",
    "diagnosis": {"code": "0123456789abcdef", "commit": None},
}
FRICTION: dict[str, Any] = {
    "kind": "friction",
    "effects": ("plate_friction",),
    "families": ("boundary",),
}


def cases() -> list[CaseRecord]:
    """Return one case of every kind."""
    return [
        nothing(name="a0", true_before_mm=0.10),
        nothing(
            "absorbed",
            name="a1",
            kind="plate_force",
            effects=("plate_force",),
            families=("loading",),
        ),
        record(name="b0", held_out_share=-0.2),
        record(
            name="b1",
            **FRICTION,
            answer="cannot-be-told-apart",
            rivals=("plate_tilt", "plate_friction"),
            gain=12.4,
        ),
        record("pair", name="c0", kind="pair", effects=("plate_tilt", "plate_friction")),
        record("triple", name="c1", kind="triple", effects=("plate_tilt", "growth", "inclusion")),
        nothing("unlike", name="d0", kind="swelling", answer="none-of-these", true_before_mm=0.4),
        record("relative", name="e0", kind="bent_plate", effects=()),
        CaseRecord(
            "f0",
            "inclusion",
            "single",
            ("inclusion",),
            ("local stiffness",),
            "failed",
            reason="InputError: the scan <is> empty\nTraceback",
        ),
    ]


def scored(records: list[CaseRecord], **seals: Any) -> ScoredSet:
    return ScoredSet("sealed-1", records, metrics(records), floor_mm(records), (SEALS | seals,))


@pytest.mark.parametrize(
    "records", [cases(), cases()[:1], [cases()[-1]]], ids=["all", "one", "failed"]
)
def test_page_is_well_formed_and_self_contained(records: list[CaseRecord]) -> None:
    source = render(scored(records))
    page = Page(source)
    assert len(page.ids) == len(set(page.ids))
    page.needs_no_other_file()
    assert not {"script", "link", "iframe", "object"} & set(page.seen)
    assert all(image["alt"] for image in page.images)
    assert len(page.drawings()) == 3
    assert render(scored(records)) == source


def test_page_shows_the_metrics() -> None:
    page = Page(render(scored(cases(), declared="a finer mesh")))
    assert page.row("False alarms on controls and hidden effects") == [
        "False alarms on controls and hidden effects",
        "0 %",
        "0 % to 66 %",
        "0 of 2",
        "at most 5 %",
        "met",
    ]
    assert page.row("One effect, visible: named first")[-1] == "not met"
    assert page.row("Baseline, chance: named first")[1:] == ["50 %", "", "2"]
    assert page.row("10 to 20") == ["10 to 20", "no case", "", "1 of 1"]
    assert page.row("20 to 50")[:2] == ["20 to 50", "4 of 4"]
    assert "The diagnosis that answered is not the one" in page.text
    assert "a finer mesh" in page.text
    assert "still has a gap of 0.10 mm, the floor" in page.text


def test_page_shows_the_seals_of_several_sets() -> None:
    both = replace(
        scored(cases()),
        name="one + another",
        seals=(SEALS | {"set": "one"}, SEALS | {"set": "another", "declared": "a finer mesh"}),
    )
    page = Page(render(both))
    assert "The sets and their seals" in page.text
    assert page.text.count(SEALS["manifest"]) == 2
    assert page.text.count("The diagnosis that answered is not the one") == 1
    text = with_metrics("<!-- figures -->\n<!-- end of figures -->", both)
    assert "cases of one + another." in text
    assert text.count(f"`{SEALS['manifest']}`") == 2


def test_page_lists_wrong_answers() -> None:
    page = Page(render(scored(cases())))
    assert page.row("b1")[1:3] == [
        "plate frictionone effect",
        "plate tilt, or plate friction (12 nats)",
    ]
    assert page.row("f0")[2] == "failedInputError: the scan <is> empty"
    assert page.row("f0")[3:] == ["–", "–", "–"]
    wrong = page.text.index("Wrong answers")
    assert page.text.index("b1", wrong) < page.text.index("Correct answers", wrong)


def test_the_rule_of_the_smallest_residual_is_compared() -> None:
    """The diagnosis and the rule each alarm on one of two controls."""
    loud = [nothing(loudness={"refit": 0.1}), nothing(loudness={"refit": 0.3}, answer="effect")]
    named = {"refit": "plate_tilt"}
    right = [record(named_by=named, loudness={"refit": evidence}) for evidence in (0.2, 0.05)]
    wrong = record(named_by=named | {"refit": "growth"}, loudness={"refit": 0.9})
    said = (
        "One visible effect is named first by the diagnosis in 3 of 3 cases, and by the smallest "
        "residual of one refit at a time, with as many false alarms, in 1 of 3."
    )
    assert comparison(metrics([*loud, *right, wrong])) == said
    assert said in Page(render(scored([*loud, *right, wrong]))).text
    assert comparison(metrics(right)) == ""


# The commands


Call = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["make", "set", "--truth", "set/truth"], "The truths must be outside the set"),
        (["make", "set", "--truth", "."], "The truths must be outside the set"),
        (["make", "set", "--cases", "0"], "Invalid value for '--cases'"),
        (["run", "set"], "set is not a sealed set: it has no manifest.json"),
        (["score", "set"], "set is not a sealed set"),
        (["score", "set", "--directions", "z"], "'z' is not one of"),
        (["score", "one", "two", "--truth", "t"], "--truth names the truths of one set"),
        (["score", "set", "./set"], "is given twice: its cases would be counted twice"),
    ],
)
def test_invalid_arguments_give_one_message(call: Call, arguments: list[str], said: str) -> None:
    code, _, err = call("blind", *arguments)
    assert code == 2
    assert said in err
    assert "Traceback" not in err


def test_score_prints_metrics_and_writes_the_page(
    call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "palpate.service.commands.validation.blind.score_sets", lambda *_: scored(cases())
    )
    code, out, _ = call("blind", "score", "set", "--page", "page.html")
    assert code == 0
    lines = [line.split() for line in out.splitlines()]
    first = next(line for line in lines if line[:2] == ["False", "alarms"])
    assert first[-1] == "met"
    assert "Floor: 0.100 mm" in out
    assert ["10", "to", "20", "no", "case", "1", "of", "1"] in lines
    assert Path("page.html").read_text().startswith("<!DOCTYPE html>")
    text = Path("blind.md")
    text.write_text("Before.\n<!-- figures -->\nstale\n<!-- end of figures -->\nAfter.\n")
    assert call("blind", "score", "set", "--into", text)[0] == 0
    written = text.read_text()
    assert "| One effect, visible: named first | 33 % | 6 % to 79 % | 1 of 3 |" in written
    assert "| 10 to 20 | no case |  | 1 of 1 |" in written
    wrong = written.partition("| wrong answer to")[2].partition("<!-- end")[0].splitlines()[2:]
    assert len(wrong) == 2
    right = sum(int(n) for n in re.findall(r"\*\*[^*]+ (\d+)\*\*", written))
    assert right == len(cases()) - 2
    assert call("blind", "score", "set", "--into", text)[0] == 0
    assert text.read_text() == written
    assert written.startswith("Before.") and written.endswith("After.\n") and "stale" not in written
    text.write_text("no marks")
    code, _, err = call("blind", "score", "set", "--into", text)
    assert (code, text.read_text()) == (2, "no marks")
    assert "Expected a line <!-- figures -->" in err
    code, out, _ = call("blind", "score", "set", "--json")
    told = json.loads(out)
    assert [c["name"] for c in told["cases"] if not c["right"]] == ["b1", "f0"]
    assert told["confusion"]["columns"][-1] == "failed"

"""`palpate plan` for a case without loaded scans: record, texts and page."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cli import main
from palpate.service.diagnosis import plan_words as words
from palpate.service.diagnosis.diagnosis_run import request_plan
from palpate.service.report.diagnosis.plan_page import render_plan
from palpate.storage.json_digests import to_json
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.plan_summary import ConfusablePair, PlannedEffect, PlanSummary
from palpate.workers.tasks.plan_tasks import stored_plan
from tests.service.diagnosis.plans_at_hand import plan_of
from tests.service.report.pages import Page
from tests.workers.diagnosis.meant_case import at_force, write_meant

Json = dict[str, Any]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide the folder of the case and of the plan."""
    folder = tmp_path_factory.mktemp("plan")
    write_meant(folder / "meant", [at_force(12)])
    return folder


@pytest.fixture(scope="module")
def planned(runs: Path) -> PlanSummary:
    """Provide the plan, computed once by one worker process."""
    out = str(runs / "page.html")
    command = ["plan", str(runs / "meant"), "--nodes", "600", "--workers", "1", "--out", out]
    assert main([*command, "--store", str(runs / "store"), "--json"]) == 0
    stored = list((runs / "store" / "fields").iterdir())
    assert len(stored) == 7  # the source, five loads and the summary
    return _again(runs)


def _again(runs: Path) -> PlanSummary:
    found = stored_plan(request_plan(runs / "meant", runs / "store", 600))
    assert found is not None
    return found


@pytest.fixture(scope="module")
def record(planned: PlanSummary) -> Json:
    """Provide the plan as JSON."""
    return dict(to_json(planned))


def test_record_contains_the_plan(record: Json) -> None:
    assert record["case"] == "small"
    assert record["scans"] == ["12 N"]
    names = [e["name"] for e in record["effects"]]
    assert {"plate_force", "plate_tilt", "inclusion", "rigid_motion"} <= set(names)
    assert record["pairs"] == len(names) * (len(names) - 1) // 2
    seen = sum(e["seen"] for e in record["effects"])
    assert record["told_apart"] + len(record["confusable"]) == seen * (seen - 1) // 2
    assert all(pair["log_evidence"] < SETTINGS.selection.tie for pair in record["confusable"])
    assert all(row[i] == 1.0 for i, row in enumerate(record["cosines"]))
    force = next(e for e in record["effects"] if e["name"] == "plate_force")
    assert force["absorbed_share"] > 0.95
    assert not force["seen"]


def test_further_measurements_are_ranked(record: Json) -> None:
    found = {a["name"]: a for a in record["acquisitions"]}
    loads = {"a scan at 6 N", "a scan at 24 N", "a view, 12 N along x"}
    assert loads <= set(found) | {f"a scan at {n}" for n in record["not_simulated"]}
    assert "a second segmentation of every scan" in found
    ranks = [a["more_told_apart"] for a in record["acquisitions"]]
    assert ranks == sorted(ranks, reverse=True)
    assert max(ranks) > 0


def test_a_stored_plan_needs_no_cluster(
    runs: Path, record: Json, no_cluster: None, capsys: pytest.CaptureFixture[str]
) -> None:
    where = ["--store", str(runs / "store"), "--out", str(runs / "again.html")]
    assert main(["plan", str(runs / "meant"), "--nodes", "600", *where, "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out) == record
    assert "nothing to compute" in said.err
    assert (runs / "again.html").read_bytes() == (runs / "page.html").read_bytes()


def test_the_console_names_effects_and_measurements(
    runs: Path,
    record: Json,
    no_cluster: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    where = ["--store", str(runs / "store"), "--out", str(runs / "page.html")]
    assert main(["plan", str(runs / "meant"), "--nodes", "600", *where]) == 0
    said = capsys.readouterr().out
    assert said.startswith("One scan (12 N) can find ")
    assert "plate force" in said
    assert "absorbed by the constants" in said
    assert record["acquisitions"][0]["name"] in said
    assert f"page: {runs / 'page.html'}" in said


def test_page_shows_complete_plan(planned: PlanSummary, record: Json) -> None:
    page = Page(render_plan(planned))
    assert words.plan_headline(planned) in page.text
    for effect in record["effects"]:
        row = next(r for r in page.cells if r and r[0].startswith(effect["name"].replace("_", " ")))
        assert f"{100 * effect['absorbed_share']:.0f} %" in row
    for acquisition in record["acquisitions"]:
        assert page.row(acquisition["name"])[1] == str(acquisition["told_apart"])
    assert len(page.drawings()) == 2
    page.needs_no_other_file()
    assert render_plan(planned) == render_plan(planned)


def test_reports_when_nothing_can_be_planned(
    tmp_path: Path, no_cluster: None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", str(tmp_path), "--store", str(tmp_path / "store")]) == 2
    assert "expected a folder with case.yaml" in capsys.readouterr().err


def test_undetectable_and_similar_effects_are_named() -> None:
    def effect(name: str, why_not: Any) -> PlannedEffect:
        return PlannedEffect(name, "", "", (), 0.5, None, 0.0, 1.0, not why_not, why_not)

    told = replace(
        plan_of(),
        effects=(
            effect("plate_force", "hidden"),
            effect("creep", "weak"),
            effect("plate_tilt", ""),
        ),
        confusable=(ConfusablePair(("plate_tilt", "plate_flex"), 1.234),),
    )
    assert words.silent_effects(told) == (
        "Neither confirmed nor ruled out: plate force (absorbed by the constants); creep "
        "(too weak)."
    )
    assert words.confused_effects(told).endswith("plate tilt or plate flex (1.2).")
    assert words.silent_effects(replace(told, effects=told.effects[2:])) == ""

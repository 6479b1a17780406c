"""Advice on further measurements: ranking, and the command on a small cluster."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cli import main
from palpate.service.diagnosis.diagnosis_run import request_for
from palpate.service.diagnosis.diagnosis_words import is_undecided
from palpate.service.diagnosis.plan_words import acquisition_worth, next_acquisitions
from palpate.storage.errors import InputError
from palpate.storage.json_digests import from_json
from palpate.workers.diagnosis.outcome.diagnosis_summary import NextAcquisition
from tests.service.diagnosis.compressed_breast import write_case
from tests.service.diagnosis.plans_at_hand import option, plan_of
from tests.service.report.diagnosis_at_hand import summary, typed

NODES = "600"
TOLD = typed(
    summary(
        verdict="cannot-be-told-apart", rivals=["plate_tilt", "fibre_fan"], absorbed=["plate_force"]
    )
)


def test_measurements_that_separate_suspects_rank_first() -> None:
    plan = plan_of(
        option("more of the same"),
        option("shows the force", reveals=("plate_force", "creep")),
        option("others", separates=(("creep", "plate_tilt"),)),
        option("decides", separates=(("creep", "plate_tilt"), ("fibre_fan", "plate_tilt"))),
        option("fifth"),
    )
    found = next_acquisitions(TOLD, plan)
    names = [a.name for a in found]
    assert names == ["decides", "shows the force", "more of the same", "others"]
    assert found[0].separates == (("fibre_fan", "plate_tilt"),)
    assert found[1].reveals == ("plate_force",)
    assert acquisition_worth(found[0]) == (
        "distinguishes fibre fan from plate tilt; detection limits become 0.90 times as large"
    )
    assert acquisition_worth(found[1]).startswith("reveals plate force")
    assert acquisition_worth(found[2]) == "detection limits become 0.90 times as large"
    assert is_undecided(TOLD)
    assert not is_undecided(replace(TOLD, verdict="effect"))


@pytest.fixture(scope="module", autouse=True)
def few_suspects() -> Iterator[None]:
    """The diagnosis has two suspected effects, the plan the whole catalogue."""

    def few(source: Any, store: Any, nodes: int) -> Any:
        return request_for(source, store, nodes, effects=("plate_tilt", "fibre_fan"))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("palpate.service.commands.studies.diagnosing.request_for", few)
        yield


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide a folder with a case diagnosed and planned by one worker."""
    folder = tmp_path_factory.mktemp("advice")
    write_case(folder / "small", {})
    assert main([*command(folder), "--plan", "--workers", "1"]) == 0
    return folder


def command(folder: Path) -> list[str]:
    where = ["--store", str(folder / "store"), "--out", str(folder / "out")]
    return ["diagnose", str(folder / "small"), "--nodes", NODES, *where]


def without_made(page: str) -> str:
    """Return a page without its date and run time."""
    return re.sub(r"<dt>(Date|Run time)</dt><dd>.*?</dd>", "", page)


@pytest.mark.slow
def test_command_recommends_measurements(
    runs: Path, no_cluster: None, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (runs / "out" / "diagnosis.html").read_text()
    assert main([*command(runs), "--plan", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    options = record["next_acquisitions"]
    assert any(o["name"].startswith("a view, ") for o in options)
    assert "What to measure next" in page
    assert all(f"<td>{o['name']}</td>" in page.replace("&#39;", "'") for o in options)
    again = (runs / "out" / "diagnosis.html").read_text()
    assert without_made(again) == without_made(page)
    assert main([*command(runs), "--plan"]) == 0
    assert (
        f"Next, {options[0]['name']}: {acquisition_worth(from_json(NextAcquisition, options[0]))}."
        in capsys.readouterr().out
    )


@pytest.mark.slow
def test_no_advice_without_a_plan(
    runs: Path, no_cluster: None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command(runs), "--no-plan", "--json"]) == 0
    assert "next_acquisitions" not in json.loads(capsys.readouterr().out)


def test_bench_experiment_has_no_plan(
    tmp_path: Path, no_cluster: None, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "beam.yaml").write_text("organ: specimen\n")
    assert main(["diagnose", str(tmp_path / "beam.yaml"), "--plan"]) == 2
    said = capsys.readouterr()
    assert "is a bench experiment" in said.err
    assert (said.err.count("\n"), said.out) == (1, "")


@pytest.mark.slow
def test_a_failed_plan_keeps_the_diagnosis(
    runs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*arguments: Any) -> None:
        raise InputError("The nominal model does not converge at 8 N.")

    monkeypatch.setattr("palpate.service.commands.studies.diagnosing.planned", fail)
    assert main([*command(runs), "--plan", "--json"]) == 0
    said = capsys.readouterr()
    assert "Further measurements could not be evaluated. The nominal model" in said.err
    assert json.loads(said.out)["verdict"] == "no-gap"

"""Table 5.1 searched again: two corneas with known constants."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from palpate.service.cli import main
from palpate.service.cluster.task_dispatch import SingleProcess
from palpate.service.thesis.cornea_chapter import chapter
from palpate.service.thesis.thesis_experiments import (
    GENETIC,
    POLISHED,
    ThesisRequest,
    eye_runs,
    run_search,
)
from palpate.service.thesis.thesis_results import ThesisResults, shear_modulus_error, thesis_results
from palpate.service.thesis.thesis_verdicts import verdicts
from palpate.workers.thesis.thesis_eyes import TABLE_5_1
from tests.service.thesis.thesis_at_hand import as_printed


def test_searches_match_table_5_1(tmp_path: Path) -> None:
    runs = eye_runs(tmp_path, "full", GENETIC)
    assert [run.title for run in runs] == ["X1, cornea", "X2, cornea"]
    targets = [(11000, 30, 35000, 80), (36000, 50, 32500, 88)]
    for run, target in zip(runs, targets, strict=True):
        spec, case = run.spec, run.spec.case.model_dump()
        assert (spec.search.population, spec.search.generations, spec.search.elite) == (84, 15, 2)
        assert tuple(spec.target.constants.values()) == target
        assert case["load"]["iop_mmhg"] == 10.5
        assert case["load"]["jet"]["pressure_kpa"] == 15
        assert case["reference"]["section"]["central_mm"] == pytest.approx(0.595)


def test_printed_estimates_have_the_printed_errors() -> None:
    """G0 of X1: half of 10711 x 31.32 + 33751 x 82.44 is 1.5590 MPa, of its target 1.565."""
    found = tuple(map(as_printed, TABLE_5_1))
    assert shear_modulus_error(found[0]) == pytest.approx(1.55895 / 1.565 - 1, abs=1e-5)
    results = ThesisResults("reduced", "a machine", {}, cornea=found)
    judged = {v.what: v for v in verdicts(results) if v.place == "Table 5.1"}
    assert judged["error of mu1, X1"].printed == "2.63 %"
    assert judged["error of mu1, X1"].found == "2.63 %"
    assert judged["error of G0, X1"].printed == "0.387 %"
    assert {judged[w].word for w in ("error of G0, X2", "JC, X1", "MHD, X2")} == {"reproduced"}
    worse = replace(results, cornea=(replace(found[0], jc=0.98, mhd_mm=0.0047), found[1]))
    judged = {v.what: v.word for v in verdicts(worse) if v.place == "Table 5.1"}
    assert (judged["JC, X1"], judged["MHD, X1"]) == ("not reproduced", "approached")


def test_real_eyes_cannot_be_compared() -> None:
    found = ThesisResults("reduced", "a machine", {}, cornea=tuple(map(as_printed, TABLE_5_1)))
    (eyes,) = [v for v in verdicts(found) if v.place == "Table 5.2"]
    assert (eyes.word, eyes.reason) == ("cannot be", "the images of the eyes are not published")


def test_chapter_shows_printed_and_our_constants() -> None:
    ours = as_printed(TABLE_5_1[0])
    ours = replace(ours, constants=(replace(ours.constants[0], estimate=12000.0, error=1 / 11),
                                    *ours.constants[1:]))  # fmt: skip
    (table,) = chapter([ours], None, "reduced").tables
    assert list(table.rows[0][1:]) == ["11000", "10711", "2.63 %", "12000", "9.09 %"]


def test_coarse_search_finds_the_stiffness_of_a_cornea(tmp_path: Path) -> None:
    request = ThesisRequest(("cornea",), "sketch", tmp_path / "store", tmp_path, POLISHED)
    first = request.searches_of("cornea")[0]
    run_search(first, request.store, SingleProcess(), lambda *_: None)  # type: ignore[arg-type]
    found = thesis_results(request).cornea
    assert found is not None
    assert [search.target for search in found] == ["X1"]
    assert abs(shear_modulus_error(found[0])) < 0.03
    assert found[0].jc is not None
    assert found[0].jc > TABLE_5_1[0].jc


@pytest.mark.slow
def test_command_finds_the_stiffness_within_a_per_cent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = ["--store", str(tmp_path / "store"), "--out", str(tmp_path / "out")]
    assert main(["thesis", "cornea", "--workers", "1", "--json", *places]) == 0
    record = json.loads(capsys.readouterr().out)
    for eye, search in zip(TABLE_5_1, record["cornea"], strict=True):
        estimate, target = (
            sum(c[0][key] * c[1][key] for c in (search["constants"][:2], search["constants"][2:]))
            for key in ("estimate", "target")
        )
        assert target == pytest.approx(2e6 * eye.target.shear_modulus_mpa)
        assert estimate == pytest.approx(target, rel=0.01)
        assert search["jc"] > 0.999
    assert "Table 5.1" in (tmp_path / "out" / "cornea.html").read_text()

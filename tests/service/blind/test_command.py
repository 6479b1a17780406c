"""Repeated draws without equilibrium, and the three commands in sequence."""

import json
from pathlib import Path
from typing import Any

import pytest

from palpate.service.blind import set_making as making
from palpate.service.cli import main
from palpate.workers.blind.random_case import draw


@pytest.mark.parametrize(("failures", "attempts"), [(0, 1), (2, 3)])
def test_repeats_a_draw_without_equilibrium(
    failures: int, attempts: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seeds: list[int] = []

    def write(truth: Any, case: Path, hidden: Path) -> None:
        seeds.append(truth.seed)
        (case / "case.yaml").write_text("half")
        if len(seeds) <= failures:
            raise making.NoEquilibriumError("none")
        (case / "case.yaml").write_text(truth.kind)

    monkeypatch.setattr(making, "write_case", write)
    folders = [str(tmp_path / place / "c0") for place in ("cases", "truth")]
    told = making.make_case(7, "tilt", True, "plain", *folders)
    assert told["attempts"] == attempts
    assert seeds == list(range(7, 7 + attempts))
    assert Path(folders[0], "case.yaml").read_text() == "tilt"
    assert draw(8, "tilt", one_direction=True).kind == "tilt"


def test_gives_up_a_case_without_any_equilibrium(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(*arguments: Any) -> None:
        raise making.NoEquilibriumError("none")

    monkeypatch.setattr(making, "write_case", write)
    with pytest.raises(making.NoEquilibriumError):
        making.make_case(
            7, "tilt", True, "plain", str(tmp_path / "a" / "c0"), str(tmp_path / "b" / "c0")
        )
    assert not list(tmp_path.rglob("c0"))


@pytest.mark.slow
def test_a_set_is_made_run_and_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    few = ["--nodes", "1500", "--workers", "1"]
    made = ["blind", "make", "set", "--cases", "1", "--seed", "4", "--one-direction", *few]
    assert main(made) == 0
    first = capsys.readouterr().out
    assert main(made) == 0  # already made
    assert capsys.readouterr().out == first
    assert main(["blind", "run", "set", "--store", "store", *few]) == 0
    assert "next: palpate blind score set" in capsys.readouterr().out
    assert main(["blind", "score", "set", "--json", "--page", "page.html"]) == 0
    told = json.loads(capsys.readouterr().out)
    (case,) = told["cases"]
    assert (case["kind"], case["group"]) == ("control", "control")  # the most frequent kind
    assert told["seals"][0]["manifest"] in first
    # Another solver, element and mesh: the noise-free error of the calibrated model.
    assert case["true_before_mm"] < 0.15
    assert Path("page.html").stat().st_size > 10_000

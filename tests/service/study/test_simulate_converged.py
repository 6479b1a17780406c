"""Convergence as reported by `palpate simulate`."""

import json
from pathlib import Path

import pytest

from palpate.service.cli import main

STUDY = """
name: stiff
case:
  reference: {phantom: {preset: 445ml, spacing_mm: 2}}
  mesh: {nodes: 850}
  load: {force_n: 100}
target: {constants: {E_fat_kpa: 10}}
search: {parameters: {E_fat_kpa: [5, 20]}}
"""


@pytest.mark.parametrize("stiffness_kpa", ["1e7", "1e9"])
def test_very_stiff_body_converges_or_reports_its_residual(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    stiffness_kpa: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("study.yaml").write_text(STUDY)
    assert main(["simulate", "study.yaml", "--set", f"E_fat_kpa={stiffness_kpa}", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    outcome = found["outcome"]
    if found["status"] == "done":
        assert outcome["residual_n"] <= 0.1
        assert abs(outcome["plate_force_n"] - 100) <= 0.1
        assert outcome["force_imbalance"] <= 2e-3
    else:
        assert "of the load" in found["reason"] or "residual" in found["reason"]

"""User folders with the same names as Palpate's do no harm."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = """
import palpate

if __name__ == "__main__":
    study = palpate.Study.from_dict(
        {
            "name": "small",
            "case": {"reference": {"phantom": {"preset": "250ml", "spacing_mm": 2}},
                     "mesh": {"nodes": 1200}, "load": {"force_n": 20}},
            "target": {"constants": {"E_fat_kpa": 12}},
            "search": {"strategy": "least-squares", "parameters": {"E_fat_kpa": [5, 20]}},
        },
        folder="runs/small",
    )
    study.run(workers=2)
    print(palpate.Study.open("runs/small").results.estimates["E_fat"].estimate)
"""


@pytest.mark.timeout(600)  # with kernels to compile; else half a minute
def test_a_script_next_to_folders_with_these_names_runs_a_study(tmp_path: Path) -> None:
    for name in ("storage", "workers", "tests"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise ImportError('the wrong package')\n")
    (tmp_path / "service.py").write_text("raise ImportError('the wrong module')\n")
    (tmp_path / "script.py").write_text(SCRIPT)
    ran = subprocess.run(
        [sys.executable, "script.py"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=550,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    assert abs(float(ran.stdout.split()[-1]) - 12) < 0.6

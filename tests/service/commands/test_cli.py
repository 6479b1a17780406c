"""Output and exit codes of commands."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.values import Volume
from palpate.workers.body.images.image_formats import read_volume_file
from tests.recovery.stand_ins import SPEC, Inline, run

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = tmp_path / "runs" / "demo"
    run(folder, Inline())
    return folder


def test_new_writes_readable_study_and_keeps_existing_file(call: Call) -> None:
    code, out, _ = call("new", "breast", "mine")
    assert code == 0
    assert "palpate run mine.yaml" in out
    assert "name: mine " in Path("mine.yaml").read_text()
    code, _, err = call("new", "breast", "mine")
    assert (code, err.count("\n")) == (2, 1)
    assert "already exists" in err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "nothing.yaml"], "palpate new breast nothing"),
        (["run", "study.yaml", "--workers", "0"], "--workers must be at least 1"),
        (["run", "study.yaml", "--workers", "2", "--scheduler", "tcp://x:1"], "give one of them"),
        (["run", "study.yaml", "--workers", "4-1"], "give the smaller number first: 1-4"),
        (["run", "study.yaml", "--workers", "1-4", "--scheduler", "tcp://x:1"], "give one of"),
        (["serve", "--workers", "0-4"], "one worker is always kept"),
        (
            ["cluster", "slurm", "--workers", "a-b"],
            "--workers a-b: expected a number of workers such as 4",
        ),
        (["status"], "There is no study in"),
        (["status", "nix"], "There is no study nix"),
        (["report", "nix", "--json"], "There is no study nix"),
        (["show", "first"], "give its number, or best"),
        (["new", "breast", "a/b"], "name"),
        (["import", "x.nrrd", "--name", "n", "--labels", "0:air"], "expected e.g. 0=air"),
        (["import", "x.nrrd", "--name", "n"], "x.nrrd does not exist"),
        (["phantom", "--preset", "huge"], "huge"),
        (["phantom", "--out", "p.txt"], ".nrrd"),
        (["mesh", "study.yaml", "--out", "no/where.vtu"], "does not exist; create it"),
        (["simulate", "study.yaml", "--set", "E_fat_kpa"], "expected NAME=VALUE"),
        (["simulate", "study.yaml", "--set", "E_fatt_kpa=3"], "did you mean 'E_fat_kpa'"),
        (["bench", "--nodes", "many"], "expected positive numbers"),
    ],
)
def test_user_errors_give_one_message_and_exit_code_2(
    call: Call, tmp_path: Path, arguments: list[str], said: str
) -> None:
    (tmp_path / "study.yaml").write_text(SPEC)
    code, out, err = call(*arguments)
    assert code == 2
    assert said in err
    assert err.startswith("Error: ")
    assert "Traceback" not in err
    assert out == ""


def test_wrong_option_gives_exit_code_2(call: Call) -> None:
    assert call("run", "--nosuch")[0] == 2
    assert call("--version")[0] == 0
    assert call("--help")[0] == 0


def test_status_counts_and_lists_failures(call: Call, study: Path) -> None:
    code, out, _ = call("status")
    assert code == 0
    assert "5 of at most 5 complete" in out
    assert "no equilibrium at 60 N" in out
    found = json.loads(call("status", study, "--json")[1])
    assert found["evaluations"]["diverged"] == len(found["failures"]) > 0


def test_show_gives_genes_score_and_reason(call: Call, study: Path) -> None:
    failed = json.loads(call("status", "demo", "--json")[1])["failures"][0]
    code, out, _ = call("show", failed["candidate"])
    assert code == 0
    assert "diverged" in out
    assert "no equilibrium at 60 N" in out
    best = json.loads(call("show", "best", "--json")[1])
    assert best["status"] == "done"
    assert json.loads(call("show", "demo", "best", "--json")[1]) == best
    assert json.loads(call("show", "best", "demo", "--json")[1]) == best  # as in earlier versions
    assert call("show", 999)[0] == 2
    assert "found 3 arguments" in call("show", "demo", "best", "2")[2]


def test_report_prints_estimates_and_json(call: Call, study: Path) -> None:
    found = json.loads(call("report", study, "--json")[1])
    assert set(found["estimates"]) == {"E_fat", "E_glandular"}
    _, out, _ = call("report", study)
    assert "E_glandular" in out
    assert f"{found['estimates']['E_glandular']['estimate']:.4g} kPa" in out
    assert "page: " in out


def test_a_finished_study_is_reported_without_a_cluster(call: Call, study: Path) -> None:
    code, out, err = call("run", study, "--json")
    assert code == 0
    assert "complete: nothing to run" in err
    assert json.loads(out)["stopped"]
    assert call("-q", "run", study, "--json") == (0, out, "")


def test_a_damaged_journal_is_named(call: Call, study: Path) -> None:
    journal = StudyLayout(study).journal
    journal.write_bytes(b"not json\n" + journal.read_bytes())
    for command in (["status", study], ["report", study, "--json"], ["run", study]):
        code, _, err = call(*command)
        assert code == 2
        assert "line 1: not a JSON record" in err


def test_imports_image_name_once(call: Call, tmp_path: Path) -> None:
    values = np.zeros((8, 9, 10), np.uint8)
    values[2:6, 2:7, 2:8] = 1
    values[3:5, 3:5, 3:5] = 2
    np.save(tmp_path / "scan.npy", values)
    options = ["--labels", "0=air,1=fat,2=glandular", "--spacing-mm", "10", "10", "20", "--json"]
    code, out, _ = call("import", "scan.npy", "--name", "mine", *options)
    assert code == 0
    found = json.loads(out)
    assert {label["tissue"] for label in found["labels"].values()} == {"air", "fat", "glandular"}
    assert call("import", "scan.npy", "--name", "mine", *options)[0] == 0
    values[3, 3, 3] = 1
    np.save(tmp_path / "other.npy", values)
    code, _, err = call("import", "other.npy", "--name", "mine", *options)
    assert code == 2
    assert "another volume named mine" in err


def test_a_phantom_is_written_as_it_is_read(call: Call, tmp_path: Path) -> None:
    code, out, _ = call("phantom", "--spacing-mm", "2", "--out", "p.nrrd", "--json")
    assert code == 0
    found: dict[str, Any] = json.loads(out)
    assert list(nrrd.read(str(tmp_path / "p.nrrd"))[0].shape) == found["shape"]
    volume: Volume = read_volume_file(tmp_path / "p.nrrd")
    assert volume.spacing_mm == (2.0, 2.0, 2.0)
    np.testing.assert_allclose(volume.origin_mm, found["origin_mm"])
    counts = dict(zip(*np.unique(volume.values, return_counts=True), strict=True))
    assert {str(k): int(v) for k, v in counts.items()} == {
        k: label["voxels"] for k, label in found["labels"].items()
    }


def test_help_is_fast() -> None:
    """Commands load numba, Dask and Zarr only when called."""
    code = (
        "import sys, palpate.service.cli\n"
        "print([m for m in ('numba', 'dask', 'zarr') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_parameters_are_listed_by_the_names_of_a_study(call: Call) -> None:
    code, said, _ = call("parameters")
    assert code == 0
    assert "E_fat_kpa" in said
    assert "wall_hold_x_kpa_per_mm" in said
    code, said, _ = call("parameters", "--effects", "--json")
    told = json.loads(said)
    assert told["constants"] == []
    tilt = next(e for e in told["effects"] if e["effect"] == "plate_tilt")
    assert [p["name"] for p in tilt["parameters"]] == ["tilt_depth_deg", "tilt_across_deg"]
    assert tilt["in_studies"]
    assert told["not_simulated"]


def test_constants_of_a_law_are_listed_on_request(call: Call) -> None:
    _, said, _ = call("parameters")
    assert "mooney-rivlin" in said
    assert "yeoh_c2_fat" not in said
    code, said, _ = call("parameters", "--law", "yeoh")
    assert (code, "yeoh_c3_glandular" in said) == (0, True)
    code, _, err = call("parameters", "--organ", "cornea", "--law", "yeoh")
    assert (code, "one law" in err) == (2, True)


def test_too_few_points_do_not_rank_laws(call: Call, tmp_path: Path) -> None:
    """Three points determine the modulus of one law, but neither a ranking nor four constants."""
    stretch = np.array([1.1, 1.2, 1.3])
    rows = [f"{x},{3 * (x - x**-2)}" for x in stretch]
    table = tmp_path / "table.csv"
    table.write_text("\n".join(["stretch,stress_kpa", *rows]))
    code, said, _ = call("fit-law", str(table), "--law", "neo-hookean", "--json")
    (fit,) = json.loads(said)["fits"]
    assert (code, fit["aicc"]) == (0, None)
    assert fit["shear_modulus_kpa"] == pytest.approx(3, rel=1e-4)
    assert call("fit-law", str(table), "--law", "neo-hookean")[0] == 0
    code, _, err = call("fit-law", str(table))
    assert (code, "too few points to compare" in err) == (2, True)
    table.write_text("\n".join(["stretch,stress_kpa", rows[0]]))
    code, _, err = call("fit-law", str(table), "--law", "yeoh")
    assert (code, "1 points under load, but yeoh has 3 constants" in err) == (2, True)


def test_fit_law_shows_the_range_of_E_and_a_slack_start(call: Call, tmp_path: Path) -> None:
    """Neo-Hooke of 3 kPa behind 4 % of slack."""
    stretch = np.linspace(1, 1.4, 21)
    rows = [f"{1.04 * x},{3 * (x - x**-2)}" for x in stretch]
    table = tmp_path / "table.csv"
    table.write_text("\n".join(["stretch,stress_kpa", "1,0", "1.02,0", *rows]))
    code, said, _ = call("fit-law", str(table), "--json")
    told = json.loads(said)
    (slack,) = told["slack"]
    assert (code, slack["table"]) == (0, 1)
    assert slack["offset_strain"] == pytest.approx(0.04, abs=1e-3)
    assert slack["E_kpa"] == pytest.approx(2 * 1.49 * 3, rel=0.02)
    for low, high in told["E_range_kpa"].values():
        assert low < told["fits"][0]["E_kpa"] <= high
        assert high >= slack["E_kpa"]
    _, said, _ = call("fit-law", str(table), "--law", "neo-hookean")
    assert re.search(r"E of neo-hookean is \d\.\d+ kPa over all points, \d.* kPa over parts", said)
    assert "Table 1 looks slack up to 4 % of strain." in said


def test_laws_are_fitted_to_tables(call: Call, tmp_path: Path) -> None:
    """Tables of Fung's law with mu0 = 4 kPa and b = 2, computed by hand."""
    stretch = np.linspace(0.8, 1.5, 12)
    first = stretch**2 + 2 / stretch
    stress = 4 * np.exp(2 * (first - 3)) * (stretch - stretch**-2)
    rows = [f"{x},{s}" for x, s in zip(stretch, stress, strict=True)]
    table = tmp_path / "table.csv"
    table.write_text("\n".join(["stretch,stress_kpa", *rows]))
    code, said, _ = call("fit-law", str(table), "--json")
    told = json.loads(said)
    assert code == 0
    assert told["equally_good"] == ["fung"]
    best = told["fits"][0]
    assert best["shear_modulus_kpa"] == pytest.approx(4, rel=1e-4)
    assert best["E_kpa"] == pytest.approx(2 * 1.49 * 4, rel=1e-4)
    assert best["constants"]["fung_b"] == pytest.approx(2, rel=1e-4)
    code, said, _ = call("fit-law", str(table), "--law", "fung")
    assert "constants: {nu: 0.49, E_fat_kpa: 11.92, fung_b_fat: 2}" in said
    assert "fit best" not in said
    code, _, err = call("fit-law", str(table), "--law", "fungi")
    assert (code, "did you mean 'fung'" in err) == (2, True)

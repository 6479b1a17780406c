"""Settings of other libraries that cannot be used: one message instead of a traceback."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

SETTINGS = {
    "dask": ("DASK_CONFIG", "broken.yaml"),
    "numba": ("NUMBA_NUM_THREADS", "0"),
    "matplotlib": ("MPLBACKEND", "nonsense"),
    "zarr": ("ZARR_CONFIG", "broken.yaml"),
}


def palpate(folder: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-P", "-m", "palpate", *words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])} | variables,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "broken.yaml").write_text("{broken: [")
    values = np.zeros((12, 40, 40), np.uint8)
    values[:, 4:36, 4:36], values[:6, 12:28, 12:28] = 1, 2
    np.save(tmp_path / "block.npy", values)
    return tmp_path


IMPORT = (
    *("import", "block.npy", "--name", "block", "--spacing-mm", "2", "2", "2"),
    *("--labels", "0=air,1=fat,2=glandular", "--anyway"),
)


@pytest.mark.parametrize(("library", "setting"), SETTINGS.items(), ids=SETTINGS)
def test_a_broken_setting_is_named_with_its_value(
    folder: Path, library: str, setting: tuple[str, str]
) -> None:
    name, value = setting
    done = palpate(folder, *IMPORT, **{name: value})
    assert done.returncode == 2, done.stderr
    assert f"Error: {library} cannot be loaded with its settings in the environ" in done.stderr
    assert f"({name}={value})" in done.stderr
    assert "Correct or unset" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_doctor_reports_all_of_them(folder: Path) -> None:
    variables = dict(SETTINGS.values())
    done = palpate(folder, "doctor", **variables)
    assert (done.returncode, done.stdout) == (2, "not ready\n"), done.stderr
    assert [line.split()[1] for line in done.stderr.splitlines()] == list(SETTINGS)
    assert done.stderr.count("problem: ") == 4
    record = json.loads(palpate(folder, "doctor", "--json", **variables).stdout)
    assert len(record["problems"]) == 4


def test_pictures_need_no_latex(folder: Path) -> None:
    (folder / "matplotlibrc").write_text("text.usetex: true\n")
    done = palpate(folder, *IMPORT, PATH="")
    assert done.returncode == 0, done.stderr
    assert (folder / "runs/images/block.png").read_bytes().startswith(b"\x89PNG")

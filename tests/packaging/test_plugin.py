"""A distribution from another lab adds an effect, a law, a score and an organ; workers run all."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLUGIN = ROOT / "examples" / "plugin"
STUDY = PLUGIN / "study.yaml"
# Names an evaluation of the study without running it.
NAME_IT = f"""
from pathlib import Path
from palpate.service.study.study_keys import read_spec
from palpate.workers.tasks.study_tasks import evaluation_digest
spec = read_spec(Path({str(STUDY)!r}))
case, score = (one.model_dump(mode="json") for one in (spec.case, spec.score))
for weight in (0.0, 0.3):
    print(evaluation_digest(case, dict(volume="v", mesh="m"), "t", dict(side_weight=weight), score))
"""

DIAGNOSE = """
import json
import palpate

if __name__ == "__main__":
    found = palpate.diagnose(
        {study!r}, nodes=1150, effects=["side_weight", "plate_tilt"], workers=2, store={store!r}
    )
    print(json.dumps([effect.name for effect in found.summary.effects]))
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of packages with the example in it, installed by pip without a network."""
    pytest.importorskip("hatchling", reason="hatchling, which builds the wheel, is not installed")
    folder = tmp_path_factory.mktemp("site")
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check"]
    built = subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, "--target", folder, PLUGIN],
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


def python(site: Path | None, *arguments: object, code: int = 0) -> str:
    """Run Python with the packages of `site` and return what it prints."""
    path = [str(ROOT), *([] if site is None else [str(site)])]
    ended = subprocess.run(
        [sys.executable, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == code, ended.stdout + ended.stderr
    return ended.stdout if code == 0 else ended.stderr


@pytest.fixture(scope="module")
def study(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example's study on a coarser mesh, run on two workers."""
    folder = tmp_path_factory.mktemp("run") / "plugin"
    coarser = folder.parent / "study.yaml"
    coarser.write_text(STUDY.read_text().replace("nodes: 1500", "nodes: 1150"))
    run = ["-m", "palpate", "run", coarser, "--study", folder, "--store", folder.parent / "store"]
    python(site, *run, "--workers", 2)
    return folder


def test_installed_plugin_fulfils_the_plugin_contracts(site: Path) -> None:
    options = ["-q", "-n", "0", "-p", "no:cacheprovider", "--rootdir", PLUGIN, "-c", os.devnull]
    python(site, "-m", "pytest", *options, PLUGIN / "tests")


def test_a_study_uses_the_effect_and_the_score_of_a_plugin(site: Path, study: Path) -> None:
    found = json.loads(python(site, "-m", "palpate", "report", study, "--json"))
    assert set(found["estimates"]) == {"E_fat", "side_weight"}
    lines = [json.loads(line) for line in (study / "journal.jsonl").read_text().splitlines()]
    scores = [line["score"] for line in lines if line.get("score")]
    assert len(scores) >= 6
    assert all(score["objective"] == score["centroid_mm"] >= 0 for score in scores)
    best = min(scores, key=lambda score: score["centroid_mm"])
    assert found["best"]["score"]["gsf"] == best["gsf"]
    text = python(site, "-m", "palpate", "status", study)
    assert f"Centroid distance {best['centroid_mm']:.5g} mm" in text
    page = (study / "report.html").read_text()
    assert "Centroid distance, mm, lower is better" in page


def test_a_diagnosis_includes_its_effect(site: Path, study: Path) -> None:
    script = study.parent / "diagnose.py"
    script.write_text(DIAGNOSE.format(study=str(study), store=str(study.parent / "store")))
    found = json.loads(python(site, script))
    assert {"side_weight", "plate_tilt"} == set(found)


def test_a_result_depends_on_the_code_of_its_plugins(site: Path) -> None:
    before = python(site, "-c", NAME_IT).split()
    effect = site / "palpate_example" / "effect.py"
    text = effect.read_text()
    try:
        effect.write_text(text.replace("PLAUSIBLE_G = 0.1", "PLAUSIBLE_G = 0.2"))
        after = python(site, "-c", NAME_IT).split()
    finally:
        effect.write_text(text)
    assert python(site, "-c", NAME_IT).split() == before
    assert after[1] != before[1]


def test_organ_of_a_plugin_has_a_template_and_is_solved(site: Path, tmp_path: Path) -> None:
    written = tmp_path / "pad.yaml"
    python(site, "-m", "palpate", "new", "gel", "pad", "--out", written)
    told = python(
        site, "-m", "palpate", "simulate", written, "--store", tmp_path / "store", "--json"
    )
    assert json.loads(told)["outcome"]["converged"]


@pytest.fixture
def bare_worker(tmp_path: Path) -> Iterator[str]:
    """A cluster whose worker has not installed the example."""
    file = tmp_path / "scheduler.json"
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    common = ["--scheduler-file", str(file), "--no-dashboard"]
    modules = ("distributed.cli.dask_scheduler", "distributed.cli.dask_worker")
    started = [subprocess.Popen([sys.executable, "-m", m, *common], env=env) for m in modules]
    try:
        for _ in range(300):
            if file.exists():
                break
            time.sleep(0.1)
        yield json.loads(file.read_text())["address"]
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait(timeout=30)


def test_a_worker_without_the_plugin_is_named_before_any_work(
    site: Path, bare_worker: str, tmp_path: Path
) -> None:
    run = ["-m", "palpate", "run", STUDY, "--study", tmp_path / "plugin", "--store", tmp_path / "s"]
    told = python(site, *run, "--scheduler", bare_worker, code=2)
    assert "lacks the plug-in" in told
    assert "palpate-example 0.1.0" in told
    listed = python(site, "-m", "palpate", "doctor", "--scheduler", bare_worker, code=2)
    assert "lacks the plug-in side_weight (effects) of palpate-example 0.1.0" in listed

"""Sources in a store: stored once by content, and rebuilt without access to their files."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from palpate.storage.errors import StoreError
from palpate.workers.diagnosis.outcome.diagnosis_source import SourceContent
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.organs.source_registry import source_kinds, source_module, source_of
from palpate.workers.resources import CACHE
from palpate.workers.tasks.code_version import reached
from palpate.workers.tasks.diagnosis_sources import (
    add_source,
    open_planned,
    open_source,
    stored_planned,
    stored_source,
)
from palpate.workers.tasks.task_store import TaskStore
from tests.service.diagnosis.compressed_breast import write_case
from tests.workers.organs.specimen.experiments import MARKERS, described, record, write
from tests.workers.tasks.test_studies import begun

NODES, SPACING_MM = 500, 10.0


def case(folder: Path) -> Path:
    return write_case(folder / "case", nodes=500)


def study(folder: Path) -> Path:
    return begun(folder / "runs" / "small")


def experiment(folder: Path) -> Path:
    (folder / "bench").mkdir()
    data = described()
    for state, drop in zip(data["states"], (0.0, -2.0), strict=True):
        moved = np.array([[0.0, drop, 0.0]] * len(MARKERS))
        record(folder / "bench" / state["files"][0], moved, np.eye(3))
    return write(folder / "bench", data)


MADE = {"scanned case": case, "breast study": study, "specimen": experiment}


def same(first: InverseProblem, second: InverseProblem) -> None:
    np.testing.assert_array_equal(first.model.finest.nodes, second.model.finest.nodes)
    np.testing.assert_array_equal(first.points.points, second.points.points)
    np.testing.assert_array_equal(first.covariance, second.covariance)
    assert [s.name for s in first.scans] == [s.name for s in second.scans]
    middle = {free.name: float(np.exp(free.log_mean)) for free in first.free}
    assert middle == {free.name: float(np.exp(free.log_mean)) for free in second.free}
    for one, other in zip(first.scans, second.scans, strict=True):
        assert one.problem(middle) == other.problem(middle)
        for a, b in zip(
            one.compare(first.points.points, first.points),
            other.compare(second.points.points, second.points),
            strict=True,
        ):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("kind", MADE)
def test_source_is_rebuilt_without_its_files(kind: str, tmp_path: Path) -> None:
    path = MADE[kind](tmp_path)
    source = open_source(path)
    before = source.inverse_problem(NODES, SPACING_MM)
    store = TaskStore(tmp_path / "elsewhere")
    name = add_source(source, store)
    assert name.kind == kind
    shutil.rmtree(path if path.is_dir() else path.parent)
    CACHE.clear()
    again = stored_source(name, store)
    assert (again.name, list(again.scans)) == (source.name, list(source.scans))
    assert [e.name for e in again.effects] == [e.name for e in source.effects]
    same(before, again.inverse_problem(NODES, SPACING_MM))


def test_copied_folder_is_the_same_stored_source(tmp_path: Path) -> None:
    store = TaskStore(tmp_path / "store")
    first = case(tmp_path)
    name = add_source(open_source(first), store)
    kept = {p: p.stat().st_mtime_ns for p in store.store.root.rglob("zarr.json")}
    copy = Path(shutil.copytree(first, tmp_path / "copy"))
    (copy / "truth.json").write_text("{}")  # not named in case.yaml
    assert add_source(open_source(copy), store) == name
    assert {p: p.stat().st_mtime_ns for p in store.store.root.rglob("zarr.json")} == kept
    shutil.copy(copy / "pressed_20N.nrrd", copy / "pressed_8N.nrrd")
    assert add_source(open_source(copy), store) != name


def test_plan_needs_only_the_unloaded_scan(tmp_path: Path) -> None:
    folder = case(tmp_path)
    for file in folder.glob("pressed*"):
        file.unlink()
    store = TaskStore(tmp_path / "store")
    name = add_source(open_planned(folder), store)
    shutil.rmtree(folder)
    CACHE.clear()
    acquisition = stored_planned(name, store).acquisition
    assert (acquisition.name, acquisition.loads) == ("small", ["8 N", "20 N"])
    assert acquisition.reference.values.any()


def test_error_names_the_unknown_kind(tmp_path: Path) -> None:
    with pytest.raises(
        StoreError, match=r"the kind 'ultrasound', but this version knows .*scanned case"
    ):
        source_of(SourceContent("ultrasound", {}, {}, {}))


@pytest.mark.parametrize("kind", source_kinds())
def test_code_digest_of_a_diagnosis_includes_all_imports(kind: str) -> None:
    modules = reached(["palpate.workers.tasks.diagnosis_tasks", source_module(kind)])
    organ = source_module(kind).split(".")[3]
    wanted = {
        "palpate.workers.diagnosis.diagnosis_settings",
        "palpate.workers.diagnosis.fits.gauss_newton",
        "palpate.workers.mechanics.fem.body_equilibrium",
        "palpate.workers.mechanics.effects.effect",
        f"palpate.workers.organs.{organ}.{organ}_effects",
        "palpate.workers.comparison.observation.segmentation_noise",
        "palpate.storage.json_digests",
    }
    assert wanted <= set(modules)
    others = {"breast", "specimen", "cornea"} - {organ}
    strangers = [
        m for m in modules if m.startswith(tuple(f"palpate.workers.organs.{o}." for o in others))
    ]
    assert not strangers
    assert not [m for m in modules if m.startswith("palpate.workers.blind")]

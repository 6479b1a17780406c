"""Parts of the experiments as tasks, at sketch scale, in one process."""

from pathlib import Path

import numpy as np
import pytest

from palpate.workers.tasks.thesis_tasks import (
    Bend,
    Compare,
    ComparedBars,
    ComparedMeshes,
    ComparePressed,
    Expose,
    ExposedPhantom,
    Measure,
    MeasuredMesh,
    Press,
    Timed,
    Turn,
    TurnedCylinder,
    bend_bar,
    compare_bars,
    compare_pressed,
    coronal_section,
    measure_mesh,
    press_phantom,
    take_mammograms,
    turn_cylinder,
)
from palpate.workers.thesis.coefficient_choice import DEFORMATIONS
from palpate.workers.thesis.mesh_quality import BINS, MEASURES
from tests.service.thesis.thesis_at_hand import bar_experiment


@pytest.mark.slow
def test_separate_bars_give_the_whole_experiment(tmp_path: Path) -> None:
    store = str(tmp_path / "store")
    for number in (0, *DEFORMATIONS):
        bend_bar(Bend(store, "sketch", number))
    request = Compare(store, "sketch")
    spent = compare_bars(request)
    assert request.part.record(ComparedBars).experiment == bar_experiment("sketch")
    assert compare_bars(request) == spent  # not computed again
    assert request.part.record(Timed).spent == spent


def test_cylinder_record_keeps_infinite_scores(tmp_path: Path) -> None:
    request = Turn(str(tmp_path / "store"), "sketch")
    turn_cylinder(request)
    rows = {row.angle_deg: row for row in request.part.record(TurnedCylinder).rows}
    assert rows[0].gsf == rows[180].gsf == -np.inf
    assert min(rows, key=lambda angle: rows[angle].jc) == 90


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A store with one phantom, pressed on both meshes."""
    folder = str(tmp_path_factory.mktemp("thesis") / "store")
    for mesh in ("adaptive", "homogeneous"):
        press_phantom(Press(folder, "sketch", 3, mesh, "neo-Hookean", "CC"))
    return folder


@pytest.mark.slow
def test_mesh_measurement_includes_histograms(store: str) -> None:
    request = Measure(store, "sketch", 3, "homogeneous")
    measure_mesh(request)
    row = request.part.record(MeasuredMesh).row
    assert row.mean["aspect"] < row.worst_aspect < 8.86
    for name in MEASURES:
        assert len(row.histograms[name]) == BINS
        assert sum(row.histograms[name]) == row.tets
    polygons, glandular = coronal_section(request)
    assert len(polygons) == len(glandular)
    assert 0 < glandular.mean() < 1


@pytest.mark.slow
def test_compares_pressed_phantoms_by_compartment(store: str) -> None:
    request = ComparePressed(store, "sketch", 3, "neo-Hookean", "CC")
    compare_pressed(request)
    row = request.part.record(ComparedMeshes).row
    assert row.adaptive.converged
    assert row.homogeneous.converged
    assert row.compartments > 5
    assert 0.3 < row.jc < 1
    assert row.centroid_mm < 3


@pytest.mark.slow
def test_mammograms_have_pictures_and_dicom_files(store: str) -> None:
    request = Expose(store, "sketch", 3, "CC")
    take_mammograms(request)
    record, arrays = request.part.load(ExposedPhantom)
    assert record.converged
    assert record.attenuation_rms > record.quantum_rms > 0
    assert arrays["adaptive"].shape == arrays["difference"].shape
    assert bytes(arrays["adaptive_dicom"][128:132]) == b"DICM"


def test_parts_depend_on_the_scale(tmp_path: Path) -> None:
    store = str(tmp_path / "store")
    names = {Bend(store, scale, 1).part.name for scale in ("sketch", "reduced", "full")}
    assert len(names) == 3
    assert Bend(store, "sketch", 1).part.name != Bend(store, "sketch", 2).part.name

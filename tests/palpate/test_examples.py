"""The examples run unchanged, with smaller meshes if they are slow."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import yaml

import palpate
from palpate.storage.values import Tissue

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_own_images_use_patient_coordinates_and_slicer_names() -> None:
    files = ("rest.seg.nrrd", "compressed.seg.nrrd")
    rest, pressed = (palpate.read_volume(EXAMPLES / "own-images" / f, axes="S R A") for f in files)
    assert set(np.unique(rest.values)) == {0, Tissue.FAT, Tissue.GLANDULAR}
    along_y = [np.flatnonzero(v.values.any(axis=(0, 2))) for v in (rest, pressed)]
    thickness = [np.ptp(rows) * rest.spacing_mm[1] for rows in along_y]
    assert thickness[1] < 0.8 * thickness[0]
    areas = np.count_nonzero(rest.values, axis=(1, 2))
    assert areas[: len(areas) // 2].sum() > 2 * areas[len(areas) // 2 :].sum()  # wall to nipple


def test_own_images_recover_hidden_constants(tmp_path: Path) -> None:
    folder = EXAMPLES / "own-images"
    keys = yaml.safe_load((folder / "study.yaml").read_text())
    for image in (keys["case"]["reference"], keys["target"]):
        image["volume"] = str(folder / image["volume"])
    keys["case"]["mesh"] = {"nodes": 800}
    keys["search"] |= {"starts": 1, "fit_evaluations": 6}
    truth = runpy.run_path(str(folder / "make.py"))["TRUTH"].constants
    found = palpate.Study.from_dict(keys, tmp_path / "own-images").run(in_process=True)
    for name, true in (("E_fat", truth.E_fat_kpa), ("E_glandular", truth.E_gl_kpa)):
        estimate = found.estimates[name]
        low, high = estimate.interval
        assert low < true < high
        assert estimate.estimate == pytest.approx(true, rel=0.15)


def test_batch_ranks_target_constants_first(tmp_path: Path) -> None:
    folder = EXAMPLES / "batch"
    study = palpate.Study.from_dict(
        yaml.safe_load((folder / "study.yaml").read_text()), tmp_path / "batch"
    )
    table = np.genfromtxt(folder / "candidates.csv", delimiter=",", names=True)
    found = study.evaluate({name: table[name] for name in table.dtype.names}, in_process=True)
    assert found["status"].tolist() == ["done"] * len(table)
    assert found.best.genes == {"E_fat_kpa": 10.0, "E_glandular_kpa": 40.0}
    assert 0.9 < found["jc"].max() < 1

"""A pair of images without fibres, pressed by FEBio, and a search of fibres from none."""

from pathlib import Path

import numpy as np
import pytest

import palpate
from palpate.service.report.study.study_consequence import next_step, quotable
from palpate.storage.values import FloatArray, IntArray, Volume
from tests.reference.test_febio import CASES, case

FAT_KPA, GLANDULAR_KPA = 2 * 1.49 * 12.75, 2 * 1.49 * 36.75
FORCE_N = 100.0
VOXEL_MM = 2.0

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not CASES.is_dir(), reason="the reference solutions of FEBio are not next to the project"
    ),
]


def labelled(nodes: FloatArray, tets: IntArray, labels: IntArray) -> Volume:
    """Return the voxels whose centres are in the elements, with their labels."""
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    start = np.floor(low / VOXEL_MM) * VOXEL_MM - 1.5 * VOXEL_MM
    start[2] = VOXEL_MM / 2  # the chest wall is between voxels
    count = np.ceil((high - start) / VOXEL_MM).astype(int) + 2
    values = np.zeros(count, np.uint8)
    for corners, label in zip(nodes[tets], labels, strict=True):
        first = np.ceil((corners.min(axis=0) - start) / VOXEL_MM).astype(int).clip(0)
        last = np.floor((corners.max(axis=0) - start) / VOXEL_MM).astype(int)
        box = [np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
        at = np.stack(np.meshgrid(*box, indexing="ij"), axis=-1).reshape(-1, 3)
        if not len(at):
            continue
        sides = (corners[1:] - corners[0]).T
        share = np.linalg.solve(sides, (start + VOXEL_MM * at - corners[0]).T)
        inside = (share >= -1e-9).all(axis=0) & (share.sum(axis=0) <= 1 + 1e-9)
        values[tuple(at[inside].T)] = label
    return Volume(values.transpose(2, 1, 0).copy(), (VOXEL_MM,) * 3, tuple(map(float, start)))


def test_stiffness_is_quotable_where_no_fibres_are_needed(tmp_path: Path) -> None:
    solved = case("nhF100")
    tets, labels, nodes = solved["tets"], solved["label"], solved["nodes"].astype(float)
    for name, moved in (("rest", 0.0), ("pressed", solved["displacement"])):
        palpate.write_volume(tmp_path / f"{name}.nrrd", labelled(nodes + moved, tets, labels))
    of_file = {"labels": {0: "air", 1: "fat", 2: "glandular"}}
    spec = {
        "name": "fibreless",
        "case": {
            "organ": "breast",
            "reference": {"volume": str(tmp_path / "rest.nrrd")} | of_file,
            "mesh": {"nodes": 1500},
            "load": {"force_n": FORCE_N},
            "constants": {"nu": 0.49, "eta_glandular_kpa": 0},
        },
        "target": {"volume": str(tmp_path / "pressed.nrrd")} | of_file,
        "score": {"labels": ["fat", "glandular"]},
        "search": {
            "parameters": {
                "E_fat_kpa": [10, 100],
                "E_glandular_kpa": [50, 250],
                "eta_fat_kpa": [0, 200],
            },
            "strategy": "least-squares",
        },
    }
    results = palpate.Study.from_dict(spec, tmp_path / "runs" / "fibreless").run(in_process=True)
    fibres = results.estimates["eta_fat"]
    assert fibres.one_sided, repr(fibres)
    for name, true in (("E_fat", FAT_KPA), ("E_glandular", GLANDULAR_KPA)):
        stiffness = results.estimates[name]
        assert stiffness.quotable, repr(stiffness)
        assert stiffness.interval is not None
        assert stiffness.interval[0] < true < stiffness.interval[1]
    assert "Widen" not in next_step(results, "image")
    assert "no fibre stiffness of fat and ligaments is needed" in quotable(results)

"""A breast from a dedicated CT, 146 million voxels, if its file is available."""

from pathlib import Path

import numpy as np
import pytest

from palpate.storage.values import Tissue, Volume
from palpate.workers.body.mesh.body_outline import skin_thickness_mm
from palpate.workers.body.mesh.mesh_geometry import summarise, volumes_mm3
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy

FILE = (
    Path(__file__).parents[5] / "shared/data/breast_bct_niftysim/UncompressedBreast3_resampled.nrrd"
)


@pytest.mark.slow
@pytest.mark.skipif(not FILE.exists(), reason="the CT volume is not available")
def test_ct_breast_keeps_volumes_and_quality():
    nrrd = pytest.importorskip("nrrd")
    values, _ = nrrd.read(str(FILE))
    labels = Volume(np.ascontiguousarray(values.astype(np.uint8).T), (0.273,) * 3)
    meshes = build_hierarchy(labels, nodes=5000)
    summary = summarise(meshes.finest.mesh)
    assert summary["nodes"] == pytest.approx(5000, rel=0.1)
    assert summary["volume_mm3"] == pytest.approx(602.8e3, rel=0.01)
    assert summary["bad"] == 0 and summary["M3"]["min"] > 0.4
    parts = volumes_mm3(meshes.finest.mesh) @ meshes.finest.fractions.astype(float)
    assert parts[Tissue.GLANDULAR] == pytest.approx(95.1e3, rel=0.1)
    assert 1.0 < skin_thickness_mm(labels) < 2.0

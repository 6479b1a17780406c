"""A breast from dedicated breast CT, before and after compression, if available."""

from pathlib import Path

import numpy as np
import pytest

from palpate.storage.values import Tissue, Volume
from palpate.workers.body.images.image_formats import read_volume_file
from palpate.workers.body.images.tissue_labels import crop_to_body, relabel, summarise

FOLDER = Path(__file__).parents[5] / "shared" / "data" / "breast_bct_niftysim"
NAMES = {0: "air", 1: "fat", 2: "glandular", 3: "skin"}


def read(name: str) -> Volume:
    if not (FOLDER / name).exists():
        pytest.skip(f"real breast data are not available: {FOLDER / name}")
    return relabel(read_volume_file(FOLDER / name), NAMES)


@pytest.mark.slow
def test_uncompressed_breast_has_the_published_volumes() -> None:
    breast = read("UncompressedBreast3_resampled.nrrd")
    summary = summarise(breast, named=True)
    assert summary["shape"] == [637, 637, 360]
    assert summary["spacing_mm"] == pytest.approx([0.273] * 3)
    ml = {entry["tissue"]: entry["ml"] for entry in summary["labels"].values()}
    # the volumes published with the data, to their last digit
    assert ml["fat"] == pytest.approx(464.6, abs=0.05)
    assert ml["glandular"] == pytest.approx(95.1, abs=0.05)
    assert ml["skin"] == pytest.approx(43.0, abs=0.05)
    box = crop_to_body(breast)
    assert box.on_lattice_of(breast)
    assert np.count_nonzero(box.values) == np.count_nonzero(breast.values)
    assert box.values[0].any()
    assert summarise(box)["body_mm"] == summary["body_mm"]


def test_compressed_breast_is_between_its_plates() -> None:
    summary = summarise(read("compressedPhantom3.nrrd"))
    assert summary["origin_mm"] == pytest.approx([15.0934, 81.59, -5.063], abs=1e-3)
    thickness = summary["body_mm"]["upper"][1] - summary["body_mm"]["lower"][1]
    # plates were 65.07 mm apart; voxelisation may remove or add two voxels
    assert thickness == pytest.approx(65.07, abs=2 * 0.273)
    assert str(int(Tissue.GLANDULAR)) in summary["labels"]

"""A second segmentation of the reference scan measures the noise of a case."""

import json
from pathlib import Path

import pytest
from compressed_breast import PHANTOM, PRESSED, SCANS, described, write_scan
from redrawn import perturbed

from storage.errors import InputError
from workers.cases.case import ImagedCase
from workers.cases.checks import check_case
from workers.cases.imaged import ImagedSource
from workers.observation.noise import SegmentationNoise
from workers.phantom.breast import generate_breast

NOISE = SegmentationNoise(0.4, 5.0, 0.4, 0.02)


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A body segmented twice by a hand that errs by 0.4 mm; case.json does not say so."""
    folder = tmp_path_factory.mktemp("repeat")
    labels = generate_breast(PHANTOM, seed=5).labels
    for number, file in enumerate(("rest.nrrd", "again.nrrd", SCANS[1])):
        write_scan(folder / file, perturbed(labels, NOISE, number))
    said = described(PRESSED[:1])
    del said["segmentation"]
    said["scans"] |= {"reference": "rest.nrrd", "reference_repeat": "again.nrrd"}
    (folder / "case.json").write_text(json.dumps(said))
    return folder


def test_the_noise_is_measured(twice: Path) -> None:
    found = ImagedCase(twice).noise
    assert found.sd_mm == pytest.approx(0.4, rel=0.2)
    assert found.correlation_mm == pytest.approx(5.0, rel=0.25)
    assert found.reference_sd_mm == found.sd_mm


def test_the_result_depends_on_it(twice: Path) -> None:
    assert twice / "again.nrrd" in ImagedSource(twice).files


def test_another_body_is_no_repeat(twice: Path, tmp_path: Path) -> None:
    for file in twice.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    labels = generate_breast(PHANTOM, seed=6).labels
    write_scan(tmp_path / "again.nrrd", labels)
    with pytest.raises(InputError, match=r"again\.nrrd .* same scan"):
        check_case(ImagedCase(tmp_path))

"""A second segmentation of the reference scan measures the noise of a case."""

from pathlib import Path

import pytest

from palpate.storage.errors import InputError
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.organs.breast.scanned_case import ScannedCase
from palpate.workers.organs.breast.scanned_case_files import read_case
from palpate.workers.organs.breast.scanned_case_source import ScannedCaseSource
from palpate.workers.tasks.diagnosis_sources import add_source, check_source
from palpate.workers.tasks.task_store import TaskStore
from tests.service.diagnosis.compressed_breast import (
    PHANTOM,
    PRESSED,
    SCANS,
    described,
    write_scan,
    write_settings,
)
from tests.workers.comparison.observation.redrawn import perturbed

NOISE = SegmentationNoise(0.4, 5.0, 0.4, 0.02)


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A body segmented twice with an error of 0.4 mm, which case.yaml does not give."""
    folder = tmp_path_factory.mktemp("repeat")
    labels = generate_breast(PHANTOM, seed=5).labels
    for number, file in enumerate(("rest.nrrd", "again.nrrd", SCANS[1])):
        write_scan(folder / file, perturbed(labels, NOISE, number))
    said = described(PRESSED[:1])
    del said["noise"]
    said["scans"] |= {"reference": "rest.nrrd", "reference_repeat": "again.nrrd"}
    write_settings(folder, said)
    return folder


def test_the_noise_is_measured_from_the_repeat(twice: Path) -> None:
    found = read_case(twice).noise
    assert found.sd_mm == pytest.approx(0.4, rel=0.2)
    assert found.correlation_mm == pytest.approx(5.0, rel=0.25)
    assert found.reference_sd_mm == found.sd_mm


def test_source_digest_depends_on_the_repeat(twice: Path, tmp_path: Path) -> None:
    store = TaskStore(tmp_path / "store")
    case = read_case(twice)
    assert case.repeat is not None
    redrawn = ScannedCase(case.file, case.reference, case.reference, case.deformed)
    names = [add_source(ScannedCaseSource(one), store) for one in (case, case, redrawn)]
    assert names[0] == names[1] != names[2]


def test_rejects_a_repeat_of_another_body(twice: Path, tmp_path: Path) -> None:
    for file in twice.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    labels = generate_breast(PHANTOM, seed=6).labels
    write_scan(tmp_path / "again.nrrd", labels)
    with pytest.raises(InputError, match=r"again\.nrrd .* same scan"):
        check_source(ScannedCaseSource(read_case(tmp_path)))

"""Several directions of compression in one case, and plates at a known distance."""

from pathlib import Path

import pytest

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.fits.nominal_calibration import calibrate
from palpate.workers.organs.breast.scan_facts import extent_mm
from palpate.workers.organs.breast.scanned_case_files import read_case
from palpate.workers.organs.breast.scanned_case_source import ScannedCaseSource
from palpate.workers.tasks.diagnosis_sources import check_source
from tests.service.diagnosis.compressed_breast import (
    CROSSWISE,
    PRESSED,
    TRUE_MPA,
    described,
    write_case,
    write_settings,
)

NODES, SPACING_MM = 1600, 8.0


@pytest.fixture(scope="module")
def both_ways(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide scans pressed along y and along x, of a body whose model lacks nothing."""
    folder = tmp_path_factory.mktemp("views") / "both"
    return write_case(folder, pressed=[PRESSED[1], CROSSWISE])


def test_a_scan_pressed_along_x_is_fitted_with_one_along_y(both_ways: Path) -> None:
    case = read_case(both_ways)
    check_source(ScannedCaseSource(case))
    assert case.names == ["20 N", "8 N along x"]
    inverse, fit = calibrate(ScannedCaseSource(case).inverse_problem(NODES, SPACING_MM))
    assert [s.problem(fit.values()).load.device.axis[0] for s in inverse.scans] == [0.0, 1.0]
    for name, true in TRUE_MPA.items():
        assert fit.values()[name] == pytest.approx(true, rel=0.12)
    for scan in fit.predictions:
        assert scan.residual.std() < 0.3


def test_a_given_plate_distance_determines_the_stiffness_ratio(
    both_ways: Path, tmp_path: Path
) -> None:
    (tmp_path / "case").mkdir()
    for file in both_ways.glob("*.nrrd"):
        (tmp_path / "case" / file.name).symlink_to(file)
    case = read_case(both_ways)
    low, high = extent_mm(case.deformed[0], (0.0, 1.0, 0.0))
    said = described([{"volume": PRESSED[1]["volume"], "plate_distance_mm": high - low}])
    said["constants"]["E_fat_kpa"] = 10.0
    write_settings(tmp_path / "case", said)
    case = read_case(tmp_path / "case")
    assert case.names == [f"{high - low:g} mm"]
    check_source(ScannedCaseSource(case))
    _, fit = calibrate(ScannedCaseSource(case).inverse_problem(NODES, SPACING_MM))
    assert fit.values()["E_gl"] / 0.010 == pytest.approx(3.2, rel=0.1)


@pytest.mark.parametrize(
    ("load", "complaint"),
    [
        ({"force_n": 8, "plate_distance_mm": 40}, "exactly one of force_n and plate_distance_mm"),
        ({}, "exactly one of force_n and plate_distance_mm"),
        ({"force_n": 8, "axis": [0, 0, 1]}, "perpendicular to z"),
    ],
)
def test_rejects_invalid_loads(load: dict[str, object], complaint: str, tmp_path: Path) -> None:
    said = described([{"volume": "pressed.nrrd"} | load])
    write_settings(tmp_path, said)
    with pytest.raises(InputError, match=complaint):
        read_case(tmp_path)


def test_a_constant_without_a_value_is_refused(both_ways: Path, tmp_path: Path) -> None:
    for file in both_ways.glob("*.nrrd"):
        (tmp_path / file.name).symlink_to(file)
    said = described(PRESSED[1:])
    del said["constants"]["E_fat_kpa"]
    write_settings(tmp_path, said)
    with pytest.raises(InputError, match="no value for E_fat"):
        _ = read_case(tmp_path).free

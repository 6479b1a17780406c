"""Tissue below the position of the chest wall in loaded scans belongs to the body."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.storage.values import FloatArray, Tissue, Volume
from palpate.workers.diagnosis.problem.inverse_problem import unknowns
from palpate.workers.diagnosis.problem.scan_prediction import predict_scan
from palpate.workers.organs.breast.breast_effects import CATALOGUE
from palpate.workers.organs.breast.scanned_case import ScannedCase
from palpate.workers.organs.breast.scanned_case_files import read_case
from palpate.workers.organs.breast.scanned_case_source import ScannedCaseSource
from palpate.workers.tasks.diagnosis_sources import check_source
from tests.service.diagnosis.compressed_breast import SCANS, TRUE_MPA, write_case, write_scan

effect = CATALOGUE.named
YIELD_MM_PER_MPA = 500.0


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> ScannedCase:
    """A body on a wall that yields, so that plates press its edges below."""
    folder: Path = tmp_path_factory.mktemp("cases") / "yielding"
    return read_case(write_case(folder, {"wall_compliance": YIELD_MM_PER_MPA}))


def below(labels: Volume, wall_mm: float) -> int:
    z = labels.origin_mm[2] + labels.spacing_mm[2] * np.arange(labels.values.shape[0])
    return int((labels.values[z < wall_mm] != Tissue.AIR).sum())


def test_loaded_scans_keep_tissue_below_the_wall_but_checks_ignore_it(case: ScannedCase) -> None:
    assert below(case.reference, case.wall_mm) == 0
    assert all(below(labels, case.wall_mm) > 100 for labels in case.deformed)
    assert all(below(case.above_wall(one), case.wall_mm) == 0 for one in case.deformed)
    check_source(ScannedCaseSource(case))


def left(case: ScannedCase) -> FloatArray:
    """Return the residuals of the true model at the points near the wall."""
    inverse = ScannedCaseSource(case).inverse_problem(1500, 4.0)
    free = unknowns(inverse.free, [effect("wall_compliance")])
    z = np.array([*np.log([TRUE_MPA[one.name] for one in inverse.free]), YIELD_MM_PER_MPA])
    scan = inverse.scans[len(SCANS) - 2]
    found = predict_scan(inverse, scan, free, z, None)
    assert found is not None
    assert (found.points[:, 2] < case.wall_mm).any()
    return found.residual[inverse.points.points[:, 2] < case.wall_mm + 8.0]


def test_points_below_the_wall_are_found_on_the_skin(case: ScannedCase) -> None:
    """A scan that is cut at the wall has no skin where they are."""
    assert np.abs(left(case)).max() < 0.9  # voxels of 1.5 mm
    cut = [case.above_wall(one) for one in case.deformed]
    without = ScannedCase(case.file, case.reference, case.repeat, cut)
    assert np.abs(left(without)).max() > 1.1


def test_scan_at_rest_is_cut_at_the_wall(tmp_path: Path) -> None:
    """Its segmentation may extend below the wall, whose position is given in the case."""
    folder = write_case(tmp_path / "spilled")
    clean = read_case(folder)
    rest = clean.reference
    x, y, z = rest.origin_mm
    spilled = np.concatenate([rest.values[:1]] * 2 + [rest.values])
    origin_mm = (x, y, z - 2 * rest.spacing_mm[2])
    write_scan(folder / SCANS[0], replace(rest, values=spilled, origin_mm=origin_mm))
    found = read_case(folder).reference
    np.testing.assert_array_equal(found.values, rest.values)
    assert found.origin_mm == pytest.approx(rest.origin_mm)

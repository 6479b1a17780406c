"""Scans that cannot show one body under these loads are rejected before anything is fitted."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Triple, Volume
from palpate.workers.organs.breast.scan_facts import extent_mm
from palpate.workers.organs.breast.scanned_case_files import read_case
from palpate.workers.organs.breast.scanned_case_source import ScannedCaseSource
from palpate.workers.tasks.diagnosis_sources import check_source
from tests.service.diagnosis.compressed_breast import SCANS, loads_exchanged, write_case, write_scan

Change = Callable[[Path], object]


@pytest.fixture(scope="module")
def tilted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scans between plates of which one is tilted."""
    return write_case(tmp_path_factory.mktemp("cases") / "tilted", {"tilt_depth": 8.0})


def scan(folder: Path, file: str) -> Volume:
    case = read_case(folder)
    return dict(zip(SCANS, [case.reference, *case.deformed], strict=True))[file]


def with_voxels(spacing: tuple[float, float, float]) -> Change:
    def change(folder: Path) -> None:
        labels = scan(folder, SCANS[1])
        write_scan(folder / SCANS[1], Volume(labels.values, spacing, (0.0, 0.0, spacing[2] / 2)))

    return change


def moved(folder: Path) -> None:
    labels = scan(folder, SCANS[1])
    x, y, z = labels.origin_mm
    write_scan(folder / SCANS[1], Volume(labels.values, labels.spacing_mm, (x + 90, y, z)))


def mirrored(folder: Path) -> None:
    labels = scan(folder, SCANS[2])
    x, y, z = labels.origin_mm
    there = (-x - (labels.shape_xyz[0] - 1) * labels.spacing_mm[0], y, z)
    write_scan(folder / SCANS[2], Volume(labels.values[:, :, ::-1], labels.spacing_mm, there))


def labels_exchanged(*files: str) -> Change:
    def change(folder: Path) -> None:
        for file in files:
            labels = scan(folder, file)
            values = np.array([0, 2, 1], np.uint8)[labels.values]
            write_scan(folder / file, Volume(values, labels.spacing_mm, labels.origin_mm))

    return change


def gland_below_the_wall(folder: Path) -> None:
    labels = scan(folder, SCANS[1])
    fat = np.minimum(labels.values, 1)
    behind = np.full_like(fat[:1], 2)
    x, y, z = labels.origin_mm
    there = (x, y, z - labels.spacing_mm[2])
    write_scan(folder / SCANS[1], Volume(np.append(behind, fat, 0), labels.spacing_mm, there))


WRONG: dict[str, tuple[Change, str]] = {
    "spacing in cm": (
        with_voxels((0.15, 0.15, 0.15)),
        "1.5 x 1.5 x 1.5 mm in rest.nrrd and 0.15 x 0.15 x 0.15 mm",
    ),
    "one spacing in cm": (with_voxels((1.5, 1.5, 0.15)), "wrong, perhaps by a factor of 10: found"),
    "another body": (with_voxels((1.6, 1.6, 1.6)), "Check that both scans show the same body"),
    "elsewhere": (moved, "overlap in 0% of their volume, expected at least 10%"),
    "mirrored": (mirrored, f"{SCANS[2]} looks like a mirror image of {SCANS[0]}"),
    "loads": (loads_exchanged, "Swap the two files, or their forces"),
    "labels of one": (labels_exchanged(SCANS[1]), f"Swap labels 1 and 2 in {SCANS[1]}"),
    "labels of all": (labels_exchanged(*SCANS), "swap the labels in all scans"),
    "gland behind the wall": (gland_below_the_wall, f"{SCANS[1]} has no voxel labelled glandular"),
}


@pytest.fixture
def copied(tilted: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(tilted, tmp_path / "case"))


def test_a_sound_case_passes(tilted: Path) -> None:
    check_source(ScannedCaseSource(read_case(tilted)))


@pytest.mark.parametrize(("change", "said"), WRONG.values(), ids=WRONG)
def test_rejects_scans_of_different_bodies(copied: Path, change: Change, said: str) -> None:
    change(copied)
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        check_source(ScannedCaseSource(read_case(copied)))


def test_symmetric_sides_are_not_a_mirror_image(copied: Path) -> None:
    for file in SCANS:
        labels = scan(copied, file)
        half = labels.values[:, :, : labels.shape_xyz[0] // 2]
        even = np.concatenate([half, half[:, :, ::-1]], axis=2)
        write_scan(copied / file, Volume(even, labels.spacing_mm, labels.origin_mm))
    check_source(ScannedCaseSource(read_case(copied)))
    mirrored(copied)
    check_source(ScannedCaseSource(read_case(copied)))


def test_a_body_may_bulge_behind_the_edge_of_the_plates(copied: Path) -> None:
    """Its first slices are then thicker under the larger force than any other slice."""
    for file, extra in zip(SCANS[1:], (4, 12), strict=False):
        labels = scan(copied, file)
        values = np.pad(labels.values, ((0, 0), (extra, 0), (0, 0)))
        for slice_ in values[: labels.shape_xyz[2] // 8]:
            columns = slice_.any(axis=0)
            first = int(slice_.any(axis=1).argmax())
            slice_[first - extra : first, columns] = 1
        x, y, z = labels.origin_mm
        place = (x, y - extra * labels.spacing_mm[1], z)
        write_scan(copied / file, Volume(values, labels.spacing_mm, place))
    check_source(ScannedCaseSource(read_case(copied)))


@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.6, -0.8, 0.0)])
def test_a_body_reaches_as_far_as_its_voxels(axis: Triple) -> None:
    """Crumbs, with rows of no voxel, of one and of several, against the corners of each voxel."""
    values = (np.random.default_rng(3).random((4, 9, 12)) < 0.05).astype(np.uint8)
    labels = Volume(values, (0.5, 1.25, 2.0), (-3.0, 4.0, 10.0))
    _, y, x = np.nonzero(values)
    corners = [
        (x + i) * 0.5 * axis[0] + (y + j) * 1.25 * axis[1] for i in (-0.5, 0.5) for j in (-0.5, 0.5)
    ]
    origin = -3.0 * axis[0] + 4.0 * axis[1]
    expected = (origin + np.min(corners), origin + np.max(corners))
    assert extent_mm(labels, axis) == pytest.approx(expected, abs=1e-12)


def test_air_around_a_scan_changes_nothing(copied: Path) -> None:
    """Neither does a speck in it."""
    before = scan(copied, SCANS[1])
    values = np.pad(before.values, ((0, 5), (7, 3), (2, 9)))
    x, y, z = before.origin_mm
    dx, dy, _ = before.spacing_mm
    values[-1, -1, -1] = Tissue.FAT
    write_scan(copied / SCANS[1], Volume(values, before.spacing_mm, (x - 2 * dx, y - 7 * dy, z)))
    after = scan(copied, SCANS[1])
    np.testing.assert_array_equal(after.values, before.values)
    assert after.values.dtype == before.values.dtype
    assert after.origin_mm == pytest.approx(before.origin_mm)

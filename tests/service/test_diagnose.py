"""Diagnoses of small scans that our own solver made: checks, tasks, clusters, the command."""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blind_at_hand import Inline
from compressed_breast import SCANS, TRUE_MPA, write_case, write_scan

from service.cli import main
from service.cluster import open_cluster
from service.diagnosis.run import Found, ask, finished, run
from service.dispatch import Dispatcher
from service.errors import Interrupted
from storage.errors import InputError, StoreError
from storage.values import Volume
from workers import examine
from workers.casebook import Casebook, Request
from workers.cases.build import build_subject
from workers.cases.case import ImagedCase
from workers.cases.checks import check_case
from workers.diagnosis.calibrate import calibrate
from workers.diagnosis.diagnosis import diagnose, look, one_by_one
from workers.diagnosis.summary import summary
from workers.effects.catalogue import effect

NODES, SPACING_MM = 1600, 8.0
SUSPECTS = ["gravity_change", "plate_tilt", "stiffness_gradient", "segmentation_offset"]
TILT_DEG = 8.0
Change = Callable[[Path], object]


@pytest.fixture(scope="module")
def tilted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scans between plates of which one is tilted."""
    return write_case(tmp_path_factory.mktemp("cases") / "tilted", {"tilt_depth": TILT_DEG})


@pytest.fixture(scope="module")
def one_worker() -> Iterator[Dispatcher]:
    """A cluster of one process."""
    with open_cluster(workers=1) as cluster:
        yield Dispatcher(cluster.client)


@pytest.fixture(scope="module")
def diagnosed(
    tilted: Path, one_worker: Dispatcher, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Request, Found]:
    """The diagnosis of one worker."""
    request = asked(tilted, tmp_path_factory.mktemp("one") / "store")
    return request, run(request, one_worker, unheard)


def asked(folder: Path, store: Path) -> Request:
    return ask(folder, store, NODES, SPACING_MM, SUSPECTS)


def unheard(*step: Any) -> None:
    pass


# What is found


def test_the_tilt_and_the_constants_are_found(diagnosed: tuple[Request, Found]) -> None:
    told = diagnosed[1].summary
    assert (told["verdict"], told["primary"], told["set90"]) == (
        "effect", ["plate_tilt"], ["plate_tilt"],
    )  # fmt: skip
    tilt = next(e for e in told["effects"] if e["name"] == "plate_tilt")
    assert tilt["magnitude"] == pytest.approx(TILT_DEG, rel=0.15)
    assert tilt["unit"] == "deg"
    for name, true in TRUE_MPA.items():
        found = told["constants"][f"{name}_kpa"]
        assert found["after"] == pytest.approx(1e3 * true, rel=0.12)
    gap = told["gap_mm"]
    assert gap["after"]["gap_mm"] < 0.7 * gap["before"]["gap_mm"]


def test_tasks_and_store_say_what_one_process_says(
    tilted: Path, diagnosed: tuple[Request, Found]
) -> None:
    case = ImagedCase(tilted)
    effects = [effect(name) for name in SUSPECTS]
    finer = Casebook(diagnosed[0]).finer()
    subject, nominal = calibrate(build_subject(case, NODES, SPACING_MM), finer)
    seen = look(subject, nominal, effects)
    expected = summary(diagnose(seen, effects, one_by_one(seen)), effects, "small")
    told = {k: v for k, v in diagnosed[1].summary.items() if k not in ("overlap", "cause_map")}
    # Tangents are solved to a relative error of 1e-5, from other starts than here.
    assert flat(told).keys() == flat(expected).keys()
    for key, value in flat(expected).items():
        if isinstance(value, float):
            value = pytest.approx(value, rel=2e-3, abs=2e-3)
        assert flat(told)[key] == value, key


def flat(value: Any, at: str = "") -> dict[str, Any]:
    """Every leaf of a record by its path."""
    if isinstance(value, dict):
        return {k: v for name in value for k, v in flat(value[name], f"{at}/{name}").items()}
    if isinstance(value, list | tuple):
        return {k: v for n, item in enumerate(value) for k, v in flat(item, f"{at}/{n}").items()}
    return {at: value}


def test_maps_belong_to_the_points(diagnosed: tuple[Request, Found]) -> None:
    request, found = diagnosed
    maps, subject = found.maps, Casebook(request).subject
    assert found.scans == ["8 N", "20 N"]
    np.testing.assert_array_equal(maps["points"], subject.points.points)
    assert maps["before"].shape == maps["after"].shape == (2, len(subject.points))
    np.testing.assert_allclose(maps["noise"].ravel() ** 2, np.diag(subject.covariance))
    assert np.mean(maps["after"] ** 2) < 0.5 * np.mean(maps["before"] ** 2)
    moved = maps["moved_after"] - maps["moved_before"]
    np.testing.assert_allclose(
        (moved * maps["normals_before"]).sum(axis=2), maps["after"] - maps["before"], atol=0.3
    )


def test_bodies_overlap_better_with_the_effect(diagnosed: tuple[Request, Found]) -> None:
    rows = diagnosed[1].summary["overlap"]
    assert [(row["scan"], row["interface"]) for row in rows] == [
        (scan, name) for scan in ("8 N", "20 N") for name in ("outline", "glandular")
    ]
    for row in rows:
        assert row["before"]["jc"] < row["after"]["jc"] <= 1.0
        assert row["after"]["mhd_mm"] < row["before"]["mhd_mm"]


# Workers, interruptions, and what is not computed again


def test_two_workers_say_the_same_to_the_last_bit(
    tilted: Path, diagnosed: tuple[Request, Found], tmp_path: Path
) -> None:
    with open_cluster(workers=2) as cluster:
        found = run(asked(tilted, tmp_path / "two"), Dispatcher(cluster.client), unheard)
    assert found.summary == diagnosed[1].summary
    for name, values in diagnosed[1].maps.items():
        np.testing.assert_array_equal(found.maps[name], values)


def test_the_order_of_tasks_leaves_no_trace(
    tilted: Path, diagnosed: tuple[Request, Found], one_worker: Dispatcher, tmp_path: Path
) -> None:
    request = asked(tilted, tmp_path / "store")
    one_worker.call(examine.calibrate_case, request)
    wanted = [(name, scan) for name in SUSPECTS for scan in range(2)]
    for which in reversed(wanted):
        assert one_worker.call(examine.print_effect, request, *which)["acts"]
    before, again = Casebook(diagnosed[0]), Casebook(request)
    for which in wanted:
        columns = before.load("print", *which)[0]["columns"]
        np.testing.assert_array_equal(again.load("print", *which)[0]["columns"], columns)


def test_an_interrupted_diagnosis_goes_on(
    tilted: Path, diagnosed: tuple[Request, Found], one_worker: Dispatcher, tmp_path: Path
) -> None:
    request = asked(tilted, tmp_path / "store")

    def until_refits(phase: str, *step: Any) -> None:
        if phase == "refits":
            raise Interrupted

    with pytest.raises(Interrupted):
        run(request, one_worker, until_refits)
    assert finished(request) is None
    done = made(request)
    assert len(done) == 1 + 2 * len(SUSPECTS) + 1  # calibration, prints and threshold
    assert run(request, one_worker, unheard).summary == diagnosed[1].summary
    assert made(request).items() >= done.items()


def test_others_build_while_one_calibrates(tilted: Path, tmp_path: Path) -> None:
    """But only where the store has no calibration yet."""

    def until_effects(phase: str, *step: Any) -> None:
        if phase == "effects":
            raise Interrupted

    request, workers = asked(tilted, tmp_path / "store"), Inline(threads=3)
    for _ in range(2):
        with pytest.raises(Interrupted):
            run(request, workers, until_effects)
    assert workers.asked == ["build_case", "build_case", "calibrate_case", "calibrate_case"]


def test_what_is_missing_is_made_again_and_nothing_else(
    tilted: Path, diagnosed: tuple[Request, Found], one_worker: Dispatcher, tmp_path: Path
) -> None:
    store = tmp_path / "store"
    shutil.copytree(diagnosed[0]["store"], store)
    request = asked(tilted, store)
    book, before = Casebook(request), made(request)
    lost = [book.path("verdict"), book.path("refit", ["plate_tilt"])]
    for path in lost:
        shutil.rmtree(path)
    assert run(request, one_worker, unheard).summary == diagnosed[1].summary
    after = made(request)
    assert {p for p in after if after[p] != before[p]} == {path.name for path in lost}


def made(request: Request) -> dict[str, int]:
    """What the store holds, and when it was written."""
    fields = Casebook(request).store.layout.fields
    return {path.name: (path / "zarr.json").stat().st_mtime_ns for path in fields.iterdir()}


def test_the_name_follows_the_scans_and_what_is_asked(tilted: Path, tmp_path: Path) -> None:
    folder = tmp_path / "case"
    shutil.copytree(tilted, folder)
    store = tmp_path / "store"
    first = asked(folder, store)
    (folder / "truth.json").write_text("{}")  # case.json does not name it
    assert asked(folder, store)["name"] == first["name"]
    assert ask(folder, store, NODES + 1, SPACING_MM, SUSPECTS)["name"] != first["name"]
    assert ask(folder, store, NODES, SPACING_MM, SUSPECTS[1:])["name"] != first["name"]
    shutil.copy(folder / SCANS[2], folder / SCANS[1])
    assert asked(folder, store)["name"] != first["name"]
    with pytest.raises(StoreError, match="they see other files of the case"):
        examine.calibrate_case(first)


def test_points_that_calibration_did_not_keep_are_no_part(
    diagnosed: tuple[Request, Found],
) -> None:
    points = Casebook(diagnosed[0]).built.points
    kept = np.arange(len(points)) % 3 > 0
    np.testing.assert_array_equal(examine.kept_of(points, points.of(np.flatnonzero(kept))), kept)
    with pytest.raises(ValueError, match="in their order"):
        examine.kept_of(points, points.of(np.array([5, 2])))


# What is refused


def scan(folder: Path, file: str) -> Volume:
    case = ImagedCase(folder)
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


def loads_exchanged(folder: Path) -> None:
    said = json.loads((folder / "case.json").read_text())
    first, second = said["scans"]["deformed"]
    first["plate_force_N"], second["plate_force_N"] = 20.0, 8.0
    (folder / "case.json").write_text(json.dumps(said))


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
    "one spacing in cm": (with_voxels((1.5, 1.5, 0.15)), "wrong, as by a factor of 10: found"),
    "another body": (with_voxels((1.6, 1.6, 1.6)), "Is it the same body"),
    "elsewhere": (moved, "overlap in 0% of their volume, expected at least 10%"),
    "mirrored": (mirrored, f"{SCANS[2]} looks like a mirror image of {SCANS[0]}"),
    "loads": (loads_exchanged, "Exchange the two files, or their plate_force_N"),
    "labels of one": (labels_exchanged(SCANS[1]), f"Exchange labels 1 and 2 in {SCANS[1]}"),
    "labels of all": (labels_exchanged(*SCANS), "exchange the labels in all scans"),
    "gland behind the wall": (gland_below_the_wall, f"{SCANS[1]} has no voxel labelled glandular"),
}


@pytest.fixture
def copied(tilted: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(tilted, tmp_path / "case"))


def test_a_sound_case_passes(tilted: Path) -> None:
    check_case(ImagedCase(tilted))


@pytest.mark.parametrize(("change", "said"), WRONG.values(), ids=WRONG)
def test_scans_that_do_not_belong_together(copied: Path, change: Change, said: str) -> None:
    change(copied)
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        check_case(ImagedCase(copied))


def test_sides_that_are_alike_are_no_mirror_image(copied: Path) -> None:
    for file in SCANS:
        labels = scan(copied, file)
        half = labels.values[:, :, : labels.shape_xyz[0] // 2]
        even = np.concatenate([half, half[:, :, ::-1]], axis=2)
        write_scan(copied / file, Volume(even, labels.spacing_mm, labels.origin_mm))
    check_case(ImagedCase(copied))
    mirrored(copied)
    check_case(ImagedCase(copied))


# The command


def test_the_command_refuses_before_it_opens_a_cluster(
    copied: Path, no_cluster: None, capsys: pytest.CaptureFixture[str]
) -> None:
    loads_exchanged(copied)
    assert main(["diagnose", str(copied), "--store", str(copied.parent / "store")]) == 2
    said = capsys.readouterr()
    assert said.err.startswith("Error: The body is ")
    assert (said.err.count("\n"), said.out) == (1, "")
    assert main(["diagnose", str(copied.parent)]) == 2
    assert "cannot be diagnosed: expected a folder with case.json" in capsys.readouterr().err


def test_the_command_writes_page_and_record(
    tilted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    command = ["diagnose", str(tilted), "--nodes", str(NODES), "--workers", "1"]
    assert main(command) == 0
    said = capsys.readouterr()
    assert said.out.startswith("Model and data differ by ")
    assert "The cause is plate tilt" in said.out
    assert "finding the nominal constants" in said.err
    written = tmp_path / "runs" / "tilted"
    assert f"page: {Path('runs/tilted/diagnosis.html')}" in said.out
    record = json.loads((written / "diagnosis.json").read_text())
    assert record["primary"] == ["plate_tilt"]
    assert (written / "diagnosis.html").read_text().startswith("<!DOCTYPE html>")


def test_a_stored_diagnosis_needs_no_cluster(
    tilted: Path, diagnosed: tuple[Request, Found], no_cluster: None, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr("service.diagnosis.run.POINT_SPACING_MM", SPACING_MM)
    monkeypatch.setattr("service.diagnosis.run.ask", lambda *_: diagnosed[0])
    assert main(["diagnose", str(tilted), "--json", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out) == diagnosed[1].summary
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text()) == diagnosed[1].summary
    assert "nothing to compute" in said.err

"""Checks of a study before its first task: errors and warnings."""

import shutil
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from palpate.service.export import export_volume
from palpate.service.search.search_keys import GENETIC, Strategy
from palpate.service.study import preflight as preflight_module
from palpate.service.study.preflight import preflight
from palpate.service.study.study_keys import StudySpec, parse_spec
from palpate.storage.errors import InputError
from palpate.storage.values import Volume
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.body.phantom.phantom_settings import BreastPhantom

IMAGES = """
name: imaged
case:
  reference: {volume: rest.nrrd, labels: {0: air, 1: fat, 2: glandular}}
  mesh: {nodes: 2000}
  load: {force_n: 60, moving: both}
target: {volume: pressed.nrrd, labels: {0: air, 1: fat, 2: glandular}}
search: {parameters: {E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]}, population: 12}
"""
PHANTOM = """
name: drawn
case: {reference: {phantom: {preset: 445ml}}, mesh: {nodes: 2000}}
target: {constants: {E_fat_kpa: 10, E_glandular_kpa: 40}}
search: {parameters: {E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]}, population: 12}
"""
Change = Callable[[Path], object]


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide a breast at rest, and squeezed along y to three quarters at constant volume."""
    settings = BreastPhantom(spacing_mm=2.0, skin_mm=0.0, ligament_mm=0.0, compartments=60)
    rest = generate_breast(settings, 1).labels
    rest = Volume(np.minimum(rest.values, 2), rest.spacing_mm, rest.origin_mm)
    folder = tmp_path_factory.mktemp("images")
    export_volume(folder / "rest.nrrd", rest)
    export_volume(folder / "pressed.nrrd", squeezed(rest, 0.75))
    return folder


def squeezed(rest: Volume, along_y: float) -> Volume:
    """Scale a body about its centre in x and y, and from the chest wall in z."""
    factors = np.array([along_y**-0.5, along_y, along_y**-0.5])
    spacing = np.asarray(rest.spacing_mm)
    count = np.ceil(np.array(rest.shape_xyz) * factors).astype(int)
    low = np.asarray(rest.origin_mm) - spacing / 2
    centre = np.asarray(rest.origin_mm) + spacing * np.argwhere(rest.values).mean(axis=0)[::-1]
    centre[2] = 0.0
    start = centre + (low - centre) * factors
    axes = [
        (
            (start[a] - centre[a] + (np.arange(count[a]) + 0.5) * spacing[a]) / factors[a]
            + centre[a]
            - low[a]
        )
        / spacing[a]
        for a in range(3)
    ]
    x, y, z = (np.clip(axis.astype(int), 0, rest.shape_xyz[a] - 1) for a, axis in enumerate(axes))
    values = np.ascontiguousarray(rest.values[np.ix_(z, y, x)])
    ox, oy, oz = (float(o) for o in start + spacing / 2)
    return Volume(values, rest.spacing_mm, (ox, oy, oz))


@pytest.fixture
def place(images: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(images, tmp_path / "place"))


def imaged(place: Path, text: str = IMAGES) -> StudySpec:
    return parse_spec(text, "study.yaml", place)


def drawn(old: str = "", new: str = "") -> StudySpec:
    assert old in PHANTOM
    return parse_spec(PHANTOM.replace(old, new) if old else PHANTOM, "study.yaml", Path())


def changed(place: Path, file: str, change: Callable[[Volume], Volume]) -> None:
    from palpate.workers.body.images.image_formats import read_volume_file

    export_volume(place / file, change(read_volume_file(place / file)))


def test_accepts_two_images_of_one_breast_without_warnings(place: Path, tmp_path: Path) -> None:
    assert preflight(imaged(place), tmp_path / "store") == []


def test_accepts_a_drawn_breast_without_warnings(tmp_path: Path) -> None:
    assert preflight(drawn(), tmp_path / "store") == []


def exchanged(place: Path) -> None:
    (place / "rest.nrrd").rename(place / "other.nrrd")
    (place / "pressed.nrrd").rename(place / "rest.nrrd")
    (place / "other.nrrd").rename(place / "pressed.nrrd")


def mirrored(place: Path) -> None:
    changed(
        place,
        "pressed.nrrd",
        lambda v: Volume(np.ascontiguousarray(v.values[:, :, ::-1]), v.spacing_mm, v.origin_mm),
    )


def elsewhere(place: Path) -> None:
    def move(v: Volume) -> Volume:
        x, y, z = v.origin_mm
        return Volume(v.values, v.spacing_mm, (x + 400, y, z))

    changed(place, "pressed.nrrd", move)


def no_gland(place: Path) -> None:
    changed(
        place, "pressed.nrrd", lambda v: Volume(np.minimum(v.values, 1), v.spacing_mm, v.origin_mm)
    )


def in_metres(place: Path) -> None:
    for file in ("rest.nrrd", "pressed.nrrd"):
        changed(
            place,
            file,
            lambda v: Volume(
                v.values,
                tuple(s / 1000 for s in v.spacing_mm),  # type: ignore[arg-type]
                tuple(o / 1000 for o in v.origin_mm),  # type: ignore[arg-type]
            ),
        )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (exchanged, "Reference and target look swapped"),
        (mirrored, "looks like a mirror image"),
        (elsewhere, "overlap in 0% of their volume"),
        (in_metres, "Give its spacing_mm in mm"),
    ],
)
def test_rejects_implausible_images(place: Path, tmp_path: Path, change: Change, said: str) -> None:
    change(place)
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        preflight(imaged(place), tmp_path / "store")


def test_implausible_study_runs_if_the_user_insists(place: Path, tmp_path: Path) -> None:
    exchanged(place)
    with pytest.raises(InputError, match="continue with --anyway"):
        preflight(imaged(place), tmp_path / "store")
    warnings = preflight(imaged(place), tmp_path / "store", anyway=True)
    assert any("look swapped" in one.text for one in warnings)


def test_impossible_study_is_always_refused(place: Path, tmp_path: Path) -> None:
    no_gland(place)
    head, target, tail = IMAGES.partition("target:")
    text = head + target + tail.replace(", 2: glandular", "")
    said = r"score\.labels: glandular is to be compared, but pressed\.nrrd has none"
    with pytest.raises(InputError, match=said) as refused:
        preflight(imaged(place, text), tmp_path / "store", anyway=True)
    assert "--anyway" not in str(refused.value)


@pytest.mark.parametrize("factor", [0.25, 3.0])
def test_rejects_a_body_of_impossible_volume(place: Path, tmp_path: Path, factor: float) -> None:
    for file in ("rest.nrrd", "pressed.nrrd"):
        changed(
            place,
            file,
            lambda v: Volume(
                v.values,
                tuple(factor * s for s in v.spacing_mm),  # type: ignore[arg-type]
                tuple(factor * o for o in v.origin_mm),  # type: ignore[arg-type]
            ),
        )
    with pytest.raises(InputError) as refused:
        preflight(imaged(place), tmp_path / "store")
    assert str(refused.value).count("a breast has 10 to 5000 ml") == 2


def test_rejects_a_spacing_of_two_metres(place: Path, tmp_path: Path) -> None:
    values = np.zeros((20, 20, 20), np.uint8)
    values[:, 3:17, 3:17] = 1
    values[5:10, 5:15, 5:15] = 2
    for file in ("rest.npy", "pressed.npy"):
        np.save(place / file, values)
    text = IMAGES.replace("rest.nrrd,", "rest.npy, spacing_mm: 2000,")
    text = text.replace("pressed.nrrd,", "pressed.npy, spacing_mm: 2000,")
    with pytest.raises(InputError, match="in voxels of 2000 x 2000 x 2000 mm"):
        preflight(imaged(place, text), tmp_path / "store")


def test_missing_image_is_accepted_for_remote_workers(place: Path, tmp_path: Path) -> None:
    (place / "pressed.nrrd").unlink()
    with pytest.raises(InputError, match=r"pressed\.nrrd"):
        preflight(imaged(place), tmp_path / "store")
    assert preflight(imaged(place), tmp_path / "store", elsewhere=True) == []


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("E_fat_kpa: [5, 20]", "E_fat_kpa: [5000, 20000]", "search.parameters.E_fat_kpa"),
        ("E_fat_kpa: [5, 20]", "E_fat_kpa: [0.005, 0.02]", "5 to 20 kPa"),
        ("E_fat_kpa: 10", "E_fat_kpa: 10000", "target.constants.E_fat_kpa: 10000 kPa"),
        ("mesh: {", "constants: {eta_fat_kpa: 100000}, mesh: {", "case.constants.eta_fat_kpa"),
        ("population: 12", "population: 100000000", "evaluations at most"),
        ("search: {", "score: {labels: [muscle]}\nsearch: {", "muscle is to be compared"),
        ("nodes: 2000", "nodes: 400", "Ask for 850 nodes or more"),
    ],
)
def test_rejects_implausible_study_files(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        preflight(drawn(old, new), tmp_path / "store")
    assert not (tmp_path / "store").exists()


def test_all_reasons_are_given_at_once(tmp_path: Path) -> None:
    spec = drawn(
        "E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]",
        "E_fat_kpa: [5000, 20000], E_glandular_kpa: [5000, 80000]",
    )
    with pytest.raises(InputError) as refused:
        preflight(spec, tmp_path / "store")
    assert "E_fat_kpa" in str(refused.value)
    assert "E_glandular_kpa" in str(refused.value)


def test_unusual_interval_gives_a_warning(tmp_path: Path) -> None:
    (found,) = preflight(drawn("E_fat_kpa: [5, 20]", "E_fat_kpa: [30, 60]"), tmp_path / "store")
    assert "about 1.5 times the known interval" in found.text


def test_low_disk_space_is_reported_in_advance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "total used free")
    spec = drawn()
    needed = spec.search.settings.most_evaluations * (24 * 2000 + 4096)
    for free, refused in ((needed - 1, True), (needed + 1, False)):
        monkeypatch.setattr(
            preflight_module.shutil, "disk_usage", lambda path, free=free: usage(0, 0, free)
        )
        if refused:
            with pytest.raises(InputError, match="Free some"):
                preflight(spec, tmp_path / "store")
        else:
            (found,) = preflight(spec, tmp_path / "store")
            assert "has only" in found.text


def test_rejects_plates_that_do_not_touch_the_body(place: Path, tmp_path: Path) -> None:
    text = IMAGES.replace("force_n: 60, moving: both", "plate_distance_mm: {final: 130}")
    with pytest.raises(InputError, match="they would not touch it"):
        preflight(imaged(place, text), tmp_path / "store")


# --- identifiability at a given plate distance --------------------------------------

DISTANCE = PHANTOM.replace("mesh:", "load: {plate_distance_mm: {final: 65}}, mesh:")
ALL_FOUR = DISTANCE.replace(
    "E_glandular_kpa: [5, 80]}",
    "E_glandular_kpa: [5, 80], eta_fat_kpa: [50, 200], eta_glandular_kpa: [50, 200]}",
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (PHANTOM, "absolute"),
        (DISTANCE, "absolute"),  # the fibres of both tissues are held
        (ALL_FOUR, "ratio"),
        (ALL_FOUR.replace("mesh:", "constants: {nu: 0.48}, mesh:"), "ratio"),
        (ALL_FOUR.replace("mesh:", "constants: {tilt_depth_deg: 2}, mesh:"), "ratio"),
        (ALL_FOUR.replace("mesh:", "constants: {gravity_x_g: 1}, mesh:"), "absolute"),
        (ALL_FOUR.replace("mesh:", "constants: {wall_hold_x_kpa_per_mm: 1}, mesh:"), "absolute"),
        (ALL_FOUR.replace("mesh:", "model: {skin: membrane}, mesh:"), "absolute"),
        (ALL_FOUR.replace("mesh:", "constants: {E_muscle_kpa: 50}, mesh:"), "absolute"),
        (ALL_FOUR.replace("E_fat_kpa: [5, 20], ", ""), "absolute"),
    ],
)
def test_distance_identifies_ratios_unless_a_stiffness_is_held(text: str, expected: str) -> None:
    assert parse_spec(text, "study.yaml", Path()).identifiable == expected


def test_unidentifiable_scale_gives_a_warning(tmp_path: Path) -> None:
    spec = parse_spec(ALL_FOUR, "study.yaml", Path())
    (found,) = preflight(spec, tmp_path / "store")
    assert "only ratios of the stiffnesses can be found" in found.text


@pytest.mark.parametrize(
    ("given", "idle"),
    [
        ("strategy: genetic", None),
        ("strategy: genetic, starts: 5", "starts"),
        ("strategy: cma, elite: 2", "elite"),
        ("strategy: least-squares, generations: 9", "population and generations"),
        ("strategy: genetic+least-squares, starts: 2", None),
    ],
)
def test_warns_of_settings_that_the_strategy_ignores(
    tmp_path: Path, given: str, idle: str | None
) -> None:
    spec = drawn("population: 12", f"population: 12, {given}")
    texts = [found.text for found in preflight(spec, tmp_path / "store")]
    said = [text for text in texts if "does not use" in text]
    assert len(said) == (idle is not None)
    assert idle is None or f"does not use {idle}." in said[0]


def test_a_strategy_uses_only_the_settings_it_lists(tmp_path: Path, monkeypatch) -> None:
    given = GENETIC.make, GENETIC.most_evaluations, GENETIC.most_generations
    plain = Strategy("plain", *given)
    monkeypatch.setattr("palpate.service.study.preflight.strategy_named", lambda name: plain)
    spec = drawn("population: 12", "population: 12, elite: 2")
    (said,) = [f.text for f in preflight(spec, tmp_path / "store") if "does not use" in f.text]
    assert "does not use population and elite. It uses stop." in said


def test_rejects_too_many_least_squares_evaluations(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"search: 600,000,000 evaluations.*Lower starts and fit"):
        preflight(
            drawn("population: 12", "strategy: least-squares, fit_evaluations: 200000000"),
            tmp_path / "store",
        )

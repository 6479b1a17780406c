"""Plausibility checks of the position, the size and the loads of a breast."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from palpate.service.cli import app
from palpate.service.export import TISSUE_NAMES, export_volume
from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.mesh.mesh_hierarchy import mesh_whole_body
from palpate.workers.organs.breast.breast_organ import ORGAN
from palpate.workers.organs.breast.scan_facts import Scan, enclosed_air
from palpate.workers.organs.breast.scan_pair_checks import likeness
from palpate.workers.organs.breast.scan_plausibility import check_bodies
from tests.cases.breast.breast_cases import (
    at_rest,
    findings,
    flipped,
    pressed,
    scaled,
    shifted,
    texts,
    turned,
    usual_pair,
)

Change = Callable[[Volume], Volume]

ORDINARY: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "60 N": ({}, {"force_n": 60}),
    "another phantom": ({"seed": 2}, {"force_n": 60}),
    "20 N": ({}, {"force_n": 20}),
    "120 N": ({"seed": 3}, {"force_n": 120}),
    "oblique": ({"seed": 2}, {"force_n": 60, "oblique_deg": 45}),
    "oblique the other way": ({"seed": 3}, {"force_n": 100, "oblique_deg": -45}),
    "both plates move": ({}, {"force_n": 60, "moving": "both"}),
    "distance": ({}, {"plate_distance_mm": {"final": 65}}),
    "small distance": ({"seed": 2}, {"plate_distance_mm": {"final": 50}}),
    "250 ml": ({"preset": "250ml"}, {"force_n": 60}),
    "little gland": ({"preset": "250ml", "glandular_fraction": 0.08}, {"force_n": 60}),
    "symmetric": ({"seed": 4, "lower_mm": 85.0, "upper_mm": 85.0}, {"force_n": 60}),
}


@pytest.mark.parametrize(("body", "load"), ORDINARY.values(), ids=ORDINARY)
def test_accepts_ordinary_pairs(body: dict[str, Any], load: dict[str, Any]) -> None:
    rest = at_rest(**body)
    assert [one.text for one in findings(rest, pressed(rest, load), load)] == []


def test_a_soft_breast_may_lose_volume() -> None:
    rest = at_rest()
    soft = {"E_fat_kpa": 5.0, "E_glandular_kpa": 10.0}
    assert findings(rest, pressed(rest, {"force_n": 60}, soft)) == []


def test_accepts_a_real_pair_of_breast_ct() -> None:
    folder = Path(__file__).parents[4] / "shared/data/breast_bct_niftysim"
    if not folder.is_dir():
        pytest.skip("shared/data/breast_bct_niftysim is not here")
    from palpate.workers.body.images.image_formats import read_volume_file
    from palpate.workers.body.images.tissue_labels import crop_to_body

    files = "UncompressedBreast3_resampled.nrrd", "compressedPhantom3.nrrd"
    rest, scan = (_coarser(crop_to_body(read_volume_file(folder / file)), 4) for file in files)
    assert findings(rest, scan, {"plate_distance_mm": {"final": 65.07, "initial": 126.7}}) == []
    for axes in ("x", "y", "z", "xy", "yz"):
        assert "mirror image" in texts(
            findings(rest, flipped(scan, axes), {"plate_distance_mm": {"final": 65.07}})
        )


def _coarser(volume: Volume, step: int) -> Volume:
    x, y, z = (float(step * s) for s in volume.spacing_mm)
    values = np.ascontiguousarray(volume.values[::step, ::step, ::step])
    return replace(volume, values=values, spacing_mm=(x, y, z))


WRONG: dict[str, tuple[Change, str]] = {
    "6 mm along z": (lambda v: shifted(v, 0, 0, 6), "moving it by (-0.2, 0.0, -6.0) mm"),
    "-6 mm along z": (lambda v: shifted(v, 0, 0, -6), "moving it by (-0.2, 0.0, 6.0) mm"),
    "8 mm along x": (lambda v: shifted(v, 8, 0, 0), "moving it by (-8.2, 0.0, 0.0) mm"),
    "4 mm along x": (lambda v: shifted(v, -4, 0, 0), "moving it by (3.8, 0.0, 0.0) mm"),
    "5 mm along y": (lambda v: shifted(v, 0, 5, 0), "moving it by (-0.2, -5.0, 0.0) mm"),
    "3 degrees about x": (lambda v: turned(v, 3, 0, 0), "degrees about x"),
    "3 degrees about y": (lambda v: turned(v, 0, 3, 0), "turned by -3.0 degrees about y"),
    "3 degrees about z": (lambda v: turned(v, 0, 0, 3), "turned by -3.0 degrees about z"),
    "5 % larger": (lambda v: scaled(v, 1.05), "a scale of 1.038 would explain it"),
    "5 % smaller": (lambda v: scaled(v, 0.95), "tissue nearly keeps its volume"),
    "3 % larger": (lambda v: scaled(v, 1.03), "tissue nearly keeps its volume"),
    "3 % smaller": (lambda v: scaled(v, 0.97), "tissue nearly keeps its volume"),
    "mirrored along x": (lambda v: flipped(v, "x"), "mirror image of rest.nrrd along x:"),
    "mirrored along y": (lambda v: flipped(v, "y"), "mirror image of rest.nrrd along y:"),
    "upside down": (lambda v: flipped(v, "z"), "mirror image of rest.nrrd along z:"),
    "turned about z": (lambda v: flipped(v, "xy"), "mirror image of rest.nrrd along x and y:"),
    "turned about x": (lambda v: flipped(v, "yz"), "mirror image of rest.nrrd along y and z:"),
    "a frame of its own": (
        lambda v: replace(v, frame_uid="1.2.4"),
        "different frames of reference (FrameOfReferenceUID 1.2.3 and 1.2.4)",
    ),
    "no place": (
        lambda v: replace(v, place_known=False),
        "pressed.nrrd does not give the body's position",
    ),
}


@pytest.mark.parametrize(("change", "said"), WRONG.values(), ids=WRONG)
def test_target_of_another_position_or_size_is_refused(change: Change, said: str) -> None:
    rest, scan = usual_pair()
    here, there = (replace(v, frame_uid="1.2.3") for v in (rest, scan))
    assert findings(here, there) == []
    assert said in texts(findings(here, change(there)))


def test_gland_on_one_side_only_cannot_hide_a_mirror_image() -> None:
    """The flip that undoes a mirror image fits best."""
    rest, scan = usual_pair()
    axis = (0.0, 1.0, 0.0)
    fits = likeness(Scan("rest", 0.0, axis, rest), Scan("scan", 60.0, axis, flipped(scan, "y")))
    assert max(fits, key=lambda flip: fits[flip]) == (False, True, False)


def test_alignment_undoes_a_rigid_motion() -> None:
    rest, scan = usual_pair()
    away = replace(shifted(turned(scan, 0, 4, -5), 30, -12, 9), frame_uid="other")
    _, motion = ORGAN.aligned(away, replace(rest, frame_uid="one"), _case())
    assert motion["shift_mm"] == pytest.approx([-30, 12, -9], abs=1.5)
    assert motion["turn_deg"] == pytest.approx([0, -4, 5], abs=0.5)
    assert findings(replace(rest, frame_uid="one"), away, align="rigid") == []


def _case() -> Any:
    from tests.cases.breast.breast_cases import case_of

    return case_of({"force_n": 60})


def test_a_shift_that_effects_may_explain_is_only_a_warning() -> None:
    rest, scan = usual_pair()
    found = findings(rest, shifted(scan, 0, 0, 6), constants={"tilt_depth_deg": 2.0})
    assert [one.severity for one in found] == ["warning"]


LOADS: dict[str, tuple[dict[str, Any], str]] = {
    "kN typed for N": ({"force_n": 0.06}, "0.06 N moves the plates by about"),
    "N typed as mN": ({"force_n": 60_000}, "would press a body of 100.0 mm"),
    "distance of a template": (
        {"plate_distance_mm": {"final": 75}},
        "is 75 mm, but the body is 56.0 mm thick between the plates in pressed.nrrd",
    ),
    "too small a distance": (
        {"plate_distance_mm": {"final": 40}},
        "is 40 mm, but the body is 56.0 mm thick between the plates in pressed.nrrd",
    ),
    "distance beyond the body": ({"plate_distance_mm": {"final": 120}}, "they would not touch it"),
    "plates elsewhere": (
        {"plate_distance_mm": {"lower": -40, "upper": 14}},
        "the lower plate ends at -40 mm, but the body in pressed.nrrd ends at -50.0 mm, 10.0 mm",
    ),
    "the other plate stays": (
        {"force_n": 60, "moving": "both"},
        "moving it by (-0.2, 22.0, 0.0) mm",
    ),
}


@pytest.mark.parametrize(("load", "said"), LOADS.values(), ids=LOADS)
def test_load_that_does_not_fit_the_scans_is_refused(load: dict[str, Any], said: str) -> None:
    assert said in texts(findings(*usual_pair(), load))


def gaps(volume: Volume, *slices: int) -> Volume:
    values = volume.values.copy()
    values[list(slices)] = 0
    return replace(volume, values=values)


def test_unlabelled_slices_are_named_with_both_pieces() -> None:
    rest, scan = usual_pair()
    said = texts(findings(gaps(rest, 9, 10, 11), scan))
    assert "3 of the 25 slices along z in rest.nrrd show only air" in said
    assert "10 to 12 (counted from 1)" in said
    assert "has 2 separate pieces, of " in said


@pytest.mark.parametrize("nodes", [1500, 8000])
def test_mesh_without_a_part_of_the_body_is_refused(nodes: int) -> None:
    """With few nodes, the thickness of the largest piece alone would be refused."""
    with pytest.raises(InputError, match="Only the largest connected piece is meshed"):
        mesh_whole_body(gaps(at_rest(), 9, 10, 11), nodes=nodes)


@pytest.mark.parametrize("axes", ["xz", "yz"])
def test_bodies_with_their_chest_wall_at_the_high_end_of_z_are_refused(axes: str) -> None:
    rest, scan = (flipped(volume, axes) for volume in usual_pair())
    found = texts(findings(rest, scan))
    assert "cm2 at the high end of z" in found
    assert "z seems to run from nipple to chest wall" in found


@pytest.mark.parametrize("factor", [1e-3, 0.1, 10.0, 1000.0])
def test_body_in_another_unit_is_refused(factor: float) -> None:
    rest, scan = (scaled(volume, factor) for volume in usual_pair())
    said = texts(findings(rest, scan))
    assert said.count("a breast has 10 to 5000 ml") == 2


# --- interfaces ---------------------------------------------------------------------

STUDY = """
name: pair
case:
  reference: {volume: rest.nrrd}
  mesh: {nodes: 1200}
  load: {force_n: 60}
target: {volume: pressed.nrrd}
search:
  strategy: least-squares
  parameters: {E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]}
  fit_evaluations: 2
  starts: 1
"""
DIAGNOSIS = """
name: pair
wall: {z_mm: 0, wall_hold_x_kpa_per_mm: 0.05, wall_hold_y_kpa_per_mm: 0.05}
model: {law: neo-hookean}
constants: {E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]}
noise: {sd_mm: 0.5, correlation_mm: 4}
scans: {reference: rest.nrrd, loads: [{volume: pressed.nrrd, force_n: 60}]}
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name, volume in zip(("rest", "pressed"), usual_pair(), strict=True):
        write(tmp_path / f"{name}.nrrd", volume)
    (tmp_path / "study.yaml").write_text(STUDY)
    (tmp_path / "case.yaml").write_text(DIAGNOSIS)
    return tmp_path


def write(path: Path, volume: Volume) -> None:
    """Write fat and gland only."""
    path.unlink(missing_ok=True)
    values = np.where(volume.values == 2, 2, np.minimum(volume.values, 1)).astype(np.uint8)
    export_volume(path, replace(volume, values=values), TISSUE_NAMES)


def palpate(*words: str) -> Any:
    return CliRunner().invoke(app, list(words))


def said(result: Any) -> str:
    return f"{result.output} {result.exception or ''}"


@pytest.mark.parametrize("command", [("run", "study.yaml"), ("diagnose", "case.yaml")])
@pytest.mark.parametrize("axes", ["x", "z"])
def test_run_and_diagnose_refuse_a_mirror_image(
    here: Path, command: tuple[str, str], axes: str
) -> None:
    write(here / "pressed.nrrd", flipped(usual_pair()[1], axes))
    result = palpate(*command)
    assert result.exit_code != 0
    assert f"mirror image of rest.nrrd along {axes}:" in said(result)
    assert "continue with --anyway" in said(result)


@pytest.mark.parametrize(
    "command",
    [
        ("run", "study.yaml"),
        ("diagnose", "case.yaml"),
        ("plan", "case.yaml"),
        ("mesh", "study.yaml"),
        ("simulate", "study.yaml"),
        ("import", "rest.nrrd", "--name", "rest"),
    ],
)
def test_every_command_refuses_a_body_in_metres(here: Path, command: tuple[str, ...]) -> None:
    for name, volume in zip(("rest", "pressed"), usual_pair(), strict=True):
        write(here / f"{name}.nrrd", scaled(volume, 1e-3))
    result = palpate(*command)
    assert result.exit_code != 0
    assert "a breast has 10 to 5000 ml" in said(result)
    assert not list(here.glob("runs/*/journal*"))


def with_voxels(volume: Volume, label: int, width: int) -> Volume:
    """Return a volume with a cube of a label inside the body, above voxel (20, 20, 10)."""
    values = volume.values.copy()
    values[10 : 10 + width, 20 : 20 + width, 20 : 20 + width] = label
    return replace(volume, values=values)


@pytest.mark.parametrize(
    ("width", "severity"), [(1, "warning"), (4, "warning"), (12, "implausible")]
)
def test_enclosed_air_is_named_with_volume_and_place(width: int, severity: str) -> None:
    rest, scan = usual_pair()
    hollow = with_voxels(rest, 0, width)
    said = texts(findings(hollow, scan), severity)
    step, voxel_ml = np.asarray(rest.spacing_mm), rest.voxel_mm3 / 1000
    first = np.asarray(rest.origin_mm) + step * [20, 20, 10]
    last = first + step * (width - 1)
    box = ", ".join(
        f"{axis} {low:.4g}" + (f" to {high:.4g}" if width > 1 else "")
        for axis, low, high in zip("xyz", first + 0.0, last + 0.0, strict=True)
    )
    air = int(np.count_nonzero(rest.values) - np.count_nonzero(hollow.values))
    assert f"rest.nrrd encloses {air * voxel_ml:.3g} ml of air (" in said
    assert f"of it) at {box} mm" in said
    assert "encloses" not in texts(findings(rest, scan), "warning")


def test_a_compared_tissue_of_one_voxel_is_refused() -> None:
    rest, scan = usual_pair()
    gland = rest.values == Tissue.GLANDULAR
    fatty = replace(rest, values=np.where(gland, np.uint8(Tissue.FAT), rest.values))
    said = texts(findings(with_voxels(fatty, Tissue.GLANDULAR, 1), scan))
    assert "Only 1 voxel in rest.nrrd is glandular, at x " in said
    assert "Segment all of it, or if it is a slip" in said


def test_a_diagnosis_names_the_air_that_it_fills(here: Path) -> None:
    from palpate.workers.organs.breast.scanned_case_files import read_case
    from palpate.workers.organs.breast.scanned_case_source import facts_of

    write(here / "pressed.nrrd", with_voxels(usual_pair()[1], 0, 2))
    facts = facts_of(read_case(here / "case.yaml"))
    assert all(enclosed_air(scan.labels) is None for scan in facts.scans)
    said = texts(list(check_bodies(facts)), "warning")
    assert "pressed.nrrd encloses 0.064 ml of air (" in said
    assert "rest.nrrd" not in said


def test_import_warns_of_pieces_and_continues(here: Path) -> None:
    write(here / "rest.nrrd", gaps(usual_pair()[0], 9, 10, 11))
    result = palpate("import", "rest.nrrd", "--name", "rest")
    assert result.exit_code == 0, said(result)
    assert "has 2 separate pieces" in result.output


def test_plates_that_start_off_the_body_are_named(here: Path) -> None:
    text = DIAGNOSIS + "plates: {lower_mm: -62.5, upper_mm: 62.5}\n"
    (here / "case.yaml").write_text(text)
    result = palpate("diagnose", "case.yaml")
    assert "the lower plate starts 12.5 mm off the body (-62.5 mm" in said(result)
    assert "the upper plate starts 12.5 mm off the body (62.5 mm" in said(result)


def test_omitted_plates_start_at_the_body(here: Path) -> None:
    from palpate.workers.organs.breast.scanned_case_files import read_case

    case = read_case(here / "case.yaml")
    assert case.plate_starts_mm(case.loads[0]) == pytest.approx((-50.0, 50.0))


def test_case_is_aligned_if_its_file_requests_it(here: Path) -> None:
    from palpate.workers.organs.breast.scanned_case_files import read_case

    write(here / "pressed.nrrd", shifted(usual_pair()[1], 9, -7, 20))
    (here / "case.yaml").write_text(DIAGNOSIS.replace("scans: {", "scans: {align: rigid, "))
    case = read_case(here / "case.yaml")
    assert case.motions == (
        "pressed.nrrd was aligned with rest.nrrd: moved by (-9.2, 7.0, -20.0) mm.",
    )


@pytest.mark.slow
def test_results_with_anyway_start_with_the_reason(here: Path) -> None:
    from palpate.study import Study

    write(here / "pressed.nrrd", shifted(usual_pair()[1], 0, 0, 6))
    refused = palpate("run", "study.yaml", "--workers", "1")
    assert refused.exit_code != 0
    result = palpate("run", "study.yaml", "--workers", "1", "--anyway")
    assert result.exit_code == 0, said(result)
    first = "Computed with --anyway, although a plausibility check failed: pressed.nrrd does not"
    report = palpate("report", "runs/pair").output
    assert report.startswith(first)
    assert first in (here / "runs/pair/report.html").read_text()
    assert Study.open("runs/pair").results.caveats[0].startswith(first)


@pytest.mark.slow
def test_reports_an_aligned_target_first(here: Path) -> None:
    write(here / "pressed.nrrd", shifted(usual_pair()[1], 5, 0, 6))
    (here / "study.yaml").write_text(STUDY.replace("pressed.nrrd", "pressed.nrrd, align: rigid"))
    result = palpate("run", "study.yaml", "--workers", "1")
    assert result.exit_code == 0, said(result)
    report = palpate("report", "runs/pair").output
    assert report.startswith(
        "The target was aligned with the reference: moved by (-5.2, 0.0, -6.0) mm."
    )


@pytest.mark.parametrize(("order", "pressed_along"), [((1, 0, 2), "z"), ((0, 2, 1), "x")])
def test_a_body_pressed_along_another_axis_is_refused(
    order: tuple[int, int, int], pressed_along: str
) -> None:
    """The scans were compressed along y, but the axes of the file were not converted."""
    rest, scan = (with_axes(one, order) for one in usual_pair())
    text = texts(findings(rest, scan))
    assert f"it was pressed along {pressed_along}" in text
    assert "look swapped" not in text


def test_a_scan_under_load_that_shows_the_body_at_rest_is_refused() -> None:
    rest = usual_pair()[0]
    assert "nothing moved under 60 N" in texts(findings(rest, rest))
    assert "nothing moved" not in texts(findings(*usual_pair()))


def with_axes(volume: Volume, order: tuple[int, int, int]) -> Volume:
    """Return a volume with its array axes, ``[z, y, x]``, in another order."""
    (a, b, c) = (volume.origin_mm[::-1][k] for k in order)
    (u, v, w) = (volume.spacing_mm[::-1][k] for k in order)
    values = np.ascontiguousarray(volume.values.transpose(order))
    return replace(volume, values=values, origin_mm=(c, b, a), spacing_mm=(w, v, u))


@pytest.mark.parametrize("factor", [0.01, 0.1, 4.45, 10.0])
def test_a_force_that_contradicts_the_thickness_is_refused(factor: float) -> None:
    text = texts(findings(*usual_pair(), {"force_n": 60 * factor}))
    verb = "cannot press 100.0 mm to 56.0 mm" if factor < 1 else "would press 100.0 mm to about"
    assert f"case.load.force_n: {60 * factor:g} N {verb}" in text
    assert ("at E >= 5 kPa" if factor < 1 else "at E <= 80 kPa") in text


ENDS = (
    {"E_fat_kpa": 5.0, "E_glandular_kpa": 5.0, "eta_fat_kpa": 50.0, "eta_glandular_kpa": 50.0},
    {"E_fat_kpa": 20.0, "E_glandular_kpa": 80.0, "eta_fat_kpa": 200.0, "eta_glandular_kpa": 200.0},
)


@pytest.mark.parametrize("constants", ENDS, ids=["softest", "stiffest"])
@pytest.mark.parametrize("force_n", [10, 120])
def test_a_right_force_passes_at_both_ends_of_the_search(
    constants: dict[str, float], force_n: float
) -> None:
    rest, load = at_rest(), {"force_n": force_n}
    fibres = {name: value for name, value in constants.items() if name.startswith("eta")}
    assert findings(rest, pressed(rest, load, constants), load, constants=fibres) == []


def without_end(volume: Volume, axis: str, mm: float) -> Volume:
    """Cut an image inside its body, at the high end of an axis."""
    number = "zyx".index(axis)
    others = tuple(n for n in range(3) if n != number)
    last = int(np.flatnonzero(volume.values.any(axis=others))[-1])
    kept = last + 1 - round(mm / volume.spacing_mm[2 - number])
    return replace(volume, values=np.take(volume.values, range(kept), axis=number))


def test_a_pair_of_which_one_scan_is_cut_off_is_refused() -> None:
    rest, scan = usual_pair()
    text = texts(findings(without_end(rest, "x", 16), scan))
    assert "rest.nrrd is cut off by the border of its image, with 10.5 cm2" in text
    assert "on its face at high x, but the one in pressed.nrrd is whole there" in text
    assert "pressed.nrrd is cut off" in texts(findings(rest, without_end(scan, "x", 16)))
    assert "rest.nrrd is cut off" in texts(findings(without_end(rest, "z", 8), scan))


def test_a_pair_cut_off_alike_gives_warnings() -> None:
    rest, scan = (without_end(volume, "x", 16) for volume in usual_pair())
    found = findings(rest, scan)
    assert texts(found) == ""
    assert "The body in rest.nrrd reaches the border of its image" in texts(found, "warning")


def test_a_body_that_ends_at_the_border_is_not_cut_off() -> None:
    rest, scan = (without_end(volume, "x", 0) for volume in usual_pair())
    assert findings(rest, scan) == []


@pytest.mark.parametrize(
    ("command", "code", "said_of_it"),
    [
        (("import", "rest.nrrd", "--name", "rest"), 0, "reaches the border of its image"),
        (("run", "study.yaml"), 1, "rest.nrrd is cut off by the border"),
        (("diagnose", "case.yaml"), 1, "rest.nrrd is cut off by the border"),
    ],
)
def test_every_command_names_a_cut(
    here: Path, command: tuple[str, ...], code: int, said_of_it: str
) -> None:
    write(here / "rest.nrrd", without_end(usual_pair()[0], "x", 16))
    result = palpate(*command)
    assert result.exit_code == code
    assert said_of_it in said(result)

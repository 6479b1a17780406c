"""Position and size of images from their headers, and rejection of contradictory headers."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import nibabel as nib
import numpy as np
import pytest
import tifffile

from palpate.service.cli import main
from palpate.service.export import export_volume
from palpate.storage.errors import InputError
from palpate.storage.store import open_store
from palpate.storage.stored_arrays import load_volume, save_volume
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.images.image_formats import read_labels, read_volume_file
from palpate.workers.body.images.tissue_labels import crop_to_body, relabel
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy
from palpate.workers.comparison.warp_volume import warp_labels
from palpate.workers.organs.breast.scan_facts import in_air, in_coarser_voxels, one_body
from palpate.workers.tasks.task_store import TaskStore
from tests.cases.images.image_cases import (
    FRAME,
    LPS,
    breast,
    tissues,
    write_nifti,
    write_nrrd,
    write_segmentation,
    write_series,
)

LABELS = ("--labels", "0=air,1=fat,2=glandular,3=skin,5=ligament")
TWO = np.diag([2.0, 2.0, 2.0, 1.0])
PLACED = TWO.copy()
PLACED[:3, 3] = [50.0, -10.0, 20.0]


def affine(*steps: float, at: tuple[float, float, float] = (50.0, -10.0, 20.0)) -> Any:
    matrix = np.diag([*steps, 1.0])
    matrix[:3, 3] = at
    return matrix


class TestNrrd:
    def test_directions_place_the_image(self, tmp_path: Path) -> None:
        volume = read_volume_file(write_nrrd(tmp_path / "a.nrrd", breast()))
        assert volume.origin_mm == (-50.0, 10.0, 20.0)
        assert volume.place_known

    @pytest.mark.parametrize(
        "origin",
        [
            {"space": "left-posterior-superior", "space origin": np.array([-50.0, 10.0, 20.0])},
            {"axis mins": np.array([-50.0, 10.0, 20.0])},
        ],
    )
    def test_refuses_an_origin_with_spacings_alone(self, tmp_path: Path, origin: Any) -> None:
        header = {"spacings": np.array([2.0, 2.0, 2.0])} | origin
        path = write_nrrd(tmp_path / "a.nrrd", breast(), header)
        with pytest.raises(InputError, match=r"but no space directions.*Save it with space"):
            read_volume_file(path)

    def test_refuses_spacings_that_contradict_directions(self, tmp_path: Path) -> None:
        path = write_nrrd(tmp_path / "a.nrrd", breast(), spacings=np.array([2.0, 2.0, 1.0]))
        with pytest.raises(
            InputError,
            match=r"2 x 2 x 2 according to its space directions, but 2 x 2 x 1 according",
        ):
            read_volume_file(path)

    def test_spacings_alone_leave_the_place_unknown(self, tmp_path: Path) -> None:
        header = {"spacings": np.array([2.0, 2.0, 2.0])}
        assert not read_volume_file(write_nrrd(tmp_path / "a.nrrd", breast(), header)).place_known

    def test_no_origin_leaves_the_place_unknown(self, tmp_path: Path) -> None:
        header = {key: value for key, value in LPS.items() if key != "space origin"}
        assert not read_volume_file(write_nrrd(tmp_path / "a.nrrd", breast(), header)).place_known

    def test_metres_are_converted(self, tmp_path: Path) -> None:
        header = LPS | {
            "space directions": np.diag([0.002] * 3),
            "space origin": np.array([-0.05, 0.01, 0.02]),
            "space units": ["m", "m", "m"],
        }
        volume = read_volume_file(write_nrrd(tmp_path / "a.nrrd", breast(), header))
        assert volume.spacing_mm == pytest.approx((2.0, 2.0, 2.0))
        assert volume.origin_mm == pytest.approx((-50.0, 10.0, 20.0))

    def test_exports_keep_frame_and_unknown_place(self, tmp_path: Path) -> None:
        volume = Volume(tissues(), (2.0, 2.0, 2.0), (1.0, 2.0, 3.0), FRAME, place_known=False)
        export_volume(tmp_path / "a.nrrd", volume)
        again = read_volume_file(tmp_path / "a.nrrd")
        assert (again.frame_uid, again.place_known) == (FRAME, False)
        assert again.origin_mm == volume.origin_mm


class TestNifti:
    def test_without_forms_the_place_is_unknown(self, tmp_path: Path) -> None:
        volume = read_volume_file(write_nifti(tmp_path / "a.nii", breast()))
        assert not volume.place_known

    @pytest.mark.parametrize("form", ["sform", "qform"])
    def test_one_form_is_enough(self, tmp_path: Path, form: str) -> None:
        image = nib.Nifti1Image(breast().transpose(), PLACED)
        if form == "qform":
            image = nib.Nifti1Image(breast().transpose(), None)
            image.set_qform(PLACED, code=1)
        else:
            image.set_qform(None, code=0)
        nib.save(image, tmp_path / "a.nii")
        volume = read_volume_file(tmp_path / "a.nii")
        assert volume.place_known
        assert volume.spacing_mm == (2.0, 2.0, 2.0)

    @pytest.mark.parametrize(
        ("sform", "said"),
        [
            (
                affine(1.0, 1.0, 1.0),
                r"1 x 1 x 1 mm according to its sform, but 2 x 2 x 2 mm according to its qform",
            ),
            (affine(2.4, 2.2, 2.6), r"2\.4 x 2\.2 x 2\.6 mm according to its sform"),
            (affine(2.0, 2.0, 2.01), r"2 x 2 x 2\.01 mm according to its sform"),
            (
                affine(-2.0, 2.0, 2.0),
                "L A S according to its sform, but towards R A S according to its qform",
            ),
            (
                affine(-2.0, -2.0, 2.0),
                "L P S according to its sform, but towards R A S according to its qform",
            ),
        ],
    )
    @pytest.mark.parametrize("code", [1, 4])
    def test_refuses_forms_that_contradict(
        self, tmp_path: Path, sform: Any, said: str, code: int
    ) -> None:
        path = write_nifti(tmp_path / "a.nii", breast(), sform=sform, qform=PLACED, codes=(code, 1))
        with pytest.raises(InputError, match=said):
            read_volume_file(path)

    def test_refuses_pixdim_that_contradicts_a_lone_sform(self, tmp_path: Path) -> None:
        path = write_nifti(
            tmp_path / "a.nii", breast(), sform=affine(1.0, 1.0, 1.0), qform=PLACED, codes=(1, 0)
        )
        with pytest.raises(
            InputError, match=r"according to its sform, but 2 x 2 x 2 mm according to its pixdim"
        ):
            read_volume_file(path)

    def test_forms_of_one_space_place_voxels_alike(self, tmp_path: Path) -> None:
        moved = affine(2.0, 2.0, 2.0, at=(42.0, -10.0, 20.0))
        same = write_nifti(tmp_path / "a.nii", breast(), sform=moved, qform=PLACED)
        with pytest.raises(InputError, match="place voxels up to 8 mm apart"):
            read_volume_file(same)
        other = write_nifti(
            tmp_path / "b.nii", breast(), sform=moved, qform=PLACED, codes=(2, 1)
        )  # aligned to another scan, which is what the sform is for
        assert read_volume_file(other).origin_mm[0] == pytest.approx(-42.0 - 2.0 * 13)

    def test_refuses_an_unknown_unit(self, tmp_path: Path) -> None:
        path = write_nifti(tmp_path / "a.nii", breast(), sform=PLACED, qform=PLACED)
        raw = bytearray(path.read_bytes())
        raw[123] = 5  # xyzt_units (nifti1.h)
        path.write_bytes(raw)
        with pytest.raises(InputError, match="code 5 for its unit of length"):
            read_volume_file(path)


class TestDicom:
    def test_frame_of_reference_is_kept(self, tmp_path: Path) -> None:
        volume = read_volume_file(write_series(tmp_path / "s", breast(), FrameOfReferenceUID=FRAME))
        assert (volume.frame_uid, volume.place_known) == (FRAME, True)
        path = write_segmentation(tmp_path / "a.dcm", breast(), {})
        assert read_volume_file(path).frame_uid == FRAME

    def test_refuses_two_frames_in_one_folder(self, tmp_path: Path) -> None:
        def frame(z: int) -> str:
            return FRAME if z < 6 else f"{FRAME}.2"

        path = write_series(tmp_path / "s", breast(), FrameOfReferenceUID=frame)
        with pytest.raises(InputError, match=r"2 frames of reference .*6 slices.*4 slices"):
            read_volume_file(path)

    @pytest.mark.parametrize("stated", [1.0, 1.9, 4.0])
    def test_refuses_a_distance_that_contradicts_positions(
        self, tmp_path: Path, stated: float
    ) -> None:
        tag = {"SpacingBetweenSlices": stated}
        said = (
            rf"2 mm apart according to their positions, expected {stated:g} mm "
            r"according to its SpacingBetweenSlices"
        )
        with pytest.raises(InputError, match=said):
            read_volume_file(write_series(tmp_path / "s", breast(), **tag))
        with pytest.raises(InputError, match=said):
            read_volume_file(write_segmentation(tmp_path / "a.dcm", breast(), {}, tag))

    @pytest.mark.parametrize("thickness", [5.0, 3.0, 2.5, 2.05, 1.0])
    @pytest.mark.parametrize("gap", [{}, {"SpacingBetweenSlices": 2.0}])
    def test_positions_decide_and_another_thickness_is_a_remark(
        self, tmp_path: Path, thickness: float, gap: dict[str, float]
    ) -> None:
        tags = {"SliceThickness": thickness, **gap}
        way = "overlap" if thickness > 2 else "leave gaps"
        said = (
            "Slices are 2 mm apart according to their positions, which is the spacing used, and "
            f"{thickness:g} mm thick (SliceThickness), so they {way}.",
        )
        for path in (
            write_series(tmp_path / "s", breast(), **tags),
            write_segmentation(tmp_path / "a.dcm", breast(), {}, tags),
        ):
            image = read_labels(path)
            assert image.volume.spacing_mm == (2.0, 2.0, 2.0)
            assert image.remarks == said

    def test_equal_thickness_is_no_remark(self, tmp_path: Path) -> None:
        path = write_series(tmp_path / "s", breast(), SliceThickness=2.01)
        assert read_labels(path).remarks == ()


class TestSlices:
    @pytest.mark.parametrize(
        "name",
        [
            lambda z: f"z_{0.25 * (z - 4)}mm.tif",
            lambda z: f"pos_{3 * z - 12}.tif",
            lambda z: f"pos_{z - 20}.tif",
            lambda z: f"pos{z - 4}.tif",
            lambda z: f"slice-{z + 1}.tif",
            lambda z: f"scan 2024-05-01_{z + 7}.tif",
            lambda z: f"{z}_z{0.273 * z:.2f}.tif",
        ],
    )
    def test_numbers_in_file_names_give_the_slice_order(
        self, tmp_path: Path, name: Callable[[int], str]
    ) -> None:
        for z, page in enumerate(breast()):
            tifffile.imwrite(tmp_path / name(z), page)
        volume = read_volume_file(tmp_path, spacing_mm=(2.0, 2.0, 2.0))
        np.testing.assert_array_equal(volume.values, breast())
        assert not volume.place_known

    @pytest.mark.parametrize(
        ("names", "said"),
        [
            ([f"slice{z}.tif" for z in range(25) if z != 12], r"number 12 \(between slice11"),
            ([f"z{z * 0.5}.tif" for z in range(9) if z not in (3, 4)], r"number 1\.5, 2 \("),
            (["s1.tif", "s2.tif", "s02.tif"], "two slices numbered 2: s02.tif and s2.tif"),
            (["s1.tif", "s2.tif", "s3.5.tif", "s4.tif"], r"differ by 1\.5 between"),
            (["t1z1.tif", "t1z2.tif", "t2z1.tif", "t2z2.tif"], "two slices numbered"),
            (["s1.tif", "s2.tif", "mask3.tif"], "differ in more than a number"),
            (["a1_z3.tif", "a2_z2.tif", "a3_z1.tif"], "give different orders"),
        ],
    )
    def test_refuses_irregular_slices(self, tmp_path: Path, names: list[str], said: str) -> None:
        for name in names:
            tifffile.imwrite(tmp_path / name, breast()[4])
        with pytest.raises(InputError, match=said):
            read_volume_file(tmp_path, spacing_mm=(2.0, 2.0, 2.0))

    def test_spacing_of_imagej_and_ome_files_is_read(self, tmp_path: Path) -> None:
        tifffile.imwrite(
            tmp_path / "a.tif",
            breast(),
            imagej=True,
            resolution=(1 / 500, 1 / 500),
            metadata={"spacing": 2000.0, "unit": "micron", "axes": "ZYX"},
        )
        sizes = {f"PhysicalSize{axis}": 2.0 for axis in "XYZ"}
        units = {f"PhysicalSize{axis}Unit": "mm" for axis in "XYZ"}
        meta = {"axes": "ZYX"} | sizes | units
        tifffile.imwrite(tmp_path / "b.ome.tif", breast(), metadata=meta)
        assert read_volume_file(tmp_path / "a.tif").spacing_mm == pytest.approx((0.5, 0.5, 2.0))
        assert read_volume_file(tmp_path / "b.ome.tif").spacing_mm == (2.0, 2.0, 2.0)
        with pytest.raises(InputError, match=r"0\.5 0\.5 2 mm, but --spacing-mm"):
            read_volume_file(tmp_path / "a.tif", spacing_mm=(2.0, 2.0, 2.0))


class TestDerivedVolumes:
    def test_derived_volumes_keep_frame_and_unknown_place(self) -> None:
        body = Volume(tissues(), (2.0, 2.0, 2.0), (1.0, 2.0, 3.0), FRAME, place_known=False)
        mesh = build_hierarchy(body, element_size_mm=4.0, nodes=None).finest.mesh
        derived = {
            "cropped": crop_to_body(body),
            "named": relabel(body, {int(t): t for t in Tissue if t != Tissue.MUSCLE}),
            "coarser": in_coarser_voxels(body, 4.0),
            "one piece": one_body(body),
            "in air": in_air(body),
            "deformed": warp_labels(body, mesh, np.zeros_like(mesh.nodes)),
        }
        for name, volume in derived.items():
            assert (volume.frame_uid, volume.place_known) == (FRAME, False), name

    def test_digests_include_the_frame_except_for_ordinary_volumes(self, tmp_path: Path) -> None:
        store = TaskStore(tmp_path / "store")
        ordinary = Volume(tissues(), (2.0, 2.0, 2.0))
        names = {
            store.add_volume(volume)
            for volume in (
                ordinary,
                Volume(tissues(), (2.0, 2.0, 2.0), frame_uid=FRAME),
                Volume(tissues(), (2.0, 2.0, 2.0), place_known=False),
            )
        }
        assert len(names) == 3
        assert ordinary.frame_facts == []

    def test_store_keeps_frame_and_unknown_place(self, tmp_path: Path) -> None:
        store = open_store(tmp_path / "store")
        volume = Volume(tissues(), (2.0, 2.0, 2.0), frame_uid=FRAME, place_known=False)
        save_volume(store, "0" * 16, volume)
        loaded = load_volume(store, "0" * 16)
        assert (loaded.frame_uid, loaded.place_known) == (FRAME, False)


class TestAnatomicalAxes:
    @pytest.mark.parametrize("axes", ["L S A", "l,s,a", "LSA"])
    def test_letters_name_the_directions_of_x_y_and_z(self, tmp_path: Path, axes: str) -> None:
        path = write_nrrd(tmp_path / "a.nrrd", breast())
        by_letters, by_axes = (
            read_volume_file(path, axes=axes),
            read_volume_file(path, axes="x,z,-y"),
        )
        np.testing.assert_array_equal(by_letters.values, by_axes.values)
        assert by_letters.origin_mm == by_axes.origin_mm

    def test_refuses_axis_letters_that_mirror_the_image(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"R S A would mirror.*for example L S A"):
            read_volume_file(write_nrrd(tmp_path / "a.nrrd", breast()), axes="R S A")

    def test_refuses_axis_letters_for_a_file_without_orientation(self, tmp_path: Path) -> None:
        np.save(tmp_path / "a.npy", breast())
        with pytest.raises(InputError, match=r"anatomical, but .*a\.npy does not define"):
            read_volume_file(tmp_path / "a.npy", spacing_mm=(2.0, 2.0, 2.0), axes="L S A")


class TestImport:
    @pytest.fixture(autouse=True)
    def _in_a_folder(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)

    def test_prints_an_unknown_place_and_the_slices_read(
        self, capsys: pytest.CaptureFixture[str]
    ) -> None:
        Path("stack").mkdir()
        for z, page in enumerate(tissues()):
            tifffile.imwrite(f"stack/z_{0.5 * z}.tif", page)
        options = ["--name", "a", "--spacing-mm", "2", "2", "2", "--anyway", *LABELS]
        assert main(["import", "stack", *options]) == 0
        out = capsys.readouterr().out
        assert "from z_0.0.tif to z_4.5.tif" in out
        assert "unknown: the file does not give the position of its voxels" in out
        assert "towards" not in out

    def test_prints_the_frame_and_the_directions(self, capsys: pytest.CaptureFixture[str]) -> None:
        write_series(Path("s"), tissues(), FrameOfReferenceUID=FRAME, SliceThickness=5)
        options = ["--name", "a", "--axes", "L S A", "--picture", "a.png", "--anyway", *LABELS]
        assert main(["import", "s", *options]) == 0
        out, err = capsys.readouterr()
        assert "Remark: Slices are 2 mm apart according to their positions" in err
        assert f"frame of reference {FRAME}" in out
        assert "towards anterior: chest wall to nipple" in out
        # y is superior: the plane across it is transverse, the one across x sagittal.
        titles = next(line for line in out.splitlines() if line.startswith("coronal, z "))
        assert titles.index("sagittal, x ") < titles.index("transverse, y ")
        assert "of the image" not in out  # whose own y may increase to anterior
        assert Path("a.png").read_bytes().startswith(b"\x89PNG")

    def test_replaces_a_name_only_when_asked(self, capsys: pytest.CaptureFixture[str]) -> None:
        np.save("first.npy", tissues())
        np.save("second.npy", tissues()[:, :, ::-1])
        options = ["--name", "a", "--spacing-mm", "2", "2", "2", "--anyway", *LABELS]
        assert main(["import", "first.npy", *options]) == 0
        assert main(["import", "second.npy", *options]) == 2
        assert "another volume named a, read from first.npy" in capsys.readouterr().err
        from palpate.storage.stored_arrays import find_volume

        store = open_store(Path("runs/store"))
        for file in ("second.npy", "first.npy"):  # and back again
            assert main(["import", file, *options, "--replace"]) == 0
            assert main(["import", file, *options]) == 0  # the name means this image now
            found = find_volume(store, "a")
            assert found is not None
            expected = crop_to_body(read_volume_file(Path(file), spacing_mm=(2.0, 2.0, 2.0)))
            np.testing.assert_array_equal(load_volume(store, found).values, expected.values)

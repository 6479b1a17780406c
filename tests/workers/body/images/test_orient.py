"""A voxel keeps the position that its file gives it, whatever the file's orientation."""

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nibabel as nib
import nrrd
import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import Volume
from palpate.workers.body.images.image_formats import read_volume_file
from palpate.workers.body.images.scan_orientation import Scan, parse_axes, to_volume

Array = NDArray[np.float64]
SPACING = np.array([0.5, 1.25, 2.0])
ORIGIN = np.array([-7.0, 11.0, 30.5])
RAS = np.diag([-1.0, -1.0, 1.0])


def signed_permutations() -> Iterator[Array]:
    """Return all 48 ways to align three index axes with three world axes."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[order, range(3)] = signs
            yield turn


def places(volume: Volume) -> Array:
    """Row n: world (x, y, z) of the voxel labelled n, from spacing and origin alone."""
    computed = np.full((volume.values.size, 3), np.nan)
    for (z, y, x), label in np.ndenumerate(volume.values):
        computed[label] = np.array(volume.origin_mm) + np.array([x, y, z]) * volume.spacing_mm
    return computed


def stated_places(values: NDArray[Any], steps: Array, origin: Array) -> Array:
    """Return the same positions by the common definition: origin + steps @ (i, j, k)."""
    computed = np.full((values.size, 3), np.nan)
    for index, label in np.ndenumerate(values):
        computed[label] = origin + steps @ np.array(index, dtype=float)
    return computed


def rotation(degrees: float, axis: int) -> Array:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.eye(3)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turn[a, a] = turn[b, b] = c
    turn[a, b], turn[b, a] = -s, s
    return turn


class TestWorldCoordinatesSurvive:
    def test_nifti_voxels_keep_their_positions(
        self, tmp_path: Path, numbered: NDArray[np.uint16]
    ) -> None:
        for turn in signed_permutations():
            affine = np.eye(4)
            affine[:3, :3], affine[:3, 3] = turn * SPACING, ORIGIN
            nib.save(nib.Nifti1Image(numbered, affine), tmp_path / "a.nii")
            volume = read_volume_file(tmp_path / "a.nii")
            expected = stated_places(numbered, RAS @ (turn * SPACING), RAS @ ORIGIN)
            np.testing.assert_allclose(places(volume), expected, atol=1e-6)
            assert volume.values.flags.c_contiguous
            assert volume.values.dtype == np.uint16

    def test_nifti_voxels_keep_the_positions_of_a_qform(
        self, tmp_path: Path, numbered: NDArray[np.uint16]
    ) -> None:
        for turn in signed_permutations():
            affine = np.eye(4)
            affine[:3, :3], affine[:3, 3] = turn * SPACING, ORIGIN
            image = nib.Nifti2Image(numbered, None)
            image.set_qform(affine, code=1)
            nib.save(image, tmp_path / "a.nii.gz")
            expected = stated_places(numbered, RAS @ (turn * SPACING), RAS @ ORIGIN)
            centres = places(read_volume_file(tmp_path / "a.nii.gz"))
            np.testing.assert_allclose(centres, expected, atol=1e-5)

    @pytest.mark.parametrize(
        ("space", "to_lps"),
        [
            ("left-posterior-superior", np.eye(3)),
            ("right-anterior-superior", RAS),
            ("RAS", RAS),
            ("left-anterior-superior", np.diag([1.0, -1.0, 1.0])),
            ("scanner-xyz", np.eye(3)),
        ],
    )
    def test_nrrd_voxels_keep_their_positions(
        self, tmp_path: Path, numbered: NDArray[np.uint16], space: str, to_lps: Array
    ) -> None:
        for turn in signed_permutations():
            steps = turn * SPACING
            header = {"space": space, "space directions": steps.T, "space origin": ORIGIN}
            nrrd.write(str(tmp_path / "a.nrrd"), numbered, header)
            centres = places(read_volume_file(tmp_path / "a.nrrd"))
            expected = stated_places(numbered, to_lps @ steps, to_lps @ ORIGIN)
            np.testing.assert_allclose(centres, expected, atol=1e-12)

    def test_dicom_voxels_keep_their_positions(
        self, tmp_path: Path, numbered: NDArray[np.uint16], write_series: Any
    ) -> None:
        # The normal is row x column, so only the 24 right-handed ways are distinguishable.
        for number, turn in enumerate(t for t in signed_permutations() if np.linalg.det(t) > 0):
            steps = turn * SPACING
            write_series(
                tmp_path / str(number),
                numbered.transpose(2, 1, 0),  # slice k, row j, column i
                orientation=(*turn[:, 0], *turn[:, 1]),
                pixel_spacing=(SPACING[1], SPACING[0]),
                step=tuple(steps[:, 2]),
                origin=tuple(ORIGIN),
            )
            centres = places(read_volume_file(tmp_path / str(number)))
            np.testing.assert_allclose(centres, stated_places(numbered, steps, ORIGIN), atol=1e-6)

    def test_values_are_indexed_z_y_x(self, tmp_path: Path, numbered: NDArray[np.uint16]) -> None:
        header = {"space": "LPS", "space directions": np.diag(SPACING), "space origin": ORIGIN}
        nrrd.write(str(tmp_path / "a.nrrd"), numbered, header)
        volume = read_volume_file(tmp_path / "a.nrrd")
        assert volume.shape_xyz == (4, 5, 6)
        assert volume.values[5, 4, 3] == numbered[3, 4, 5]
        assert volume.spacing_mm == (0.5, 1.25, 2.0)
        assert volume.origin_mm == (-7.0, 11.0, 30.5)


class TestAxes:
    def test_axes_rotate_the_frame(self, tmp_path: Path, numbered: NDArray[np.uint16]) -> None:
        header = {"space": "LPS", "space directions": np.diag(SPACING), "space origin": ORIGIN}
        nrrd.write(str(tmp_path / "a.nrrd"), numbered, header)
        volume = read_volume_file(tmp_path / "a.nrrd", axes="-z,y,x")
        world = stated_places(numbered, np.diag(SPACING), ORIGIN)
        house = np.column_stack([-world[:, 2], world[:, 1], world[:, 0]])
        np.testing.assert_allclose(places(volume), house, atol=1e-12)
        assert volume.shape_xyz == (6, 5, 4)
        assert volume.spacing_mm == (2.0, 1.25, 0.5)

    def test_given_spacing_refers_to_the_file(self, tmp_path: Path) -> None:
        np.save(tmp_path / "a.npy", np.zeros((6, 5, 4), np.uint8))
        volume = read_volume_file(tmp_path / "a.npy", spacing_mm=(1.0, 2.0, 3.0), axes="y,z,x")
        assert volume.spacing_mm == (2.0, 3.0, 1.0)
        assert volume.shape_xyz == (5, 6, 4)

    def test_exactly_half_of_all_permutations_are_rotations(self) -> None:
        accepted = 0
        for order in itertools.permutations("xyz"):
            for signs in itertools.product(("", "-"), repeat=3):
                text = ",".join(s + o for s, o in zip(signs, order, strict=True))
                try:
                    turn = parse_axes(text)
                except InputError as error:
                    assert "mirror" in str(error)
                    hints = re.findall(r"for example (-?[xyz],-?[xyz],-?[xyz])", str(error))
                    assert len(hints) == 2
                    for hint in hints:
                        assert np.linalg.det(parse_axes(hint)) == pytest.approx(1)
                else:
                    accepted += 1
                    assert np.linalg.det(turn) == pytest.approx(1)
        assert accepted == 24

    @pytest.mark.parametrize("axes", ["x,y", "x,y,y", "x,y,w", "--x,y,z", "xyz", "", "x,y,z,z"])
    def test_refuses_invalid_axes(self, axes: str) -> None:
        with pytest.raises(InputError, match="x, y and z once each"):
            parse_axes(axes)

    def test_axes_are_checked_before_the_file_is_read(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="mirror"):
            read_volume_file(tmp_path / "missing.nrrd", axes="-x,y,z")


class TestOblique:
    def test_oblique_image_is_refused_with_its_angles(
        self, tmp_path: Path, numbered: NDArray[np.uint16]
    ) -> None:
        steps = rotation(10.0, axis=2) * SPACING
        header = {"space": "LPS", "space directions": steps.T, "space origin": ORIGIN}
        nrrd.write(str(tmp_path / "a.nrrd"), numbered, header)
        with pytest.raises(InputError, match=r"10\.0, 10\.0, 0\.0 degrees.*Resample"):
            read_volume_file(tmp_path / "a.nrrd")

    def test_refuses_sheared_dicom_series(
        self, tmp_path: Path, numbered: NDArray[np.uint16], write_series: Any
    ) -> None:
        write_series(tmp_path / "gantry", numbered, step=(0.0, 0.5, 1.0))
        with pytest.raises(InputError, match=r"0\.0, 0\.0, 26\.6 degrees"):
            read_volume_file(tmp_path / "gantry")

    def test_slight_tilt_is_rotated_about_the_centre(self, numbered: NDArray[np.uint16]) -> None:
        turn = rotation(0.5, axis=0) @ np.diag([-1.0, 1.0, -1.0])
        scan = Scan.with_steps(numbered, turn * SPACING, ORIGIN)
        volume = to_volume(scan, "tilted")
        middle = ORIGIN + (turn * SPACING) @ ((np.array([4, 5, 6]) - 1) / 2)
        np.testing.assert_allclose(places(volume).mean(axis=0), middle, atol=1e-12)
        tilted = stated_places(numbered, turn * SPACING, ORIGIN)
        # half a diagonal times half a degree
        assert np.abs(places(volume) - tilted).max() < 0.5 * 12 * np.radians(0.5)

    def test_refuses_two_parallel_axes(self, numbered: NDArray[np.uint16]) -> None:
        steps = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        with pytest.raises(InputError, match="in the same direction"):
            to_volume(Scan.with_steps(numbered, steps, ORIGIN), "odd")


class TestSpacing:
    def test_contradictory_spacings_are_both_named(
        self, tmp_path: Path, numbered: NDArray[np.uint16]
    ) -> None:
        header = {"space": "LPS", "space directions": np.diag(SPACING), "space origin": ORIGIN}
        nrrd.write(str(tmp_path / "a.nrrd"), numbered, header)
        with pytest.raises(InputError, match=r"0\.5 1\.25 2 mm.*1 1 1 mm"):
            read_volume_file(tmp_path / "a.nrrd", spacing_mm=(1.0, 1.0, 1.0))

    def test_spacings_are_compared_in_world_order(
        self, tmp_path: Path, numbered: NDArray[np.uint16]
    ) -> None:
        turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        header = {"space": "LPS", "space directions": (turn * SPACING).T, "space origin": ORIGIN}
        nrrd.write(str(tmp_path / "a.nrrd"), numbered, header)
        volume = read_volume_file(tmp_path / "a.nrrd", spacing_mm=(2.0, 0.5, 1.25))
        assert volume.spacing_mm == (2.0, 0.5, 1.25)

    @pytest.mark.parametrize("bad", [(0.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (np.nan, 1.0, 1.0), (1.0,)])
    def test_refuses_invalid_spacing(self, tmp_path: Path, bad: tuple[float, ...]) -> None:
        np.save(tmp_path / "a.npy", np.zeros((3, 3, 3), np.uint8))
        with pytest.raises(InputError, match="three positive numbers"):
            read_volume_file(tmp_path / "a.npy", spacing_mm=bad)  # type: ignore[arg-type]

    @pytest.mark.parametrize("qform", [True, False])
    @pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
    def test_nifti_header_without_usable_spacing_requires_the_option(
        self, tmp_path: Path, numbered: NDArray[np.uint16], bad: float, qform: bool
    ) -> None:
        path = tmp_path / "a.nii"
        image = nib.Nifti1Image(numbered, None)
        image.header["pixdim"][1:4] = SPACING
        if qform:
            image.set_qform(np.diag([*SPACING, 1.0]), code=1)
        nib.save(image, path)
        raw = bytearray(path.read_bytes())
        raw[76 + 8 : 76 + 12] = np.float32(bad).tobytes()  # pixdim[2] (nifti1.h)
        path.write_bytes(raw)
        with pytest.raises(InputError, match=r"0\.5 \? 2 mm.*--spacing-mm"):
            read_volume_file(path)
        volume = read_volume_file(path, spacing_mm=(0.5, 3.0, 2.0))
        assert volume.spacing_mm == (0.5, 3.0, 2.0)
        is_in_ras = volume.values[0, -1, -1] == numbered[0, 0, 0]
        assert is_in_ras == qform  # without a form there is no orientation to convert

    def test_nifti_sform_with_a_zero_column_requires_the_option(
        self, tmp_path: Path, numbered: NDArray[np.uint16]
    ) -> None:
        path = tmp_path / "a.nii"
        nib.save(nib.Nifti1Image(numbered, np.eye(4)), path)
        raw = bytearray(path.read_bytes())
        raw[300:304] = np.float32(0.0).tobytes()  # srow_y[1] (nifti1.h: srow_y at 296)
        path.write_bytes(raw)
        with pytest.raises(InputError, match="--spacing-mm"):
            read_volume_file(path)

    @pytest.mark.parametrize("spacings", [None, "0 1 1", "-1 1 1", "nan 1 1"])
    def test_nrrd_header_without_usable_spacing_requires_the_option(
        self, tmp_path: Path, numbered: NDArray[np.uint16], spacings: str | None
    ) -> None:
        header = {} if spacings is None else {"spacings": np.array(spacings.split(), float)}
        nrrd.write(str(tmp_path / "a.nrrd"), numbered, header)
        with pytest.raises(InputError, match="--spacing-mm"):
            read_volume_file(tmp_path / "a.nrrd")
        volume = read_volume_file(tmp_path / "a.nrrd", spacing_mm=(3.0, 1.0, 1.0))
        assert volume.spacing_mm == (3.0, 1.0, 1.0)

    def test_nrrd_zero_direction_requires_the_option(
        self, tmp_path: Path, numbered: NDArray[np.uint16]
    ) -> None:
        header = {
            "space": "LPS",
            "space directions": np.diag([1.0, 0.0, 1.0]),
            "space origin": ORIGIN,
        }
        nrrd.write(str(tmp_path / "a.nrrd"), numbered, header)
        with pytest.raises(InputError, match="--spacing-mm"):
            read_volume_file(tmp_path / "a.nrrd")
        volume = read_volume_file(tmp_path / "a.nrrd", spacing_mm=(1.0, 2.0, 1.0))
        assert volume.origin_mm == tuple(ORIGIN)

    def test_dicom_without_pixel_spacing_requires_the_option(
        self, tmp_path: Path, numbered: NDArray[np.uint16], write_series: Any
    ) -> None:
        def drop(_: int, image: Any) -> None:
            del image.PixelSpacing

        write_series(tmp_path / "s", numbered, step=(0, 0, 2.5), change=drop)
        with pytest.raises(InputError, match=r"\? \? 2\.5 mm.*--spacing-mm"):
            read_volume_file(tmp_path / "s")
        volume = read_volume_file(tmp_path / "s", spacing_mm=(0.3, 0.4, 2.5))
        assert volume.spacing_mm == pytest.approx((0.3, 0.4, 2.5))
        with pytest.raises(InputError, match=r"\? \? 2\.5 mm, but"):
            read_volume_file(tmp_path / "s", spacing_mm=(0.3, 0.4, 2.0))

    @pytest.mark.parametrize(("unit", "mm"), [("mm", 1.0), ("micron", 1e-3), ("meter", 1e3)])
    def test_converts_nifti_units(
        self, tmp_path: Path, numbered: NDArray[np.uint16], unit: str, mm: float
    ) -> None:
        affine = np.diag([*(SPACING / mm), 1.0])
        affine[:3, 3] = ORIGIN / mm
        image = nib.Nifti1Image(numbered, affine)
        image.header.set_xyzt_units(unit)
        nib.save(image, tmp_path / "a.nii")
        volume = read_volume_file(tmp_path / "a.nii")
        assert volume.spacing_mm == pytest.approx(tuple(SPACING))
        np.testing.assert_allclose(places(volume)[0], RAS @ ORIGIN, rtol=1e-6)

    def test_converts_nrrd_units(self, tmp_path: Path, numbered: NDArray[np.uint16]) -> None:
        header = {
            "space": "LPS",
            "space directions": np.diag(SPACING / 10),
            "space origin": ORIGIN / 10,
            "space units": ["cm", "cm", "cm"],
        }
        nrrd.write(str(tmp_path / "a.nrrd"), numbered, header)
        volume = read_volume_file(tmp_path / "a.nrrd")
        assert volume.spacing_mm == pytest.approx(tuple(SPACING))
        assert volume.origin_mm == pytest.approx(tuple(ORIGIN))

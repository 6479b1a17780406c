"""Files of every format, and one clear error for each kind of defect."""

import bz2
import gzip
from pathlib import Path
from typing import Any

import nibabel as nib
import nrrd
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.workers.body.images.image_formats import read_labels, read_volume_file
from palpate.workers.body.images.named_labels import label_tissues

UNIT = (1.0, 1.0, 1.0)
LPS = {
    "space": "left-posterior-superior",
    "space directions": np.eye(3),
    "space origin": np.zeros(3),
}


@pytest.fixture
def body() -> NDArray[np.uint8]:
    """Return labels [z, y, x] that any flip or swap changes."""
    return np.random.default_rng(5).integers(0, 4, (6, 5, 4)).astype(np.uint8)


def save(path: Path, body: NDArray[Any]) -> Path:
    """Write [z, y, x] in the format of the suffix, axes along the world's."""
    if path.name.endswith((".nii", ".nii.gz")):
        nib.save(nib.Nifti1Image(body.transpose(), np.diag([-1.0, -1.0, 1.0, 1.0])), path)
    elif path.suffix == ".nrrd":
        nrrd.write(str(path), body.transpose(), LPS)
    elif path.suffix == ".npy":
        np.save(path, body)
    else:
        tifffile.imwrite(path, body, photometric="minisblack")
    return path


SUFFIXES = [".nii", ".nii.gz", ".nrrd", ".npy", ".tif", ".tiff"]


class TestEveryFormat:
    @pytest.mark.parametrize("suffix", SUFFIXES)
    def test_returns_the_same_labels(
        self, tmp_path: Path, body: NDArray[np.uint8], suffix: str
    ) -> None:
        volume = read_volume_file(save(tmp_path / f"a{suffix}", body), spacing_mm=UNIT)
        np.testing.assert_array_equal(volume.values, body)
        assert volume.values.flags.c_contiguous
        assert volume.values.dtype == np.uint8
        assert volume.spacing_mm == UNIT
        assert volume.origin_mm == (0.0, 0.0, 0.0)

    @pytest.mark.parametrize("suffix", [s for s in SUFFIXES if s != ".tiff"])
    def test_refuses_truncated_file(self, tmp_path: Path, suffix: str) -> None:
        noise = np.random.default_rng(1).integers(0, 4, (20, 20, 20)).astype(np.uint8)
        path = save(tmp_path / f"a{suffix}", noise)
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        with pytest.raises(InputError, match="cut short"):
            read_volume_file(path, spacing_mm=UNIT)

    @pytest.mark.parametrize("suffix", [*SUFFIXES, ".dcm", ".nhdr"])
    @pytest.mark.parametrize("content", [b"", b"not an image at all\n" * 100])
    def test_refuses_content_that_does_not_match_the_suffix(
        self, tmp_path: Path, suffix: str, content: bytes
    ) -> None:
        path = tmp_path / f"a{suffix}"
        path.write_bytes(content)
        with pytest.raises(InputError, match="damaged"):
            read_volume_file(path, spacing_mm=UNIT)

    @pytest.mark.parametrize("suffix", SUFFIXES)
    def test_refuses_two_dimensional_image(self, tmp_path: Path, suffix: str) -> None:
        path = save(tmp_path / f"a{suffix}", np.ones((1, 5, 4), np.uint8))
        with pytest.raises(InputError, match="not a 3-D image"):
            read_volume_file(path, spacing_mm=UNIT)

    @pytest.mark.parametrize("suffix", [".npy", ".tif"])
    def test_requires_spacing(self, tmp_path: Path, body: NDArray[np.uint8], suffix: str) -> None:
        with pytest.raises(InputError, match="--spacing-mm X Y Z"):
            read_volume_file(save(tmp_path / f"a{suffix}", body))

    @pytest.mark.parametrize("suffix", SUFFIXES)
    def test_accepts_whole_floats(
        self, tmp_path: Path, body: NDArray[np.uint8], suffix: str
    ) -> None:
        path = save(tmp_path / f"a{suffix}", body.astype(np.float32))
        volume = read_volume_file(path, spacing_mm=UNIT)
        np.testing.assert_array_equal(volume.values, body)
        assert volume.values.dtype == np.uint8

    @pytest.mark.parametrize("suffix", SUFFIXES)
    @pytest.mark.parametrize("bad", [0.5, np.nan, np.inf])
    def test_refuses_other_floats(
        self, tmp_path: Path, body: NDArray[np.uint8], suffix: str, bad: float
    ) -> None:
        grey = body.astype(np.float32)
        grey[3, 2, 1] = bad
        message = {0.5: "0.5", np.inf: "inf"}.get(bad, "NaN")
        with pytest.raises(InputError, match=f"not a label map: it contains {message}"):
            read_volume_file(save(tmp_path / f"a{suffix}", grey), spacing_mm=UNIT)

    def test_reads_suffixes_in_capitals(self, tmp_path: Path, body: NDArray[np.uint8]) -> None:
        path = save(tmp_path / "a.nii.gz", body).rename(tmp_path / "A.NII.GZ")
        np.testing.assert_array_equal(read_volume_file(path).values, body)


class TestWhichFile:
    def test_refuses_missing_file(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="does not exist"):
            read_volume_file(tmp_path / "nowhere.nrrd")

    @pytest.mark.parametrize("name", ["body.stl", "body", "body.gz"])
    def test_refuses_unknown_suffix(self, tmp_path: Path, name: str) -> None:
        (tmp_path / name).write_bytes(b"solid")
        with pytest.raises(InputError, match=r"unsupported format.*\.nrrd"):
            read_volume_file(tmp_path / name)

    def test_refuses_empty_folder(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="no files"):
            read_volume_file(tmp_path)

    def test_refuses_folder_of_whole_images(self, tmp_path: Path, body: NDArray[np.uint8]) -> None:
        save(tmp_path / "a.nrrd", body)
        with pytest.raises(InputError, match="Give the file itself"):
            read_volume_file(tmp_path)


class TestFourAxes:
    def test_axis_of_a_single_time_point_is_dropped(
        self, tmp_path: Path, body: NDArray[np.uint8]
    ) -> None:
        nib.save(nib.Nifti1Image(body.transpose()[..., None], np.eye(4)), tmp_path / "a.nii")
        np.save(tmp_path / "a.npy", body[None])
        header = LPS | {"space directions": np.vstack([np.full(3, np.nan), np.eye(3)])}
        header["kinds"] = ["vector", "domain", "domain", "domain"]
        nrrd.write(str(tmp_path / "a.nrrd"), body.transpose()[None], header)
        nrrd.write(
            str(tmp_path / "b.nrrd"),
            body.transpose()[None],
            {"spacings": np.array([np.nan, 1.0, 1.0, 1.0])},
        )
        assert read_volume_file(tmp_path / "a.nii").shape_xyz == (4, 5, 6)
        for name in ("a.npy", "a.nrrd", "b.nrrd"):
            volume = read_volume_file(tmp_path / name, spacing_mm=UNIT)
            np.testing.assert_array_equal(volume.values, body)

    def test_refuses_two_time_points(self, tmp_path: Path, body: NDArray[np.uint8]) -> None:
        both = np.stack([body, body])
        nib.save(nib.Nifti1Image(both.transpose(), np.eye(4)), tmp_path / "a.nii")
        np.save(tmp_path / "a.npy", both)
        tifffile.imwrite(tmp_path / "a.tif", both, photometric="minisblack")
        header = LPS | {"space directions": np.vstack([np.eye(3), np.full(3, np.nan)])}
        header["kinds"] = ["domain", "domain", "domain", "list"]
        nrrd.write(str(tmp_path / "a.nrrd"), both.transpose(), header)
        for path in sorted(tmp_path.iterdir()):
            with pytest.raises(InputError, match="a volume has 3"):
                read_volume_file(path, spacing_mm=UNIT)

    def test_rejects_colour_images(self, tmp_path: Path) -> None:
        tifffile.imwrite(tmp_path / "a.tif", np.zeros((6, 5, 4, 3), np.uint8), photometric="rgb")
        with pytest.raises(InputError, match="a volume has 3"):
            read_volume_file(tmp_path / "a.tif", spacing_mm=UNIT)
        header = LPS | {"space directions": np.vstack([np.full(3, np.nan), np.eye(3)[:2]])}
        header["kinds"] = ["RGB-color", "domain", "domain"]
        nrrd.write(str(tmp_path / "a.nrrd"), np.zeros((3, 5, 4), np.uint8), header)
        with pytest.raises(InputError, match="2 axes in space"):
            read_volume_file(tmp_path / "a.nrrd", spacing_mm=UNIT)


class TestVoxels:
    def test_reads_booleans_and_foreign_byte_order(self, tmp_path: Path) -> None:
        np.save(tmp_path / "mask.npy", np.eye(3, dtype=bool) & np.ones((3, 3, 3), bool))
        assert read_volume_file(tmp_path / "mask.npy", spacing_mm=UNIT).values.dtype == np.uint8
        np.save(tmp_path / "big.npy", np.full((3, 3, 3), 258, dtype=">i2"))
        volume = read_volume_file(tmp_path / "big.npy", spacing_mm=UNIT)
        assert volume.values.dtype == np.int16
        assert volume.values.dtype.isnative
        assert (volume.values == 258).all()

    @pytest.mark.parametrize(
        ("low", "high", "kind"),
        [(0, 255, "u1"), (0, 256, "u2"), (-1, 3, "i2"), (-1, 40000, "i4"), (0, 2**40, "i8")],
    )
    def test_floats_become_the_smallest_integer_type(
        self, tmp_path: Path, low: int, high: int, kind: str
    ) -> None:
        grey = np.zeros((3, 3, 3))
        grey[0, 0, 0], grey[2, 2, 2] = low, high
        np.save(tmp_path / "a.npy", grey)
        values = read_volume_file(tmp_path / "a.npy", spacing_mm=UNIT).values
        assert values.dtype == np.dtype(kind)
        assert (values[0, 0, 0], values[2, 2, 2]) == (low, high)

    def test_applies_nifti_scale_slope(self, tmp_path: Path, body: NDArray[np.uint8]) -> None:
        image = nib.Nifti1Image(body.transpose(), np.diag([-1.0, -1.0, 1.0, 1.0]))
        image.header.set_slope_inter(2, -1)  # stored numbers stay those of body
        nib.save(image, tmp_path / "a.nii")
        volume = read_volume_file(tmp_path / "a.nii")
        np.testing.assert_array_equal(volume.values, 2 * body.astype(int) - 1)

    @pytest.mark.parametrize(
        ("name", "fields"),
        [
            ("a.nii", "scl_slope {} and scl_inter 0"),
            ("s", "RescaleSlope {} and RescaleIntercept 0"),
        ],
    )
    def test_names_the_fields_that_scale_labels(
        self, tmp_path: Path, write_series: Any, name: str, fields: str
    ) -> None:
        def write(slope: float) -> None:
            def scaled(_: int, image: Any) -> None:
                image.RescaleSlope, image.RescaleIntercept = f"{slope:.10f}", 0

            write_series(tmp_path / "s", body.astype(np.uint16), change=scaled)
            image = nib.Nifti1Image(body.transpose(), np.diag([-1.0, -1.0, 1.0, 1.0]))
            image.header.set_slope_inter(slope, 0)
            nib.save(image, tmp_path / "a.nii")

        body = np.random.default_rng(5).integers(0, 4, (6, 5, 4)).astype(np.uint8)
        write(2.0)
        labels, said = read_labels(tmp_path / name), f"scaled by {fields.format(2)}"
        assert labels.remarks == (f"The labels are the stored numbers {said}.",)
        with pytest.raises(InputError, match=rf"{said}\) has numbers as labels and no names"):
            label_tissues(labels, None)
        write(1 / 255)
        said = (
            f"scales the stored numbers by {fields.format('0.00392157')}: if those are the labels"
        )
        with pytest.raises(InputError, match=said):
            read_labels(tmp_path / name)

    def test_refuses_complex_numbers_and_pickles(self, tmp_path: Path) -> None:
        np.save(tmp_path / "a.npy", np.zeros((3, 3, 3), complex))
        with pytest.raises(InputError, match="complex128, expected one whole number"):
            read_volume_file(tmp_path / "a.npy", spacing_mm=UNIT)
        np.save(tmp_path / "b.npy", np.full((3, 3, 3), {}, dtype=object))
        with pytest.raises(InputError, match=r"cannot be read as NumPy.*pickle"):
            read_volume_file(tmp_path / "b.npy", spacing_mm=UNIT)


class TestNrrd:
    @pytest.mark.parametrize("encoding", ["raw", "gzip", "bzip2"])
    def test_reads_all_encodings_and_detached_headers(
        self, tmp_path: Path, body: NDArray[np.uint8], encoding: str
    ) -> None:
        for name in ("a.nrrd", "a.nhdr"):
            nrrd.write(str(tmp_path / name), body.transpose(), LPS | {"encoding": encoding})
            np.testing.assert_array_equal(read_volume_file(tmp_path / name).values, body)

    def test_refuses_missing_detached_data(self, tmp_path: Path, body: NDArray[np.uint8]) -> None:
        nrrd.write(str(tmp_path / "a.nhdr"), body.transpose(), LPS | {"encoding": "raw"})
        (tmp_path / "a.raw").unlink()
        with pytest.raises(InputError, match="cannot be read as NRRD"):
            read_volume_file(tmp_path / "a.nhdr")

    def test_refuses_mirrored_space(self, tmp_path: Path, body: NDArray[np.uint8]) -> None:
        nrrd.write(str(tmp_path / "a.nrrd"), body.transpose(), LPS | {"space": "3D-left-handed"})
        with pytest.raises(InputError, match="Save it as left-posterior-superior"):
            read_volume_file(tmp_path / "a.nrrd")

    def test_refuses_unknown_units(self, tmp_path: Path, body: NDArray[np.uint8]) -> None:
        header = LPS | {"space units": ["inch"] * 3}
        nrrd.write(str(tmp_path / "a.nrrd"), body.transpose(), header)
        with pytest.raises(InputError, match="inch"):
            read_volume_file(tmp_path / "a.nrrd")

    def test_refuses_damaged_compressed_data(self, tmp_path: Path) -> None:
        noise = np.random.default_rng(1).integers(0, 4, (20, 20, 20)).astype(np.uint8)
        for encoding, compress in (("gzip", gzip.compress), ("bzip2", bz2.compress)):
            path = tmp_path / f"{encoding}.nrrd"
            nrrd.write(str(path), noise, LPS | {"encoding": encoding})
            raw = bytearray(path.read_bytes())
            half = len(raw) - len(compress(noise.tobytes())) // 2
            raw[half : half + 40] = bytes(40)
            path.write_bytes(raw)
            with pytest.raises(InputError, match="cannot be read as NRRD"):
                read_volume_file(path)


class TestTiff:
    def test_sorts_slices_by_number(self, tmp_path: Path, body: NDArray[np.uint8]) -> None:
        stack = np.concatenate([body, body[::-1]])  # 12 slices: 10 and 11 sort before 2 as text
        for z, page in enumerate(stack):
            tifffile.imwrite(tmp_path / f"slice{z}.tif", page)
        (tmp_path / "notes.txt").write_text("scanned on a Tuesday")
        volume = read_volume_file(tmp_path, spacing_mm=(1.0, 2.0, 3.0))
        np.testing.assert_array_equal(volume.values, stack)
        assert volume.spacing_mm == (1.0, 2.0, 3.0)

    def test_refuses_slices_of_different_size(self, tmp_path: Path) -> None:
        tifffile.imwrite(tmp_path / "s1.tif", np.zeros((5, 4), np.uint8))
        tifffile.imwrite(tmp_path / "s2.tif", np.zeros((5, 3), np.uint8))
        with pytest.raises(InputError, match=r"s2\.tif.*\(5, 3\).*\(5, 4\)"):
            read_volume_file(tmp_path, spacing_mm=UNIT)

    def test_refuses_folder_of_stacks(self, tmp_path: Path, body: NDArray[np.uint8]) -> None:
        tifffile.imwrite(tmp_path / "s1.tif", body, photometric="minisblack")
        with pytest.raises(InputError, match="expected one slice"):
            read_volume_file(tmp_path, spacing_mm=UNIT)

    def test_damaged_slice_is_named(self, tmp_path: Path) -> None:
        for z in range(3):
            tifffile.imwrite(tmp_path / f"s{z}.tif", np.zeros((5, 4), np.uint8))
        (tmp_path / "s1.tif").write_bytes(b"II*\0")
        with pytest.raises(InputError, match=r"s1\.tif is damaged"):
            read_volume_file(tmp_path, spacing_mm=UNIT)

    def test_refuses_file_without_its_last_pages(
        self, tmp_path: Path, body: NDArray[np.uint8]
    ) -> None:
        path = tmp_path / "a.tif"
        with tifffile.TiffWriter(path) as writer:
            for page in body:
                writer.write(page, contiguous=False, metadata=None)
        with tifffile.TiffFile(path) as tiff:
            cut = tiff.pages[4].offset
        path.write_bytes(path.read_bytes()[:cut])
        with pytest.raises(InputError, match="damaged or cut short"):
            read_volume_file(path, spacing_mm=UNIT)

    def test_rejects_pages_of_different_kinds(
        self, tmp_path: Path, body: NDArray[np.uint8]
    ) -> None:
        with tifffile.TiffWriter(tmp_path / "a.tif") as writer:
            writer.write(body, photometric="minisblack")
            writer.write(np.zeros((3, 7, 7), np.uint16), photometric="minisblack")
        with pytest.raises(InputError, match="2 images of different kinds"):
            read_volume_file(tmp_path / "a.tif", spacing_mm=UNIT)

    def test_reads_bits_and_palettes(self, tmp_path: Path) -> None:
        mask = np.random.default_rng(3).integers(0, 2, (4, 8, 8)).astype(bool)
        tifffile.imwrite(tmp_path / "bits.tif", mask, photometric="minisblack")
        volume = read_volume_file(tmp_path / "bits.tif", spacing_mm=UNIT)
        np.testing.assert_array_equal(volume.values, mask)
        labels = np.random.default_rng(3).integers(0, 4, (4, 8, 8)).astype(np.uint8)
        colours = np.random.default_rng(3).integers(0, 2**16, (3, 256)).astype(np.uint16)
        tifffile.imwrite(tmp_path / "p.tif", labels, photometric="palette", colormap=colours)
        volume = read_volume_file(tmp_path / "p.tif", spacing_mm=UNIT)
        np.testing.assert_array_equal(volume.values, labels)

"""DICOM: slices ordered by position; segmentations; refusals."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydicom.uid import generate_uid

from palpate.storage.errors import InputError
from palpate.workers.body.images.image_formats import read_volume_file


@pytest.fixture
def slices() -> NDArray[np.uint16]:
    """Labels [slice, row, column]."""
    return np.random.default_rng(2).integers(0, 4, (7, 5, 4)).astype(np.uint16)


class TestSeries:
    @pytest.mark.parametrize("suffix", [".dcm", ".IMA", ""])
    def test_sorted_by_position_and_spaced_by_rows_and_columns(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any, suffix: str
    ) -> None:
        write_series(
            tmp_path,
            slices,
            pixel_spacing=(0.5, 0.25),
            step=(0, 0, 1.5),
            origin=(10, 20, -30),
            suffix=suffix,
        )
        (tmp_path / "readme.txt").write_text("a series")
        (tmp_path / "DICOMDIR").write_bytes(b"an index")
        volume = read_volume_file(tmp_path)
        np.testing.assert_array_equal(volume.values, slices)
        assert volume.spacing_mm == (0.25, 0.5, 1.5)  # columns step along x, rows along y
        assert volume.origin_mm == (10.0, 20.0, -30.0)

    def test_accepts_positions_rounded_in_the_file(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        def rounded(index: int, image: Any) -> None:
            image.ImagePositionPatient = [0.0, 0.0, round(index * 0.273, 2)]

        many = np.tile(slices, (12, 1, 1))
        write_series(tmp_path, many, change=rounded)
        volume = read_volume_file(tmp_path)
        np.testing.assert_array_equal(volume.values, many)
        assert volume.spacing_mm[2] == pytest.approx(0.273, abs=1e-4)

    def test_applies_rescale_slope_and_intercept(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        def shifted(_: int, image: Any) -> None:
            image.RescaleSlope, image.RescaleIntercept = 2, -1024

        write_series(tmp_path, slices, change=shifted)
        expected = 2 * slices.astype(int) - 1024
        np.testing.assert_array_equal(read_volume_file(tmp_path).values, expected)

    def test_refuses_missing_slice(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        paths = write_series(tmp_path, slices, step=(0, 0, 1.5))
        paths[3].unlink()
        with pytest.raises(InputError, match=r"slices 3 and 4 .* 3 mm apart, expected 1\.5 mm"):
            read_volume_file(tmp_path)

    def test_refuses_uneven_gaps(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        def stretched(index: int, image: Any) -> None:
            image.ImagePositionPatient = [0.0, 0.0, index + 0.3 * (index > 4)]

        write_series(tmp_path, slices, change=stretched)
        with pytest.raises(InputError, match=r"slices 5 and 6 .* 1\.3 mm apart, expected 1 mm"):
            read_volume_file(tmp_path)

    def test_refuses_slice_out_of_place(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        def moved(index: int, image: Any) -> None:
            image.ImagePositionPatient = [0.0, 0.0, index - 0.2 * (index == 3)]

        write_series(tmp_path, slices, change=moved)  # the mean gap is still 1 mm
        with pytest.raises(InputError, match=r"uneven gaps.*expected 1 mm"):
            read_volume_file(tmp_path)

    def test_refuses_slices_off_the_line(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        def shifted(index: int, image: Any) -> None:
            image.ImagePositionPatient = [2.0 * (index == 3), 0.0, float(index)]

        write_series(tmp_path, slices, change=shifted)
        with pytest.raises(InputError, match=r"not on one line \(2 mm off\)"):
            read_volume_file(tmp_path)

    def test_refuses_two_time_points(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        def twice(index: int, image: Any) -> None:
            image.ImagePositionPatient = [0.0, 0.0, float(index // 2)]

        write_series(tmp_path, slices[:6], change=twice)
        with pytest.raises(InputError, match="several slices at one position"):
            read_volume_file(tmp_path)

    def test_refuses_two_series(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        other = generate_uid()

        def half(index: int, image: Any) -> None:
            if index > 4:
                image.SeriesInstanceUID = other

        write_series(tmp_path, slices, change=half)
        with pytest.raises(InputError, match=r"2 series .*5 slices.*2 slices"):
            read_volume_file(tmp_path)

    @pytest.mark.parametrize("name", ["ImagePositionPatient", "ImageOrientationPatient"])
    def test_refuses_missing_geometry(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any, name: str
    ) -> None:
        write_series(tmp_path, slices, change=lambda _, image: image.__delattr__(name))
        with pytest.raises(InputError, match=r"no ImagePosition|image orientation \[\]"):
            read_volume_file(tmp_path)

    def test_refuses_one_rotated_slice(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        def turned(index: int, image: Any) -> None:
            if index == 6:
                image.ImageOrientationPatient = [0.0, 1.0, 0.0, -1.0, 0.0, 0.0]

        write_series(tmp_path, slices, change=turned)
        with pytest.raises(InputError, match=r"differs from .* in orientation"):
            read_volume_file(tmp_path)

    def test_refuses_slices_with_two_spacings(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        def coarser(index: int, image: Any) -> None:
            if index == 6:
                image.PixelSpacing = [2.0, 2.0]

        write_series(tmp_path, slices, change=coarser)
        with pytest.raises(InputError, match="different PixelSpacing"):
            read_volume_file(tmp_path)

    def test_refuses_single_slice(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        paths = write_series(tmp_path, slices)
        with pytest.raises(InputError, match=r"2-D image\. Give the folder"):
            read_volume_file(paths[0])

    @pytest.mark.parametrize("cut", [20, 100])
    def test_truncated_slice_is_named(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any, cut: int
    ) -> None:
        path = write_series(tmp_path, slices)[6]
        path.write_bytes(path.read_bytes()[:-cut])
        with pytest.raises(InputError, match=rf"{path.name}.*cut short"):
            read_volume_file(tmp_path)

    def test_names_file_that_is_not_dicom(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        path = write_series(tmp_path, slices)[6]  # an end slice: its loss would leave no gap
        path.write_bytes(b"\0" * 300)
        with pytest.raises(InputError, match=rf"{path.name} is not a DICOM file"):
            read_volume_file(tmp_path)

    def test_refuses_folder_without_images(self, tmp_path: Path) -> None:
        (tmp_path / "readme.txt").write_text("nothing here")
        with pytest.raises(InputError, match="no DICOM image"):
            read_volume_file(tmp_path)


class TestSegmentation:
    @pytest.fixture
    def frames(self) -> list[tuple[int, float, NDArray[np.uint8]]]:
        """Return two segments, [row, column] of 3 x 5; slot 2 of 5 has no frame."""
        outer, inner = np.zeros((3, 5), np.uint8), np.zeros((3, 5), np.uint8)
        outer[0, :2], inner[2, 3:] = 1, 1
        return [(1, 0.0, outer), (1, 6.0, outer), (2, 6.0, inner), (2, 8.0, inner), (1, 2.0, outer)]

    @pytest.mark.parametrize("gap_mm", [2.0, None])
    @pytest.mark.parametrize("in_folder", [True, False])
    def test_reads_binary_segmentations(
        self,
        tmp_path: Path,
        frames: Any,
        write_segmentation: Any,
        gap_mm: float | None,
        in_folder: bool,
    ) -> None:
        path = write_segmentation(tmp_path / "seg.dcm", frames, gap_mm=gap_mm)
        volume = read_volume_file(tmp_path if in_folder else path)
        expected = np.zeros((5, 3, 5), int)
        expected[[0, 1, 3], 0, :2] = 1
        expected[[3, 4], 2, 3:] = 2
        np.testing.assert_array_equal(volume.values, expected)
        assert volume.spacing_mm == (0.25, 0.5, 2.0)
        assert volume.origin_mm == (10.0, 20.0, 0.0)

    def test_reads_label_maps(self, tmp_path: Path, write_segmentation: Any) -> None:
        labels = np.random.default_rng(4).integers(0, 4, (4, 3, 5)).astype(np.uint8)
        frames = [(1, float(z), page) for z, page in enumerate(labels)]
        path = write_segmentation(tmp_path / "a.dcm", frames, kind="LABELMAP")
        np.testing.assert_array_equal(read_volume_file(path).values, labels)

    def test_refuses_overlapping_segments(
        self, tmp_path: Path, frames: Any, write_segmentation: Any
    ) -> None:
        frames.append((2, 2.0, frames[0][2]))
        with pytest.raises(InputError, match=r"overlap \(slice 2\)"):
            read_volume_file(write_segmentation(tmp_path / "seg.dcm", frames))

    def test_refuses_contradictory_slice_distance(
        self, tmp_path: Path, frames: Any, write_segmentation: Any
    ) -> None:
        with pytest.raises(InputError, match=r"expected 1\.5 mm"):
            read_volume_file(write_segmentation(tmp_path / "seg.dcm", frames, gap_mm=1.5))

    def test_refuses_fractions(self, tmp_path: Path, frames: Any, write_segmentation: Any) -> None:
        path = write_segmentation(tmp_path / "seg.dcm", frames, kind="FRACTIONAL")
        with pytest.raises(InputError, match="type FRACTIONAL; only segmentations"):
            read_volume_file(path)

    def test_refuses_other_multi_frame_images(
        self, tmp_path: Path, slices: NDArray[np.uint16], write_series: Any
    ) -> None:
        def many(_: int, image: Any) -> None:
            image.NumberOfFrames = 2
            image.PixelData = 2 * image.PixelData

        path = write_series(tmp_path, slices[:1], change=many)[0]
        with pytest.raises(InputError, match="multi-frame DICOM file of type CT"):
            read_volume_file(path)

    def test_refuses_segmentation_mixed_with_slices(
        self,
        tmp_path: Path,
        slices: NDArray[np.uint16],
        frames: Any,
        write_series: Any,
        write_segmentation: Any,
    ) -> None:
        write_series(tmp_path, slices)
        write_segmentation(tmp_path / "seg.dcm", frames)
        with pytest.raises(InputError, match="mixes a multi-frame file with 7 other images"):
            read_volume_file(tmp_path)

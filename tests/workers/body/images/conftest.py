"""Real label files, written with the libraries that define the formats."""

import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pytest
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, SegmentationStorage, generate_uid

WriteSeries = Callable[..., list[Path]]
WriteSegmentation = Callable[..., Path]


@pytest.fixture
def numbered() -> NDArray[np.uint16]:
    """Return voxels [i, j, k] with distinct labels: 0, 1, 2, ..., 119."""
    return np.arange(4 * 5 * 6, dtype=np.uint16).reshape(4, 5, 6)


def _image(sop_class: str, shape: tuple[int, ...], bits: int) -> Dataset:
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = sop_class
    meta.MediaStorageSOPInstanceUID = generate_uid()
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    image = Dataset()
    image.file_meta = meta
    image.SOPClassUID = sop_class
    image.SOPInstanceUID = meta.MediaStorageSOPInstanceUID
    image.SamplesPerPixel, image.PhotometricInterpretation = 1, "MONOCHROME2"
    image.Rows, image.Columns = shape
    image.BitsAllocated = image.BitsStored = bits
    image.HighBit, image.PixelRepresentation = bits - 1, 0
    return image


@pytest.fixture
def write_series() -> WriteSeries:
    """Write [slice, row, column] as one file each; `change(index, dataset)` edits them."""

    def write(
        folder: Path,
        values: NDArray[np.uint16],
        *,
        orientation: tuple[float, ...] = (1, 0, 0, 0, 1, 0),
        pixel_spacing: tuple[float, float] = (1.0, 1.0),
        step: tuple[float, ...] = (0, 0, 1),
        origin: tuple[float, ...] = (0, 0, 0),
        change: Callable[[int, Dataset], None] | None = None,
        suffix: str = ".dcm",
    ) -> list[Path]:
        folder.mkdir(parents=True, exist_ok=True)
        series, paths = generate_uid(), []
        names = np.random.default_rng(0).permutation(len(values))  # names are in random order
        for index, pixels in enumerate(values):
            image = _image(CTImageStorage, pixels.shape, 16)
            image.Modality, image.SeriesInstanceUID = "CT", series
            image.ImageOrientationPatient = [float(o) for o in orientation]
            place = np.array(origin, dtype=float) + index * np.array(step, dtype=float)
            image.ImagePositionPatient = [float(round(p, 6)) for p in place]
            image.PixelSpacing = list(pixel_spacing)
            image.PixelData = np.ascontiguousarray(pixels, dtype="<u2").tobytes()
            if change is not None:
                change(index, image)
            paths.append(folder / f"slice{names[index]}{suffix}")
            image.save_as(paths[-1], enforce_file_format=True)
        return paths

    return write


@pytest.fixture
def write_segmentation() -> WriteSegmentation:
    """Write frames [(segment, z, mask or labels)] as one SEG file."""

    def write(
        path: Path,
        frames: list[tuple[int, float, NDArray[Any]]],
        *,
        kind: str = "BINARY",
        gap_mm: float | None = None,
    ) -> Path:
        bits = 1 if kind == "BINARY" else 8
        pixels = np.array([frame for _, _, frame in frames], dtype=np.uint8)
        image = _image(SegmentationStorage, pixels.shape[1:], bits)
        image.Modality, image.SegmentationType = "SEG", kind
        image.NumberOfFrames = len(frames)
        shared, measures, plane = Dataset(), Dataset(), Dataset()
        measures.PixelSpacing = [0.5, 0.25]
        if gap_mm is not None:
            measures.SpacingBetweenSlices = gap_mm
        plane.ImageOrientationPatient = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
        shared.PixelMeasuresSequence = [measures]
        shared.PlaneOrientationSequence = [plane]
        image.SharedFunctionalGroupsSequence = [shared]
        items = []
        for segment, z, _ in frames:
            item, place, named = Dataset(), Dataset(), Dataset()
            place.ImagePositionPatient = [10.0, 20.0, z]
            item.PlanePositionSequence = [place]
            named.ReferencedSegmentNumber = segment
            item.SegmentIdentificationSequence = [named]
            items.append(item)
        image.PerFrameFunctionalGroupsSequence = items
        data = (
            np.packbits(pixels.ravel(), bitorder="little").tobytes()
            if bits == 1
            else pixels.tobytes()
        )
        image.PixelData = data + b"\0" * (len(data) % 2)
        image["PixelData"].VR = "OB"
        pydicom.dcmwrite(path, image, enforce_file_format=True)
        return path

    return write


@pytest.fixture
def peak_mib() -> Iterator[Callable[[], float]]:
    """Return the peak memory allocated by Python and NumPy since the test began, in MiB."""
    tracemalloc.start()
    yield lambda: tracemalloc.get_traced_memory()[1] / 2**20
    tracemalloc.stop()

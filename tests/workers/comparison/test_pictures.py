"""Mammograms as pictures and as DICOM files."""

from io import BytesIO

import numpy as np
import pydicom
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.mammogram_image import (
    EQUAL_GREY,
    LARGEST_PIXEL,
    Mammogram,
    Noise,
    dicom_bytes,
    difference_picture,
    expose,
    grey_picture,
    mammogram_dataset,
    presentation_values,
    processing_values,
)
from palpate.workers.comparison.xray_beam import Unit, geometry_of


def body(lump: bool) -> Volume:
    values = np.full((30, 40, 50), Tissue.FAT, np.uint8)
    if lump:
        values[10:20, 10:30, 20:30] = Tissue.GLANDULAR
    return Volume(values, (1.0, 1.0, 1.0), (-24.5, 0.5, 0.5))


def mammogram(lump: bool = True, noise: Noise | None = None) -> Mammogram:
    plain = body(False)
    return expose(body(lump), geometry_of(plain, unit=Unit(pixel_mm=1.0)), noise=noise)


def test_dense_tissue_is_bright_and_air_is_black() -> None:
    grey = grey_picture(mammogram())
    assert grey.dtype == np.uint8
    lump, fat, air = grey[25:29, 15], grey[5:10, 5], grey[-1, -1]
    assert lump.min() > 200
    assert lump.min() > fat.max()
    assert air == 0
    assert fat.min() > 0


def test_equal_parts_are_grey_in_the_difference() -> None:
    with_lump, without = mammogram(True), mammogram(False)
    assert (difference_picture(with_lump, with_lump) == EQUAL_GREY).all()
    forth, back = difference_picture(with_lump, without), difference_picture(without, with_lump)
    assert forth[27, 15] > 170
    assert back[27, 15] < 86
    assert forth[5, 5] == EQUAL_GREY
    other = expose(body(True), geometry_of(body(True), unit=Unit(pixel_mm=2.0)))
    with pytest.raises(InputError, match="in the same geometry"):
        difference_picture(with_lump, other)


@pytest.mark.parametrize("intent", ["presentation", "processing"])
@pytest.mark.parametrize("view", ["CC", "MLO"])
def test_dicom_file_round_trips(view: str, intent: str) -> None:
    taken = mammogram(noise=Noise(2))
    content = dicom_bytes(mammogram_dataset(taken, view, intent))  # type: ignore[arg-type]
    read = pydicom.dcmread(BytesIO(content))
    values = presentation_values if intent == "presentation" else processing_values
    assert np.array_equal(read.pixel_array, values(taken, LARGEST_PIXEL))
    assert read.pixel_array.max() > 0.85 * LARGEST_PIXEL
    name = f"Digital Mammography X-Ray Image Storage - For {intent.capitalize()}"
    assert read.SOPClassUID.name == name
    assert read.file_meta.MediaStorageSOPInstanceUID == read.SOPInstanceUID
    assert read.PresentationIntentType == f"FOR {intent.upper()}"
    assert (read.Modality, read.OrganExposed, read.ImageLaterality) == ("MG", "BREAST", "L")
    meaning = {"CC": "cranio-caudal", "MLO": "medio-lateral oblique"}[view]
    assert read.ViewCodeSequence[0].CodeMeaning == meaning
    assert [float(v) for v in read.ImagerPixelSpacing] == [1.0, 1.0]
    assert float(read.DistanceSourceToDetector) == 650.0
    # Required type 1 and 2 attributes of DX Detector, DX Image and Mammography Image;
    # the whole file was checked once with dciodvfy, which found no error.
    for keyword in (
        "PositionerType", "BreastImplantPresent", "PartialView", "DetectorTemperature",
        "PixelIntensityRelationship", "RescaleSlope", "PresentationLUTShape", "PatientOrientation",
        "AcquisitionContextSequence", "BurnedInAnnotation", "AnatomicRegionSequence",
    ):  # fmt: skip
        assert keyword in read, keyword
    if intent == "processing":
        assert read.PixelIntensityRelationship == "LIN"


def test_equal_mammograms_give_equal_files() -> None:
    first, again = (dicom_bytes(mammogram_dataset(mammogram(), "CC")) for _ in range(2))
    assert first == again
    other = mammogram_dataset(mammogram(), "MLO")
    assert other.SOPInstanceUID != pydicom.dcmread(BytesIO(first)).SOPInstanceUID


def test_refuses_unknown_view() -> None:
    with pytest.raises(InputError, match="CC or MLO"):
        mammogram_dataset(mammogram(), "ML")  # type: ignore[arg-type]

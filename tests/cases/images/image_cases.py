"""Small breasts in several file formats, for tests of positions and labels."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import nibabel as nib
import nrrd
import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, SegmentationStorage, generate_uid

Labels = NDArray[np.uint8]
SLICER = {1: "Skin", 2: "Fat", 3: "Glandular", 4: "Ligament"}
FRAME = "1.2.826.0.1.3680043.8.498.1"
LPS = {
    "space": "left-posterior-superior",
    "space directions": np.diag([2.0, 2.0, 2.0]),
    "space origin": np.array([-50.0, 10.0, 20.0]),
}


def breast() -> Labels:
    """Return [z, y, x] labels in the order of `SLICER`: 1 skin, 2 fat, 3 glandular, 4 ligament."""
    values = np.zeros((10, 12, 14), np.uint8)
    values[:8, 2:10, 2:12] = 1
    values[:7, 3:9, 3:11] = 2
    values[2:5, 4:8, 5:9] = 3
    values[5, 5, 5] = 4
    return values


def tissues() -> Labels:
    """Return the same body with the numbers of `Tissue`."""
    return np.array([0, 3, 1, 2, 5], np.uint8)[breast()]


def write_nrrd(
    path: Path, values: NDArray[Any], header: Mapping[str, Any] | None = None, **names: Any
) -> Path:
    """Write [z, y, x] labels with these header fields."""
    fields = dict(LPS if header is None else header)
    nrrd.write(str(path), values.transpose(), fields | names)
    return path


def segments(names: Mapping[int, str], layers: Mapping[int, int] | None = None) -> dict[str, str]:
    """Return the header fields of 3D Slicer with the names of segments."""
    fields: dict[str, str] = {}
    for number, (label, name) in enumerate(names.items()):
        fields |= {
            f"Segment{number}_ID": f"Segment_{number}",
            f"Segment{number}_Name": name,
            f"Segment{number}_LabelValue": str(label),
            f"Segment{number}_Layer": str((layers or {}).get(label, 0)),
        }
    return fields


def write_nifti(
    path: Path,
    values: NDArray[Any],
    *,
    sform: NDArray[np.float64] | None = None,
    qform: NDArray[np.float64] | None = None,
    codes: tuple[int, int] = (1, 1),
) -> Path:
    """Write [z, y, x] labels with an sform and a qform with these codes; pixdim is the qform's."""
    image = nib.Nifti1Image(values.transpose(), None)
    if qform is not None:
        image.set_qform(qform, code=codes[1])
    if sform is not None:
        image.set_sform(sform, code=codes[0])
    nib.save(image, path)
    return path


def write_series(folder: Path, values: Labels, *, gap_mm: float = 2.0, **tags: Any) -> Path:
    """Write [z, y, x] labels as one DICOM file per slice; a tag may be a function of the slice."""
    folder.mkdir()
    series = generate_uid()
    for z, pixels in enumerate(values):
        image = _image(CTImageStorage, pixels.shape, 8)
        image.SeriesInstanceUID = series
        image.ImageOrientationPatient = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
        image.ImagePositionPatient = [-50.0, 10.0, 20.0 + gap_mm * z]
        image.PixelSpacing = [2.0, 2.0]
        for name, value in tags.items():
            setattr(image, name, value(z) if callable(value) else value)
        image.PixelData = np.ascontiguousarray(pixels).tobytes()
        image.save_as(folder / f"{z}.dcm", enforce_file_format=True)
    return folder


def write_segmentation(
    path: Path,
    values: Labels,
    names: Mapping[int, tuple[str, str]],
    measures: Mapping[str, float] | None = None,
) -> Path:
    """Write [z, y, x] labels as a DICOM LABELMAP; names are segment labels and code meanings."""
    image = _image(SegmentationStorage, values.shape[1:], 8)
    image.Modality, image.SegmentationType = "SEG", "LABELMAP"
    image.NumberOfFrames, image.FrameOfReferenceUID = len(values), FRAME
    shared, spacing, plane = Dataset(), Dataset(), Dataset()
    spacing.PixelSpacing = [2.0, 2.0]
    for name, value in (measures or {}).items():
        setattr(spacing, name, value)
    plane.ImageOrientationPatient = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = [spacing], [plane]
    image.SharedFunctionalGroupsSequence = [shared]
    image.PerFrameFunctionalGroupsSequence = [_frame(z) for z in range(len(values))]
    image.SegmentSequence = [_segment(n, *named) for n, named in names.items()]
    image.PixelData = values.tobytes() + b"\0" * (values.size % 2)
    image["PixelData"].VR = "OB"
    pydicom.dcmwrite(path, image, enforce_file_format=True)
    return path


def _frame(z: int) -> Dataset:
    item, place = Dataset(), Dataset()
    place.ImagePositionPatient = [-50.0, 10.0, 20.0 + 2.0 * z]
    item.PlanePositionSequence = [place]
    return item


def _segment(number: int, label: str, meaning: str) -> Dataset:
    segment, code = Dataset(), Dataset()
    segment.SegmentNumber, segment.SegmentLabel = number, label
    code.CodeMeaning = meaning
    segment.SegmentedPropertyTypeCodeSequence = [code]
    return segment


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

"""Digital Mammography X-Ray Images (DICOM PS3.3, A.27).

Written directly from the tables of the standard. Pixels for processing are linear in the energy
read by the detector; pixels for presentation are the logarithm of the attenuation, with dense
tissue bright.
"""

import hashlib
from io import BytesIO
from typing import Any, Literal

import numpy as np
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

from palpate.storage.errors import InputError
from palpate.workers.comparison.mammogram.exposure import Mammogram
from palpate.workers.comparison.mammogram.picture import presentation_values, processing_values

View = Literal["CC", "MLO"]
Intent = Literal["presentation", "processing"]

SOP_CLASSES = {
    "presentation": "1.2.840.10008.5.1.4.1.1.1.2",
    "processing": "1.2.840.10008.5.1.4.1.1.1.2.1",
}
# CID 4014, and directions of columns and rows in a left breast: anterior, then right or feet.
VIEWS = {
    "CC": ("399162004", "cranio-caudal", ["A", "R"]),
    "MLO": ("399368009", "medio-lateral oblique", ["A", "FR"]),
}
BITS = 14
LARGEST = 2**BITS - 1


def mammogram_dataset(
    mammogram: Mammogram, view: View, intent: Intent = "presentation", body_name: str = "PHANTOM^"
) -> FileDataset:
    """Return the DICOM data set of a mammogram of a left breast.

    Unique identifiers are derived from the pixels, so equal mammograms give equal files.

    Parameters
    ----------
    mammogram : Mammogram
    view : {"CC", "MLO"}
    intent : {"presentation", "processing"}
    body_name : str
        Written as the patient's name and ID.

    Raises
    ------
    InputError
        If the view or the intent is unknown.
    """
    if view not in VIEWS or intent not in SOP_CLASSES:
        raise InputError(
            f"A mammogram must be CC or MLO, for presentation or processing; got {view!r}, "
            f"{intent!r}."
        )
    make = presentation_values if intent == "presentation" else processing_values
    pixels = np.ascontiguousarray(make(mammogram, LARGEST), dtype="<u2")
    names = _identifiers(pixels, view, intent)
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = SOP_CLASSES[intent]
    meta.MediaStorageSOPInstanceUID = names["SOPInstanceUID"]
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    parts = (
        names,
        _patient_and_study(body_name),
        _image(view, intent),
        _beam_and_detector(mammogram),
        _pixels(pixels, intent),
    )
    for part in parts:
        for keyword, value in part.items():
            setattr(dataset, keyword, value)
    dataset.SOPClassUID = SOP_CLASSES[intent]
    return dataset


def dicom_bytes(dataset: FileDataset) -> bytes:
    """Return the content of a DICOM file."""
    file = BytesIO()
    dataset.save_as(file, enforce_file_format=True)
    return file.getvalue()


def _identifiers(pixels: Any, view: str, intent: str) -> dict[str, Any]:
    content = hashlib.sha256(pixels.tobytes()).hexdigest()
    levels = {
        "StudyInstanceUID": ("study", content),
        "SeriesInstanceUID": ("series", content, view, intent),
        "SOPInstanceUID": ("image", content, view, intent),
    }
    return {key: generate_uid(entropy_srcs=list(parts)) for key, parts in levels.items()}


def _patient_and_study(name: str) -> dict[str, Any]:
    """Return the modules Patient, General Study, General Series and General Equipment."""
    return {
        "PatientName": name,
        "PatientID": name,
        "PatientBirthDate": "",
        "PatientSex": "F",
        "StudyDate": "",
        "StudyTime": "",
        "ReferringPhysicianName": "",
        "StudyID": "",
        "AccessionNumber": "",
        "Modality": "MG",
        "SeriesNumber": 1,
        "Manufacturer": "Palpate",
        "ManufacturerModelName": "simulated mammography unit",
    }


def _image(view: str, intent: str) -> dict[str, Any]:
    """Return the modules General Image, DX Anatomy, Mammography Image and Acquisition Context."""
    code, meaning, orientation = VIEWS[view]
    of_view = _code(code, meaning)
    of_view.ViewModifierCodeSequence = Sequence([])
    return {
        "InstanceNumber": 1,
        "ContentDate": "",
        "ContentTime": "",
        "ImageType": ["DERIVED" if intent == "presentation" else "ORIGINAL", "PRIMARY", ""],
        "PatientOrientation": orientation,
        "BurnedInAnnotation": "NO",
        "LossyImageCompression": "00",
        "ImageLaterality": "L",
        "AnatomicRegionSequence": Sequence([_code("76752008", "Breast")]),
        "OrganExposed": "BREAST",
        "PositionerType": "MAMMOGRAPHIC",
        "ViewCodeSequence": Sequence([of_view]),
        "BreastImplantPresent": "NO",
        "PartialView": "NO",
        "AcquisitionContextSequence": Sequence([]),
    }


def _beam_and_detector(mammogram: Mammogram) -> dict[str, Any]:
    """Return the modules DX Detector and X-Ray Acquisition Dose, and the mammography geometry."""
    g = mammogram.geometry
    normal = np.cross(g.down_mm, g.right_mm)
    height = abs(float((g.source_mm - g.first_mm) @ normal)) / float(np.linalg.norm(normal))
    pixel = [f"{np.linalg.norm(step):.6g}" for step in (g.down_mm, g.right_mm)]
    return {
        "DetectorType": "DIRECT",
        "DetectorConfiguration": "AREA",
        "DetectorActiveShape": "RECTANGLE",
        "FieldOfViewShape": "RECTANGLE",
        "FieldOfViewOrigin": [0, 0],
        "FieldOfViewRotation": "0",
        "FieldOfViewHorizontalFlip": "NO",
        "DetectorTemperature": None,
        "ImagerPixelSpacing": pixel,
        "DetectorElementSpacing": pixel,
        "DistanceSourceToDetector": f"{height:.6g}",
        "KVP": 28,
        "FocalSpots": [0.0],
        "ExposureControlMode": "MANUAL",
    }


def _pixels(pixels: Any, intent: str) -> dict[str, Any]:
    """Return the modules Image Pixel, DX Image and VOI LUT."""
    rows, columns = pixels.shape
    shown = intent == "presentation"
    values = {
        "PresentationIntentType": "FOR PRESENTATION" if shown else "FOR PROCESSING",
        "SamplesPerPixel": 1,
        "PhotometricInterpretation": "MONOCHROME2",
        "Rows": rows,
        "Columns": columns,
        "BitsAllocated": 16,
        "BitsStored": BITS,
        "HighBit": BITS - 1,
        "PixelRepresentation": 0,
        "PixelIntensityRelationship": "LOG" if shown else "LIN",
        # The value increases with attenuation (-1) or with energy (1).
        "PixelIntensityRelationshipSign": -1 if shown else 1,
        "RescaleIntercept": 0,
        "RescaleSlope": 1,
        "RescaleType": "US",
        "PresentationLUTShape": "IDENTITY",
        "PixelData": pixels.tobytes(),
    }
    if shown:
        values["WindowCenter"] = (LARGEST + 1) // 2
        values["WindowWidth"] = LARGEST + 1
    return values


def _code(value: str, meaning: str) -> Dataset:
    """Return a SNOMED CT term."""
    item = Dataset()
    item.CodeValue = value
    item.CodingSchemeDesignator = "SCT"
    item.CodeMeaning = meaning
    return item

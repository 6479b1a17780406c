"""Mammograms: readings of an ideal detector, grey values, and Digital Mammography X-Ray Images.

The detector is behind known lengths of tissue; its readings are with or without noise. Grey
values are for screens and files. DICOM files (PS3.3, A.27) are written directly from the tables
of the standard. Pixels for processing are linear in the energy read by the detector; pixels for
presentation are the logarithm of the attenuation, with dense tissue bright.
"""

import hashlib
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Volume
from palpate.workers.comparison.xray_beam import (
    TABLE_DISTANCE_MM,
    Geometry,
    Spectrum,
    attenuation_table,
    path_lengths_mm,
    spectrum_of,
)

# Events of the electronic Poisson process; its skewness is one tenth.
ELECTRONIC_EVENTS = 100.0


@dataclass(frozen=True)
class Noise:
    """Noise in the readings of pixels.

    Parameters
    ----------
    seed : int
        Seed of both random processes.
    electronic_kev : float
        Standard deviation of the electronic noise, in keV of absorbed energy. In amorphous
        selenium, some 2,000 electrons of 50 eV each amount to 100 keV.

    Raises
    ------
    InputError
        If the seed or the standard deviation is negative.
    """

    seed: int = 0
    electronic_kev: float = 100.0

    def __post_init__(self) -> None:
        if self.seed < 0 or not self.electronic_kev >= 0:
            raise InputError(
                f"The seed and the electronic noise must be >= 0, got seed {self.seed} and "
                f"{self.electronic_kev:g} keV."
            )


@dataclass(frozen=True, eq=False)
class Mammogram:
    """The readings of a detector.

    Parameters
    ----------
    energy_kev : ndarray of float64, shape (rows, columns)
        Energy absorbed in each pixel.
    open_kev : ndarray of float64, shape (rows, columns)
        Energy without a body and without noise.
    geometry : Geometry
    """

    energy_kev: FloatArray
    open_kev: FloatArray
    geometry: Geometry

    @property
    def log_attenuation(self) -> FloatArray:
        """ln(open / energy), where readings below 1 keV count as 1 keV."""
        return np.asarray(np.log(self.open_kev / np.maximum(self.energy_kev, 1.0)))


def expose(
    body: Volume,
    geometry: Geometry,
    spectrum: Spectrum | None = None,
    *,
    mas: float = 60.0,
    noise: Noise | None = None,
) -> Mammogram:
    """Take a mammogram.

    The focal spot is a point, the beam polyenergetic without scatter, and the detector
    ideal: it absorbs every photon that meets a pixel and reads the sum of their energies
    (thesis section 4.4.3).

    Parameters
    ----------
    body : Volume
        `Tissue` labels.
    geometry : Geometry
    spectrum : Spectrum, optional
        A tungsten anode with a rhodium filter by default.
    mas : float
        Tube current times exposure time, > 0.
    noise : Noise, optional
        Noise of the reading; by default, the expected reading is returned.

    Raises
    ------
    InputError
        If the exposure is not positive, or a value is not a label.
    """
    lengths = path_lengths_mm(body, geometry)
    return read_out(lengths, geometry, spectrum or spectrum_of("w_rh"), mas=mas, noise=noise)


def read_out(
    lengths_mm: NDArray[np.floating],
    geometry: Geometry,
    spectrum: Spectrum,
    *,
    mas: float,
    noise: Noise | None = None,
) -> Mammogram:
    r"""Return an expected or noisy reading behind known lengths of tissue.

    In a bin of energy E, a pixel receives an expected

    .. math:: N_E = \text{mAs} \, \phi_E \, A \cos\theta \, (1000 / r)^2
              \exp\Big(-\sum_t \mu_t(E) L_t\Big)

    photons and reads :math:`\sum_E E N_E`. With noise, N is drawn from a Poisson distribution in
    each bin, and the electronics add a second Poisson process minus its mean.

    Parameters
    ----------
    lengths_mm : ndarray, shape (rows, columns, tissues)
    geometry, spectrum, mas, noise
        See `expose`.

    Raises
    ------
    InputError
        If the exposure is not positive.
    """
    if not mas > 0:
        raise InputError(f"The exposure must be positive, got {mas:g} mAs.")
    energies = spectrum.energies_kev
    attenuation = attenuation_table(energies)
    photons = mas * spectrum.photons_per_mm2_mas[:, None] * _weight_mm2(geometry).ravel()
    open_kev = (energies @ photons).reshape(geometry.rows, geometry.columns)
    energy = np.empty_like(open_kev)
    generator = None if noise is None else np.random.default_rng(noise.seed)
    for row in range(geometry.rows):  # row by row, to limit the memory of the energy bins
        part = photons[:, row * geometry.columns : (row + 1) * geometry.columns]
        counts = part * np.exp(-(attenuation.T @ lengths_mm[row].T.astype(np.float64)))
        if generator is not None:
            counts = generator.poisson(counts).astype(np.float64)
        energy[row] = energies @ counts
    if noise is not None and generator is not None and noise.electronic_kev > 0:
        events = generator.poisson(ELECTRONIC_EVENTS, energy.shape) - ELECTRONIC_EVENTS
        energy += events * (noise.electronic_kev / np.sqrt(ELECTRONIC_EVENTS))
    return Mammogram(energy, open_kev, geometry)


def _weight_mm2(geometry: Geometry) -> FloatArray:
    """Return each pixel's area as seen from the focal spot, scaled to the table's distance."""
    ray = geometry.pixels_mm - geometry.source_mm
    distance = np.linalg.norm(ray, axis=-1)
    normal = np.cross(geometry.down_mm, geometry.right_mm)  # its length is the pixel's area
    seen = np.abs(ray @ normal) / distance
    return np.asarray(seen * (TABLE_DISTANCE_MM / distance) ** 2)


# Percentiles of the pixels behind the body; darker and brighter values saturate.
PERCENTILES = (1.0, 99.5)
# Pixels with less attenuation than this, ln(open / energy), count as air.
AIR_ATTENUATION = 0.05
EQUAL_GREY = 128
# Fraction of the range of attenuations behind the body at which a difference saturates.
LARGEST_DIFFERENCE = 0.1


def presentation_values(mammogram: Mammogram, largest: int) -> NDArray[np.uint16]:
    """Return the log attenuation as whole numbers: dense tissue bright, air dark.

    Parameters
    ----------
    mammogram : Mammogram
    largest : int
        Value of the brightest pixel, up to 65535.

    Returns
    -------
    ndarray of uint16, shape (rows, columns)
    """
    attenuation = mammogram.log_attenuation
    low, high = window_of(attenuation)
    grey = np.clip((attenuation - low) / (high - low), 0.0, 1.0)
    return np.asarray(np.rint(grey * largest), np.uint16)


def processing_values(mammogram: Mammogram, largest: int) -> NDArray[np.uint16]:
    """Return the energy as whole numbers on a linear scale, with the open field at nine tenths.

    Parameters
    ----------
    mammogram : Mammogram
    largest : int
        Largest value, up to 65535.

    Returns
    -------
    ndarray of uint16, shape (rows, columns)
    """
    scale = 0.9 * largest / float(mammogram.open_kev.max())
    return np.asarray(np.rint(np.clip(mammogram.energy_kev * scale, 0, largest)), np.uint16)


def grey_picture(mammogram: Mammogram) -> NDArray[np.uint8]:
    """Return the 8-bit picture for presentation."""
    return presentation_values(mammogram, 255).astype(np.uint8)


def difference_picture(first: Mammogram, second: Mammogram) -> NDArray[np.uint8]:
    """Return the signed difference of attenuations (thesis Fig. 4.18): grey if equal.

    White (black) means that the first (second) attenuates more, by a tenth of the range of the
    first; differences between breasts are hundredths of that range.

    Raises
    ------
    InputError
        If the mammograms have different numbers of pixels.
    """
    a, b = first.log_attenuation, second.log_attenuation
    if a.shape != b.shape:
        raise InputError(
            f"The mammograms have different shapes, {a.shape} and {b.shape} pixels. Take both in "
            "the same geometry."
        )
    low, high = window_of(a)
    grey = EQUAL_GREY + 127 * (a - b) / (LARGEST_DIFFERENCE * (high - low))
    return np.asarray(np.rint(np.clip(grey, 0, 255)), np.uint8)


def window_of(attenuation: FloatArray) -> tuple[float, float]:
    """Return the darkest and brightest attenuation of a picture."""
    body = attenuation[attenuation > AIR_ATTENUATION]
    if not body.size:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(body, PERCENTILES))
    return low, max(high, low + 1e-6)


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
PIXEL_BITS = 14
LARGEST_PIXEL = 2**PIXEL_BITS - 1


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
    pixels = np.ascontiguousarray(make(mammogram, LARGEST_PIXEL), dtype="<u2")
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
        "BitsStored": PIXEL_BITS,
        "HighBit": PIXEL_BITS - 1,
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
        values["WindowCenter"] = (LARGEST_PIXEL + 1) // 2
        values["WindowWidth"] = LARGEST_PIXEL + 1
    return values


def _code(value: str, meaning: str) -> Dataset:
    """Return a SNOMED CT term."""
    item = Dataset()
    item.CodeValue = value
    item.CodingSchemeDesignator = "SCT"
    item.CodeMeaning = meaning
    return item

"""Valid files of every kind, the basis of damaged ones, and their readers."""

import hashlib
import io
import json
import tarfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import nibabel as nib
import nrrd
import numpy as np
import pydicom
import tifffile
from PIL import Image
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, SegmentationStorage, generate_uid

from palpate.service.study.study_archive import MANIFEST, import_study
from palpate.service.study.study_keys import read_spec
from palpate.workers.body.images.image_formats import read_volume_file
from palpate.workers.body.images.named_labels import read_label_file
from palpate.workers.mechanics.materials.law_fit import read_tables
from palpate.workers.organs.cornea.tonometer_frames import read_picture
from palpate.workers.organs.specimen.block_lattice import lattice
from palpate.workers.organs.specimen.mesh_file import read_mesh_file
from palpate.workers.tasks.diagnosis_sources import check_source, open_source
from tests.cases.bench.bench_cases import described, rows, text_of, write

UNIT = (1.0, 1.0, 1.0)
STUDY = """
name: demo
case:
  reference: {phantom: {preset: 445ml}}
  mesh: {nodes: 2000}
  load: {force_n: 60}
target: {constants: {E_fat_kpa: 10}}
search:
  parameters: {E_fat_kpa: [5, 20], eta_fat_kpa: [50, 200]}
  population: 12
"""
LAW_TABLE = "stretch,stress_kpa\n1.0,0\n1.1,2.1\n1.2,4.5\n1.3,7.2\n"


@dataclass(frozen=True)
class Seed:
    """A valid file of one kind.

    Parameters
    ----------
    reader : str
        Name of its reader, for tables.
    name : str
        Name of the file.
    make : callable
        Writes the file to a path.
    read : callable
        Reads the file at a path, as Palpate does.
    """

    reader: str
    name: str
    make: Callable[[Path], object]
    read: Callable[[Path], object]


def labels() -> np.ndarray:
    """A body of two tissues in air, [z, y, x]."""
    values = np.zeros((12, 14, 16), np.uint8)
    values[:10, 2:12, 3:13] = 1
    values[3:7, 5:9, 6:10] = 2
    return values


def volume(path: Path) -> object:
    """Read an image; spacing is given if the format has none."""
    stated = path.name.endswith((".npy", ".tif"))
    return read_volume_file(path, spacing_mm=UNIT if stated else None)


def nrrd_file(encoding: str) -> Callable[[Path], object]:
    header = {
        "space": "left-posterior-superior", "space directions": np.eye(3),
        "space origin": np.zeros(3), "encoding": encoding, "kinds": ["domain"] * 3,
        "Segment0_Name": "Fat", "Segment0_LabelValue": "1", "Segment1_Name": "Glandular",
        "Segment1_LabelValue": "2",
    }  # fmt: skip
    return lambda path: nrrd.write(str(path), labels().transpose(), header)


def nifti_file(kind: type) -> Callable[[Path], object]:
    affine = np.diag([-1.0, -1.0, 1.0, 1.0])
    return lambda path: nib.save(nib.Nifti1Image(labels().transpose().astype(kind), affine), path)


def tiff_file(**options: Any) -> Callable[[Path], object]:
    return lambda path: tifffile.imwrite(path, labels(), photometric="minisblack", **options)


def dicom_segmentation(path: Path) -> None:
    """Write a segmentation of one segment."""
    pixels = (labels() > 0).astype(np.uint8)
    image = _dicom(SegmentationStorage, pixels.shape[1:], 1)
    image.Modality, image.SegmentationType, image.NumberOfFrames = "SEG", "BINARY", len(pixels)
    shared, measures, plane = Dataset(), Dataset(), Dataset()
    measures.PixelSpacing = [1.0, 1.0]
    plane.ImageOrientationPatient = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = [measures], [plane]
    image.SharedFunctionalGroupsSequence = [shared]
    items = []
    for z in range(len(pixels)):
        item, place, named = Dataset(), Dataset(), Dataset()
        place.ImagePositionPatient = [0.0, 0.0, float(z)]
        named.ReferencedSegmentNumber = 1
        item.PlanePositionSequence, item.SegmentIdentificationSequence = [place], [named]
        items.append(item)
    image.PerFrameFunctionalGroupsSequence = items
    image.PixelData = np.packbits(pixels.ravel(), bitorder="little").tobytes()
    image["PixelData"].VR = "OB"
    pydicom.dcmwrite(path, image, enforce_file_format=True)


def dicom_slice(path: Path) -> None:
    """Write the second of two slices; the first one next to it stays intact."""
    uids = generate_uid(entropy_srcs=["series"])
    for z, place in enumerate((path.with_name("whole.dcm"), path)):
        image = _dicom(CTImageStorage, (14, 16), 16)
        image.Modality, image.SeriesInstanceUID = "CT", uids
        image.ImageOrientationPatient = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
        image.ImagePositionPatient, image.PixelSpacing = [0.0, 0.0, float(z)], [1.0, 1.0]
        image.PixelData = labels()[z].astype("<u2").tobytes()
        image["PixelData"].VR = "OW"
        pydicom.dcmwrite(place, image, enforce_file_format=True)


def _dicom(kind: str, shape: tuple[int, ...], bits: int) -> Dataset:
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = kind
    meta.MediaStorageSOPInstanceUID = generate_uid(entropy_srcs=["image"])
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    image = Dataset()
    image.file_meta = meta
    image.SOPClassUID, image.SOPInstanceUID = kind, meta.MediaStorageSOPInstanceUID
    image.SamplesPerPixel, image.PhotometricInterpretation = 1, "MONOCHROME2"
    image.Rows, image.Columns = shape
    image.BitsAllocated = image.BitsStored = bits
    image.HighBit, image.PixelRepresentation = bits - 1, 0
    return image


def mesh_file(binary: bool | None = None) -> Callable[[Path], object]:
    def make(path: Path) -> None:
        mesh = lattice((30.0, 30.0, 60.0), (3, 3, 4))
        options = {} if binary is None else {"binary": binary}
        kinds = {".msh": "gmsh22", ".inp": "abaqus"}
        kind = kinds.get(path.suffix)
        meshio.write(path, meshio.Mesh(mesh.nodes, [("tetra", mesh.tets)]), kind, **options)

    return make


def surface_file(path: Path) -> None:
    """Write a closed surface as a binary STL."""
    corners = np.array([[x, y, z] for x in (0, 30) for y in (0, 30) for z in (0, 60)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    meshio.write(path, meshio.Mesh(corners, [("triangle", np.array(triangles))]), binary=True)


def experiment_with(path: Path, changed: str) -> None:
    """Write an experiment, one file of which is damaged afterwards."""
    write(path.parent, described())
    if changed == "a.csv":
        path.write_text(text_of(rows()))


def archive_file(path: Path) -> None:
    """Write a file that looks like an archive of a study."""
    sha256 = {"study/study.yaml": hashlib.sha256(STUDY.encode()).hexdigest()}
    manifest = {"schema_version": 1, "study": "demo", "sha256": sha256}
    with tarfile.open(path, "w") as tar:
        for name, content in ((MANIFEST, json.dumps(manifest)), ("study/study.yaml", STUDY)):
            member = tarfile.TarInfo(name)
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content.encode()))


def unpack(path: Path) -> object:
    """Import an archive into a new store and folder."""
    scratch = path.parent / "imported"
    return import_study(path, scratch / "runs", str(scratch / "store"))


def picture(kind: str) -> Callable[[Path], object]:
    grey = np.random.default_rng(1).integers(0, 255, (60, 80)).astype(np.uint8)
    return lambda path: Image.fromarray(grey).save(path, kind)


def in_experiment(path: Path) -> object:
    """Read the experiment in the folder of a file."""
    source = open_source(path.parent / "experiment.yaml")
    check_source(source)
    return source


SEEDS = (
    Seed("NRRD", "raw.nrrd", nrrd_file("raw"), volume),
    Seed("NRRD", "gzip.nrrd", nrrd_file("gzip"), volume),
    Seed("NRRD", "text.nrrd", nrrd_file("ascii"), volume),
    Seed("NIfTI", "a.nii", nifti_file(np.uint8), volume),
    Seed("NIfTI", "float.nii", nifti_file(np.float32), volume),
    Seed("NIfTI", "a.nii.gz", nifti_file(np.int16), volume),
    Seed("TIFF", "plain.tif", tiff_file(), volume),
    Seed("TIFF", "deflated.tif", tiff_file(compression="zlib"), volume),
    Seed("TIFF", "ome.tif", tiff_file(ome=True, metadata={"axes": "ZYX"}), volume),
    Seed("TIFF", "imagej.tif", tiff_file(imagej=True, metadata={"axes": "ZYX"}), volume),
    Seed("NumPy", "a.npy", lambda path: np.save(path, labels()), volume),
    Seed("DICOM", "seg.dcm", dicom_segmentation, volume),
    Seed("DICOM", "slice.dcm", dicom_slice, lambda path: read_volume_file(path.parent)),
    Seed("mesh", "ascii.vtk", mesh_file(False), lambda path: read_mesh_file(path, 1.0)),
    Seed("mesh", "binary.vtk", mesh_file(True), lambda path: read_mesh_file(path, 1.0)),
    Seed("mesh", "a.vtu", mesh_file(), lambda path: read_mesh_file(path, 1.0)),
    Seed("mesh", "ascii.msh", mesh_file(False), lambda path: read_mesh_file(path, 1.0)),
    Seed("mesh", "binary.msh", mesh_file(True), lambda path: read_mesh_file(path, 1.0)),
    Seed("mesh", "a.inp", mesh_file(), lambda path: read_mesh_file(path, 1.0)),
    Seed("mesh", "a.stl", surface_file, lambda path: read_mesh_file(path, 1.0)),
    Seed("CSV", "a.csv", lambda path: experiment_with(path, "a.csv"), in_experiment),
    Seed("CSV", "law.csv", lambda path: path.write_text(LAW_TABLE), read_tables),
    Seed("YAML", "experiment.yaml", lambda path: experiment_with(path, ""), in_experiment),
    Seed("YAML", "study.yaml", lambda path: path.write_text(STUDY), read_spec),
    Seed("labels", "a.json", lambda p: p.write_text('{"fat": 1, "gland": 2}'), read_label_file),
    Seed("labels", "a.ctbl", lambda p: p.write_text("1 Fat 255 0 0 255\n"), read_label_file),
    Seed("picture", "a.png", picture("PNG"), read_picture),
    Seed("picture", "a.jpg", picture("JPEG"), read_picture),
    Seed("picture", "a.bmp", picture("BMP"), read_picture),
    Seed("archive", "a.tar", archive_file, unpack),
)

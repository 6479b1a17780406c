"""Headers that name other files, or claim more data than the file or memory can hold."""

import gzip
import io
import os
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nibabel as nib
import nrrd
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from pydicom.uid import DeflatedExplicitVRLittleEndian

from palpate.storage.errors import InputError
from palpate.workers.body.images.image_formats import read_volume_file
from palpate.workers.input_files import confined_to

UNIT = (1.0, 1.0, 1.0)
FOREIGN = np.random.default_rng(3).integers(1, 4, (4, 5, 6)).astype(np.uint8)
HEADER = b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 6 5 4\nencoding: raw\nspacings: 1 1 1\n"


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """Voxels of another user, next to the folder of an upload."""
    path = tmp_path / "foreign.raw"
    path.write_bytes(FOREIGN.tobytes())
    (tmp_path / "upload").mkdir()
    return path


SPELLINGS = [
    b"data file: NAME", b"datafile: NAME", b"DATA FILE: NAME", b"Data  File: NAME",
    b" data file: NAME", b"\tdata file: NAME", b"data\xc2\xa0file: NAME", b"da\xfcta file: NAME",
    b"data file:=NAME", b"datafile:=NAME", b"data file : NAME",
    b"#\n" * 300_000 + b"data file: NAME",
    b"content: x\rdata file: NAME", b"\xe2\x80\x8bdata file: NAME", b"data\x0bfile: NAME",
]  # fmt: skip


@pytest.mark.parametrize("spelling", SPELLINGS, ids=range(len(SPELLINGS)))
@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
def test_nrrd_never_opens_a_second_file(foreign: Path, spelling: bytes, end: bytes) -> None:
    path = foreign.parent / "upload" / "scan.nrrd"
    header = HEADER + spelling.replace(b"NAME", os.fsencode(foreign)) + b"\n\n"
    path.write_bytes(header.replace(b"\n", end))
    with pytest.raises(InputError, match=r"another file|not an NRRD field|cut short"):
        read_volume_file(path)


def test_detached_header_opens_its_data(foreign: Path) -> None:
    path = foreign.parent / "scan.nhdr"
    path.write_bytes(HEADER + b"data file: foreign.raw\n")
    np.testing.assert_array_equal(read_volume_file(path).values, FOREIGN)
    with (
        confined_to(foreign.parent / "upload"),
        pytest.raises(InputError, match="outside the uploaded folder"),
    ):
        read_volume_file(path)


def test_confined_header_opens_data_only_in_its_folder(foreign: Path) -> None:
    path = foreign.parent / "upload" / "scan.nhdr"
    path.write_bytes(HEADER + b"data file: ../foreign.raw\n")
    np.testing.assert_array_equal(read_volume_file(path).values, FOREIGN)
    with confined_to(path.parent), pytest.raises(InputError, match="outside the uploaded"):
        read_volume_file(path)


OME = (
    '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">'
    '<Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint8" SizeX="6" '
    'SizeY="5" SizeZ="4" SizeC="1" SizeT="1"><TiffData IFD="0" PlaneCount="4">'
    "<UUID {name}>urn:uuid:1b7b3a4c-0000-0000-0000-000000000000</UUID></TiffData></Pixels></Image>"
    "</OME>"
)


@pytest.mark.parametrize(
    "name", ['FileName="{}"', "FileName='{}'", 'FileName = "{}"', 'FileName="&#x2f;{}"']
)
def test_tiff_never_opens_a_second_file(foreign: Path, name: str) -> None:
    other = foreign.parent / "foreign.tif"
    tifffile.imwrite(other, FOREIGN, photometric="minisblack")
    path = foreign.parent / "upload" / "scan.tif"
    blank = np.zeros((1, 5, 6), np.uint8)
    text = OME.format(name=name.format(other))
    tifffile.imwrite(path, blank, description=text, metadata=None, photometric="minisblack")
    with pytest.raises(InputError):
        read_volume_file(path, spacing_mm=UNIT)


def test_other_kinds_of_tiff_open_no_index_file(
    foreign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    real = io.open

    def noted(file: Any, *more: Any, **options: Any) -> Any:
        opened.append(str(file))
        return real(file, *more, **options)

    path = foreign.parent / "upload" / "scan.tif"
    metadata = [(51123, 2, None, '{"Summary": {}, "a": 1}', False)]
    tifffile.imwrite(path, FOREIGN, extratags=metadata, metadata=None, photometric="minisblack")
    (path.parent / "NDTiff.index").write_bytes(b"\x01")
    monkeypatch.setattr("builtins.open", noted)
    np.testing.assert_array_equal(read_volume_file(path, spacing_mm=UNIT).values, FOREIGN)
    assert not [name for name in opened if name.endswith("NDTiff.index")]


def nifti(shape: tuple[int, ...], kind: type = np.uint8, **fields: Any) -> bytes:
    header = nib.Nifti1Header()
    header.set_data_dtype(kind)
    header.set_data_shape(shape)
    for name, value in ({"magic": b"n+1", "vox_offset": 352} | fields).items():
        header[name] = value
    return bytes(header.binaryblock) + bytes(4)


def npy(shape: str) -> bytes:
    text = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def zipped(content: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("arr.npy", content)
    return buffer.getvalue()


def sized(sizes: str, *lines: str, encoding: str = "raw") -> bytes:
    text = f"NRRD0004\ntype: uint8\ndimension: 3\nsizes: {sizes}\nencoding: {encoding}\n"
    return (text + "".join(f"{line}\n" for line in lines) + "spacings: 1 1 1\n\n").encode()


BOMB = gzip.compress(bytes(2**20))
CASES = {
    "more than the file": ("a.nrrd", sized("900 900 900")),
    "more than any memory": ("a.nrrd", sized("9000000 9000000 9000000")),
    "sizes beyond 64 bits": ("a.nrrd", sized("99999999999999999999 1 1")),
    "a size of 5,000 digits": ("a.nrrd", sized("9" * 5000 + " 1 1")),
    "no voxels": ("a.nrrd", sized("0 5 5")),
    "negative sizes": ("a.nrrd", sized("-1 -1 5")),
    "more than gzip can expand to": ("a.nrrd", sized("900 900 900", encoding="gzip") + BOMB),
    "less than gzip holds": ("a.nrrd", sized("6 5 4", encoding="gzip") + BOMB),
    "line skip without lines": ("a.nrrd", sized("6 5 4", "line skip: 999999999999") + bytes(120)),
    "negative line skip": ("a.nrrd", sized("6 5 4", "line skip: -5") + bytes(120)),
    "byte skip beyond the end": ("a.nrrd", sized("6 5 4", "byte skip: 99999999999") + bytes(120)),
    "byte skip of -1 in a short file": ("a.nrrd", sized("60 50 40", "byte skip: -1") + bytes(9)),
    "an unknown field": ("a.nrrd", sized("6 5 4", "include: /etc/passwd") + bytes(120)),
    "a field twice": ("a.nrrd", sized("6 5 4", "sizes: 6 5 4") + bytes(120)),
    "NIfTI: more than the file": ("a.nii", nifti((9000, 9000, 90))),
    "NIfTI: scaled beyond the memory": ("a.nii", nifti((9000, 900, 90), scl_slope=2)),
    "NIfTI: more than gzip can hold": ("a.nii.gz", gzip.compress(nifti((900, 900, 900)))),
    "NIfTI: voxels far behind": ("a.nii", nifti((5, 5, 5), vox_offset=3e9)),
    "NIfTI: a large extension": (
        "a.nii.gz",
        gzip.compress(
            nifti((5, 5, 5), vox_offset=2**24)[:348]
            + b"\1\0\0\0" + struct.pack("<ii", 2**31 - 16, 4) + bytes(2**20)
        ),
    ),
    "NumPy: more than the file": ("a.npy", npy("(900, 900, 900)")),
    "NumPy: more than any memory": ("a.npy", npy("(9000000, 9000000, 9000000)")),
    "NumPy: an archive": ("a.npy", zipped(npy("(5, 5, 5)") + bytes(125))),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_refuses_headers_that_claim_too_much(
    tmp_path: Path, case: str, peak_mib: Callable[[], float]
) -> None:
    name, content = CASES[case]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"a\.n"):
        read_volume_file(path)
    assert peak_mib() < 64


def test_tiff_strip_larger_than_its_page_is_refused(
    tmp_path: Path, peak_mib: Callable[[], float]
) -> None:
    path = tmp_path / "a.tif"
    values = np.random.default_rng(1).integers(0, 3, (4, 90, 80)).astype(np.uint8)
    tifffile.imwrite(path, values, compression="zlib", photometric="minisblack", rowsperstrip=90)
    np.testing.assert_array_equal(read_volume_file(path, spacing_mm=UNIT).values, values)
    stream = zlib.compressobj()
    bomb = b"".join(stream.compress(bytes(2**20)) for _ in range(96)) + stream.flush()
    with tifffile.TiffFile(path, mode="r+") as tiff:
        tags = tiff.pages[0].tags
        tags["StripOffsets"].overwrite((path.stat().st_size,))
        tags["StripByteCounts"].overwrite((len(bomb),))
    with path.open("ab") as file:
        file.write(bomb)
    with pytest.raises(InputError, match="has more pixels than its page"):
        read_volume_file(path, spacing_mm=UNIT)
    assert peak_mib() < 64


class TestDicom:
    def test_segmentation_with_slices_far_apart_is_refused_before_allocating(
        self, tmp_path: Path, write_segmentation: Any, peak_mib: Callable[[], float]
    ) -> None:
        frame = np.ones((1000, 1000), np.uint8)
        places = [0.0, 1.0, *(19.0 * n for n in range(1, 40))]
        path = write_segmentation(tmp_path / "a.dcm", [(1, z, frame) for z in places])
        before = peak_mib()
        with pytest.raises(InputError, match=r"742 x 1000 x 1000 voxels"):
            read_volume_file(path)
        assert peak_mib() <= before

    def test_refuses_deflated_file(self, tmp_path: Path, write_series: Any) -> None:
        values = np.ones((3, 5, 4), np.uint16)
        paths = write_series(tmp_path, values)
        for path in paths:
            content = path.read_bytes().replace(b"1.2.840.10008.1.2.1\0", b"1.2.840.10008.1.2.1.99")
            path.write_bytes(content)
        assert DeflatedExplicitVRLittleEndian == "1.2.840.10008.1.2.1.99"
        with pytest.raises(InputError):
            read_volume_file(tmp_path)

    @pytest.mark.parametrize(
        ("name", "value"),
        [("Rows", 65535), ("Columns", 65535), ("BitsAllocated", 7), ("SamplesPerPixel", 60000)],
    )
    def test_refuses_missing_pixels(
        self, tmp_path: Path, write_series: Any, name: str, value: int
    ) -> None:
        def change(_: int, image: Any) -> None:
            setattr(image, name, value)

        write_series(tmp_path, np.ones((3, 5, 4), np.uint16), change=change)
        with pytest.raises(InputError, match=str(tmp_path)):
            read_volume_file(tmp_path)


@pytest.mark.parametrize("suffix", [".nrrd", ".nii", ".nii.gz", ".npy", ".tif", ".dcm"])
def test_pipes_and_devices_are_refused(tmp_path: Path, suffix: str) -> None:
    pipe, device = tmp_path / f"pipe{suffix}", tmp_path / f"zero{suffix}"
    os.mkfifo(pipe)
    device.symlink_to("/dev/zero")
    for path in (pipe, device):
        with pytest.raises(InputError, match="a pipe or a device"):
            read_volume_file(path, spacing_mm=UNIT)


def test_headers_of_other_programs_are_read(tmp_path: Path) -> None:
    labels: NDArray[np.uint8] = FOREIGN.transpose()
    header = {
        "space": "left-posterior-superior",
        "space directions": np.eye(3),
        "space origin": np.zeros(3),
        "kinds": ["domain"] * 3,
        "Segment0_Name": "Druse: links",
    }
    for encoding in ("raw", "gzip", "bzip2", "ascii"):
        path = tmp_path / f"{encoding}.nrrd"
        nrrd.write(str(path), labels, header | {"encoding": encoding})
        path.write_bytes(path.read_bytes().replace(b"Druse", "Drüse".encode(), 1))
        np.testing.assert_array_equal(read_volume_file(path).values, FOREIGN)

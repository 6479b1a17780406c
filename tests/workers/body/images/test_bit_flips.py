"""Damage to compressed data: one changed bit is refused, or changes nothing.

A changed bit may be harmless: in the time, the name or the system of a gzip header, in the last,
unused bits of a stream, or where another distance leads to equal bytes. It then has to give the
same voxels. Adler-32, the checksum of deflate in TIFF, misses about one change in 2,000 of noise
(it is blind to +1 -1 -1 +1); none of the seeded ones is among them. PackBits and DICOM's RLE have
no checksum: no reader can see a changed pixel, but a changed length is refused.
"""

import bz2
import gzip
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import nibabel as nib
import nrrd
import numpy as np
import pydicom
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image
from pydicom.uid import RLELossless
from scipy.spatial import Delaunay

from palpate.storage.errors import InputError
from palpate.workers.body.images import nifti_images
from palpate.workers.body.images.image_formats import read_volume_file
from palpate.workers.organs.specimen.mesh_file import read_mesh_file

UNIT = (1.0, 1.0, 1.0)
LPS = {
    "space": "left-posterior-superior",
    "space directions": np.eye(3),
    "space origin": np.zeros(3),
}
Spans = list[tuple[int, int]]


def ball(n: int = 48) -> NDArray[np.uint8]:
    """Return labels 0, 1 and 2 of two balls, with noise in some slices."""
    z, y, x = np.mgrid[:n, :n, :n] - n / 2
    values = (x**2 + y**2 + z**2 < (0.4 * n) ** 2).astype(np.uint8)
    values[(x - 3) ** 2 + y**2 + z**2 < (0.2 * n) ** 2] = 2
    values[::12] = np.random.default_rng(0).integers(0, 3, values[::12].shape)
    return values


def write_nrrd(path: Path, encoding: str) -> tuple[Path, Spans]:
    """Return the file with the compressed voxels, and where in it they are."""
    nrrd.write(str(path), ball().transpose(), LPS | {"encoding": encoding})
    if path.suffix == ".nrrd":
        return path, [(path.read_bytes().index(b"\n\n") + 2, path.stat().st_size)]
    (data,) = (file for file in path.parent.iterdir() if file != path)
    return data, [(0, data.stat().st_size)]


def write_nifti(path: Path) -> tuple[Path, Spans]:
    nib.save(nib.Nifti1Image(ball().transpose(), np.diag([-1.0, -1.0, 1.0, 1.0])), path)
    return path, [(0, path.stat().st_size)]


def write_tiff(path: Path, **options: Any) -> tuple[Path, Spans]:
    tifffile.imwrite(path, ball(), photometric="minisblack", metadata=None, **options)
    with tifffile.TiffFile(path) as tiff:
        spans = [
            (start, start + count)
            for page in tiff.pages
            for start, count in zip(page.dataoffsets, page.databytecounts, strict=True)
        ]
    return path, spans


def write_vtu(path: Path, compression: str) -> tuple[Path, Spans]:
    points = np.random.default_rng(0).uniform(0, 20, (2000, 3))  # arrays of several blocks
    cells = Delaunay(points).simplices
    mesh = meshio.Mesh(points, [("tetra", cells)], cell_data={"label": [cells[:, 0] % 3]})
    meshio.vtu.write(path, mesh, compression=compression)
    arrays = re.finditer(rb'format="binary"[^>]*>\s*([\w+/=]+)', path.read_bytes())
    return path, [match.span(1) for match in arrays]


FORMATS: dict[str, Callable[[Path], tuple[Path, Spans]]] = {
    "gzip.nrrd": lambda path: write_nrrd(path, "gzip"),
    "gzip.nhdr": lambda path: write_nrrd(path, "gzip"),
    "bzip2.nrrd": lambda path: write_nrrd(path, "bzip2"),
    "bzip2.nhdr": lambda path: write_nrrd(path, "bzip2"),
    "whole.nii.gz": write_nifti,
    "deflate.tif": lambda path: write_tiff(path, compression="zlib"),
    "strips.tif": lambda path: write_tiff(path, compression="zlib", predictor=2, rowsperstrip=7),
    "lzma.tif": lambda path: write_tiff(path, compression="lzma"),
    "zlib.vtu": lambda path: write_vtu(path, "zlib"),
    "lzma.vtu": lambda path: write_vtu(path, "lzma"),
}
FLIPS = 200 // len(FORMATS)


def content(path: Path) -> tuple[Any, ...]:
    """Return all that a volume or a mesh consists of, as bytes and numbers."""
    if path.suffix == ".vtu":
        mesh = read_mesh_file(path, 1.0)
        labels = {name: values.tobytes() for name, values in mesh.labels.items()}
        return mesh.corners.shape, mesh.corners.tobytes(), mesh.cell.tobytes(), labels
    volume = read_volume_file(path, spacing_mm=UNIT)
    return volume.values.shape, volume.values.tobytes(), volume.spacing_mm, volume.origin_mm


def flip(path: Path, raw: bytes, bit: int) -> None:
    changed = bytearray(raw)
    changed[bit // 8] ^= 1 << bit % 8
    path.write_bytes(changed)


@pytest.mark.parametrize("name", FORMATS)
def test_a_flipped_bit_is_refused_or_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    # A NIfTI larger than this is not at its end when its header has been read.
    monkeypatch.setattr(nifti_images, "HEADER_BYTES", 4096)
    path = tmp_path / name
    data, spans = FORMATS[name](path)
    raw, whole = data.read_bytes(), content(path)
    bits = np.concatenate([np.arange(8 * start, 8 * end) for start, end in spans])
    refused = 0
    for bit in np.random.default_rng(2).choice(bits, FLIPS, replace=False):
        flip(data, raw, int(bit))
        try:
            same = content(path) == whole
        except InputError:
            refused += 1
        else:
            assert same, f"byte {bit // 8}, bit {bit % 8}"
    assert refused >= FLIPS // 2


@pytest.mark.parametrize("name", ["gzip.nrrd", "gzip.nhdr", "whole.nii.gz"])
def test_every_bit_of_a_gzip_checksum_and_length_counts(tmp_path: Path, name: str) -> None:
    data, _ = FORMATS[name](tmp_path / name)
    raw = data.read_bytes()
    for bit in range(8 * len(raw) - 64, 8 * len(raw)):
        flip(data, raw, bit)
        with pytest.raises(InputError, match=r"cannot be read as .*(CRC check|length of data)"):
            read_volume_file(tmp_path / name)


def test_the_time_in_a_gzip_header_is_not_data(tmp_path: Path) -> None:
    data, spans = write_nrrd(tmp_path / "a.nrrd", "gzip")
    raw, whole = data.read_bytes(), content(data)
    for bit in range(8 * (spans[0][0] + 4), 8 * (spans[0][0] + 8)):
        flip(data, raw, bit)
        assert content(data) == whole


class TestAfterTheVoxels:
    @pytest.mark.parametrize("name", ["gzip.nrrd", "bzip2.nrrd", "bzip2.nhdr", "whole.nii.gz"])
    def test_only_zeros_may_follow_a_stream(self, tmp_path: Path, name: str) -> None:
        data, _ = FORMATS[name](tmp_path / name)
        raw, whole = data.read_bytes(), content(tmp_path / name)
        data.write_bytes(raw + bytes(100_000))
        assert content(tmp_path / name) == whole
        for rest in (b"more", bytes(100_000) + b"\1"):
            data.write_bytes(raw + rest)
            with pytest.raises(InputError, match=r"cannot be read as .* damaged"):
                read_volume_file(tmp_path / name)

    @pytest.mark.parametrize("compress", [gzip.compress, bz2.compress])
    @pytest.mark.parametrize("between", [b"", bytes(70_000)])
    def test_every_stream_is_read(
        self, tmp_path: Path, compress: Callable[[bytes], bytes], between: bytes
    ) -> None:
        encoding = "gzip" if compress is gzip.compress else "bzip2"
        path = tmp_path / "a.nrrd"
        _, ((start, _),) = write_nrrd(path, encoding)
        head, voxels = path.read_bytes()[:start], ball().tobytes()
        first, second = compress(voxels[:5000]), compress(voxels[5000:])
        path.write_bytes(head + first + between + second)
        np.testing.assert_array_equal(read_volume_file(path).values, ball())
        # Without its magic number the second stream is no padding, even if it has no voxels.
        path.write_bytes(head + compress(voxels) + b"\1" + compress(b"")[1:])
        with pytest.raises(InputError, match="cannot be read as NRRD"):
            read_volume_file(path)

    def test_a_stream_without_its_end_is_refused(self, tmp_path: Path) -> None:
        for name in ("gzip.nrrd", "bzip2.nrrd", "whole.nii.gz"):
            data, _ = FORMATS[name](tmp_path / name)
            data.write_bytes(data.read_bytes()[:-1])
            with pytest.raises(InputError, match="cut short"):
                read_volume_file(tmp_path / name)

    @pytest.mark.parametrize("name", ["a.nii", "a.nii.gz", "a.npy"])
    def test_refuses_more_voxels_than_the_header_states(self, tmp_path: Path, name: str) -> None:
        path, opened = tmp_path / name, gzip.open if name.endswith(".gz") else open
        if name == "a.npy":
            np.save(path, ball())
        else:
            write_nifti(path)
        with opened(path, "rb") as file:
            raw = file.read()
        whole = content(path)
        for rest in (bytes(512), bytes(ball().nbytes), b"\1\2"):
            with opened(path, "wb") as file:
                file.write(raw + rest)
            if rest == bytes(512):
                assert content(path) == whole
                continue
            with pytest.raises(InputError, match="more voxels than its header states"):
                read_volume_file(path, spacing_mm=UNIT)

    def test_refuses_more_pixels_than_a_dicom_slice_has(
        self, tmp_path: Path, write_series: Any
    ) -> None:
        values = ball(8).astype(np.uint16)
        paths = write_series(tmp_path, values)
        image = pydicom.dcmread(paths[3])
        image.PixelData += bytes(16)
        image.save_as(paths[3])
        np.testing.assert_array_equal(read_volume_file(tmp_path).values, values)
        image.PixelData = image.PixelData[:-1] + b"\1"
        image.save_as(paths[3])
        with pytest.raises(InputError, match=rf"{paths[3].name} holds more voxels"):
            read_volume_file(tmp_path)


class TestWithoutChecksum:
    def test_packbits_must_expand_to_the_stated_size(self, tmp_path: Path) -> None:
        path = tmp_path / "a.tif"
        values = np.repeat(ball(16)[:, :, :1], 100, axis=2)  # rows are runs of 100
        pages = [Image.fromarray(page) for page in values]
        pages[0].save(path, save_all=True, append_images=pages[1:], compression="packbits")
        np.testing.assert_array_equal(read_volume_file(path, spacing_mm=UNIT).values, values)
        raw = path.read_bytes()
        with tifffile.TiffFile(path) as tiff:
            start = tiff.pages[5].dataoffsets[0]
        assert raw[start] == 257 - 100  # the length of the first run
        for bit in range(8 * start, 8 * start + 7):
            flip(path, raw, bit)
            with pytest.raises(
                InputError, match=r"part 1 of a page expands to \d+ bytes, expected"
            ):
                read_volume_file(path, spacing_mm=UNIT)

    @pytest.mark.filterwarnings("ignore")  # as for a user, whom pydicom only warns
    def test_dicom_runs_must_expand_to_the_stated_size(
        self, tmp_path: Path, write_series: Any
    ) -> None:
        values = np.repeat(ball(16)[:, :, :1], 100, axis=2).astype(np.uint16)
        paths = write_series(tmp_path, values)
        for path in paths:
            image = pydicom.dcmread(path)
            image.compress(RLELossless)
            image.save_as(path)
        np.testing.assert_array_equal(read_volume_file(tmp_path).values, values)
        raw = paths[5].read_bytes()
        run = raw.index(bytes([257 - 100]), raw.rindex(b"\xfe\xff\x00\xe0") + 72)
        for bit in range(8 * run, 8 * run + 7):
            flip(paths[5], raw, bit)
            with pytest.raises(InputError, match=rf"{paths[5].name}: the pixels cannot be read"):
                read_volume_file(tmp_path)

    def test_a_compression_that_is_not_read_is_named(self, tmp_path: Path) -> None:
        pages = [Image.fromarray(page) for page in ball(16)]
        options: dict[str, Any] = {"save_all": True, "append_images": pages[1:]}
        pages[0].save(tmp_path / "a.tif", compression="tiff_lzw", **options)
        with pytest.raises(
            InputError, match=r"compressed by LZW, which cannot be read here\. Save"
        ):
            read_volume_file(tmp_path / "a.tif", spacing_mm=UNIT)

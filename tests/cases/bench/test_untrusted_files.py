"""Untrusted experiment files: format strings, inconsistent headers, extreme numbers."""

import struct
from pathlib import Path

import numpy as np
import pytest
import yaml

from palpate.storage.errors import InputError
from palpate.workers.comparison.observation.number_table import read_table
from palpate.workers.input_files import confined_to
from palpate.workers.organs.cornea.tonometer_frames import read_picture
from palpate.workers.organs.specimen.experiment_files import read_experiment
from palpate.workers.organs.specimen.mesh_file import read_mesh_file
from palpate.workers.tasks.diagnosis_sources import open_source
from tests.cases.bench.bench_cases import described, write


@pytest.mark.parametrize(
    "column",
    [
        "{marker}_{axis}_{0}", "{marker}_{axis:>99999999999}", "{marker.__class__}{marker}{axis}",
        "{marker!r}_{axis}{marker}", "{{marker}}_{axis}{marker}", "{marker}_{axis}}",
        "{axis}{marker}{",
    ],
)  # fmt: skip
def test_column_names_are_not_format_strings(tmp_path: Path, column: str) -> None:
    data = described()
    data["markers"]["column"] = column
    with pytest.raises(InputError, match="column"):
        read_experiment(write(tmp_path, data))


def test_marker_names_are_not_placeholders(tmp_path: Path) -> None:
    data = described()
    data["markers"]["markers"]["{axis}"] = data["markers"]["markers"].pop("M1")
    with pytest.raises(InputError, match=r"lacks the columns \{axis\}_x_mm"):
        read_experiment(write(tmp_path, data))


@pytest.mark.parametrize("name", ["../foreign.csv", "{}/foreign.csv", "link.csv"])
def test_rejects_recordings_outside_of_an_upload(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "upload"
    folder.mkdir()
    path = write(folder, described())
    foreign = tmp_path / "foreign.csv"
    foreign.write_text((folder / "a.csv").read_text())
    (folder / "link.csv").symlink_to(foreign)
    data = yaml.safe_load(path.read_text())
    data["states"][0]["files"] = [name.format(tmp_path)]
    path.write_text(yaml.safe_dump(data))
    assert open_source(path).name == "block"
    with confined_to(folder), pytest.raises(InputError, match="outside the uploaded folder"):
        open_source(path)


def stl(facets: int, count: int) -> bytes:
    return b"binary".ljust(80) + struct.pack("<I", facets) + bytes(50 * count)


VTK = b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\n"
MESHES = {
    "empty.stl": b"",
    "short.stl": b"solid",
    "solid.stl": b"solid x\nendsolid x\n",
    "no_facets.stl": stl(0, 0),
    "count.stl": stl(2**32 - 1, 3),
    "flat.stl": stl(4, 4),
    "points.vtk": VTK + b"POINTS 9999999999 float\n0 0 0\n",
    "negative.vtk": VTK + b"POINTS -5 float\n0 0 0\n",
    "cells.vtk": VTK + b"POINTS 1 float\n0 0 0\nCELLS 99999999 999999999\n4 0 0 0 0\n",
    "far.vtk": VTK + b"POINTS 4 double\n0 0 0 1e308 0 0 0 1e308 0 0 0 1e308\nCELLS 1 5\n4 0 1 2 3\n"
    b"CELL_TYPES 1\n10\n",
    "nodes.msh": b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n99999999999\n1 0 0 0\n$EndNodes\n",
    "digits.msh": b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n" + b"9" * 5000 + b"\n",
    "include.inp": b"*NODE\n1, 0, 0, 0\n*INCLUDE, INPUT=/etc/passwd\n",
    "other.xdmf": b'<Xdmf><DataItem Format="HDF">/etc/passwd:/x</DataItem></Xdmf>',
}


@pytest.mark.parametrize("name", MESHES)
def test_rejects_inconsistent_meshes(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(MESHES[name])
    with pytest.raises(InputError, match=name):
        read_mesh_file(path, 1.0)


TABLES = {
    "5,000 digits": "t_s,x\n0,1\n1," + "9" * 5000 + "x\n",
    "a cell of a megabyte": "t_s,x\n0," + "1" * 2**20 + "\n",
    "ragged": "t_s,x\n0,1\n1\n2,3,4\n",
    "bytes": "t_s,x\n0,\0\n",
    "only a header": "t_s,x\n",
    "a header of 100,000 columns": ",".join(f"c{n}" for n in range(100_000)) + "\n1\n",
}


@pytest.mark.parametrize("table", TABLES)
def test_rejects_invalid_tables_briefly(tmp_path: Path, table: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(TABLES[table])
    with pytest.raises(InputError, match=r"a\.csv") as caught:
        read_table(path, ["t_s", "x"])
    assert len(str(caught.value)) < 1000


def test_rejects_huge_pictures_before_decoding(tmp_path: Path) -> None:
    # 30,000 x 30,000 pixels of one bit, run-length coded by hand: 1 KB.
    header = b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", 8)
    tags = [(256, 30_000), (257, 30_000), (258, 1), (259, 32773), (262, 1), (273, 110)]
    tags += [(278, 30_000), (279, 900)]
    header += b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    path = tmp_path / "a.tif"
    path.write_bytes(header + bytes(4) + b"\x81\xff" * 450)
    with pytest.raises(InputError, match=r"30000 x 30000 pixels|not an image"):
        read_picture(path)


@pytest.mark.parametrize(
    "change",
    [
        {"down": [0, 0, 1e308]},
        {"body": {"box_mm": [1e308, 30, 60]}},
        {"body": {"box_mm": [1e-308, 30, 60]}},
        {"name": "\0"},
        {"holds": [{"region": "bottom", "axes": ["z"] * 10_000}]},
    ],
)
def test_extreme_numbers_raise_input_errors_or_are_read(tmp_path: Path, change: dict) -> None:
    with np.errstate(all="ignore"):
        try:
            source = open_source(write(tmp_path, described() | change))
        except InputError:
            return
        assert source.content.record

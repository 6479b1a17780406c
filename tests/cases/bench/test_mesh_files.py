"""Mesh files: kinds of cells, decks, cavities, indices."""

import re
from itertools import product

import meshio
import numpy as np
import pytest

import palpate
from palpate.storage.errors import InputError
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles
from palpate.workers.organs.specimen.block_lattice import lattice
from palpate.workers.organs.specimen.experiment_files import READER, read_experiment
from palpate.workers.organs.specimen.mesh_file import VOLUMES, read_mesh_file
from palpate.workers.organs.specimen.specimen_keys import read_spec
from palpate.workers.organs.specimen.voxelised_mesh import body_of_file
from tests.cases.bench.bench_cases import described, write

SIZE = np.array([30.0, 30.0, 60.0])
VOLUME_ML = 54.0
HALF = 30.0


def bricks(low=(0, 0, 0), high=SIZE, count=(3, 3, 6)):
    """Return points and hexahedra of a box."""
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, count, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    step = np.array([(count[1] + 1) * (count[2] + 1), count[2] + 1, 1])
    first = np.array([np.dot(ijk, step) for ijk in product(*map(range, count))])
    ring = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    corners = [np.dot(c, step) for c in ring] + [np.dot(c, step) + step[2] for c in ring]
    return points, first[:, None] + np.array(corners)


def tetrahedra(low=(0, 0, 0), high=SIZE):
    """Return points and tetrahedra of a box, some of them with a negative orientation."""
    mesh = lattice(tuple(np.subtract(high, low)), (3, 3, 4))
    tets = mesh.tets.copy()
    tets[::3] = tets[::3][:, [1, 0, 2, 3]]
    return mesh.nodes + low, tets


def joined(*parts):
    """Join several parts, each with its own points, into one mesh."""
    points, blocks = [], []
    for (own, cells), kind in parts:
        blocks.append((kind, cells + sum(map(len, points))))
        points.append(own)
    return meshio.Mesh(np.concatenate(points), blocks)


def wedges():
    points, cells = bricks((0, 0, HALF), SIZE, (3, 3, 3))
    return points, np.concatenate([cells[:, [0, 1, 2, 4, 5, 6]], cells[:, [0, 2, 3, 4, 6, 7]]])


def pyramids():
    points, cells = bricks((0, 0, HALF), SIZE, (2, 2, 2))
    tops = len(points) + np.arange(len(cells))[:, None]
    faces = VOLUMES["hexahedron"][1]
    every = np.concatenate([np.hstack([cells[:, list(face)], tops]) for face in faces])
    return np.vstack([points, points[cells].mean(axis=1)]), every


def quadratic():
    points, tets = tetrahedra((0, 0, HALF))
    edges = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    middles = np.stack([points[tets[:, list(e)]].mean(axis=1) for e in edges], axis=1)
    number = len(points) + np.arange(len(tets) * 6).reshape(-1, 6)
    return np.vstack([points, middles.reshape(-1, 3)]), np.hstack([tets, number])


def voxels():
    points, cells = bricks((0, 0, HALF), SIZE, (3, 3, 3))
    return points, cells


UPPER = {
    "hexahedron": voxels(),
    "wedge": wedges(),
    "pyramid": pyramids(),
    "tetra10": quadratic(),
    "tetra": tetrahedra((0, 0, HALF)),
}
LOWER = tetrahedra((0, 0, 0), (30, 30, HALF))


def spec_of(folder, name, **body):
    data = described(body={"mesh": name, "voxel_mm": 2.0} | body)
    if "labels" in body:
        data["materials"] = {"gel": data["materials"]["gel"], "hard": data["materials"]["gel"]}
    return read_spec(write(folder, data))


def filled_ml(folder, mesh, name="a.vtk", **body):
    if isinstance(mesh, str):
        (folder / name).write_text(mesh)
    else:
        meshio.write(folder / name, mesh)
    volume, notes = body_of_file(spec_of(folder, name, **body), folder / name)
    return float((volume.values > 0).sum()) * volume.voxel_mm3 / 1000, notes


@pytest.mark.parametrize("kind", UPPER)
@pytest.mark.parametrize("suffix", ["vtk", "vtu", "inp"])
def test_reads_every_kind_of_volume_cell(tmp_path, kind, suffix):
    if suffix == "inp" and kind in ("pyramid", "wedge"):
        pytest.skip("meshio does not write these cells as .inp")
    mesh = joined((LOWER, "tetra"), (UPPER[kind], kind))
    found, notes = filled_ml(tmp_path, mesh, f"a.{suffix}")
    assert found == pytest.approx(VOLUME_ML)
    assert notes == ()


def test_leaves_out_triangles_next_to_volume_cells(tmp_path):
    plate = (np.array([[-50.0, -50, 60], [90, -50, 60], [0, 90, 60]]), np.array([[0, 1, 2]]))
    for kind in ("tetra", "tetra10"):
        body = tetrahedra() if kind == "tetra" else quadratic()
        wanted = VOLUME_ML if kind == "tetra" else VOLUME_ML / 2
        found, notes = filled_ml(tmp_path, joined((body, kind), (plate, "triangle")))
        assert found == pytest.approx(wanted)
        assert notes == ("1 surface cells of a.vtk are not part of the body.",)


def test_rejects_unsupported_cells_by_name_and_count(tmp_path, monkeypatch):
    cubic = (np.random.default_rng(0).uniform(0, 30, (20, 3)), np.arange(20)[None])
    mesh = joined((LOWER, "tetra"), (cubic, "tetra20"))
    monkeypatch.setattr(meshio, "read", lambda path: mesh)
    (tmp_path / "a.vtu").touch()
    with pytest.raises(InputError, match="unsupported cells: 1 tetra20"):
        read_mesh_file(tmp_path / "a.vtu", 1.0)


DECK = """*HEADING
*PART, NAME=A
*NODE
{nodes}
*ELEMENT, TYPE=C3D4
{cells}
*END PART
"""


def deck(mesh):
    points, tets = mesh
    nodes = "\n".join(f"{n}, {x}, {y}, {z}" for n, (x, y, z) in enumerate(points, start=1))
    cells = "\n".join(f"{n}, " + ", ".join(map(str, t + 1)) for n, t in enumerate(tets, start=1))
    return DECK.format(nodes=nodes, cells=cells)


INSTANCE = "*ASSEMBLY, NAME=X\n*INSTANCE, NAME=A-1, PART=A\n{}*END INSTANCE\n*END ASSEMBLY\n"


def test_reads_a_deck_of_one_part(tmp_path):
    text = deck(tetrahedra()) + INSTANCE.format("")
    assert filled_ml(tmp_path, text, "a.inp")[0] == pytest.approx(VOLUME_ML)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (INSTANCE.format("0., 0., 100.\n"), "a translation or rotation of an \\*INSTANCE"),
        (INSTANCE.format("") + INSTANCE.format(""), "a second \\*INSTANCE, after the one in line"),
        (DECK.format(nodes="1, 0, 0, 0", cells="1, 1, 1, 1, 1"), "a second \\*PART"),
        ("*NODE\n900, 0, 0, 0\n", "a second \\*NODE"),
        ("*SYSTEM\n0, 0, 1\n", "\\*SYSTEM"),
        ("*ELGEN\n1, 3\n", "\\*ELGEN"),
        ("*ELEMENT, TYPE=C3D4, INPUT=more.inp\n", "\\*ELEMENT with INPUT"),
    ],
)
def test_rejects_decks_with_unsupported_keywords(tmp_path, more, words):
    text = deck(tetrahedra()) + more
    with pytest.raises(InputError, match=rf"a\.inp, line \d+: {words}.* is not read"):
        filled_ml(tmp_path, text, "a.inp")


def box_surface(low, high):
    mesh = lattice(tuple(np.subtract(high, low)), (3, 3, 4))
    return mesh.nodes + low, boundary_triangles(mesh.tets)


def test_rejects_cavities_and_loose_pieces(tmp_path):
    outer = (box_surface((0, 0, 0), SIZE), "triangle")
    inner = (box_surface((5, 5, 10), (25, 25, 50)), "triangle")
    beside = (box_surface((50, 0, 0), (80, 30, 60)), "triangle")
    with pytest.raises(InputError, match=r"encloses a cavity of 16 ml; its total volume is 38 ml"):
        filled_ml(tmp_path, joined(outer, inner), "a.stl")
    with pytest.raises(InputError, match=r"has loose pieces of 54 ml; its total volume is 108 ml"):
        filled_ml(tmp_path, joined(outer, beside), "a.stl")
    solid = ((0, 0, 0), SIZE), ((50, 0, 0), (80, 30, 60))
    with pytest.raises(InputError, match="has loose pieces"):
        filled_ml(tmp_path, joined(*((tetrahedra(*ends), "tetra") for ends in solid)))


@pytest.mark.parametrize("flip", [False, True])
def test_duplicate_facets_count_once(tmp_path, flip):
    points, faces = box_surface((0, 0, 0), SIZE)
    again = faces[:, ::-1] if flip else faces
    mesh = joined(((points, faces), "triangle"), ((points, again), "triangle"))
    found, notes = filled_ml(tmp_path, mesh, "a.stl")
    assert found == pytest.approx(VOLUME_ML)
    assert notes == (f"{len(faces)} facets of a.stl are duplicates and counted once.",)


def test_fills_touching_bodies(tmp_path):
    halves = [((0, 0, 0), (30, 30, HALF)), ((0, 0, HALF), SIZE)]
    mesh = joined(*((box_surface(*ends), "triangle") for ends in halves))
    assert filled_ml(tmp_path, mesh, "a.stl")[0] == pytest.approx(VOLUME_ML)


def test_fills_a_surface_of_quadrilaterals(tmp_path):
    points, cells = bricks(count=(1, 1, 1))
    faces = np.concatenate([cells[:, list(face)] for face in VOLUMES["hexahedron"][1]])
    found, _ = filled_ml(tmp_path, meshio.Mesh(points, [("quad", faces)]))
    assert found == pytest.approx(VOLUME_ML)


@pytest.mark.parametrize("index", [-1, 10**6])
@pytest.mark.parametrize("kind", ["tetra", "triangle"])
def test_rejects_indices_without_a_point(tmp_path, index, kind, monkeypatch):
    points, cells = tetrahedra() if kind == "tetra" else box_surface((0, 0, 0), SIZE)
    cells = cells.copy()
    cells[7, 1] = index
    mesh = meshio.Mesh(points, [(kind, cells)])
    monkeypatch.setattr(meshio, "read", lambda path: mesh)
    (tmp_path / "a.vtk").touch()
    words = rf"cell 7 of {kind} refers to point {index}, counted from 0, but the file has"
    with pytest.raises(InputError, match=words):
        read_mesh_file(tmp_path / "a.vtk", 1.0)


def test_rejects_used_points_that_are_not_finite(tmp_path):
    points, tets = tetrahedra()
    unused = np.vstack([points, [[np.nan] * 3, [1e9] * 3]])
    assert filled_ml(tmp_path, meshio.Mesh(unused, [("tetra", tets)]))[0] == pytest.approx(
        VOLUME_ML
    )
    points[tets[5, 0]] = np.nan
    with pytest.raises(InputError, match="has coordinates that are not finite"):
        filled_ml(tmp_path, meshio.Mesh(points, [("tetra", tets)]))


def test_leaves_out_flat_cells_with_a_note(tmp_path):
    points, tets = tetrahedra()
    flat = np.vstack([tets, [tets[0, 0], tets[0, 1], tets[0, 1], tets[0, 2]]])
    found, notes = filled_ml(tmp_path, meshio.Mesh(points, [("tetra", flat)]))
    assert found == pytest.approx(VOLUME_ML)
    assert notes == (f"1 of {len(flat)} cells of a.vtk are flat and left out.",)
    with pytest.raises(InputError, match="all of them flat"):
        filled_ml(tmp_path, meshio.Mesh(points, [("tetra", flat[-1:])]))


def test_suggests_units_if_voxels_do_not_fit(tmp_path):
    points, tets = tetrahedra()
    metres = meshio.Mesh(points / 1000, [("tetra", tets)])
    with pytest.raises(InputError, match=r"Check body\.mm_per_unit: 1000 for a file in metres"):
        filled_ml(tmp_path, metres)
    assert filled_ml(tmp_path, metres, mm_per_unit=1000.0)[0] == pytest.approx(VOLUME_ML, rel=0.01)
    with pytest.raises(InputError, match=r"too small .* 0\.001 for one in micrometres"):
        filled_ml(tmp_path, meshio.Mesh(points * 1000, [("tetra", tets)]))


def test_physical_groups_label_all_blocks(tmp_path):
    mesh = joined((LOWER, "tetra"), (UPPER["hexahedron"], "hexahedron"))
    groups = [
        np.full(len(block.data), label) for block, label in zip(mesh.cells, (7, 9), strict=True)
    ]
    mesh.cell_data = {"gmsh:physical": groups, "gmsh:geometrical": [0 * g + 1 for g in groups]}
    meshio.write(tmp_path / "a.msh", mesh, file_format="gmsh22")
    spec = spec_of(tmp_path, "a.msh", labels={7: "gel", 9: "hard"})
    values = body_of_file(spec, tmp_path / "a.msh")[0].values
    half = len(values) // 2
    assert (values[:half] == spec.tissue_of("gel")).all()
    assert (values[half:] == spec.tissue_of("hard")).all()
    mesh.cell_data = {"kind": [g + 0.4 for g in groups]}
    meshio.write(tmp_path / "b.vtk", mesh)
    with pytest.raises(InputError, match="are not labels: not all are integers"):
        body_of_file(spec_of(tmp_path, "b.vtk", labels={7: "gel", 9: "hard"}), tmp_path / "b.vtk")


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.vtk", b"words"), ("a.msh", b"$MeshFormat\n9 0 8\n"), ("a.stl", b"\x00" * 90),
     ("a.inp", b"*NODE\n1, 2\n*ELEMENT, TYPE=C3D4\n1, 5, 6, 7, 8\n"), ("a.vtu", b"<VTKFile"),
     ("a.xyz", b"")],
)  # fmt: skip
def test_damaged_files_give_one_message(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name):
        read_mesh_file(tmp_path / name, 1.0)


def test_experiment_includes_notes_of_its_mesh(tmp_path):
    points, tets = tetrahedra()
    flat = np.vstack([tets, [tets[0, [0, 1, 1, 2]]]])
    meshio.write(tmp_path / "a.vtk", meshio.Mesh(points, [("tetra", flat)]))
    path = write(tmp_path, described(body={"mesh": "a.vtk", "voxel_mm": 2.0}))
    assert "flat and left out" in read_experiment(path).observed.notes[0]


def pieces(mesh, parts=2):
    """Return the text of a .vtu of the body in pieces, each with points of its own."""
    points, tets = mesh
    text = '<VTKFile type="UnstructuredGrid" version="0.1"><UnstructuredGrid>'
    for cells in np.array_split(tets, parts):
        used, index = np.unique(cells, return_inverse=True)
        arrays = {
            "connectivity": index.ravel(),
            "offsets": 4 * np.arange(1, len(cells) + 1),
            "types": np.full(len(cells), 10),
        }
        text += f'<Piece NumberOfPoints="{len(used)}" NumberOfCells="{len(cells)}"><Points>'
        text += '<DataArray type="Float64" NumberOfComponents="3" format="ascii">'
        text += " ".join(map(str, points[used].ravel())) + "</DataArray></Points><Cells>"
        for name, values in arrays.items():
            text += f'<DataArray type="Int64" Name="{name}" format="ascii">'
            text += " ".join(map(str, values)) + "</DataArray>"
        text += "</Cells></Piece>"
    return text + "</UnstructuredGrid></VTKFile>"


def test_refuses_a_vtu_of_which_pieces_are_lost(tmp_path):
    assert filled_ml(tmp_path, pieces(tetrahedra(), 1), "a.vtu")[0] == pytest.approx(VOLUME_ML)
    cells = len(tetrahedra()[1])
    words = rf"states 2 pieces with \d+ points and {cells} cells, but .* {cells // 2} cells can be"
    with pytest.raises(InputError, match=words):
        filled_ml(tmp_path, pieces(tetrahedra()), "a.vtu")


def test_refuses_files_of_which_points_or_cells_are_lost(tmp_path):
    body = joined((tetrahedra(), "tetra"))
    points, cells = len(body.points), len(body.cells[0].data)
    meshio.write(tmp_path / "a.msh", body, file_format="gmsh22", binary=False)
    text = (tmp_path / "a.msh").read_text()
    nodes = text[text.index("$Nodes") : text.index("$Elements")]
    words = rf"states 2 pieces with {2 * points} points and {cells} cells, but {points} points"
    with pytest.raises(InputError, match=words):
        filled_ml(tmp_path, text.replace(nodes, nodes * 2), "a.msh")
    meshio.write(tmp_path / "a.bdf", body, cell_format="fixed-large")
    with pytest.raises(InputError, match=rf"states .* and {cells} cells, but .* and 0 cells can"):
        read_mesh_file(tmp_path / "a.bdf", 1.0)
    surface = joined((box_surface((0, 0, 0), SIZE), "triangle"))
    meshio.write(tmp_path / "a.stl", surface, binary=True)
    (tmp_path / "a.stl").write_bytes((tmp_path / "a.stl").read_bytes() * 2)
    with pytest.raises(InputError, match=r"bytes follow them, perhaps a second solid"):
        read_mesh_file(tmp_path / "a.stl", 1.0)


COMPLETE = {
    "a.vtu": {}, "b.vtu": {"binary": False}, "a.vtk": {}, "b.vtk": {"binary": False},
    "c.vtk": {"file_format": "vtk42"}, "a.msh": {}, "b.msh": {"binary": False},
    "c.msh": {"file_format": "gmsh22"}, "a.mesh": {}, "a.bdf": {}, "a.inp": {},
}  # fmt: skip


@pytest.mark.parametrize("name", COMPLETE)
def test_reads_complete_files_of_every_format(tmp_path, name):
    meshio.write(tmp_path / name, joined((tetrahedra(), "tetra")), **COMPLETE[name])
    spec = spec_of(tmp_path, name)
    volume, notes = body_of_file(spec, tmp_path / name)
    assert float((volume.values > 0).sum()) * volume.voxel_mm3 / 1000 == pytest.approx(VOLUME_ML)
    assert notes == ()


@pytest.mark.parametrize("name", ["a.ply", "b.ply", "a.off", "a.obj", "a.stl", "b.stl"])
def test_reads_complete_surfaces_of_every_format(tmp_path, name):
    options = {} if name in ("a.off", "a.obj") else {"binary": name.startswith("a")}
    meshio.write(tmp_path / name, joined((box_surface((0, 0, 0), SIZE), "triangle")), **options)
    volume, _ = body_of_file(spec_of(tmp_path, name), tmp_path / name)
    assert float((volume.values > 0).sum()) * volume.voxel_mm3 / 1000 == pytest.approx(VOLUME_ML)


@pytest.mark.parametrize("kind", ["solid", "surface"])
def test_compares_the_volume_of_voxels_with_the_mesh(tmp_path, kind):
    """A bar of 20.6 x 20.6 x 20.1 mm becomes one of 21 x 21 x 20 mm."""
    size = (20.6, 20.6, 20.1)
    made = {"solid": tetrahedra, "surface": box_surface}[kind]((0, 0, 0), size)
    mesh = joined((made, "tetra" if kind == "solid" else "triangle"))
    meshio.write(tmp_path / "a.vtk", mesh)
    spec = spec_of(tmp_path, "a.vtk", voxel_mm=1.0)
    (note,) = body_of_file(spec, tmp_path / "a.vtk")[1]
    assert note.startswith("Voxels of 1 mm hold 8.82 ml, +3.4% against the 8.53 ml of a.vtk: 21 x")
    rows = dict(READER.understood(tmp_path / "experiment.yaml"))
    with pytest.warns(UserWarning, match="Voxels of 1 mm hold"):
        palpate.Specimen(tmp_path / "experiment.yaml")
    assert rows["size"] == "20.6 x 20.6 x 20.1 mm, 8.53 ml; 8.82 ml in voxels of 1 mm"
    spec = spec_of(tmp_path, "a.vtk", voxel_mm=0.1 if kind == "solid" else 0.5)
    assert body_of_file(spec, tmp_path / "a.vtk")[1] == ()


def test_refuses_a_surface_that_voxels_do_not_resolve(tmp_path):
    """A plate of 30 x 30 x 6 mm with two walls of 0.6 mm, which voxels of 3 mm leave out."""
    blocks = [((0, 0, 0), (30, 30, 6)), ((0, 0, 6), (30, 0.6, 60)), ((0, 29.4, 6), SIZE)]
    mesh = joined(*((box_surface(*ends), "triangle") for ends in blocks))
    meshio.write(tmp_path / "a.stl", mesh)
    with pytest.raises(
        InputError, match=r"The facets of .* enclose 7.344 ml, but fill 5.4 ml: they overlap"
    ):
        body_of_file(spec_of(tmp_path, "a.stl", voxel_mm=3.0), tmp_path / "a.stl")


def test_cells_in_several_groups_count_once(tmp_path):
    """As in files of Gmsh's version 2: once in the group of the body, once in that of a part."""
    mesh = joined((LOWER, "tetra"), (UPPER["tetra"], "tetra"))
    low, high = (len(block.data) for block in mesh.cells)
    cells = np.concatenate([block.data for block in mesh.cells])
    groups = np.concatenate([np.full(low + high, 1), np.full(low, 7), np.full(high, 9)])
    again = meshio.Mesh(
        mesh.points,
        [("tetra", np.concatenate([cells, cells[:, [2, 0, 1, 3]]]))],
        cell_data={"gmsh:physical": [groups], "gmsh:geometrical": [groups]},
    )
    meshio.write(tmp_path / "a.msh", again, file_format="gmsh22")
    for labels in ({}, {"labels": {7: "gel", 9: "hard"}}):
        spec = spec_of(tmp_path, "a.msh", **labels)
        volume, (note,) = body_of_file(spec, tmp_path / "a.msh")
        assert note.startswith(f"{low + high} of {2 * (low + high)} cells of a.msh have the corn")
        assert (volume.values > 0).sum() * volume.voxel_mm3 / 1000 == pytest.approx(VOLUME_ML)
    half = len(volume.values) // 2
    assert (volume.values[:half] == spec.tissue_of("gel")).all()
    assert (volume.values[half:] == spec.tissue_of("hard")).all()
    spec = spec_of(tmp_path, "a.msh", labels={1: "gel", 9: "hard"})
    with pytest.raises(InputError, match=r"has the labels \[1, 9\], which are of different mat"):
        body_of_file(spec, tmp_path / "a.msh")
    spec = spec_of(tmp_path, "a.msh", labels={7: "gel"})
    with pytest.raises(InputError, match=r"has the labels \[1\], which are missing"):
        body_of_file(spec, tmp_path / "a.msh")


def test_cells_with_copies_of_their_points_count_once(tmp_path):
    found, notes = filled_ml(tmp_path, joined((tetrahedra(), "tetra"), (tetrahedra(), "tetra")))
    assert found == pytest.approx(VOLUME_ML)
    assert "are counted once" in notes[0]


DIALECTS = {
    "hybrid": lambda text: text.replace("C3D4", "C3D4H"),
    "small letters": str.lower,
    "trailing commas": lambda text: re.sub(r"(?m)^(\d.*)$", r"\1,", text),
    "spaces": lambda text: re.sub(r"(?m)^", "  ", text.replace("TYPE=", "TYPE = ")),
    "a comment within": lambda text: text.replace("\n3, ", "\n** here\n3, "),
    "a keyword in two lines": lambda text: text.replace("=C3D4", "=C3D4,\nELSET=ALL"),
    "bars beside": lambda text: text + "*ELEMENT, TYPE=B31\n9001, 1, 2\n",
    "Windows": lambda text: text.replace("\n", "\r\n"),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_reads_dialects_of_a_deck(tmp_path, dialect):
    text = DIALECTS[dialect](deck(tetrahedra()))
    assert filled_ml(tmp_path, text, "a.inp") == (pytest.approx(VOLUME_ML), ())


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("TYPE=C3D4", "TYPE=C3D27", r"line \d+: elements of TYPE=C3D27 are not read. Bodies cons"),
        ("\n3, ", "\n3; ", r"line 6: a node needs its number and three coordinates, found '3; "),
        ("\n3, 0.0,", "\n3, ", r"line 6: a node needs its number and three coordinates"),
        ("\n3, ", "\n9999, ", r"its elements refer to the node 3, which is not under \*NODE \(1 "),
        ("*END PART", "7, 1, 2\n*END PART", r"elements of 4 nodes \(tetra\) need 5 numbers each"),
        ("*END PART", "7, 1, 2, x\n", r"line \d+: an element needs whole numbers, its own"),
    ],
)
def test_names_the_line_of_a_fault_in_a_deck(tmp_path, old, new, words):
    text = deck(tetrahedra()).replace(old, new, 1)
    with pytest.raises(InputError, match=words):
        filled_ml(tmp_path, text, "a.inp")


def obj(vertex="v {} {} {}", face="f {} {} {}", back=False):
    points, faces = box_surface((0, 0, 0), SIZE)
    numbers = faces - len(points) if back else faces + 1
    head = "o body\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\nusemtl skin\ns off\n"
    lines = [vertex.format(*p) for p in points] + [face.format(*n) for n in numbers]
    return head + "\n".join(lines)


@pytest.mark.parametrize(
    "text",
    [obj(), obj(face="f {}/1/1 {}/2/1 {}/3/1"), obj(face="f {}//1 {}//1 {}//1"), obj(back=True),
     obj(back=True, face="f {}/-1/-1 {}/-2/-1 {}/-3/-1"), obj("v {} {} {} 0.5 0.25 1"),
     obj("v {} {} {} 1.0"), obj(face="f {} {} \\\n {} # here")],
)  # fmt: skip
def test_reads_dialects_of_obj(tmp_path, text):
    assert filled_ml(tmp_path, text, "a.obj")[0] == pytest.approx(VOLUME_ML)


@pytest.mark.parametrize(
    "line", ["f 1 2 x", "f 1 2", "f 0 1 2", "f 1 2 -9999", "v 1 2", "f 1 2 3 4 5"]
)
def test_names_the_line_of_a_fault_in_obj(tmp_path, line):
    text = obj()
    with pytest.raises(
        InputError, match=rf"a.obj, line {len(text.splitlines()) + 1}: found '{line}'"
    ):
        filled_ml(tmp_path, text + "\n" + line, "a.obj")


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.vtk", "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 0 float\n"),
     ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n4 0 1 2 0\n"), ("a.ply", "ply\nformat x\n")],
)  # fmt: skip
def test_says_what_to_do_if_a_library_cannot_read_a_mesh(tmp_path, name, content):
    (tmp_path / name).write_text(content)
    words = rf"{name} cannot be read as a mesh: it is damaged, or \{name[1:]} of this form is not"
    with pytest.raises(InputError, match=words + r".* Export it again, as one unstructured grid"):
        read_mesh_file(tmp_path / name, 1.0)

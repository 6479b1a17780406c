"""A body solved again, and its solution as files: mesh with fields, surface, series of meshes.

A study stores no whole solution, so a body is solved once more before it is exported. The mesh has
displacement, stress, strain and volume change.

A surface is a binary ``.stl``: a header of 80 bytes, the number of triangles, and for each its unit
normal, three corners and two spare bytes, all little-endian in single precision. STL has no units;
coordinates are in mm.

A series for ParaView moves from rest to load: the displacement of the solution is scaled from 0 to
1. These are not load steps: in between the body is not in equilibrium, so the meshes have no
stress.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np

from palpate.service.export.exported_mesh import export_mesh
from palpate.storage.backends.atomic_files import explained, write_file
from palpate.storage.errors import InputError
from palpate.storage.store import open_store
from palpate.storage.values import FloatArray, IntArray, SpecJson, TetMesh, Volume
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium, equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.mesh_level import Level
from palpate.workers.mechanics.fem.stress_fields import ElementFields, element_fields
from palpate.workers.tasks.pipeline import Setup
from palpate.workers.tasks.study_tasks import case_of, case_organ, make_target, prepare_case
from palpate.workers.tasks.task_store import BodyStore


@dataclass(frozen=True, eq=False)
class SolvedBody:
    """A body in equilibrium.

    Parameters
    ----------
    title : str
        Body and constants, for the header of a file.
    setup : Setup
    constants : mapping of str to float
        All parameters, in internal names and units.
    solved : Equilibrium
    """

    title: str
    setup: Setup
    constants: Mapping[str, float]
    solved: Equilibrium

    @property
    def level(self) -> Level:
        """Return the finest mesh with its problem."""
        return self.solved.levels[-1]

    @property
    def positions_mm(self) -> FloatArray:
        """Return the positions of the nodes, shape (n, 3)."""
        return self.solved.states[-1].x

    @property
    def displacement_mm(self) -> FloatArray:
        """Return the displacements from the imaged shape, shape (n, 3)."""
        return self.solved.solution.displacement_mm

    @cached_property
    def fields(self) -> ElementFields:
        """Return stress and strain."""
        return element_fields(self.level, self.positions_mm)

    def deformed_labels(self) -> Volume:
        """Return the deformed body as labelled voxels."""
        organ = self.setup.organ
        deformed = organ.deform(self.setup.body, self.setup.mesh, self.displacement_mm)
        return organ.picture(deformed)

    def under(self, problem: Problem) -> "SolvedBody":
        """Return the same body, solved for another problem.

        Raises
        ------
        InputError
            If the simulation does not converge.
        """
        return replace(self, solved=_solve_again(self.setup, problem))


def solve_body(
    case: SpecJson,
    constants: Mapping[str, float],
    store: str,
    title: str,
    target: SpecJson | None = None,
) -> SolvedBody:
    """Solve the body of a case under its load.

    Parameters
    ----------
    case : mapping
        In the format of `CaseSpec`.
    constants : mapping of str to float
        In internal names and units; missing ones are taken from the case.
    store : str
        Location of the store, which keeps body and mesh.
    title : str
    target : mapping, optional
        In the format of `TargetSpec`. Plates at a given distance are placed as in an imaged target.

    Raises
    ------
    InputError
        If the simulation does not converge, or the organ has no tetrahedra.
    """
    spec = case_of(case)
    prepared = prepare_case(case, store)
    digests = {"volume": prepared["volume"], "mesh": prepared["mesh"]}
    imaged = target is not None and target.get("constants") is None
    shown = make_target(case, target, store)["target"] if target and imaged else None
    setup = BodyStore(open_store(store), case_organ(case)).setup(spec, digests, shown)
    values = spec.complete(constants)
    problem: Any = setup.organ.problem(
        setup.model, spec, values, setup.landmarks, setup.target_landmarks
    )
    if not isinstance(problem, Problem):
        raise InputError(
            f"A {spec.organ} cannot be exported: expected a body of tetrahedra, such as a breast."
        )
    return SolvedBody(title, setup, values, _solve_again(setup, problem))


def _solve_again(setup: Setup, problem: Problem) -> Equilibrium:
    solved = equilibrium(setup.model, problem)
    outcome = solved.solution.outcome
    if not outcome.converged:
        raise InputError(
            f"There is nothing to export because the simulation diverged: {outcome.reason}. "
            "Choose other constants, a smaller load or another mesh."
        )
    return solved


# The order of a symmetric tensor's six components in ParaView and Gmsh.
SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


@dataclass(frozen=True, eq=False)
class MeshData:
    """A deformed mesh with values at its nodes and in its elements.

    At the nodes ``displacement_mm``, ``volume_ratio`` (J) and ``pressure_kpa``; in the elements
    ``tissue``, ``volume_ratio``, ``pressure_kpa``, ``von_mises_kpa``, and as six components xx, yy,
    zz, xy, yz, xz ``cauchy_stress_kpa`` and ``green_strain``.

    Parameters
    ----------
    mesh : TetMesh
    points, cells : dict of str to ndarray
        Values at the n nodes, shape (n,) or (n, 3), and in the m elements, shape (m,) or (m, 6).
    """

    mesh: TetMesh
    points: dict[str, FloatArray]
    cells: dict[str, FloatArray | IntArray]


def mesh_data(
    deformed: TetMesh, displacement_mm: FloatArray, tissue: IntArray, fields: ElementFields
) -> MeshData:
    """Return a deformed mesh with all values that are written to files.

    Parameters
    ----------
    deformed : TetMesh
        A mesh with n nodes and m elements.
    displacement_mm : ndarray, shape (n, 3)
    tissue : ndarray of int32, shape (m,)
    fields : ElementFields
    """
    points = {
        "displacement_mm": displacement_mm,
        "volume_ratio": fields.node_volume_ratio,
        "pressure_kpa": 1e3 * fields.node_pressure_mpa,
    }
    cells: dict[str, FloatArray | IntArray] = {
        "tissue": tissue,
        "volume_ratio": fields.volume_ratio,
        "pressure_kpa": 1e3 * fields.pressure_mpa,
        "von_mises_kpa": 1e3 * fields.von_mises_mpa,
        "cauchy_stress_kpa": 1e3 * _six_components(fields.cauchy_mpa),
        "green_strain": _six_components(fields.green_strain),
    }
    return MeshData(deformed, points, cells)


def export_solved_mesh(path: Path, body: SolvedBody) -> None:
    """Write the deformed mesh with the values in `MeshData`.

    Raises
    ------
    InputError
        If the suffix is unknown.
    StoreError
        If the file cannot be written.
    """
    model = body.level.model
    tissue = model.fractions.argmax(axis=1).astype(np.int32)
    deformed = TetMesh(body.positions_mm, model.elements.tets)
    data = mesh_data(deformed, body.displacement_mm, tissue, body.fields)
    export_mesh(path, data.mesh, data.points, data.cells)


def _six_components(tensors: FloatArray) -> FloatArray:
    """Return the components xx, yy, zz, xy, yz, xz, shape (m, 6)."""
    return np.stack([tensors[:, i, j] for i, j in SYMMETRIC], axis=1)


TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])


def export_surface(path: Path, nodes: FloatArray, triangles: IntArray) -> None:
    """Write triangles.

    Parameters
    ----------
    path : Path
    nodes : ndarray, shape (n, 3)
        In mm.
    triangles : ndarray, shape (k, 3)
        Corners, counter-clockwise when seen from outside.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    corners = nodes[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    written = np.zeros(len(triangles), TRIANGLE)
    written["normal"] = normal / np.maximum(size, 1e-30)
    written["corners"] = corners
    # A binary file must not begin with "solid", which marks a text file.
    header = b"Palpate, units mm".ljust(80) + np.uint32(len(triangles)).tobytes()
    with explained(path):
        write_file(path, header + written.tobytes())


SERIES_NOTE = "displacement scaled from 0 to 1, not load steps"
SERIES_STEPS = 10


def export_series(path: Path, body: SolvedBody) -> None:
    """Write a ``.pvd`` and a ``.vtu`` for each step, in a folder of the same name next to it.

    Each mesh has ``displacement_mm`` at its nodes and ``tissue`` in its elements; the time is the
    fraction of the displacement.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    folder = path.with_suffix("")
    with explained(folder):
        folder.mkdir(exist_ok=True)
    tissue = body.level.model.fractions.argmax(axis=1).astype(np.int32)
    tets = body.level.model.elements.tets
    root = Xml.Element("VTKFile", type="Collection", version="0.1")
    root.append(Xml.Comment(f" {body.title}: {SERIES_NOTE} "))
    collection = Xml.SubElement(root, "Collection")
    for step in range(SERIES_STEPS + 1):
        share = step / SERIES_STEPS
        name = f"{folder.name}_{step:02d}.vtu"
        moved = share * body.displacement_mm
        mesh = TetMesh(rest_of(body) + moved, tets)
        export_mesh(folder / name, mesh, {"displacement_mm": moved}, {"tissue": tissue})
        attributes = {"timestep": f"{share:g}", "part": "0", "file": f"{folder.name}/{name}"}
        Xml.SubElement(collection, "DataSet", attributes)
    Xml.indent(root)
    write_file(path, Xml.tostring(root, encoding="utf-8", xml_declaration=True))


def rest_of(body: SolvedBody) -> FloatArray:
    """Return the nodes of the imaged shape, shape (n, 3)."""
    return body.positions_mm - body.displacement_mm

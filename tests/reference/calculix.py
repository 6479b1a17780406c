"""CalculiX (`ccx`) as an independent solver for a body of linear tetrahedra.

The body is neo-Hookean. CalculiX writes the law as
``W = C10 (I1bar - 3) + (J - 1)^2 / D1`` (manual, *HYPERELASTIC), which equals ours with
C10 = mu / 2 and D1 = 2 / kappa. A C3D4 element has one integration point and no remedy for
locking, like our plain element.

The deck uses fields of at most 20 characters, the most that CalculiX reads.
"""

import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.storage.values import FloatArray, IntArray, TetMesh, Triple

GRAVITY_MM_PER_S2 = 9806.65
# Out-of-balance force over the mean nodal force, and last correction over the
# increment; the defaults of CalculiX are 5e-3 and 1e-2.
RESIDUAL, CORRECTION = 1e-6, 1e-5
# Faces P1 to P4 of C3D4, as corners of the tetrahedron.
FACES = ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0))


@dataclass(frozen=True, eq=False)
class Material:
    """A neo-Hookean solid in the elements `tets` (row numbers of the mesh)."""

    tets: IntArray
    mu_mpa: float
    kappa_mpa: float
    density_t_per_mm3: float = 1e-9


@dataclass(frozen=True, eq=False)
class Held:
    """Nodes with one displacement component (axis 0, 1 or 2) prescribed, in mm."""

    nodes: IntArray
    axis: int
    value_mm: float | FloatArray = 0.0


@dataclass(frozen=True, eq=False)
class Springs:
    """One spring per node, along an axis, to a rigid ground that moves by `ground_mm`.

    With ``ground_mm = 0`` this is an elastic foundation. On a flat face it is a frictionless
    plate with a penalty, as long as every spring is compressed.
    """

    nodes: IntArray
    axis: int
    n_per_mm: FloatArray
    ground_mm: float = 0.0


@dataclass(frozen=True, eq=False)
class Body:
    """The model for CalculiX.

    Parameters
    ----------
    mesh : TetMesh
    materials : tuple of Material
        Each element belongs to exactly one material.
    held : tuple of Held
    springs : tuple of Springs
    forces_n : ndarray, shape (n, 3), optional
        Forces on the nodes.
    pressure_mpa : float
        Follower pressure, inwards, on the triangles `pressed`, shape (k, 3).
    gravity_g : tuple of float
        Body force in multiples of gravity.
    """

    mesh: TetMesh
    materials: tuple[Material, ...]
    held: tuple[Held, ...] = ()
    springs: tuple[Springs, ...] = ()
    forces_n: FloatArray | None = None
    pressure_mpa: float = 0.0
    pressed: IntArray | None = None
    gravity_g: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Answer:
    """The solution of CalculiX.

    Parameters
    ----------
    displacement_mm : ndarray, shape (n, 3)
    ground_n : tuple of float
        Force that moves each ground, along the axis of its springs.
    seconds : float
        Run time of `ccx`, without writing and reading.
    """

    displacement_mm: FloatArray
    ground_n: tuple[float, ...]
    seconds: float


def available() -> bool:
    """Return True if `ccx` can be run."""
    return shutil.which("ccx") is not None


def solve(body: Body, *, first_increment: float = 0.25, tight: bool = True) -> Answer:
    """Return the equilibrium of the body.

    Parameters
    ----------
    body : Body
    first_increment : float
        Initial fraction of the load.
    tight : bool
        Iterate to `RESIDUAL` and `CORRECTION` instead of CalculiX's own tolerances.

    Raises
    ------
    RuntimeError
        If CalculiX does not reach the end of the load.
    """
    with tempfile.TemporaryDirectory() as folder:
        deck = Path(folder) / "body.inp"
        parts = (_nodes(body), _elements(body), _springs(body), _step(body, first_increment, tight))
        deck.write_text("".join(f"{line}\n" for part in parts for line in part))
        begun = time.perf_counter()
        done = subprocess.run(
            ["ccx", "-i", deck.stem], cwd=folder, capture_output=True, text=True, check=False
        )
        seconds = time.perf_counter() - begun
        if done.returncode or "Job finished" not in done.stdout:
            raise RuntimeError("CalculiX gave up:\n" + "\n".join(done.stdout.splitlines()[-20:]))
        n = len(body.mesh.nodes)
        moved, force = _last_tables(deck.with_suffix(".dat"), n + len(body.springs))
    ground = tuple(float(force[n + k, s.axis]) for k, s in enumerate(body.springs))
    return Answer(moved[:n], ground, seconds)


def _nodes(body: Body) -> Iterator[str]:
    """Yield the nodes of the mesh, then one for each ground."""
    yield "*NODE,NSET=ALL"
    for number, (x, y, z) in enumerate(body.mesh.nodes, 1):
        yield f"{number},{x:.12g},{y:.12g},{z:.12g}"
    for k in range(len(body.springs)):
        yield f"{_ground(body, k)},0.,0.,0."


def _ground(body: Body, k: int) -> int:
    return len(body.mesh.nodes) + k + 1


def _elements(body: Body) -> Iterator[str]:
    for k, material in enumerate(body.materials):
        yield f"*ELEMENT,TYPE=C3D4,ELSET=PART{k}"
        for tet in material.tets:
            a, b, c, d = body.mesh.tets[tet] + 1
            yield f"{tet + 1},{a},{b},{c},{d}"
        yield f"*MATERIAL,NAME=M{k}"
        yield "*HYPERELASTIC,NEO HOOKE"
        yield f"{material.mu_mpa / 2:.12g},{2 / material.kappa_mpa:.12g}"
        yield "*DENSITY"
        yield f"{material.density_t_per_mm3:.12g}"
        yield f"*SOLID SECTION,ELSET=PART{k},MATERIAL=M{k}"
    yield "*ELSET,ELSET=BODY"
    yield from (f"PART{k}" for k in range(len(body.materials)))


def _springs(body: Body) -> Iterator[str]:
    """Yield springs, one card for each stiffness, because each card counts as a material."""
    number = len(body.mesh.tets)
    for k, springs in enumerate(body.springs):
        stiffness, group = np.unique(springs.n_per_mm.round(12), return_inverse=True)
        for g, n_per_mm in enumerate(stiffness):
            yield f"*ELEMENT,TYPE=SPRING2,ELSET=S{k}G{g}"
            for node in springs.nodes[group == g]:
                number += 1
                yield f"{number},{_ground(body, k)},{node + 1}"
            yield f"*SPRING,ELSET=S{k}G{g}"
            yield f"{springs.axis + 1},{springs.axis + 1}"
            # Without the decimal point it would be read as a degree of freedom.
            yield f"{n_per_mm:#.12g}"


def _step(body: Body, first_increment: float, tight: bool) -> Iterator[str]:
    yield "*STEP,NLGEOM,INC=1000"
    yield "*STATIC"
    yield f"{first_increment:.12g},1."
    if tight:
        yield "*CONTROLS,PARAMETERS=FIELD"
        yield f"{RESIDUAL},{CORRECTION},,,{RESIDUAL}"
    yield "*BOUNDARY"
    for held in body.held:
        values = np.broadcast_to(held.value_mm, len(held.nodes))
        for node, value in zip(held.nodes, values, strict=True):
            yield f"{node + 1},{held.axis + 1},{held.axis + 1},{value:.12g}"
    for k, springs in enumerate(body.springs):
        for axis in range(3):
            value = springs.ground_mm if axis == springs.axis else 0.0
            yield f"{_ground(body, k)},{axis + 1},{axis + 1},{value:.12g}"
    yield from _loads(body)
    yield "*NODE PRINT,NSET=ALL,FREQUENCY=10000"
    yield "U,RF"
    yield "*END STEP"


def _loads(body: Body) -> Iterator[str]:
    size = float(np.linalg.norm(body.gravity_g))
    if size:
        x, y, z = (component / size for component in body.gravity_g)
        yield "*DLOAD"
        yield f"BODY,GRAV,{size * GRAVITY_MM_PER_S2:.12g},{x:.12g},{y:.12g},{z:.12g}"
    if body.pressed is not None:
        yield "*DLOAD"
        for tet, face in _element_faces(body.mesh, body.pressed):
            yield f"{tet + 1},P{face + 1},{body.pressure_mpa:.12g}"
    if body.forces_n is not None:
        yield "*CLOAD"
        for node, axis in zip(*np.nonzero(body.forces_n), strict=True):
            yield f"{node + 1},{axis + 1},{body.forces_n[node, axis]:.12g}"


def _element_faces(mesh: TetMesh, triangles: IntArray) -> Iterator[tuple[int, int]]:
    """Return the element and its face number for each triangle."""
    owner = {
        frozenset(tet[list(corners)].tolist()): (e, face)
        for e, tet in enumerate(mesh.tets)
        for face, corners in enumerate(FACES)
    }
    return (owner[frozenset(triangle.tolist())] for triangle in triangles)


def _last_tables(path: Path, n: int) -> tuple[FloatArray, FloatArray]:
    """Return displacement and force at the final load, shape (n, 3) each, from a .dat file."""
    rows = [line.split() for line in path.read_text().splitlines()]
    numbers = np.array([row for row in rows if len(row) == 4 and row[0].isdigit()], dtype=float)
    tables = numbers[-2 * n :, 1:].reshape(2, n, 3)
    return tables[0], tables[1]

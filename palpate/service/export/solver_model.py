"""A body as a model for other solvers: elements, materials, prescribed displacements.

The plates are replaced by their effect: every node in contact with a plate is given its
displacement from our solution, only along the plate's normal if plates are flat, aligned with an
axis and frictionless (it is then free tangentially), and otherwise in all three components. Both
solvers then compute the rest of the body.

Features that other solvers lack are also removed from our model, see `comparable`; the header of
the file gives the distance by which that moves the nodes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from palpate.service.export.solved_mesh_files import SolvedBody
from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, Tissue
from palpate.workers.mechanics.fem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.element_energy import deformation_gradients
from palpate.workers.mechanics.fem.external_forces import stated_springs

# With more materials than this, constants are rounded to fewer digits.
MOST_MATERIALS = 300
# The compared solution is more accurate than a search needs.
TOLERANCE_MM = 1e-4


@dataclass(frozen=True, eq=False)
class Fibres:
    """Fibres of one family in elements of one material.

    Parameters
    ----------
    eta_mpa : float
    direction : ndarray, shape (3,)
        Unit vector.
    elements : ndarray, shape (k,)
        Elements in which they act in the final state: for tension-only fibres, the stretched ones.
    """

    eta_mpa: float
    direction: FloatArray
    elements: IntArray


@dataclass(frozen=True, eq=False)
class Material:
    """Elements of one material.

    Parameters
    ----------
    name : str
        Name of its tissue, in capitals, numbered if a tissue has several materials.
    elements : ndarray, shape (k,)
        Rows of the mesh.
    mu_mpa, kappa_mpa, c2_mpa : float
        ``mu/2 (I1bar - 3) + c2 (I1bar - 3)^2 + kappa/2 (J - 1)^2``.
    fibres : tuple of Fibres
        Its fibre families.
    """

    name: str
    elements: IntArray
    mu_mpa: float
    kappa_mpa: float
    c2_mpa: float
    fibres: tuple[Fibres, ...]


@dataclass(frozen=True, eq=False)
class SolverModel:
    """A body of standard linear tetrahedra, at rest and with its loads.

    Parameters
    ----------
    title : str
    nodes : ndarray, shape (n, 3)
        The stress-free shape, in mm.
    tets : ndarray, shape (m, 4)
    materials : tuple of Material
        Each element belongs to exactly one material.
    prescribed : ndarray of bool, shape (n, 3)
        Components with a prescribed displacement.
    displacement_mm : ndarray, shape (n, 3)
        The prescribed displacements; elsewhere our solution.
    stated_springs_n_per_mm : ndarray, shape (n, 3)
        Springs of the chest wall and of attachments to the ground; zero if there is none.
    drift_n_per_mm : ndarray, shape (n, 3)
        Springs of negligible stiffness that hold a body in place between frictionless plates.
    force_n : ndarray, shape (n, 3)
        Dead forces on the nodes, including weight.
    isochoric_fibre : bool
        Whether fibres are measured by I4bar instead of I4.
    tension_only : bool
        Whether fibres act in tension only.
    constants : mapping of str to float
        For the header.
    remarks : tuple of str
        Omissions and approximations, and the accuracy of the elements.
    """

    title: str
    nodes: FloatArray
    tets: IntArray
    materials: tuple[Material, ...]
    prescribed: BoolArray
    displacement_mm: FloatArray
    stated_springs_n_per_mm: FloatArray
    drift_n_per_mm: FloatArray
    force_n: FloatArray
    isochoric_fibre: bool
    tension_only: bool
    constants: Mapping[str, float]
    remarks: tuple[str, ...]


def comparable(problem: Problem) -> Problem:
    """Return the closest problem that other solvers can represent.

    Raises
    ------
    InputError
        If a tissue has a law that the files cannot represent.
    """
    laws = {t.name.lower(): type(c.law).__name__ for t, c in problem.constants.items() if c.law}
    if laws:
        others = ", ".join(f"{tissue}: {law}" for tissue, law in laws.items())
        raise InputError(
            "Files for CalculiX and FEBio, and --comparable, need neo-Hookean tissue, but this "
            f"model has other laws ({others}). Set case.model.law to neo-hookean, or export "
            ".vtu, .stl or .nrrd."
        )
    constants = {t: replace(c, growth=1.0) for t, c in problem.constants.items()}
    if problem.isochoric_fibre:  # CalculiX has no stiffening material with these fibres
        constants = {
            tissue: replace(c, stiffening=0.0) if c.fibre_mpa or c.second_fibre_mpa else c
            for tissue, c in constants.items()
        }
    return replace(
        problem,
        constants=constants,
        membrane=None,
        pressures=(),
        plain_elements=True,
        tolerance_mm=min(problem.tolerance_mm, TOLERANCE_MM),
    )


def solver_model(own: SolvedBody, told: SolvedBody) -> SolverModel:
    """Return a body as a model for other solvers.

    Parameters
    ----------
    own, told : SolvedBody
        The body with its own problem, and with the `comparable` problem.
    """
    level = told.level
    stated = stated_springs(level.model, level.problem)
    return SolverModel(
        title=told.title,
        nodes=level.model.nodes,
        tets=level.model.elements.tets,
        materials=tuple(_materials(told)),
        prescribed=_prescribed(told),
        displacement_mm=told.positions_mm - level.model.nodes,
        stated_springs_n_per_mm=stated,
        drift_n_per_mm=level.springs - stated,
        force_n=level.dead_load,
        isochoric_fibre=level.problem.isochoric_fibre,
        tension_only=not level.problem.literal_fibre,
        constants=told.constants,
        remarks=tuple(_remarks(own, told)),
    )


def contact_nodes(body: SolvedBody) -> BoolArray:
    """Return a mask of the nodes in contact with a plate, shape (n,)."""
    touching = np.zeros(len(body.level.model.nodes), np.bool_)
    for contact in body.level.plate_contacts(body.solved.states[-1], body.solved.stage):
        touching[contact.nodes.index[contact.gap < 0]] = True
    return touching


def _prescribed(body: SolvedBody) -> BoolArray:
    """Return a mask of the prescribed components: held nodes and contacts, shape (n, 3)."""
    given = np.asarray(body.level.free == 0)
    given[contact_nodes(body)] |= _plate_components(body)
    return given


def _plate_components(body: SolvedBody) -> BoolArray:
    """Return a mask of the components that a plate prescribes, shape (3,)."""
    every = np.ones(3, np.bool_)
    device = body.level.problem.load.device
    if device.friction:
        return every
    normals = [p.normal for p in body.solved.stage.plates(body.solved.states[-1].travel_mm)]
    bent = any(any(plate.bow_per_mm) for plate in (device.lower, device.upper))
    aligned = np.abs(normals).min(axis=0) > 1 - 1e-9 if normals else every
    if bent or aligned.sum() != 1:
        return every
    return np.asarray(aligned)


def _materials(body: SolvedBody) -> list[Material]:
    """Group the elements by tissue and constants."""
    level = body.level
    m = level.constants.material
    tissue = level.model.fractions.argmax(axis=1)
    directions = (m.fibre * (m.eta > 0)[:, :, None]).reshape(len(tissue), -1)
    shares = np.column_stack([m.mu, m.kappa, m.c2, m.eta])
    group, count = _grouped(tissue, shares, directions)
    active = _active_fibres(body)
    made: list[Material] = []
    used: dict[str, int] = {}
    for g in range(count):
        elements = np.flatnonzero(group == g).astype(np.int32)
        name = Tissue(int(tissue[elements[0]])).name
        used[name] = used.get(name, 0) + 1
        mu, kappa, c2, *eta = (float(value) for value in shares[elements].mean(axis=0))
        along = m.fibre[elements].mean(axis=0)
        fibres = tuple(
            Fibres(stiffness, a / np.linalg.norm(a), elements[active[elements, family]])
            for family, (stiffness, a) in enumerate(zip(eta, along, strict=True))
            if stiffness > 0
        )
        number = "" if used[name] == 1 else f"_{used[name]}"
        made.append(Material(name + number, elements, mu, kappa, c2, fibres))
    return made


def _active_fibres(body: SolvedBody) -> BoolArray:
    """Return a mask of the elements in which each family acts, shape (m, families)."""
    m, elements = body.level.constants.material, body.level.model.elements
    if not m.tension_only:
        return np.ones(m.eta.shape, np.bool_)
    F = deformation_gradients(body.positions_mm, elements)
    stretched = np.einsum("eij,efj->efi", F, m.fibre)
    return np.asarray((stretched**2).sum(axis=2) > 1)


def _grouped(tissue: IntArray, shares: FloatArray, directions: FloatArray) -> tuple[IntArray, int]:
    """Assign a material number to each element, rounding to at most `MOST_MATERIALS`."""
    for digits in (9, 3, 2, 1, 0):
        # Constants by their logarithm: three digits are 0.1 %.
        size = np.round(np.log(np.maximum(shares, 1e-12)), digits)
        key = np.column_stack([tissue, size, np.round(directions, max(digits, 1))])
        _, group = np.unique(key, axis=0, return_inverse=True)
        count = int(group.max()) + 1
        if count <= MOST_MATERIALS:
            break
    return group.ravel().astype(np.int32), count


def _remarks(own: SolvedBody, told: SolvedBody) -> list[str]:
    """Return remarks on features that other solvers lack or approximate."""
    problem = own.level.problem
    away = np.linalg.norm(own.positions_mm - told.positions_mm, axis=1)
    remarks = [
        "Elements: textbook linear tetrahedra with one integration point. Palpate's elements "
        "average the volume at the nodes and lock less; both converge as the mesh is refined.",
        f"Plates: replaced by the displacements of the {int(contact_nodes(told).sum())} nodes "
        "in contact with them, " + _components_text(_plate_components(told)) + ".",
    ]
    if problem.membrane is not None:
        remarks.append(
            "Skin: left out. It is a sheet that wrinkles, with E = "
            f"{problem.membrane.young_mpa * 1e3:g} kPa, {problem.membrane.thickness_mm:g} mm thick."
        )
    if any(c.growth != 1 for c in problem.constants.values()):
        remarks.append("Growth: left out.")
    if any(c.stiffening for c in problem.constants.values()) and problem.isochoric_fibre:
        remarks.append("Strain stiffening: left out in tissues with fibres.")
    if any(problem.imaged_gravity_g):
        remarks.append("Nodes: the stress-free shape, which differs from the image.")
    if problem.pressures:
        remarks.append("Pressure on the surface: left out.")
    if problem.variations:
        remarks.append("Gradients and inclusions: in steps; elements of a step share their mean.")
    remarks.append(
        f"All this together moves the nodes by {away.mean():.2g} mm (mean; at most "
        f"{away.max():.2g} mm) compared with Palpate's own model. Palpate has solved this "
        "simplified model, too, and its solution gives the displacements at the plates: "
        "compare node by node with a .vtu from `palpate export --comparable`."
    )
    return remarks


def _components_text(components: BoolArray) -> str:
    if components.all():
        return "in all three components"
    return f"along {'xyz'[int(components.argmax())]} alone, free along the plate"

"""Export of a body as an input deck of CalculiX (`ccx`) or Abaqus, `.inp`.

CalculiX writes the neo-Hookean law as ``C10 (I1bar - 3) + (J - 1)^2 / D1`` with C10 = mu / 2 and
D1 = 2 / kappa, and Yeoh's with an additional C20. Fibres along a are a second layer of elements on
the same nodes: their ``eta/2 (I4 - 1)^2`` is ``1/2 E : C : E`` of the Green strain E with
``C = 4 eta a a a a``, because I4 - 1 = 2 a E a; CalculiX's *ELASTIC does this under NLGEOM.
Fibres measured by I4bar use its "Fiber reinforced material" (names begin with
ELASTIC_FIBER), ``k1 / (2 k2) (exp(k2 <I4bar - 1>^2) - 1)`` with k1 = eta and a small k2.

Fields have at most 20 characters, the most that CalculiX reads.
"""

import textwrap
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import numpy as np

from palpate.service.export.solver_model import Material, SolverModel
from palpate.storage.backends.atomic_files import explained, write_file

# In exp(k2 x^2): so small that the law is quadratic.
K2 = 1e-4
# The order of the 21 moduli of *ELASTIC,TYPE=ANISO: 1111, 1122, 2222, 1133, ..., 2323.
VOIGT = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
ANISO = tuple((i, j, k, l) for n, (k, l) in enumerate(VOIGT) for i, j in VOIGT[: n + 1])
# The initial number of load increments; CalculiX shortens or lengthens them.
FIRST_INCREMENT = 0.1
# Out-of-balance force over the mean nodal force, and last correction over the increment;
# the defaults of CalculiX are 5e-3 and 1e-2.
RESIDUAL, CORRECTION = 1e-5, 1e-4


def export_calculix(path: Path, model: SolverModel) -> None:
    """Write an input deck.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    numbers = count(len(model.tets) + 1)
    parts = (
        _header(path, model),
        _mesh(model),
        _materials(model),
        _fibre_layers(model, numbers),
        _springs(model, numbers),
        _step(model),
    )
    text = "".join(f"{line}\n" for part in parts for line in part)
    with explained(path):
        write_file(path, text.encode())


def _header(path: Path, model: SolverModel) -> Iterator[str]:
    yield "*HEADING"
    yield "Palpate"
    notes = [
        model.title,
        "Units: mm, N, MPa.",
        "Constants: " + ", ".join(f"{k} = {v:g}" for k, v in model.constants.items() if v),
        f"To run it: ccx -i {path.stem}. Displacements go to {path.stem}.dat and {path.stem}.frd.",
        *model.remarks,
        *_notes_on_fibres(model),
    ]
    for note in notes:
        for line in textwrap.wrap(note, 90):
            yield f"** {line}"


def _notes_on_fibres(model: SolverModel) -> Iterator[str]:
    if not any(m.fibres for m in model.materials):
        return
    if not model.isochoric_fibre:
        yield (
            "Fibres: separate elements on the same nodes, wherever fibres are stretched in the "
            "final state: 1/2 E : C : E with C = 4 eta along the fibre, which is eta/2 (I4 - 1)^2 "
            "in CalculiX. Abaqus uses *ELASTIC for another law: there, define fibres as "
            "*ANISOTROPIC HYPERELASTIC."
        )
        return
    yield (
        "Fibres: materials ELASTIC_FIBER..., which are built into CalculiX. In Abaqus write "
        "*ANISOTROPIC HYPERELASTIC, HOLZAPFEL instead."
    )


def _mesh(model: SolverModel) -> Iterator[str]:
    yield "*NODE,NSET=NALL"
    for number, (x, y, z) in enumerate(model.nodes, 1):
        yield f"{number},{x:.12g},{y:.12g},{z:.12g}"
    for material in model.materials:
        yield f"*ELEMENT,TYPE=C3D4,ELSET={material.name}"
        for element in material.elements:
            a, b, c, d = model.tets[element] + 1
            yield f"{element + 1},{a},{b},{c},{d}"


def _materials(model: SolverModel) -> Iterator[str]:
    for material in model.materials:
        inside = model.isochoric_fibre and bool(material.fibres)
        name = f"ELASTIC_FIBER_{material.name}" if inside else f"M_{material.name}"
        yield f"*MATERIAL,NAME={name}"
        yield from _matrix_with_fibres(material) if inside else _matrix(material)
        yield f"*SOLID SECTION,ELSET={material.name},MATERIAL={name}"


def _matrix(material: Material) -> Iterator[str]:
    c10, d1 = f"{material.mu_mpa / 2:.12g}", f"{2 / material.kappa_mpa:.12g}"
    if material.c2_mpa:
        yield "*HYPERELASTIC,YEOH"
        yield f"{c10},{material.c2_mpa:.12g},0.,{d1},0.,0."
    else:
        yield "*HYPERELASTIC,NEO HOOKE"
        yield f"{c10},{d1}"


def _matrix_with_fibres(material: Material) -> Iterator[str]:
    fields = [f"{material.mu_mpa / 2:.12g}", f"{2 / material.kappa_mpa:.12g}"]
    for fibres in material.fibres:
        # The third component is computed from the other two, and is positive.
        x, y, _ = fibres.direction if fibres.direction[2] >= 0 else -fibres.direction
        fields += [f"{x:.12g}", f"{y:.12g}", f"{fibres.eta_mpa:.12g}", f"{K2:g}"]
    yield f"*USER MATERIAL,CONSTANTS={len(fields)}"
    yield from _lines(fields)


def _fibre_layers(model: SolverModel, numbers: Iterator[int]) -> Iterator[str]:
    """Yield fibres measured by I4, as elements with stiffness only along the fibre."""
    if model.isochoric_fibre:
        return
    for material in model.materials:
        for family, fibres in enumerate(material.fibres, 1):
            if not len(fibres.elements):
                continue
            name = f"FIBRES{family}_{material.name}"
            yield f"*ELEMENT,TYPE=C3D4,ELSET={name}"
            for element in fibres.elements:
                a, b, c, d = model.tets[element] + 1
                yield f"{next(numbers)},{a},{b},{c},{d}"
            yield f"*MATERIAL,NAME=M_{name}"
            yield "*ELASTIC,TYPE=ANISO"
            a = fibres.direction
            moduli = [4 * fibres.eta_mpa * a[i] * a[j] * a[k] * a[l] for i, j, k, l in ANISO]
            yield from _lines([f"{value:.10g}" for value in moduli])
            yield f"*SOLID SECTION,ELSET={name},MATERIAL=M_{name}"


def _lines(fields: list[str]) -> Iterator[str]:
    """Yield lines of eight fields, the maximum for a card."""
    for first in range(0, len(fields), 8):
        yield ",".join(fields[first : first + 8])


def _springs(model: SolverModel, numbers: Iterator[int]) -> Iterator[str]:
    """Yield springs, one card for each stiffness, because each card counts as a material."""
    for axis in range(3):
        # Three digits: a node's share of the wall is no more precise.
        both = (model.stated_springs_n_per_mm + model.drift_n_per_mm)[:, axis]
        stiffness = np.array([float(f"{k:.3g}") for k in both])
        for group, n_per_mm in enumerate(np.unique(stiffness[stiffness > 0])):
            name = f"SPRING_{'XYZ'[axis]}{group}"
            yield f"*ELEMENT,TYPE=SPRING1,ELSET={name}"
            for node in np.flatnonzero(stiffness == n_per_mm):
                yield f"{next(numbers)},{node + 1}"
            yield f"*SPRING,ELSET={name}"
            yield f"{axis + 1}"
            # Without the decimal point it would be read as a degree of freedom.
            yield f"{n_per_mm:#.12g}"


def _step(model: SolverModel) -> Iterator[str]:
    yield "*STEP,NLGEOM,INC=1000"
    yield "*STATIC"
    yield f"{FIRST_INCREMENT:g},1."
    yield "*CONTROLS,PARAMETERS=FIELD"
    yield f"{RESIDUAL},{CORRECTION},,,{RESIDUAL}"
    yield "*BOUNDARY"
    for node, axis in np.argwhere(model.prescribed):
        yield f"{node + 1},{axis + 1},{axis + 1},{model.displacement_mm[node, axis]:.12g}"
    if model.force_n.any():
        yield "*CLOAD"
        for node, axis in np.argwhere(model.force_n):
            yield f"{node + 1},{axis + 1},{model.force_n[node, axis]:.12g}"
    yield "*NODE PRINT,NSET=NALL,FREQUENCY=10000"
    yield "U"
    yield "*NODE FILE,FREQUENCY=10000"
    yield "U"
    yield "*EL FILE,FREQUENCY=10000"
    yield "S,E"
    yield "*END STEP"

"""Export of a body as an input file of FEBio 4, `.feb`.

Materials are uncoupled: "Mooney-Rivlin" with c1 = mu / 2 and c2 = 0 is the neo-Hookean law, and
pressure_model 2 its ``k / 2 (J - 1)^2``. Fibres are "fiber-exp-pow", whose energy with alpha -> 0
and beta = 2 is ``ksi / 2 <I4 - 1>^2``, in a second layer of elements on the same nodes; those
measured by I4bar are "fiber-exp-pow-uncoupled" in a mixture (FEBio User's Manual, sections
"Uncoupled Materials" and "Fiber Materials"). The tests do not run FEBio.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from palpate.service.export.solver_model import Fibres, Material, SolverModel
from palpate.storage.backends.atomic_files import explained, write_file

STEPS = 10
# U(J) = k/2 (J - 1)^2, FEBio's third pressure model.
PRESSURE_MODEL = 2
# FEBio 4 interprets zero as "no exponential"; older versions divide by it.
ALPHA = 1e-20


# Attachments fade gradually: springs below this fraction of the stiffest are omitted.
FELT = 1e-3


def export_febio(path: Path, model: SolverModel) -> None:
    """Write an input file, with springs of chest wall and skin as prescribed displacements.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    model = _without_springs(model)
    root = Xml.Element("febio_spec", version="4.0")
    root.append(Xml.Comment("\n".join(["", *_notes(model), ""]).replace("--", "- -")))
    _add(root, "Module", type="solid")
    _control(root)
    _materials(root, model)
    _mesh(root, model)
    _boundary(root, model)
    _loads(root, model)
    _output(root, path)
    Xml.indent(root)
    with explained(path):
        write_file(path, Xml.tostring(root, encoding="utf-8", xml_declaration=True))


def _without_springs(model: SolverModel) -> SolverModel:
    """Prescribe the displacements of nodes with springs, and of one node to prevent drift."""
    springs = model.stated_springs_n_per_mm
    given = model.prescribed | (springs > FELT * springs.max(axis=0))
    wall = np.flatnonzero(given[:, 2])
    nodes = model.nodes[wall]
    middle = wall[np.argmin(np.linalg.norm(nodes - nodes.mean(axis=0), axis=1))]
    given[middle] |= ~given.any(axis=0)
    return replace(model, prescribed=given)


def _notes(model: SolverModel) -> Iterator[str]:
    yield f"Palpate: {model.title}"
    yield "Units: mm, N, MPa."
    yield "Constants: " + ", ".join(f"{k} = {v:g}" for k, v in model.constants.items() if v)
    yield from model.remarks
    if any(m.c2_mpa for m in model.materials):
        yield "Strain stiffening (Yeoh's c2): left out."
    if any(m.fibres for m in model.materials) and not model.tension_only:
        yield "Fibres: in tension only; Palpate's also resist compression."
    if model.stated_springs_n_per_mm.any():
        yield "Springs of chest wall and skin: replaced by the displacements of their nodes."


def _add(parent: Xml.Element, tag: str, text: object = None, **attributes: object) -> Xml.Element:
    child = Xml.SubElement(parent, tag, {k: str(v) for k, v in attributes.items()})
    if text is not None:
        child.text = f"{text:.12g}" if isinstance(text, float) else str(text)
    return child


def _triple(values: np.ndarray) -> str:
    return ",".join(f"{v:.12g}" for v in values)


def _control(root: Xml.Element) -> None:
    control = _add(root, "Control")
    _add(control, "analysis", "STATIC")
    _add(control, "time_steps", STEPS)
    _add(control, "step_size", 1 / STEPS)
    solver = _add(control, "solver", type="solid")
    _add(solver, "max_refs", 30)
    _add(solver, "symmetric_stiffness", "symmetric")
    stepper = _add(control, "time_stepper", type="default")
    _add(stepper, "max_retries", 10)
    _add(stepper, "opt_iter", 20)
    _add(stepper, "dtmin", 1e-3)
    _add(stepper, "dtmax", 1 / STEPS)


def _materials(root: Xml.Element, model: SolverModel) -> None:
    section = _add(root, "Material")
    for number, material in enumerate(model.materials, 1):
        mixed = model.isochoric_fibre and bool(material.fibres)
        kind = "uncoupled solid mixture" if mixed else "Mooney-Rivlin"
        element = _add(section, "material", id=number, name=material.name, type=kind)
        _add(element, "k", material.kappa_mpa)
        _add(element, "pressure_model", PRESSURE_MODEL)
        _matrix(_add(element, "solid", type="Mooney-Rivlin") if mixed else element, material)
        for fibres in material.fibres if mixed else ():
            _fibre_law(_add(element, "solid", type="fiber-exp-pow-uncoupled"), fibres)
    for number, (name, fibres) in enumerate(_layers(model), len(model.materials) + 1):
        element = _add(section, "material", id=number, name=name, type="fiber-exp-pow")
        _fibre_law(element, fibres)


def _layers(model: SolverModel) -> Iterator[tuple[str, Fibres]]:
    """Yield the separate layers of elements for fibres measured by I4."""
    for material in () if model.isochoric_fibre else model.materials:
        for family, fibres in enumerate(material.fibres, 1):
            if len(fibres.elements):
                yield f"FIBRES{family}_{material.name}", fibres


def _fibre_law(parent: Xml.Element, fibres: Fibres) -> None:
    _add(parent, "ksi", fibres.eta_mpa)
    _add(parent, "alpha", ALPHA)
    _add(parent, "beta", 2)
    _add(parent, "fiber", _triple(fibres.direction), type="vector")


def _matrix(parent: Xml.Element, material: Material) -> None:
    _add(parent, "c1", material.mu_mpa / 2)
    _add(parent, "c2", 0)


def _mesh(root: Xml.Element, model: SolverModel) -> None:
    mesh = _add(root, "Mesh")
    nodes = _add(mesh, "Nodes", name="body")
    for number, place in enumerate(model.nodes, 1):
        _add(nodes, "node", _triple(place), id=number)
    numbers = count(1)
    parts = [(m.name, m.elements) for m in model.materials]
    parts += [(name, fibres.elements) for name, fibres in _layers(model)]
    for name, chosen in parts:
        elements = _add(mesh, "Elements", type="tet4", name=name)
        for tet in model.tets[chosen] + 1:
            _add(elements, "elem", ",".join(map(str, tet)), id=next(numbers))
    for axis in range(3):
        given = np.flatnonzero(model.prescribed[:, axis])
        if len(given):
            _add(mesh, "NodeSet", ",".join(str(n + 1) for n in given), name=f"given_{'xyz'[axis]}")
    if model.force_n.any():
        loaded = np.flatnonzero(model.force_n.any(axis=1))
        _add(mesh, "NodeSet", ",".join(str(n + 1) for n in loaded), name="loaded")
    domains = _add(root, "MeshDomains")
    for name, _ in parts:
        _add(domains, "SolidDomain", name=name, mat=name)
    _mesh_data(root, model)


def _mesh_data(root: Xml.Element, model: SolverModel) -> None:
    """Add values at the nodes of a set, numbered by their order in the set."""
    data = _add(root, "MeshData")
    for axis in range(3):
        given = model.displacement_mm[model.prescribed[:, axis], axis]
        if len(given):
            where = f"given_{'xyz'[axis]}"
            part = _add(data, "NodeData", name=f"u_{where}", node_set=where, data_type="scalar")
            for number, value in enumerate(given, 1):
                _add(part, "node", float(value), lid=number)
    if model.force_n.any():
        part = _add(data, "NodeData", name="force", node_set="loaded", data_type="vec3")
        for number, value in enumerate(model.force_n[model.force_n.any(axis=1)], 1):
            _add(part, "node", _triple(value), lid=number)


def _boundary(root: Xml.Element, model: SolverModel) -> None:
    boundary = _add(root, "Boundary")
    for axis in range(3):
        if not model.prescribed[:, axis].any():
            continue
        where = f"given_{'xyz'[axis]}"
        kind = "prescribed displacement"
        condition = _add(boundary, "bc", name=where, node_set=where, type=kind)
        _add(condition, "dof", "xyz"[axis])
        _add(condition, "value", f"u_{where}", lc=1, type="map")
        _add(condition, "relative", 0)


def _loads(root: Xml.Element, model: SolverModel) -> None:
    if model.force_n.any():
        load = _add(_add(root, "Loads"), "nodal_load", node_set="loaded", type="nodal_force")
        _add(load, "value", "force", lc=1, type="map")
    controller = _add(_add(root, "LoadData"), "load_controller", id=1, type="loadcurve")
    _add(controller, "interpolate", "LINEAR")
    points = _add(controller, "points")
    _add(points, "pt", "0,0")
    _add(points, "pt", "1,1")


def _output(root: Xml.Element, path: Path) -> None:
    output = _add(root, "Output")
    plot = _add(output, "plotfile", type="febio")
    for name in ("displacement", "stress"):
        _add(plot, "var", type=name)
    log = _add(output, "logfile")
    _add(log, "node_data", data="ux;uy;uz", file=f"{path.stem}_displacement.txt", delim=",")

"""Export of a body moving from rest to load as a series of meshes for ParaView.

The displacement of the solution is scaled from 0 to 1. These are not load steps: in between the
body is not in equilibrium, so the meshes have no stress.
"""

from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from palpate.service.export.solved_body import SolvedBody
from palpate.storage.backends.atomic import explained, write_file
from palpate.storage.stores.meshes import export_mesh
from palpate.storage.values import FloatArray, TetMesh

NOTE = "displacement scaled from 0 to 1, not load steps"
STEPS = 10


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
    root.append(Xml.Comment(f" {body.title}: {NOTE} "))
    collection = Xml.SubElement(root, "Collection")
    for step in range(STEPS + 1):
        share = step / STEPS
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

"""Blind cases made by our own solver for tests, and handmade records."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from palpate.service.blind.case_truth import CaseRecord
from palpate.service.blind.sealed_set import BlindSet, Truths
from palpate.service.blind.set_making import SetRequest, make, plan, publish, seal, unmade
from palpate.service.cluster.task_dispatch import Ending, Task, TaskCalls
from palpate.storage.values import FloatArray, Tissue, Volume
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.comparison.observation.interface_residual import interface_points
from palpate.workers.comparison.warp_volume import warp_labels
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.problem.planned_acquisition import INTERFACES
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium, equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import frame_of
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.organs.breast.breast_effects import CATALOGUE
from palpate.workers.organs.breast.scanned_case_files import read_case
from tests.service.diagnosis.compressed_breast import (
    CROSSWISE,
    PHANTOM,
    PRESSED,
    SCANS,
    TRUE_MPA,
    described,
    write_scan,
    write_settings,
)

NODES, SPACING_MM = 800, 9.0
SUSPECTS = ["plate_tilt", "segmentation_offset"]
TILT_DEG = 8.0
TILT = {
    "kind": "tilt",
    "effect": "plate_tilt",
    "family": "plate geometry",
    "parameters": {"depth_deg": TILT_DEG, "across_deg": 0.0},
}
CAUSES: dict[str, list[dict[str, Any]]] = {"control": [], "tilt": [TILT]}
SHARES = {"control": 1.0, "tilt": 1.0}
# The lower plate starts off the body, as when the bounds of the tests were measured.
LOADS = (PRESSED[1], CROSSWISE | {"lower_mm": -45})


def small_case(
    seed: int, kind: str, one_direction: bool, world: str, case: str, truth: str
) -> dict[str, Any]:
    """Replace `service.blind.set_making.make_case`: a tilted plate, or nothing."""
    loads = LOADS[:1] if one_direction else LOADS
    publish(Path(case), Path(truth), lambda *folders: write_small(kind, loads, *folders))
    return {"seconds": 0.0}


def write_small(kind: str, loads: Iterable[dict[str, Any]], case: Path, truth: Path) -> None:
    """Write scans, and the true displacements of the interfaces."""
    loads = list(loads)
    rest = generate_breast(PHANTOM, seed=5).labels
    for file in (SCANS[0], *(load["volume"] for load in loads)):
        write_scan(case / file, rest)
    write_settings(case, described(loads) | {"name": case.name})
    imaged = read_case(case)
    hierarchy = build_hierarchy(imaged.reference, nodes=NODES)
    mesh, model = hierarchy.finest.mesh, prepare(hierarchy)
    frame = frame_of(model.finest.nodes)
    points = interface_points(imaged.reference, INTERFACES, 3.0, SETTINGS.points.wall_margin_mm)
    at_points = interpolation_at_points(mesh, points.points)
    effects = {"tilt_depth": TILT_DEG} if kind == "tilt" else {}
    went = []
    for number, load in enumerate(loads):
        problem = CATALOGUE.apply(imaged.problem(number, frame)(TRUE_MPA), effects, frame)
        at = equilibrium(model, problem)
        u = at.solution.displacement_mm
        write_scan(case / load["volume"], _flattened(warp_labels(imaged.reference, mesh, u), at))
        moved = points.points + at_points @ u
        went.append(moved + _out_of_plates(moved, at) - points.points)
    (truth / "truth.json").write_text(json.dumps({"kind": kind, "causes": CAUSES[kind]}))
    np.savez(
        truth / "truth.npz",
        points=points.points,
        interface=points.interface,
        displacement=np.stack(went),
    )


def _out_of_plates(places: FloatArray, at: Equilibrium) -> FloatArray:
    """Return displacements that move places deeper than any node out of the plates: a mesh cuts the
    corners of a body, and the remaining corners would be inside a plate."""
    out = np.zeros_like(places)
    for contact in at.levels[-1].plate_contacts(at.states[-1], at.stage):
        found = contact.surface.gap(places)
        deeper = np.minimum(found.gap + contact.penetration.max(), 0.0)
        out -= deeper[:, None] * found.gradient
    return out


def _flattened(labels: Volume, at: Equilibrium) -> Volume:
    """Return the labels without voxels inside a plate."""
    steps = np.argwhere(labels.values != Tissue.AIR)
    centres = labels.origin_mm + steps[:, ::-1] * np.asarray(labels.spacing_mm)
    inside = np.linalg.norm(_out_of_plates(centres, at), axis=1) > 0
    values = labels.values.copy()
    values[tuple(steps[inside].T)] = Tissue.AIR
    return Volume(values, labels.spacing_mm, labels.origin_mm)


class Inline:
    """A dispatcher without a cluster."""

    def __init__(self, threads: int = 1) -> None:
        self.threads = threads
        self.asked: list[str] = []

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        for key, arguments in calls:
            self.asked.append(task.__name__)
            try:
                yield Ending(key, "returned", task(*arguments))
            except ArithmeticError as error:
                yield Ending(key, "crashed", None, error, f"{type(error).__name__}: {error}")


def make_set(root: Path, cases: int = 2, task: Any = small_case, **more: Any) -> BlindSet:
    """Make a sealed set in `root`, with its truths next to it."""
    blind, asked = BlindSet(root), SetRequest(cases, 7, False, NODES)
    truths = Truths(blind.truth_beside())
    entries = plan(blind, truths, asked, more.pop("shares", SHARES))
    waiting = unmade(blind, truths, entries)
    make(blind, truths, waiting, asked, Inline(), lambda: None, task)  # type: ignore[arg-type]
    seal(blind, truths, entries, asked)
    return blind


def record(group: str = "single", **changes: Any) -> CaseRecord:
    """Return the record of a tilted plate that is found, with some fields changed."""
    given: dict[str, Any] = {
        "name": "c0",
        "kind": "tilt",
        "group": group,
        "effects": ("plate_tilt",),
        "families": ("plate geometry",),
        "answer": "effect",
        "primary": ("plate_tilt",),
        "family_of": {
            "plate_tilt": "plate geometry",
            "plate_friction": "boundary",
            "inclusion": "local stiffness",
        },
        "gain": 40.0,
        "claimed_before_mm": 0.30,
        "claimed_after_mm": 0.10,
        "true_before_mm": 0.30,
        "true_after_mm": 0.10,
        "claimed_share": 0.9,
        "held_out_share": 0.8,
        "catalogue": 2,
    }
    return CaseRecord(**given | changes)


def nothing(group: str = "control", **changes: Any) -> CaseRecord:
    """Return the record of a case in which nothing is found."""
    given: dict[str, Any] = {
        "kind": group,
        "effects": (),
        "families": (),
        "answer": "no-gap",
        "primary": (),
        "gain": 0.0,
        "claimed_before_mm": 0.05,
        "claimed_after_mm": None,
        "true_before_mm": 0.10,
        "true_after_mm": None,
        "claimed_share": None,
        "held_out_share": None,
    }
    return record(group, **given | changes)

"""A small breast between plates, scanned by the solver itself: a case with a known cause."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from palpate.service.export import export_volume
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.body.phantom.phantom_settings import BreastPhantom
from palpate.workers.comparison.warp_volume import warp_labels
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import frame_of
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.organs.breast.breast_effects import CATALOGUE
from palpate.workers.organs.breast.scanned_case_files import read_case

TRUE_MPA = {"E_fat": 0.010, "E_gl": 0.032}
FORCES_N = (8.0, 20.0)
PHANTOM = BreastPhantom(
    lower_mm=30.0,
    upper_mm=45.0,
    half_width_mm=28.0,
    depth_mm=32.0,
    spacing_mm=1.5,
    glandular_fraction=0.3,
    skin_mm=0.0,
    ligament_mm=0.0,
    compartments=60,
)
SCANS = ("rest.nrrd", "pressed_8N.nrrd", "pressed_20N.nrrd")
PRESSED = tuple(
    {"volume": file, "force_n": force} for file, force in zip(SCANS[1:], FORCES_N, strict=True)
)
CROSSWISE = {
    "volume": "pressed_8N_x.nrrd",
    "force_n": 8.0,
    "axis": "x",
    "lower_mm": -30,
    "upper_mm": 45,
}


def described(pressed: Sequence[dict] = PRESSED) -> dict:
    """Return the content of case.yaml."""
    return {
        "name": "small",
        "model": {"law": "neo-hookean"},
        "wall": {"z_mm": 0.0, "wall_hold_x_kpa_per_mm": 0.2, "wall_hold_y_kpa_per_mm": 0.05},
        "plates": {"lower_mm": -28.0, "upper_mm": 28.0},
        "constants": {"E_fat_kpa": [6, 15], "E_glandular_kpa": [15, 60], "nu": 0.49},
        "noise": {"sd_mm": 0.2, "correlation_mm": 4.0, "in_scans": "loaded"},
        "scans": {
            "reference": SCANS[0],
            "labels": {"0": "air", "1": "fat", "2": "glandular"},
            "loads": list(pressed),
        },
    }


def write_settings(folder: Path, said: dict) -> None:
    """Write case.yaml."""
    (folder / "case.yaml").write_text(yaml.safe_dump(said, sort_keys=False))


def read_settings(folder: Path) -> dict:
    """Read case.yaml."""
    said: dict = yaml.safe_load((folder / "case.yaml").read_text())
    return said


def write_case(
    folder: Path,
    effects: Mapping[str, float] | None = None,
    nodes: int = 1500,
    pressed: Sequence[dict] = PRESSED,
) -> Path:
    """Write scans of a body whose model lacks only `effects`, parameters of the catalogue."""
    folder.mkdir(parents=True)
    rest = generate_breast(PHANTOM, seed=5).labels
    for file in (SCANS[0], *(one["volume"] for one in pressed)):
        write_scan(folder / file, rest)
    write_settings(folder, described(pressed))
    case = read_case(folder)
    hierarchy = build_hierarchy(case.reference, nodes=nodes)
    model = prepare(hierarchy)
    frame = frame_of(model.finest.nodes)
    for number, one in enumerate(pressed):
        problem = CATALOGUE.apply(case.problem(number, frame)(TRUE_MPA), effects or {}, frame)
        solution = solve(model, problem)
        assert solution.outcome.converged, solution.outcome.reason
        scan = warp_labels(case.reference, hierarchy.finest.mesh, solution.displacement_mm)
        write_scan(folder / one["volume"], scan)
    return folder


def write_scan(path: Path, labels: Volume) -> None:
    """Fat and glandular tissue as 1 and 2."""
    values = np.where(labels.values == Tissue.GLANDULAR, 2, (labels.values > 0).astype(np.uint8))
    path.unlink(missing_ok=True)
    export_volume(path, replace(labels, values=values.astype(np.uint8)))


def loads_exchanged(folder: Path) -> None:
    """Swap the forces of both scans."""
    said = read_settings(folder)
    first, second = said["scans"]["loads"]
    first["force_n"], second["force_n"] = 20.0, 8.0
    write_settings(folder, said)

"""Case files: public data in one folder, the truth in another.

Names, order, precision and modification times of the files do not reveal the kind of a case.
"""

import gzip
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.storage.values import Volume
from palpate.workers.blind.breast_scene import NU, WALL_SPRING_KPA_PER_MM
from palpate.workers.blind.case_body import (
    CORNERS,
    SPACING_MM,
    Body,
    Segmenter,
    body_of,
    deformed_labels,
    glandular_share,
    points_on,
    segmented,
)
from palpate.workers.blind.case_deviations import reshaped
from palpate.workers.blind.random_case import Load, Truth
from palpate.workers.blind.scene_solution import Solution, plate_starts, solve_scene
from palpate.workers.blind.solver.plate_equilibrium import topology_of
from palpate.workers.blind.solver.quadratic_mesh import fine_mesh_of
from palpate.workers.input_files import dump_yaml

POINTS = 1500  # on each interface
TIME_S = 1_000_000_000  # modification time of all files


def write_case(
    truth: Truth,
    case_folder: Path,
    truth_folder: Path,
    *,
    corners: int = CORNERS,
    spacing_mm: float = SPACING_MM,
) -> None:
    """Simulate a case and write it.

    Parameters
    ----------
    truth : Truth
    case_folder : Path
        Receives ``case.yaml`` and the segmented scans; its name is the case's id.
    truth_folder : Path
        Receives ``truth.json`` and ``truth.npz``: ``points`` (k, 3) on the true interfaces,
        ``interface`` (k,), 0 for the outline and 1 for the boundary of the glandular
        tissue, and ``displacement`` (scans, k, 3), all in mm and without noise.
    corners, spacing_mm
        See `workers.blind.case_body.body_of`.

    Raises
    ------
    NoEquilibriumError
        If the solver finds no equilibrium for a load.
    InputError
        If the body cannot be generated or meshed.
    """
    body = body_of(truth.anatomy, corners, spacing_mm)
    if truth.deviations.shape is not None:
        body = reshaped(body, truth.deviations.shape)
    solutions = solve_scene(truth.scene, topology_of(body.mesh), body.labels, truth.loads)
    scans = _scans(truth, body, solutions)
    case_folder.mkdir(parents=True, exist_ok=True)
    truth_folder.mkdir(parents=True, exist_ok=True)
    for name, labels in scans.items():
        _write_volume(case_folder / name, labels)
    case = dump_yaml(_case(truth, case_folder.name))
    (case_folder / "case.yaml").write_text(case, encoding="utf-8")
    _write_truth(truth, body, solutions, truth_folder)
    for path in (*case_folder.iterdir(), *truth_folder.iterdir(), case_folder, truth_folder):
        os.utime(path, (TIME_S, TIME_S))


def scan_names(loads: tuple[Load, ...]) -> list[str]:
    """Return the file names of the loaded scans: the axis, numbered from the smallest force."""
    count: dict[str, int] = {}
    names = []
    for load in loads:
        count[load.axis] = count.get(load.axis, 0) + 1
        names.append(f"deformed_{load.axis}{count[load.axis]}.nrrd")
    return names


def _scans(truth: Truth, body: Body, solutions: list[Solution]) -> dict[str, Volume]:
    fine, share = fine_mesh_of(body.mesh), glandular_share(body.labels)
    # One random stream per scan, separate from the streams of the truth.
    streams = np.random.SeedSequence([truth.seed, 1]).spawn(len(solutions) + 1)
    rngs = [np.random.default_rng(s) for s in streams]
    outline, gland = truth.scene.segmentation_mm
    off, nodes = truth.deviations, body.mesh.nodes
    rest = deformed_labels(share, fine, np.zeros_like(nodes))
    reader = Segmenter(
        off.noise_factor * truth.noise_sd_mm, ln_at_wall=off.ln_noise_at_wall, pieces=off.pieces
    )
    scans = {"reference.nrrd": segmented(rest, reader, rngs[0])}
    segmenter = replace(reader, outline_mm=outline, glandular_mm=gland)
    for number, (solution, rng) in enumerate(zip(solutions, rngs[1:], strict=True)):
        drawn = truth.scene.drawn(nodes + solution.displacement_mm)
        shown = off.posed(number, drawn) - nodes
        moved = deformed_labels(share, fine, shown)
        scans[scan_names(truth.loads)[number]] = segmented(moved, segmenter, rng)
    return scans


def _case(truth: Truth, name: str) -> dict[str, Any]:
    low, high = plate_starts(truth.anatomy, "y")
    return {
        "organ": "breast",
        "name": name,
        "model": {
            "law": "fibre-neo-hookean",
            "fibres": "tension-only",
            "fibre_invariant": "isochoric",
            "fibre_direction": [0, 0, 1],
        },
        "wall": {
            "z_mm": 0,
            "wall_hold_x_kpa_per_mm": WALL_SPRING_KPA_PER_MM,
            "wall_hold_y_kpa_per_mm": WALL_SPRING_KPA_PER_MM,
        },
        "plates": {"lower_mm": low, "upper_mm": high},
        "constants": {
            "E_fat_kpa": [7, 14],
            "E_glandular_kpa": [20, 50],
            "eta_fat_kpa": [50, 120],
            "eta_glandular_kpa": "eta_fat_kpa",
            "nu": NU,
        },
        "noise": {"sd_mm": truth.noise_sd_mm, "correlation_mm": 4},
        "scans": {
            "reference": "reference.nrrd",
            "labels": {0: "air", 1: "fat", 2: "glandular"},
            "loads": [
                _load(truth, load, file)
                for load, file in zip(truth.loads, scan_names(truth.loads), strict=True)
            ],
        },
    }


def _load(truth: Truth, load: Load, file: str) -> dict[str, Any]:
    lower, upper = plate_starts(truth.anatomy, load.axis)
    return {
        "volume": file,
        "force_n": load.force_n,
        "axis": load.axis,
        "lower_mm": lower,
        "upper_mm": upper,
    }


def _write_truth(truth: Truth, body: Body, solutions: list[Solution], folder: Path) -> None:
    record = truth.record() | {"plate_travel_mm": [s.travel_mm for s in solutions]}
    _write_json(folder / "truth.json", record)
    points = points_on(body.mesh, body.labels, POINTS, truth.seed)
    np.savez_compressed(
        folder / "truth.npz",
        points=points.points,
        interface=points.interface,
        displacement=np.stack([points.moved(s.displacement_mm) for s in solutions]),
    )


def _write_volume(path: Path, labels: Volume) -> None:
    """Write NRRD directly: packages write the time into the header."""
    sizes = " ".join(str(n) for n in labels.shape_xyz)
    steps = " ".join(
        f"({','.join(f'{step:g}' if i == k else '0' for k in range(3))})"
        for i, step in enumerate(labels.spacing_mm)
    )
    origin = ",".join(f"{x:.4f}" for x in labels.origin_mm)
    header = (
        "NRRD0004\ntype: uint8\ndimension: 3\nspace dimension: 3\n"
        f"sizes: {sizes}\nspace directions: {steps}\nkinds: domain domain domain\n"
        f'encoding: gzip\nspace units: "mm" "mm" "mm"\nspace origin: ({origin})\n\n'
    )
    voxels = np.ascontiguousarray(labels.values, np.uint8).tobytes()
    path.write_bytes(header.encode("ascii") + gzip.compress(voxels, mtime=0))


def _write_json(path: Path, record: dict[str, Any]) -> None:
    path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")

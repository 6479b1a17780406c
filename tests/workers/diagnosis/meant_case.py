"""A case for which only the body at rest has been scanned."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from palpate.workers.body.phantom.phantom_generation import generate_breast
from tests.service.diagnosis.compressed_breast import (
    PHANTOM,
    SCANS,
    described,
    write_scan,
    write_settings,
)

NODES, SPACING_MM = 700, 8.0


def write_meant(folder: Path, pressed: Sequence[dict], springs: bool = True) -> Path:
    """Write case.yaml and the reference scan only; optional `springs` hold the chest wall."""
    folder.mkdir(parents=True)
    said = described(pressed)
    if not springs:
        said["wall"] = {"z_mm": 0.0, "wall_hold_x_kpa_per_mm": 0.0, "wall_hold_y_kpa_per_mm": 0.0}
    write_settings(folder, said)
    write_scan(folder / SCANS[0], at_rest())
    return folder


@cache
def at_rest():
    """Return the labels of the body at rest."""
    return generate_breast(PHANTOM, seed=5).labels


def at_force(force_n: float) -> dict:
    """Return the entry in case.yaml for a planned scan."""
    return {"volume": f"not_there_{force_n:g}N.nrrd", "force_n": force_n}


def at_distance(distance_mm: float) -> dict:
    """Return the entry in case.yaml for a planned scan with plates at a given distance."""
    return {"volume": f"not_there_{distance_mm:g}mm.nrrd", "plate_distance_mm": distance_mm}
